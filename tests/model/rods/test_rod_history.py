"""States walked in order with friction and relaxation."""

from __future__ import annotations

import numpy as np
import pytest

from model.errors import BadCondition
from model.rods import FAST, FINE, Fast, Form, Rods, Status, rods, solve, stations
from model.rods.fast.friction.history import Memory, walk
from tests.model.rods.cases import robots, wild_robots

NONE = np.zeros((0, 1, 1))
COURSE = ((0.4, 0.5), (1.0, 1.0), (0.5, -0.6), (0.0, 0.3))
"""Share of the pressure and of the force at the tip, state by state."""


def pieces(pressure: float) -> Rods:
    """Two robots of 8 elements."""
    return in_pieces(robots(2, pressure, 0.1), 4)


def in_pieces(plain: Rods, parts: int) -> Rods:
    """The same rods with each element cut into so many."""
    cut = {
        name: np.repeat(plain.field(name), parts, axis=1) for name in ("bend_stiffness", "stretch_stiffness", "load")
    }
    ends = {name: plain.field(name) for name in ("tip_force", "tip_moment", "dead_force")}
    return rods(
        Form(2 * parts), len(plain), length=np.repeat(plain.field("length"), parts, axis=1) / parts, **cut, **ends
    )


def softened(found: Rods, factor: float) -> Rods:
    """The same rods with bending compliance about x and y times `factor`."""
    made = Rods(found.form, found.values.copy())
    made.field("bend_stiffness")[..., :2] /= factor
    return made


def loaded(whole: Rods, share: float, sideways: float) -> Rods:
    """The same rods with a share of the pressure and of the force at the tip."""
    made = Rods(whole.form, whole.values.copy())
    made.field("tip_force")[:] *= share
    made.field("tip_moment")[:] *= share
    made.field("dead_force")[:] *= sideways
    return made


def walk_by_plain_iteration(states: list[Rods], duration: float, memory: Memory) -> list[np.ndarray]:
    """Tips (n, 3) of each state: finely solved with the memory held until nothing changes any more."""
    length, flex = states[0].field("length"), 1.0 / states[0].field("bend_stiffness")[..., :2]
    middle, decay = np.cumsum(length, axis=1) - 0.5 * length, np.exp(-duration / memory.lag_time)[..., None]
    play, lag, tips = np.zeros((1, *flex.shape)), np.zeros((1, *flex.shape)), []
    for state in states:
        held, change = Rods(state.form, state.values.copy()), np.inf
        for _ in range(80):
            found = solve(held, FINE)
            at = stations(held, found, middle, FINE)
            w, r, m = at.orientation[..., :1], -at.orientation[..., 1:], at.moment
            moment = (m + 2 * w * np.cross(r, m) + 2 * np.cross(r, np.cross(r, m)))[..., :2]
            away = moment - play
            size = np.linalg.norm(away, axis=-1, keepdims=True).clip(1e-300)
            new_play = moment - away * np.minimum(1.0, memory.play_yield[..., None] / size)
            new_lag = decay * lag + (1.0 - decay) * moment
            rest = (memory.play_compliance[..., None] * new_play + memory.lag_share[..., None] * new_lag * flex).sum(0)
            change = np.abs(rest - held.field("rest_curvature")[..., :2]).max()
            if change < 1e-8:
                break
            held.field("rest_curvature")[..., :2] = rest
        assert change < 1e-8
        play, lag = new_play, new_lag
        tips.append(found.trusted().tip)
    return tips


def strong_memory(whole: Rods) -> Memory:
    """Friction with a quarter and relaxation with a tenth of the compliance."""
    flex = 1.0 / whole.field("bend_stiffness")[..., 0]
    one = np.ones((1, 1, 1))
    return Memory(0.25 * flex[None], 0.04 * one, 0.1 * one, 10.0 * one)


def test_two_cores_find_the_same_as_one() -> None:
    whole = in_pieces(wild_robots(40, 3), 2)
    states, memory = [loaded(whole, *at) for at in COURSE], strong_memory(whole)
    one, two = walk(states, [1.0] * 4, memory), walk(states, [1.0] * 4, memory, Fast(cores=2))
    assert all(np.array_equal(a.values, b.values) for a, b in zip(one, two, strict=True))


def test_a_walk_finds_what_iterating_to_the_end_with_the_memory_held_finds() -> None:
    # One full group of sixteen rods and a rest of four: they take different ways through the kernel.
    whole = in_pieces(wild_robots(20, 8), 2)
    states, memory = [loaded(whole, *at) for at in COURSE], strong_memory(whole)
    wanted = walk_by_plain_iteration(states, 4.0, memory)
    for accuracy, near in ((FINE, 1e-8), (FAST, 5e-6)):
        for tips, solution in zip(wanted, walk(states, [4.0] * 4, memory, accuracy), strict=True):
            assert np.abs(solution.trusted().tip - tips).max() < near


def test_a_rod_near_buckling_is_walked_too() -> None:
    whole = in_pieces(robots(2, 30e3, 0.0), 2)
    whole.field("dead_force")[:, 2] = -20.0
    states, memory = [loaded(whole, *at) for at in ((1.0, 1.0), (0.5, 0.9))], strong_memory(whole)
    wanted = walk_by_plain_iteration(states, 4.0, memory)
    for tips, solution in zip(wanted, walk(states, [4.0] * 2, memory, FINE), strict=True):
        assert (solution.status == Status.SOLVED_IN_STEPS).all() and (solution.margin < 0.5).all()
        assert np.abs(solution.tip - tips).max() < 1e-6


def test_a_rod_that_is_lost_stays_so_and_leaves_the_others_alone() -> None:
    whole = in_pieces(robots(3, 100e3, 0.1), 2)
    states = [loaded(whole, *at) for at in ((0.5, 1.0), (1.0, 1.0), (0.5, 1.0))]
    alone = walk([state[1:] for state in states], [1.0] * 3, strong_memory(whole[1:]), FINE)
    for state, push in zip(states, (0.0, -60.0, 0.0), strict=True):
        for name in ("tip_force", "tip_moment", "dead_force"):
            state.field(name)[0] = 0.0
        state.field("dead_force")[0, 2] = push
    together = walk(states, [1.0] * 3, strong_memory(whole), FINE)
    assert [bool(found.converged[0]) for found in together] == [True, False, False]
    for a, b in zip(alone, together, strict=True):
        assert b.converged[1:].all() and np.abs(a.tip - b.tip[1:]).max() < 1e-9


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
    with pytest.raises(BadCondition, match="lag_share, lag_time: shapes"):
        walk([pieces(0.0)], [1.0], Memory(NONE, NONE, np.ones((1, 3, 1)), np.ones((1, 1, 1))))
    with pytest.raises(BadCondition, match="states: 1 rods .* in state 1, 2 of"):
        walk([pieces(0.0), pieces(0.0)[:1]], [1.0, 1.0], Memory(NONE, NONE, NONE, NONE + 1.0))
    with pytest.raises(BadCondition, match="durations: 2 for 1"):
        walk([pieces(0.0)], [1.0, 1.0], Memory(NONE, NONE, NONE, NONE + 1.0))
