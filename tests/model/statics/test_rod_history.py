"""States walked in order with friction and relaxation."""

from __future__ import annotations

import numpy as np
import pytest

from model.errors import BadCondition
from model.statics import Rods, rods, solve
from model.statics.history import Memory, walk
from model.statics.problem import Form
from tests.model.statics.cases import robots

NONE = np.zeros((0, 1, 1))


def pieces(pressure: float, parts: int = 4) -> Rods:
    """A robot of 8 elements."""
    plain = robots(2, pressure, 0.1)
    cut = {
        name: np.repeat(plain.field(name), parts, axis=1) for name in ("bend_stiffness", "stretch_stiffness", "load")
    }
    ends = {name: plain.field(name) for name in ("tip_force", "tip_moment", "dead_force")}
    return rods(Form(2 * parts), 2, length=np.repeat(plain.field("length"), parts, axis=1) / parts, **cut, **ends)


def softened(found: Rods, factor: float) -> Rods:
    """The same rods with bending compliance about x and y times `factor`."""
    made = Rods(found.form, found.values.copy())
    made.field("bend_stiffness")[..., :2] /= factor
    return made


def test_friction_makes_unloading_lag_behind_loading_whatever_the_time() -> None:
    flex = 1.0 / pieces(0.0).field("bend_stiffness")[..., 0]
    memory = Memory(0.2 * flex[None], np.full((1, 1, 1), 0.15), NONE, NONE + 1.0)
    states = [pieces(p) for p in (50e3, 150e3, 50e3)]
    quick, slow = walk(states, [1.0] * 3, memory), walk(states, [100.0] * 3, memory)
    assert quick[2].tip[0, 0] < quick[0].tip[0, 0] - 1e-3
    assert np.array_equal(quick[2].tip, slow[2].tip)


def test_play_without_a_yield_is_a_softer_rod() -> None:
    flex = 1.0 / pieces(0.0).field("bend_stiffness")[..., 0]
    memory = Memory(0.2 * flex[None], np.zeros((1, 1, 1)), NONE, NONE + 1.0)
    tip = walk([pieces(100e3)], [0.0], memory)[0].trusted().tip
    # The memory is constant within an element: second order in its length.
    assert np.abs(tip - solve(softened(pieces(100e3), 1.2)).tip).max() < 5e-4


def test_a_long_hold_relaxes_to_the_softer_rod_and_a_short_one_does_not() -> None:
    memory = Memory(NONE, NONE, np.full((1, 1, 1), 0.05), np.full((1, 1, 1), 10.0))
    short, hold = walk([pieces(100e3)] * 2, [1e-6, 1e4], memory)
    assert np.abs(short.tip - solve(pieces(100e3)).tip).max() < 1e-5
    assert np.abs(hold.tip - solve(softened(pieces(100e3), 1.05)).tip).max() < 2e-4


def test_bad_memory_is_refused_by_field() -> None:
    with pytest.raises(BadCondition, match="lag_time"):
        walk([pieces(0.0)], [1.0], Memory(NONE, NONE, np.ones((1, 1, 1)), np.zeros((1, 1, 1))))
    with pytest.raises(BadCondition, match="durations: 2 for 1"):
        walk([pieces(0.0)], [1.0, 1.0], Memory(NONE, NONE, NONE, NONE + 1.0))
