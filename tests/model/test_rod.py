"""The converged rod and the paper's method against independent values, closed forms and symmetries. States and their rods:
shapes, limits, cross-section, mixing by volume, actuation, and the error table."""

import subprocess
import sys
from itertools import permutations
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from model.arrays import Array
from model.body import body_of
from model.compare import error_table
from model.condition import States, conditions
from model.errors import BadCondition
from model.robot import Robot, robot_from_dict
from model.rods import FINE, Paper, Status
from model.section import rods_of
from tests.model.rods.cases import PRESSURES, REFERENCE, Bending, solved
from tests.simulated.bench import raises


def test_tips_agree_with_the_twenty_reference_values(reference_robot: Robot, bending: Bending) -> None:
    expected = np.concatenate(list(REFERENCE.values())) * 1e-3
    result = solved(reference_robot, bending(reference_robot, list(REFERENCE), PRESSURES))
    assert (result.status == Status.SOLVED).all()
    # The values are printed to 1e-9 m.
    np.testing.assert_allclose(result.tip[:, [0, 2]], expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(result.tip[:, 1], 0, atol=1e-10)


def test_unpressurised_it_hangs_straight_and_stretches_by_its_weight(paper_robot: Robot) -> None:
    state = conditions(paper_robot, 0.0, np.zeros(9), tip_mass=0.25)
    length, area = paper_robot.length, body_of(paper_robot).mean_area
    stretch = (0.25 * 9.81 * length + 1300 * area * 9.81 * length**2 / 2) / (paper_robot.youngs_modulus * area)
    np.testing.assert_allclose(solved(paper_robot, state).tip[0], [0, 0, length + stretch], atol=1e-10)


def test_a_roll_of_forty_degrees_turns_the_tip_by_forty_degrees(paper_robot: Robot) -> None:
    pressure = np.linspace(10e3, 170e3, 9)
    result = solved(paper_robot, conditions(paper_robot, 0.15, pressure, roll=[0.0, np.deg2rad(40)]))
    c, s = np.cos(np.deg2rad(40)), np.sin(np.deg2rad(40))
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    np.testing.assert_allclose(result.tip[1], turn @ result.tip[0], atol=1e-9)
    straight, rolled = Rotation.from_quat(result.orientation, scalar_first=True).as_matrix()
    np.testing.assert_allclose(rolled, turn @ straight @ turn.T, atol=1e-9)


def test_shape_starts_at_the_base_ends_at_the_tip_and_is_given_in_the_order_asked(paper_robot: Robot, bending: Bending) -> None:
    result = solved(paper_robot, bending(paper_robot, [0.0, 0.2], [100e3]), [0.4, 0.0, 0.2, 0.1])
    np.testing.assert_allclose(result.shape[:, 0], result.tip, atol=1e-9)
    np.testing.assert_allclose(result.shape[:, 1], 0, atol=1e-10)
    assert (np.abs(result.shape[:, 2, 2]) > np.abs(result.shape[:, 3, 2])).all()


def test_random_states_of_a_soft_robot_are_all_in_equilibrium(paper_robot: Robot) -> None:
    draw = np.random.default_rng(7)
    soft = robot_from_dict({**paper_robot.model_dump(), "youngs_modulus": 3e5, "shear_modulus": 1e5, "gravity": [7.0, 0.0, -7.0]})
    n = 100
    pressure = draw.uniform(0, 400e3, (n, 9)) * (draw.uniform(size=(n, 9)) < 0.5)
    states = conditions(soft, draw.uniform(0, 0.3, n), pressure, draw.uniform(0, 0.3, n), draw.uniform(0, 6, n))
    result, batch = solved(soft, states).trusted(), rods_of(soft, states)
    thrust = Rotation.from_quat(result.orientation, scalar_first=True).apply(batch.field("tip_force"))
    np.testing.assert_allclose(result.base_force, thrust + batch.field("dead_force") + 0.4 * batch.field("load")[:, 0], atol=1e-7)


def test_a_bent_rod_is_followed_through_buckling_to_the_side_it_leans_to(paper_robot: Robot) -> None:
    upright = robot_from_dict({**paper_robot.model_dump(), "gravity": [0.0, 0.0, -9.81]})
    pressure = np.zeros(9)
    pressure[0] = 30e3
    result = solved(upright, conditions(upright, 0.0, pressure, tip_mass=4.0))
    assert result.status[0] == Status.SOLVED_IN_STEPS
    assert result.tip[0, 0] < -0.2


@pytest.mark.parametrize(("steps", "worst_mm", "median_mm"), [(100, 6.1108, 0.16306), (1000, 0.58457, 0.016102)])
def test_its_error_is_the_known_one(
    reference_robot: Robot, bending: Bending, steps: int, worst_mm: float, median_mm: float
) -> None:
    states = bending(reference_robot, list(REFERENCE), PRESSURES)
    coarse, exact = (solved(reference_robot, states, method=method).tip for method in (Paper(steps), FINE))
    off = np.linalg.norm(coarse - exact, axis=1) * 1e3
    assert off.argmax() == 4  # no spine, 250 kPa
    assert off.max() == pytest.approx(worst_mm, rel=1e-4)
    assert np.median(off) == pytest.approx(median_mm, rel=1e-4)


def test_what_shooting_cannot_close_is_flagged(paper_robot: Robot) -> None:
    wild = robot_from_dict({**paper_robot.model_dump(), "youngs_modulus": 1e4, "shear_modulus": 3e3, "area_factor": 10.0})
    result = solved(wild, conditions(wild, 0.0, np.array([2e6] + 8 * [0.0])), method=Paper())
    assert not result.converged[0] and np.isnan(result.tip[0]).all()


def test_a_step_count_without_sense_is_refused() -> None:
    raises(BadCondition, "steps: 0", Paper, steps=0)


# -- what is compiled ahead is what is asked for later
def test_rod_and_fakes_are_compiled_for_the_same_processor_whichever_is_imported_first() -> None:
    """Cached machine code is keyed by the processor's features: if these differed, one of the two would be recompiled."""
    code = "import importlib, sys; [importlib.import_module(name) for name in sys.argv[1:]]\n"
    code += "from numba.core.registry import cpu_target; print(cpu_target.target_context.codegen().magic_tuple())"
    told = {
        subprocess.run([sys.executable, "-c", code, *order], capture_output=True, text=True, check=True).stdout
        for order in permutations(("model.rods", "sim_fakes.virtual_robot"))
    }
    assert len(told) == 1 and told != {""}


# ------------------------------------------------------------------ states
NINE = np.zeros(9)


def test_single_values_hold_for_all_states_and_the_tip_mass_comes_from_the_robot(paper_robot: Robot) -> None:
    made = conditions(paper_robot, [0.0, 0.1, 0.2], NINE, roll=0.5)
    assert len(made) == 3
    assert made.pressure.shape == (3, 9)
    np.testing.assert_array_equal(made.tip_mass, [0.053] * 3)
    np.testing.assert_array_equal(made.roll, [0.5] * 3)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"spine_length": 0.41, "pressure": NINE}, ["spine_length", "0.41 m", "0.4 m"]),
        ({"spine_length": -0.01, "pressure": NINE}, ["spine_length", "-0.01 m", "negative"]),
        ({"spine_length": [0.0, np.nan], "pressure": NINE}, ["spine_length", "state 1", "finite"]),
        ({"spine_length": 0.0, "pressure": np.full(9, np.nan)}, ["pressure", "finite"]),
        ({"spine_length": 0.0, "pressure": np.full(9, 3e6)}, ["pressure", "3e+06 Pa", "unit"]),
        ({"spine_length": 0.0, "pressure": np.zeros(3)}, ["pressure", "3 columns", "9 chambers"]),
        ({"spine_length": [0.0, 0.1], "pressure": np.zeros((3, 9))}, ["spine_length", "(2,)", "(3,)"]),
        ({"spine_length": 0.0, "pressure": NINE, "tip_mass": -0.1}, ["tip_mass", "-0.1 kg"]),
        ({"spine_length": 0.1, "pressure": NINE, "force": [0.0, 1.0]}, ["force: shape (1, 2), must be (3,) or (1, 3)"]),
        ({"spine_length": "long", "pressure": NINE}, ["spine_length", "'long'", "numbers"]),
    ],
)
def test_a_bad_state_is_refused_with_field_and_value(paper_robot: Robot, arguments: dict[str, Any], words: list[str]) -> None:
    said = raises(BadCondition, None, conditions, paper_robot, **arguments)
    assert all(word in said for word in words)


