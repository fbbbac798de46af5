"""Friction, relaxation and creep: a sequence of states walked one by one through the same solver.

A section with a memory has the bending curvature
    u = m / K_bt + u* + sum_j c_j p_j + sum_k a_k z_k / K_bt
    p_j  play (Coulomb friction in parallel with a spring): follows m at a distance of at most y_j, |m - p_j| <= y_j
    z_k  lag: tau_k dz_k/dt + z_k = m, with m held over a step of time
A friction element that slips at the moment y in parallel to a body K, its spring being k, is one play with
c = 1/K - 1/(K + k) and y_j = y (K + k) / k, the section's stiffness being K + k. The memory is kept at the middle of
each element, so elements set its resolution; within a state moments and memory are brought to agree by the passes of
the solver (`hysteresis`). Rods for which these do not close, or near buckling, are solved with the memory held, again
and again until both agree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.errors import BadCondition
from model.rods.description import Rods
from model.rods.fast.batches import full_of, share_out
from model.rods.fast.friction.hysteresis import (
    AGREED,
    COMPLIANCE,
    LAW,
    MIDDLE,
    PLAY,
    PLAYS,
    REST_AT_NO_MOMENT,
    SLOPE,
    YIELD,
    solve_state,
)
from model.rods.fast.method import FAST, Fast
from model.rods.fast.stations import stations
from model.rods.solution import AT_MARGIN, AT_RESIDUAL, RESULT, Solution, Status, no_shape
from model.rotation import to_local

Array = NDArray[np.float64]

MOST_ROUNDS = 60
"""Solves with the memory held that a rod may take."""
LEAST_CHANGE = 1e-9
"""rad: change of the bend over a rod's length that counts as none between such solves."""


@dataclass(frozen=True)
class Memory:
    """The laws of n rods with E elements (arrays broadcast to these shapes)."""

    play_compliance: Array
    """(J, n, E) 1/(N m^2)."""
    play_yield: Array
    """(J, n, E) N m."""
    lag_share: Array
    """(K, n, E) 1, of the elastic compliance."""
    lag_time: Array
    """(K, n, E) s."""

    def check(self) -> Memory:
        """Itself; raises `BadCondition` naming the field."""
        for name in ("play_compliance", "play_yield", "lag_share", "lag_time"):
            value = getattr(self, name)
            if not np.isfinite(value).all() or (value < 0).any() or (name == "lag_time" and (value <= 0).any()):
                raise BadCondition(f"{name}: must be finite and {'positive' if name == 'lag_time' else 'not negative'}")
        return self

    def spread(self, n: int, elements: int) -> Memory:
        """Itself with arrays of n rods and so many elements; raises `BadCondition` where they do not fit."""
        full: dict[str, Array] = {}
        for pair in (("play_compliance", "play_yield"), ("lag_share", "lag_time")):
            one, other = (getattr(self, name) for name in pair)
            try:
                laws = np.broadcast_shapes(one.shape, other.shape)[0]
                full |= {name: np.broadcast_to(getattr(self, name), (laws, n, elements)) for name in pair}
            except ValueError as error:
                raise BadCondition(
                    f"{pair[0]}, {pair[1]}: shapes {one.shape}, {other.shape} must fit (laws, {n}, {elements})"
                ) from error
        return Memory(**full)


def walk(states: Sequence[Rods], durations: Sequence[float], memory: Memory, method: Fast = FAST) -> list[Solution]:
    """Solve the states (each n rods, the same rods under other loads) in order; `durations` (s) lead to each state.

    All start without memory. A rod whose moments and memory do not come to agree is FAILED from there on.
    """
    memory.check()
    if len(states) != len(durations) or any(d < 0 for d in durations):
        raise BadCondition(f"durations: {len(durations)} for {len(states)} states; give one per state, not negative")
    if not states:
        return []
    n, elements = len(states[0]), states[0].form.elements
    for i, rods in enumerate(states):
        if len(rods) != n or rods.form != states[0].form:
            raise BadCondition(f"states: {len(rods)} rods of {rods.form} in state {i}, {n} of {states[0].form} before")
    memory = memory.spread(n, elements)
    play, lag = np.zeros((*memory.play_yield.shape, 2)), np.zeros((*memory.lag_time.shape, 2))
    table = np.zeros((n, elements, PLAYS + LAW * len(play)))
    lost = np.zeros(n, bool)
    found = []
    for rods, duration in zip(states, durations, strict=True):
        decay = np.exp(-duration / memory.lag_time)[..., None]
        values, status, agreed = _settle(rods, decay, memory, play, lag, table, method)
        lost |= ~agreed
        # A lost rod goes on without memory so that the others of its group are not disturbed.
        table[lost] = 0.0
        moment = table[..., MIDDLE : MIDDLE + 2]
        play = _moved(play, moment, memory.play_yield)
        lag = decay * lag + (1.0 - decay) * moment
        play[:, lost], lag[:, lost] = 0.0, 0.0
        values[lost, :AT_RESIDUAL], status[lost] = np.nan, np.maximum(status[lost], Status.FAILED)
        found.append(Solution(values, status, no_shape(n)))
    return found


