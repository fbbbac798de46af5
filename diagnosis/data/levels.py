"""Which readings were meant to be the same setting."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recordings.trials import Table

from ..arrays import Array, Ints, rows_by

SPINE_GAP, PRESSURE_GAP, VACUUM_GAP = 3e-3, 3e3, 10e3
"""m, Pa, Pa: readings that differ by less were meant to be the same setting. Of pressures this is the most, see below."""
MASS_GAP, FORCE_GAP, ROLL_GAP, RATE_GAP = 2e-3, 0.02, 1.0, 1e3
"""kg and N at the tip, degrees, Pa/s: the same."""
LOADS = {"spine_length": SPINE_GAP, "tip_mass": MASS_GAP, "roll_deg": ROLL_GAP, "vacuum": VACUUM_GAP,
         "force_x": FORCE_GAP, "force_y": FORCE_GAP, "force_z": FORCE_GAP}  # fmt: skip
REST = 2e3
"""Pa up to which a robot is at rest, as zeros of sensors are not exact, unless a map says another number (`trials.below`)."""
OF_RANGE, OF_SCATTER = 0.02, 3.0
"""Pressures are distinguished from this share of the highest on; never finer than this many times their scatter in a reading."""

VENTED, VENTED_SHARE = 5e3, 0.025
"""Pa, and of the highest pressure of all: a chamber that never reads more than the lesser of them in a trial is vented."""


def levels(values: Array, gap: float) -> Ints:
    """Number of each value's level: sorted values further than `gap` apart belong to different levels.

    >>> levels(np.array([0.1, 50.2, 0.0, 49.9]), 3.0)
    array([0, 1, 0, 1])
    """
    order = np.argsort(values, kind="stable")
    return np.append(0, np.cumsum(np.diff(values[order]) > gap))[np.argsort(order)]


def distinct(*columns: NDArray[np.generic]) -> Ints:
    """Number of each row of columns (n,) or (n, k) among different rows, in their order."""
    rows = np.column_stack(columns)
    order = np.lexsort(rows.T[::-1])
    return np.append(0, np.cumsum((rows[order[1:]] != rows[order[:-1]]).any(axis=1)))[np.argsort(order)]


def by_frequency(*columns: NDArray[np.generic]) -> Ints:
    """The same, 0 for the most frequent row."""
    index = distinct(*columns)
    rank = np.argsort(np.argsort(-np.bincount(index), kind="stable"), kind="stable")
    return rank[index].astype(np.int64)


def loads(states: Table) -> Ints:
    """(n, 7) level of each state's spine length, mass, roll, vacuum and forces: readings of one setting have one level."""
    return np.column_stack([levels(states.get(name, 0.0), gap) for name, gap in LOADS.items()])


def pressure_gap(trials: Table) -> float:
    """Pa within which pressures count as one setting: 3 kPa, less where the whole range is small."""
    if not len(trials):
        return PRESSURE_GAP
    pressures = trials.pressures
    every = np.column_stack([trials.get(f"sd_p{k + 1}") for k in range(pressures.shape[1])])
    scatter = every[np.arange(len(trials)), pressures.argmax(axis=1)]  # of the highest chamber's samples
    spread = scatter[np.isfinite(scatter)]
    fine = max(OF_RANGE * float(pressures.max()), OF_SCATTER * float(np.median(spread)) if spread.size else 0.0)
    return min(PRESSURE_GAP, fine) if fine > 0 else PRESSURE_GAP


def vented_at_zero(pressure: Array, trial: Ints, gap: float) -> Array:
    """(n, chambers) Pa gauge, readings with those of vented chambers set to zero.

    Vented are chambers that stay below `VENTED` throughout a trial, and all of a state whose highest is below `gap`, its
    campaign's `pressure_gap`. A chamber that is open to the room is at zero gauge; what its sensor reads there is the sensor's
    own error, which would otherwise bend the model.
    """
    out = pressure.copy()
    vented_below = min(VENTED, VENTED_SHARE * float(out.max(initial=0.0)))
    for own in rows_by(trial):
        out[own] = np.where(out[own].max(axis=0) < vented_below, 0.0, out[own])
    out[out.max(axis=1) < gap] = 0.0
    return out


def step_gap(deflection: Array, trial: Ints) -> float:
    """m within which deflections of one specimen at one length were meant to be the same."""
    moved = np.concatenate([np.diff(np.sort(deflection[own])) for own in rows_by(trial)])
    moved = moved[moved > 0]
    # of the trials' usual step: deflections that differ by less were meant to be the same
    return 0.4 * float(np.median(moved)) if moved.size else 0.0