def test_a_robot_without_spine_takes_no_spine_length(paper_robot: Robot) -> None:
    bare = robot_from_dict({**paper_robot.model_dump(), "spine": None})
    raises(BadCondition, "no spine", conditions, bare, 0.1, NINE)


def test_states_group_by_spine_length_within_a_tenth_of_a_millimetre(paper_robot: Robot) -> None:
    groups = {length: own.tolist() for length, own in conditions(paper_robot, [0.1, 0.05, 0.10002], NINE).by_spine_length()}
    assert groups == {0.05: [False, True, False], 0.1: [True, False, True]}


def test_rows_are_picked_together(paper_robot: Robot) -> None:
    made = conditions(paper_robot, [0.0, 0.1], np.arange(18.0).reshape(2, 9), [0.1, 0.2])
    picked = made[np.array([False, True])]
    assert len(picked) == 1
    assert picked.spine_length[0] == 0.1 and picked.pressure[0, 0] == 9.0 and picked.tip_mass[0] == 0.2


def test_mixing_by_volume_weighs_annulus_and_spine(paper_robot: Robot) -> None:
    share = (0.05**2 - 0.029**2) / 0.05**2
    expected = share * 507147 + (1 - share) * 4.389e6
    bend = rods_of(paper_robot, conditions(paper_robot, [0.30, 0.05], np.zeros(9))).field("bend_stiffness")[..., 0]
    inner, outer = bend.T / body_of(paper_robot).mean_second
    assert inner[0] == pytest.approx(expected, rel=1e-12)
    assert inner[1] < outer[1] == pytest.approx(paper_robot.youngs_modulus)


