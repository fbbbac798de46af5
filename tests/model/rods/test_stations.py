"""Positions, and wrenches along solved rods."""

from __future__ import annotations

import numpy as np
import pytest

from model.errors import BadCondition
from model.rods import FINE, solve, stations
from tests.model.rods.cases import LENGTH, robots
from tests.model.rods.reference import REFERENCE


def test_the_ends_are_the_base_and_the_tip() -> None:
    rods = robots(3, np.array([50e3, 150e3, 250e3]), 0.1)
    solution = solve(rods, FINE)
    found = stations(rods, solution, [0.0, LENGTH], FINE)
    assert np.abs(found.position[:, 0]).max() < 1e-9
    assert np.abs(found.position[:, 1] - solution.tip).max() < 1e-12
    assert np.abs(found.orientation[:, 0] - (1, 0, 0, 0)).max() < 1e-8
    assert np.abs(found.moment[:, 0] - solution.base_moment).max() < 1e-8
    assert np.abs(found.force[:, 0] - solution.base_force).max() < 1e-8


def test_markers_agree_with_the_slow_converged_solver() -> None:
    rods = robots(3, np.array([50e3, 150e3, 250e3]), np.array([0.0, 0.1, 0.3]), roll=0.5)
    arcs = np.array([0.05, 0.1, 0.2, 0.33])
    slow = solve(rods, REFERENCE, arc_lengths=arcs).shape
    assert np.abs(stations(rods, solve(rods, FINE), arcs, FINE).position - slow).max() < 1e-9
    assert np.abs(stations(rods, solve(rods), arcs).position - slow).max() < 1e-5


def test_arc_lengths_beyond_the_rod_are_refused() -> None:
    rods = robots(1, 100e3, 0.1)
    with pytest.raises(BadCondition, match="arc_lengths: 0.5 m of rod 0"):
        stations(rods, solve(rods), [0.5])
