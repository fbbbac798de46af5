"""The robot in PyElastica: the same robot, with a law of its own where it is stretched."""

from collections.abc import Callable

import numpy as np
import pytest

from model.condition import States
from model.robot import Robot
from model.rods import FINE, solve
from model.section import rods_of
from model.simulators import Forward, Readings


def read(robot: Robot, at: States, elements: int = 20, **parameters: float) -> Readings:
    from model.simulators.pyelastica import PyElastica  # slow to import

    own = PyElastica(robot, elements)
    assert isinstance(own, Forward)
    changes = {name.replace("__", "."): value for name, value in parameters.items()}
    return own.predict(at, changes)


@pytest.mark.long
def test_it_hangs_and_bends_as_the_rod_does(reference_robot: Robot, bending: Callable[..., States]) -> None:
    """At 50 kPa the thrust stretches the body by 0.6 %, and its law differs from the rod's by three times as much."""
    at = bending(reference_robot, [0.0, 0.1, 0.3], [0.0, 50e3])
    tip, rod = read(reference_robot, at).tip, solve(rods_of(reference_robot, at), FINE).tip
    assert tip == pytest.approx(rod, abs=0.8e-3)
    assert np.abs(tip - rod)[at.pressure.max(axis=1) == 0].max() < 0.05e-3


@pytest.mark.long
def test_its_own_law_bends_farther_under_high_pressure(reference_robot: Robot, bending: Callable[..., States]) -> None:
    at = bending(reference_robot, [0.0], [250e3])
    tip, rod = read(reference_robot, at).tip[0], solve(rods_of(reference_robot, at), FINE).tip[0]
    assert tip[0] < rod[0] < -0.2 and abs(tip[0] - rod[0]) < 0.04


@pytest.mark.long
def test_a_larger_chamber_pushes_more(reference_robot: Robot, bending: Callable[..., States]) -> None:
    at = bending(reference_robot, [0.2], [50e3])
    more = bending(reference_robot, [0.2], [51e3])
    assert read(reference_robot, at, area__excess=0.02).tip == pytest.approx(read(reference_robot, more).tip, abs=2e-5)
