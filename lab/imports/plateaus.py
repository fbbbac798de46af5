"""Which rows of a time series make a state."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .map_file import Plateaus, States

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Cut:
    """Rows that are averaged into one state."""

    rows: slice
    since: float
    """s from the start of the stretch to the middle of these rows."""
    at_rest: bool = False
    """All pressures are zero whatever was read."""


def cuts(states: States, t: Array, pressures: Array, trial: NDArray[np.int64], force: Array | None = None) -> list[Cut]:
    """The states of one file, in the order of its rows; `force` (n, k) N on the tip."""
    if states.plateaus is not None:
        held = pressures
        if force is not None and states.plateaus.force is not None:
            held = np.column_stack([pressures, force * (states.plateaus.steady / states.plateaus.force)])
        return plateaus(states.plateaus, t, held, trial)
    if not states.windows:
        return [Cut(slice(i, i + 1), 0.0) for i in range(len(t))]
    out = []
    for one in dict.fromkeys(trial.tolist()):
        own = np.flatnonzero(trial == one)
        a, b = int(own[0]), int(own[-1]) + 1
        for window in states.windows:
            rows = slice(a, min(a + window.first, b)) if window.first else slice(max(b - (window.last or 1), a), b)
            out.append(Cut(rows, float(t[rows].mean() - t[a]), window.at_rest))
    return out


def plateaus(wanted: Plateaus, t: Array, pressures: Array, trial: NDArray[np.int64]) -> list[Cut]:
    """Stretches in which no pressure varies by more than `steady` within `shortest`, and no row is `steady` off the next.

    Rows without a pressure neither end nor begin a stretch.
    """
    seen = np.flatnonzero(np.isfinite(pressures).all(axis=1))
    return [
        Cut(slice(int(seen[c.rows.start]), int(seen[c.rows.stop - 1]) + 1), c.since)
        for c in _stretches(wanted, t[seen], pressures[seen], trial[seen])
    ]


def _spread(values: Array, ends: NDArray[np.int64]) -> Array:
    """(n,) largest difference within a column of (n, k) values, from each row up to the one before `ends`."""
    n = len(values)
    lengths = ends - np.arange(n)
    low, high, out = values, values, np.zeros(n)
    size = 1
    while True:  # `low` and `high` are over `size` rows; two such stretches cover up to twice as many
        own = np.flatnonzero((lengths >= size) & (lengths < 2 * size))
        last = ends[own] - size
        out[own] = (np.maximum(high[own], high[last]) - np.minimum(low[own], low[last])).max(axis=1)
        if 2 * size > n:
            return out
        low, high = np.minimum(low[:-size], low[size:]), np.maximum(high[:-size], high[size:])
        size *= 2


def _stretches(wanted: Plateaus, t: Array, filled: Array, trial: NDArray[np.int64]) -> list[Cut]:
    n = len(t)
    if not n:
        return []
    step = float(np.median(np.diff(t))) if n > 1 else wanted.shortest
    # by time rather than by rows: clocks are coarse, rows come in bursts, and some are missing
    ends = np.searchsorted(t, t + wanted.shortest * (1 + 1e-9), side="right")
    ends = np.clip(np.maximum(ends, np.arange(n) + 3), None, n)
    calm = (_spread(filled, ends) <= wanted.steady) & (t[-1] - t >= wanted.shortest * (1 - 1e-6) - step)
    # a row belongs to a plateau when a calm window holds it
    begun, ended = np.zeros(n + 1, np.int64), np.zeros(n + 1, np.int64)
    begun[:n] = calm
    np.add.at(ended, ends[calm], 1)
    steady = np.cumsum(begun - ended)[:n] > 0
    apart = (
        (np.abs(np.diff(filled, axis=0)).max(axis=1) > wanted.steady) | (np.diff(trial) != 0) | (np.diff(steady.astype(int)) != 0)
    )
    edges = [0, *(np.flatnonzero(apart) + 1).tolist(), n]
    out = []
    for a, b in zip(edges, edges[1:], strict=False):
        long = float(t[b - 1] - t[a])
        if not steady[a] or b - a < 2 or long < wanted.shortest * (1 - 1e-6) - step:
            continue
        skip = int(np.searchsorted(t[a:b], t[a] + wanted.settling)) if long > wanted.shortest + wanted.settling else 0
        rows = slice(a + skip, b)
        out.append(Cut(rows, float(t[rows].mean() - t[a])))
    return out
