"""The converged rod and the paper's method against independent values, closed forms and symmetries."""

import subprocess
import sys
from collections.abc import Callable
from itertools import permutations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from model.body import body_of
from model.condition import States, conditions
from model.errors import BadCondition
from model.robot import Robot, robot_from_dict
from model.rods import FINE, Paper, Status
from model.section import rods_of
from tests.model.rods.cases import PRESSURES, REFERENCE, solved

Bending = Callable[..., States]


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


SPINES = [0.0, 0.1, 0.2, 0.3]


@pytest.mark.parametrize(("steps", "worst_mm", "median_mm"), [(100, 6.1108, 0.16306), (1000, 0.58457, 0.016102)])
def test_its_error_is_the_known_one(
    reference_robot: Robot, bending: Bending, steps: int, worst_mm: float, median_mm: float
) -> None:
    states = bending(reference_robot, SPINES, PRESSURES)
    coarse, exact = (solved(reference_robot, states, method=method).tip for method in (Paper(steps), FINE))
    off = np.linalg.norm(coarse - exact, axis=1) * 1e3
    assert off.argmax() == 4  # no spine, 250 kPa
    assert off.max() == pytest.approx(worst_mm, rel=1e-4)
    assert np.median(off) == pytest.approx(median_mm, rel=1e-4)


def test_what_shooting_cannot_close_is_flagged(paper_robot: Robot) -> None:
    wild = robot_from_dict({**paper_robot.model_dump(), "youngs_modulus": 1e4, "shear_modulus": 3e3, "area_factor": 10.0})
    result = solved(wild, conditions(wild, 0.0, np.array([2e6] + 8 * [0.0])), method=Paper())
    assert not result.converged[0] and np.isnan(result.tip[0]).all()


def test_a_step_count_without_sense_is_refused(paper_robot: Robot) -> None:
    with pytest.raises(BadCondition, match="steps: 0"):
        Paper(steps=0)


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
