"""Friction, relaxation and creep: a sequence of states walked one by one through the same solver.

A section with a memory has the bending curvature
    u = m / K_bt + u* + sum_j c_j p_j + sum_k a_k z_k / K_bt
    p_j  play (Coulomb friction in parallel with a spring): follows m at a distance of at most y_j, |m - p_j| <= y_j
    z_k  lag: tau_k dz_k/dt + z_k = m, with m held over a step of time
A friction element that slips at the moment y in parallel to a body K, its spring being k, is one play with
c = 1/K - 1/(K + k) and y_j = y (K + k) / k, the section's stiffness being K + k. The memory is kept at the middle of
each element, so elements set its resolution; within a state moments and memory are brought to agree by iteration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from model.batch import Status
from model.errors import BadCondition
from model.statics.problem import Rods
from model.statics.shape import stations
from model.statics.solver import DEFAULT, Accuracy, Solution, solve

Array = NDArray[np.float64]

AGREED = 1e-6
"""rad: change of the bend over a rod's length in one round at which moments and memory agree."""
MOST_ROUNDS = 60


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


def walk(
    states: Sequence[Rods], durations: Sequence[float], memory: Memory, accuracy: Accuracy = DEFAULT
) -> list[Solution]:
    """Solve the states (each n rods, the same rods under other loads) in order; `durations` (s) lead to each state.

    All start without memory. A rod whose moments and memory do not come to agree is FAILED from there on.
    """
    memory.check()
    if len(states) != len(durations) or any(d < 0 for d in durations):
        raise BadCondition(f"durations: {len(durations)} for {len(states)} states; one each, not negative")
    if not states:
        return []
    shape = (len(states[0]), states[0].form.elements, 2)
    play = np.zeros((len(memory.play_yield), *shape))
    lag = np.zeros((len(memory.lag_time), *shape))
    lost = np.zeros(shape[0], bool)
    found = []
    for rods, duration in zip(states, durations, strict=True):
        solution, play, lag, agreed = _settle(rods, duration, memory, play, lag, accuracy)
        lost |= ~agreed
        if lost.any():
            values, status = solution.values.copy(), solution.status.copy()
            values[lost, :13], status[lost] = np.nan, np.maximum(status[lost], Status.FAILED)
            solution = replace(solution, values=values, status=status)
        found.append(solution)
    return found


def _settle(
    rods: Rods, duration: float, memory: Memory, play: Array, lag: Array, accuracy: Accuracy
) -> tuple[Solution, Array, Array, NDArray[np.bool_]]:
    """One state: the solution, the memory it leaves, and which rods agree with theirs."""
    length = rods.field("length")
    middle = np.cumsum(length, axis=1) - 0.5 * length
    flex = 1.0 / rods.field("bend_stiffness")[..., :2]
    decay = np.exp(-duration / memory.lag_time)[..., None]
    loaded = Rods(rods.form, rods.values.copy())
    offset = (memory.play_compliance[..., None] * play).sum(0) + (memory.lag_share[..., None] * lag).sum(0) * flex
    rest = rods.field("rest_curvature")[..., :2].copy()
    step = np.ones((len(rods), 1, 1))
    before: Array | None = None
    for _ in range(MOST_ROUNDS):
        loaded.field("rest_curvature")[..., :2] = rest + offset
        solution = solve(loaded, accuracy)
        moment = _section_moment(stations(loaded, solution, middle, accuracy).values)
        distance = moment - play
        size = np.linalg.norm(distance, axis=-1, keepdims=True)
        limit = memory.play_yield[..., None]
        new_play = moment - distance * np.minimum(1.0, limit / np.maximum(size, 1e-300))
        new_lag = decay * lag + (1.0 - decay) * moment
        wanted = (memory.play_compliance[..., None] * new_play).sum(0)
        wanted = wanted + (memory.lag_share[..., None] * new_lag).sum(0) * flex
        gap = wanted - offset
        change = np.abs(gap * length[..., None]).sum(axis=(1, 2))
        agreed = change < AGREED
        if agreed.all() or not np.isfinite(change).any():
            break
        if before is not None:
            # The secant over the last round says how far to go along the gap (Aitken); it keeps the sign of progress.
            turned = before - gap
            step = (
                step * (before * turned).sum((1, 2), keepdims=True) / (turned**2).sum((1, 2), keepdims=True).clip(1e-30)
            )
            step = np.where(np.isfinite(step), np.clip(step, 0.05, 3.0), 1.0)
        offset = np.where(np.isfinite(gap), offset + step * gap, offset)
        before = gap
    return solution, new_play, new_lag, agreed


def _section_moment(values: Array) -> Array:
    """Bending moments (n, E, 2) in the section frame from stations."""
    w, r, m = values[..., 3:4], -values[..., 4:7], values[..., 10:13]
    t = 2 * np.cross(r, m)
    return (m + w * t + np.cross(r, t))[..., :2]
