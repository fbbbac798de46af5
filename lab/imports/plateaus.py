"""Which rows of a time series make a state."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from .map_file import Plateaus, States

Array = NDArray[np.float64]

BURST = 20
"""Rows over which the time from row to row is averaged, as clocks are coarse and rows come in bursts."""


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


def _stretches(wanted: Plateaus, t: Array, filled: Array, trial: NDArray[np.int64]) -> list[Cut]:
    n = len(t)
    if not n:
        return []
    many = max(1, min(n - 1, BURST))
    step = float(np.median(t[many:] - t[:-many])) / many if n > 1 else wanted.shortest
    width = min(max(3, round(wanted.shortest / max(step, 1e-9)) | 1), 2 * n + 1)
    low = minimum_filter1d(filled, width, axis=0, mode="nearest")
    high = maximum_filter1d(filled, width, axis=0, mode="nearest")
    calm = (high - low).max(axis=1) <= wanted.steady
    # a row belongs to a plateau when a calm window holds it
    steady = maximum_filter1d(calm.astype(np.int8), width) > 0
    apart = (
        (np.abs(np.diff(filled, axis=0)).max(axis=1) > wanted.steady)
        | (np.diff(trial) != 0)
        | (np.diff(steady.astype(int)) != 0)
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
