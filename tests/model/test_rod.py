"""The converged rod against independent values, closed forms and symmetries."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_bvp

from model.condition import States, conditions
from model.errors import BadCondition, SolveFailed
from model.robot import Robot, robot_from_dict
from model.rods import FINE, Status, solve
from model.section import body_area, rods_of
from tests.model.rods.cases import solved

PRESSURES = [50e3, 100e3, 150e3, 200e3, 250e3]
# Tip x and z in mm, spine 0, 10, 20, 30 cm (rows) by pressure (columns): collocation and shooting of another code
# agree on them.
REFERENCE = """
-23.265687 403.896067  -59.174490 402.057387  -108.384877 392.375035  -169.873106 368.680966  -239.509465 322.875895
-20.627443 403.591562  -51.821151 402.484340   -94.187001 395.386688  -147.155722 377.809735  -208.079651 343.984436
-13.519996 402.698634  -32.954293 403.015653   -58.705616 400.997735   -90.861718 395.098990  -128.995021 383.356816
 -7.948362 401.803812  -18.746965 402.537608   -32.568804 402.598711   -49.539904 401.597467   -69.713213 399.040631
"""
Bending = Callable[..., States]


def rotation(q: np.ndarray) -> np.ndarray:
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def test_tips_agree_with_the_twenty_reference_values(reference_robot: Robot, bending: Bending) -> None:
    expected = np.array(REFERENCE.split(), float).reshape(-1, 2) * 1e-3
    result = solved(reference_robot, bending(reference_robot, [0.0, 0.1, 0.2, 0.3], PRESSURES))
    assert (result.status == Status.SOLVED).all()
    # The values are printed to 1e-9 m.
    np.testing.assert_allclose(result.tip[:, [0, 2]], expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(result.tip[:, 1], 0, atol=1e-10)


def test_an_out_of_plane_state_agrees_with_collocation(paper_robot: Robot) -> None:
    robot = robot_from_dict({**paper_robot.model_dump(), "gravity": [3.0, -5.0, 7.0]})
    state = conditions(robot, 0.0, np.array([20, 200, 50, 0, 30, 0, 0, 150, 0]) * 1e3, tip_mass=0.2, roll=0.3)
    batch = rods_of(robot, state)

    def slope(s: np.ndarray, y: np.ndarray) -> np.ndarray:
        out = np.empty_like(y)
        for k in range(s.size):
            turn, n, m = y[3:12, k].reshape(3, 3), y[12:15, k], y[15:18, k]
            v = turn.T @ n / batch.field("stretch_stiffness")[0, 1] + [0, 0, 1]
            u = turn.T @ m / batch.field("bend_stiffness")[0, 1]
            cross = np.array([[0, -u[2], u[1]], [u[2], 0, -u[0]], [-u[1], u[0], 0]])
            out[:, k] = np.concatenate([turn @ v, (turn @ cross).ravel(), -batch.field("load")[0, 0], -np.cross(turn @ v, n)])
        return out

    def ends(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        turn = b[3:12].reshape(3, 3)
        force = b[12:15] - turn @ batch.field("tip_force")[0] - batch.field("dead_force")[0]
        return np.concatenate([a[:3], a[3:12] - np.eye(3).ravel(), force, b[15:18] - turn @ batch.field("tip_moment")[0]])

    s = np.linspace(0, 0.4, 15)
    guess = np.zeros((18, s.size))
    guess[2], guess[3:12] = s, np.eye(3).reshape(9, 1)
    collocated = solve_bvp(slope, ends, s, guess, tol=1e-7, max_nodes=3000)
    assert collocated.success
    result = solved(robot, state, s)
    np.testing.assert_allclose(result.shape[0], collocated.sol(s)[:3].T, atol=2e-7)
    np.testing.assert_allclose(rotation(result.orientation[0]), collocated.y[3:12, -1].reshape(3, 3), atol=2e-6)
    np.testing.assert_allclose(result.base_force[0], collocated.y[12:15, 0], atol=1e-5)
    np.testing.assert_allclose(result.base_moment[0], collocated.y[15:18, 0], atol=1e-5)


def test_unpressurised_it_hangs_straight_and_stretches_by_its_weight(paper_robot: Robot) -> None:
    state = conditions(paper_robot, 0.0, np.zeros(9), tip_mass=0.25)
    length, area = paper_robot.length, body_area(paper_robot)
    stretch = (0.25 * 9.81 * length + 1300 * area * 9.81 * length**2 / 2) / (paper_robot.youngs_modulus * area)
    np.testing.assert_allclose(solved(paper_robot, state).tip[0], [0, 0, length + stretch], atol=1e-10)


def test_an_end_moment_alone_gives_a_circular_arc(paper_robot: Robot) -> None:
    batch = rods_of(paper_robot, conditions(paper_robot, 0.0, np.zeros(9), tip_mass=0.0))
    bent = batch.changed(load=0.0, tip_moment=[0.0, -8.0, 0.0])
    curvature = 8.0 / batch.field("bend_stiffness")[0, 1, 1]
    angle = curvature * paper_robot.length
    expected = np.array([-(1 - np.cos(angle)), 0, np.sin(angle)]) / curvature
    np.testing.assert_allclose(solve(bent, FINE).tip[0], expected, atol=1e-10)


def test_a_small_side_load_deflects_like_a_shearing_cantilever(paper_robot: Robot) -> None:
    state = conditions(paper_robot, 0.0, np.zeros(9), tip_mass=0.0)
    batch = rods_of(robot_from_dict({**paper_robot.model_dump(), "density": 0.0}), state)
    pushed = batch.changed(dead_force=[0.01, 0.0, 0.0])
    bend, shear = batch.field("bend_stiffness")[0, 1, 1], batch.field("stretch_stiffness")[0, 1, 0]
    assert solve(pushed, FINE).tip[0, 0] == pytest.approx(0.01 * (0.4**3 / (3 * bend) + 0.4 / shear), rel=1e-4)


def test_a_roll_of_forty_degrees_turns_the_tip_by_forty_degrees(paper_robot: Robot) -> None:
    pressure = np.linspace(10e3, 170e3, 9)
    result = solved(paper_robot, conditions(paper_robot, 0.15, pressure, roll=[0.0, np.deg2rad(40)]))
    c, s = np.cos(np.deg2rad(40)), np.sin(np.deg2rad(40))
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    np.testing.assert_allclose(result.tip[1], turn @ result.tip[0], atol=1e-9)
    np.testing.assert_allclose(rotation(result.orientation[1]), turn @ rotation(result.orientation[0]) @ turn.T, atol=1e-9)


def test_base_carries_weight_and_thrust(paper_robot: Robot, bending: Bending) -> None:
    state = bending(paper_robot, [0.1], [150e3])
    batch, result = rods_of(paper_robot, state), solved(paper_robot, state)
    thrust = rotation(result.orientation[0]) @ batch.field("tip_force")[0]
    np.testing.assert_allclose(
        result.base_force[0], thrust + batch.field("dead_force")[0] + 0.4 * batch.field("load")[0, 0], atol=1e-8
    )


def test_shape_starts_at_the_base_ends_at_the_tip_and_is_given_in_the_order_asked(paper_robot: Robot, bending: Bending) -> None:
    state = bending(paper_robot, [0.0, 0.2], [100e3])
    result = solved(paper_robot, state, [0.4, 0.0, 0.2, 0.1])
    np.testing.assert_allclose(result.shape[:, 0], result.tip, atol=1e-9)
    np.testing.assert_allclose(result.shape[:, 1], 0, atol=1e-10)
    assert (np.abs(result.shape[:, 2, 2]) > np.abs(result.shape[:, 3, 2])).all()


def test_a_state_does_not_depend_on_its_neighbours_in_the_batch(paper_robot: Robot, bending: Bending) -> None:
    states = bending(paper_robot, list(np.linspace(0, 0.3, 25)), PRESSURES)
    together = solved(paper_robot, states)
    alone = solved(paper_robot, states[100:101])
    np.testing.assert_allclose(together.tip[100], alone.tip[0], atol=1e-9)


def test_random_states_of_a_soft_robot_are_all_in_equilibrium(paper_robot: Robot) -> None:
    draw = np.random.default_rng(7)
    soft = robot_from_dict({**paper_robot.model_dump(), "youngs_modulus": 3e5, "shear_modulus": 1e5, "gravity": [7.0, 0.0, -7.0]})
    n = 100
    pressure = draw.uniform(0, 400e3, (n, 9)) * (draw.uniform(size=(n, 9)) < 0.5)
    states = conditions(soft, draw.uniform(0, 0.3, n), pressure, draw.uniform(0, 0.3, n), draw.uniform(0, 6, n))
    result, batch = solved(soft, states).trusted(), rods_of(soft, states)
    for i in range(n):
        load = (
            rotation(result.orientation[i]) @ batch.field("tip_force")[i]
            + batch.field("dead_force")[i]
            + 0.4 * batch.field("load")[i, 0]
        )
        np.testing.assert_allclose(result.base_force[i], load, atol=1e-7)


@pytest.fixture
def upright(paper_robot: Robot) -> Robot:
    return robot_from_dict({**paper_robot.model_dump(), "gravity": [0.0, 0.0, -9.81]})


def test_a_straight_rod_beyond_its_buckling_load_is_flagged_and_holds_no_tip(upright: Robot) -> None:
    result = solved(upright, conditions(upright, 0.0, np.zeros(9), tip_mass=[2.0, 4.0]), [0.2])
    assert result.status.tolist() == [Status.SOLVED_IN_STEPS, Status.OTHER_BRANCH]
    assert result.converged.tolist() == [True, False]
    for values in (result.tip, result.orientation, result.base_force, result.base_moment, result.shape):
        assert np.isfinite(values[0]).all() and np.isnan(values[1]).all()
    with pytest.raises(SolveFailed, match=r"1 \(OTHER_BRANCH at"):
        result.trusted()


def test_a_bent_rod_is_followed_through_buckling_to_the_side_it_leans_to(upright: Robot) -> None:
    pressure = np.zeros(9)
    pressure[0] = 30e3
    result = solved(upright, conditions(upright, 0.0, pressure, tip_mass=4.0))
    assert result.status[0] == Status.SOLVED_IN_STEPS
    assert result.tip[0, 0] < -0.2


def test_arc_lengths_beyond_the_robot_are_refused(paper_robot: Robot) -> None:
    with pytest.raises(BadCondition, match="arc_lengths"):
        solved(paper_robot, conditions(paper_robot, 0.0, np.zeros(9)), [0.5])


def test_no_states_give_no_tips(paper_robot: Robot, bending: Bending) -> None:
    result = solved(paper_robot, bending(paper_robot, [0.0], PRESSURES)[0:0])
    assert result.tip.shape == (0, 3) and result.trusted() is result
