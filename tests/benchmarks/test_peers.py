"""Collocation solves the rods that ours solves."""

import pytest

from benchmarks.peers import collocation
from benchmarks.rod_cases import paper_rods
from model.rods import FINE, solve

RODS = paper_rods(35, seed=4)[4:9:4]


def test_collocation_finds_the_same_tips() -> None:
    assert collocation(RODS, 1e-6) == pytest.approx(solve(RODS, FINE).tip, abs=1e-8)
