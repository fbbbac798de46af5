"""Other ways solve the rods that ours solves."""

import numpy as np
import pytest

from benchmarks.peers_rod import Equations, solve_bvp_peer
from benchmarks.rod_cases import paper_rods
from model.rods import FINE, solve

RODS = paper_rods(35, seed=4)[4:9:4]


def test_equations_at_many_places_are_those_at_each() -> None:
    rod, y = Equations(RODS, 1), np.random.default_rng(1).normal(size=(18, 4))
    assert rod.slopes(y, 1) == pytest.approx(np.stack([rod.slope(each, 1) for each in y.T], axis=1))


def test_collocation_finds_the_same_tips() -> None:
    _, tips = solve_bvp_peer(RODS, 1e-6)
    assert tips == pytest.approx(solve(RODS, FINE).tip, abs=1e-8)