def test_torsion_carries_youngs_modulus_and_the_polar_moment_as_printed(paper_robot: Robot) -> None:
    batch = rods_of(paper_robot, conditions(paper_robot, 0.1, np.zeros(9)))
    stretch, bend = batch.field("stretch_stiffness")[0], batch.field("bend_stiffness")[0]
    assert bend[:, 2] == pytest.approx(bend[:, 0] + bend[:, 1])
    assert stretch[:, 0] == pytest.approx(stretch[:, 2] / 3, rel=1e-5)


def wrench(robot: Robot, states: States) -> tuple[Array, Array]:
    """Force (n, 3) N and moment (n, 3) N m of the pressurised chambers in the tip frame."""
    batch = rods_of(robot, states)
    return batch.field("tip_force"), batch.field("tip_moment")


def test_one_chamber_pushes_along_the_axis_and_bends_away_from_it_and_all_together_do_not_bend(paper_robot: Robot) -> None:
    pressure = np.zeros(9)
    pressure[0] = 100e3
    force, moment = wrench(paper_robot, conditions(paper_robot, 0.0, pressure))
    push = 100e3 * 1.5 * np.pi * 0.005**2
    np.testing.assert_allclose(force[0], [0, 0, push])
    np.testing.assert_allclose(moment[0], [0, -0.04 * push, 0], atol=1e-15)
    force, moment = wrench(paper_robot, conditions(paper_robot, 0.0, np.full(9, 100e3)))
    np.testing.assert_allclose(moment, 0, atol=1e-12)
    assert force[0, 2] == pytest.approx(9 * push)


def test_a_roll_of_one_pitch_equals_moving_the_pattern_by_one_chamber(paper_robot: Robot) -> None:
    pressure = np.linspace(0, 80e3, 9)
    rolled = conditions(paper_robot, 0.1, pressure, roll=np.deg2rad(40))
    moved = conditions(paper_robot, 0.1, np.roll(pressure, 1))
    for a, b in zip(wrench(paper_robot, rolled), wrench(paper_robot, moved), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)


def test_weight_and_tip_load_point_along_gravity(paper_robot: Robot) -> None:
    sideways = robot_from_dict({**paper_robot.model_dump(), "gravity": [9.81, 0.0, 0.0]})
    batch = rods_of(sideways, conditions(sideways, 0.1, np.zeros(9), tip_mass=0.2))
    np.testing.assert_allclose(batch.field("dead_force")[0], [0.2 * 9.81, 0, 0])
    np.testing.assert_allclose(batch.field("load")[0, 1], [1300 * body_of(sideways).mean_area * 9.81, 0, 0])


def test_errors_are_averaged_per_spine_length_and_axis(paper_robot: Robot) -> None:
    states = conditions(paper_robot, [0.0, 0.1, 0.0], np.zeros(9))
    model = np.zeros((3, 3))
    measured = np.array([[0.012, 0.0, -0.004], [0.003, 0.001, 0.0], [-0.004, 0.0, 0.002]])
    table = error_table(states, measured, model, 0.4)
    first, second = table.rows
    assert (first.spine_length, first.n, second.spine_length, second.n) == (0.0, 2, 0.1, 1)
    assert (first.mean_abs_x, first.mean_abs_z) == pytest.approx((0.008, 0.003))
    assert second.mean_abs_y == pytest.approx(0.001)
    assert first.worst == pytest.approx(np.hypot(0.012, 0.004))
    assert (table.worst_percent("x"), table.worst_percent("z")) == pytest.approx((2.0, 0.75))
    np.testing.assert_allclose(table.residual, measured)


@pytest.mark.parametrize(("measured", "word"), [(np.zeros((1, 3)), "measured"), (np.full((2, 3), np.nan), "not finite")])
def test_measurements_that_do_not_fit_are_refused(paper_robot: Robot, measured: np.ndarray, word: str) -> None:
    states = conditions(paper_robot, [0.0, 0.1], np.zeros(9))
    raises(BadCondition, word, error_table, states, measured, np.zeros((2, 3)), 0.4)
