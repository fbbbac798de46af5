"""The paper's method: its own error, and that refining it converges to the rod."""

from collections.abc import Callable

import numpy as np
import pytest

from model.condition import States, conditions
from model.errors import BadCondition
from model.robot import Robot, robot_from_dict
from model.rods import Paper
from tests.model.rods.cases import solved

Bending = Callable[..., States]
SPINES = [0.0, 0.1, 0.2, 0.3]
PRESSURES = [50e3, 100e3, 150e3, 200e3, 250e3]


@pytest.mark.parametrize(("steps", "worst_mm", "median_mm"), [(100, 6.1108, 0.16306), (1000, 0.58457, 0.016102)])
def test_its_error_is_the_known_one(
    reference_robot: Robot, bending: Bending, steps: int, worst_mm: float, median_mm: float
) -> None:
    states = bending(reference_robot, SPINES, PRESSURES)
    off = (
        np.linalg.norm(solved(reference_robot, states, method=Paper(steps)).tip - solved(reference_robot, states).tip, axis=1)
        * 1e3
    )
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