def _moved(play: Array, moment: Array, limit: Array) -> Array:
    """(J, n, E, 2) N m: plays after the moment (n, E, 2) has come, at a distance of at most `limit` (J, n, E)."""
    distance = moment - play
    size = np.sqrt(distance[..., 0] ** 2 + distance[..., 1] ** 2)
    return np.asarray(moment - distance * np.minimum(1.0, limit / np.maximum(size, 1e-300))[..., None])


def _settle(
    rods: Rods, decay: Array, memory: Memory, play: Array, lag: Array, table: Array, method: Fast
) -> tuple[Array, NDArray[np.int8], NDArray[np.bool_]]:
    """One state: values and status of a solution, and which rods agree with their memory; moments go to `table`."""
    form, flex = rods.form, 1.0 / rods.field("bend_stiffness")[..., :2]
    share = memory.lag_share[..., None]
    table[..., REST_AT_NO_MOMENT : REST_AT_NO_MOMENT + 2] = (
        rods.field("rest_curvature")[..., :2] + (share * decay * lag).sum(0) * flex
    )
    table[..., SLOPE : SLOPE + 2] = (share * (1.0 - decay)).sum(0) * flex
    for j, moved in enumerate(play):
        o = PLAYS + LAW * j
        table[..., o + COMPLIANCE], table[..., o + YIELD] = memory.play_compliance[j], memory.play_yield[j]
        table[..., o + PLAY : o + PLAY + 2] = moved
    values = np.empty((len(rods), RESULT))

    def part(rows: slice) -> None:
        settings = (float(method.divisions), float(method.close))
        solve_state(rods.values[rows], form.columns, full_of(form), settings, table[rows], values[rows])

    share_out(part, len(rods), method.cores)
    good = (values[:, AT_RESIDUAL] < method.close) & (values[:, AT_MARGIN] > method.least_margin)
    status, agreed = np.zeros(len(rods), np.int8), np.ones(len(rods), bool)
    doubtful = np.flatnonzero(~good)
    if doubtful.size:
        held, moment, agreed[doubtful] = _settle_held(rods[doubtful], table[doubtful], method)
        values[doubtful], status[doubtful] = held.values, held.status
        table[doubtful, :, MIDDLE : MIDDLE + 2] = moment
    return values, status, agreed


def _rest(table: Array, moment: Array) -> Array:
    """(n, E, 2) 1/m: bending u* under the moments (n, E, 2) by the laws of `table`, see `hysteresis`."""
    rest = table[..., REST_AT_NO_MOMENT : REST_AT_NO_MOMENT + 2] + table[..., SLOPE : SLOPE + 2] * moment
    for o in range(PLAYS, table.shape[2], LAW):
        moved = _moved(table[..., o + PLAY : o + PLAY + 2], moment, table[..., o + YIELD])
        rest = rest + table[..., o + COMPLIANCE, None] * moved
    return np.asarray(rest)


def _settle_held(rods: Rods, table: Array, method: Fast) -> tuple[Solution, Array, NDArray[np.bool_]]:
    """The solution by solves with the memory held, the moments at the middles, and which rods agree with both."""
    length = rods.field("length")
    middle = np.cumsum(length, axis=1) - 0.5 * length
    loaded = Rods(rods.form, rods.values.copy())
    rest = _rest(table, np.zeros((*length.shape, 2)))
    step = np.ones((len(rods), 1, 1))
    before: Array | None = None
    for _ in range(MOST_ROUNDS):
        loaded.field("rest_curvature")[..., :2] = rest
        solution = method.solve(loaded)
        there = stations(loaded, solution, middle, method)
        moment = to_local(there.orientation, there.moment)[..., :2]
        gap = _rest(table, moment) - rest
        change = np.abs(gap * length[..., None]).sum(axis=(1, 2))
        agreed = change < max(AGREED * method.close, LEAST_CHANGE)
        if (agreed | ~np.isfinite(change)).all():
            break
        if before is not None:
            # The secant over the last round says how far to go along the gap (Aitken); it keeps the sign of progress.
            turned = before - gap
            step = (
                step * (before * turned).sum((1, 2), keepdims=True) / (turned**2).sum((1, 2), keepdims=True).clip(1e-30)
            )
            step = np.where(np.isfinite(step), np.clip(step, 0.05, 3.0), 1.0)
        rest = np.where(np.isfinite(gap), rest + step * gap, rest)
        before = gap
    return solution, moment, agreed
