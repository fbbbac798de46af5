"""Positions, wrenches and energy along solved rods."""

from __future__ import annotations

import numpy as np
import pytest

from model.errors import BadCondition
from model.rods import FINE, REFERENCE, Form, energy, sensitivities, solve, stations, strains
from tests.model.rods.cases import LENGTH, robots


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


@pytest.mark.parametrize("series", [None, (0.03, 0.5, 1.0), (-0.01, -2.0, -1.0)])
def test_the_work_of_a_dead_load_is_the_energy_it_leaves(series: tuple[float, ...] | None) -> None:
    rods = robots(1, 0.0, 0.1, tip_weight=0.0, weight=0.0, form=Form(elements=2, full=series is not None))
    if series is not None:
        rods.field("series")[:] = series
    rods.field("dead_force")[:] = (3.0, 1.0, 8.0)
    load = np.zeros((1, 1, rods.form.width))
    rods.form.view(load, "dead_force")[0, 0] = rods.field("dead_force")[0]
    # dW/dF = F . dp/dF along growing loads (Castigliano), integrated by Gauss's rule.
    points, weights = np.polynomial.legendre.leggauss(12)
    work = 0.0
    for x, w in zip(0.5 * (1 + points), 0.5 * weights, strict=True):
        part = robots(1, 0.0, 0.1, tip_weight=0.0, weight=0.0, form=rods.form)
        part.values[:] = rods.values
        part.field("dead_force")[:] *= x
        gained = sensitivities(part, solve(part, FINE), load, FINE).tip[0, 0]
        work += w * float(gained @ part.field("dead_force")[0])
    assert energy(rods, solve(rods, FINE), FINE)[0] == pytest.approx(work, rel=1e-7)


def test_arc_lengths_beyond_the_rod_are_refused() -> None:
    rods = robots(1, 100e3, 0.1)
    with pytest.raises(BadCondition, match="arc_lengths: 0.5 m of rod 0"):
        stations(rods, solve(rods), [0.5])


def test_of_no_rods_there_are_no_strains_and_no_energies() -> None:
    none = robots(2, 100e3, 0.1)[np.zeros(2, bool)]
    solution = solve(none)
    assert strains(none, solution).shape == (0, none.form.elements)
    assert energy(none, solution).shape == (0,)
