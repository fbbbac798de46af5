"""The robot in SoRoMoX: the same robot, with strain that is constant within a segment."""

from collections.abc import Callable

import numpy as np
import pytest

pytest.importorskip("soromox", reason="pip install 'softlab[soromox]'")

from model.condition import States
from model.robot import Robot
from model.rods import FINE, solve
from model.section import rods_of
from model.simulators import Forward, Readings
from model.simulators.soromox import SoRoMoX


def read(robot: Robot, at: States, segments: int = 10, **parameters: float) -> Readings:
    own = SoRoMoX(robot, segments)
    assert isinstance(own, Forward)
    changes = {name.replace("__", "."): value for name, value in parameters.items()}
    return own.predict(at, changes)


def test_it_stands_where_the_rod_does(reference_robot: Robot, bending: Callable[..., States]) -> None:
    at = bending(reference_robot, [0.0, 0.1, 0.3], [0.0, 50e3, 250e3])
    tip, rod = read(reference_robot, at).tip, solve(rods_of(reference_robot, at), FINE).tip
    assert tip == pytest.approx(rod, abs=2e-3)
    assert np.linalg.norm(tip - rod, axis=1).max() > 1e-6  # its own solution


def test_it_agrees_better_with_more_segments(reference_robot: Robot, bending: Callable[..., States]) -> None:
    at = bending(reference_robot, [0.1], [200e3])
    rod = solve(rods_of(reference_robot, at), FINE).tip
    coarse, fine = (float(np.linalg.norm(read(reference_robot, at, n).tip - rod)) for n in (5, 20))
    assert fine < 0.3 * coarse and fine < 0.3e-3


def test_a_larger_chamber_pushes_more(reference_robot: Robot, bending: Callable[..., States]) -> None:
    at, more = bending(reference_robot, [0.2], [50e3]), bending(reference_robot, [0.2], [51e3])
    assert read(reference_robot, at, area__excess=0.02).tip == pytest.approx(read(reference_robot, more).tip, abs=2e-5)
