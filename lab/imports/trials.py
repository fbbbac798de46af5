"""Which rows of a time series make a state, and which states a trial.

A trial begins where a column's count or name changes, or the robot returns to rest between two sweeps.

The rest after a descent belongs to the trial that descends, the rest before a rise to the trial that rises. A single one belongs
to the trial that rises, unless a column says otherwise.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from typing import Any

import numpy as np

from model.actuators import Words
from model.arrays import Array, Ints, Mask

from ..files.map_file import Map, Plateaus, States
from .clock import gaps
from .quantities import FileRows
from .series import Series

MOST_NOTES = 3
"""Changes away from rest that are noted one by one."""


# ------------------------------------------------------------------ states
@dataclass(frozen=True)
class Cut:
    """Rows that are averaged into one state."""

    rows: slice
    since: float
    """s from the start of the stretch to the middle of these rows."""
    at_rest: bool = False
    """All pressures are zero whatever was read."""


def cuts(states: States, t: Array, pressures: Array, trial: Ints, force: Array | None = None) -> list[Cut]:
    """Cut the rows (n) of one file into states, in their order: plateaus, single rows, or windows of each trial.

    `t` (n,) s, `pressures` (n, chambers) Pa, `trial` (n,) from 0, `force` (n, k) N on the tip."""
    if states.plateaus is not None:
        held = pressures
        if force is not None and states.plateaus.force is not None:
            # in units in which its own limit is that of the pressures
            held = np.column_stack([pressures, force * (states.plateaus.steady / states.plateaus.force)])
        return plateaus(states.plateaus, t, held, trial)
    if not states.windows:
        return [Cut(slice(i, i + 1), 0.0) for i in range(len(t))]
    cut_list = []
    for number in dict.fromkeys(trial.tolist()):
        of_trial = np.flatnonzero(trial == number)
        a, b = int(of_trial[0]), int(of_trial[-1]) + 1
        for window in states.windows:
            rows = slice(a, min(a + window.first, b)) if window.first else slice(max(b - (window.last or 1), a), b)
            cut_list.append(Cut(rows, float(t[rows].mean() - t[a]), window.at_rest))
    return cut_list


def plateaus(wanted: Plateaus, t: Array, pressures: Array, trial: Ints) -> list[Cut]:
    """Stretches in which no pressure varies by more than `steady` within `shortest`, and no row is `steady` off the next.

    Rows without a pressure neither end nor begin a stretch; a gap in time does."""
    seen = np.flatnonzero(np.isfinite(pressures).all(axis=1))
    trial = trial + np.cumsum(gaps(t))
    return [
        Cut(slice(int(seen[c.rows.start]), int(seen[c.rows.stop - 1]) + 1), c.since)
        for c in _stretches(wanted, t[seen], pressures[seen], trial[seen])
    ]


def _spread(values: Array, ends: Ints) -> Array:
    """(n,) largest difference within a column of (n, k) values, from each row up to the one before `ends`."""
    import pandas as pd

    class Ahead(pd.api.indexers.BaseIndexer):
        def get_window_bounds(
            self, num_values: Any = 0, min_periods: Any = None, center: Any = None, closed: Any = None, step: Any = None
        ) -> tuple[Ints, Ints]:
            return np.arange(len(ends)), ends

    ahead = pd.DataFrame(values).rolling(Ahead(), min_periods=1)
    return np.asarray((ahead.max() - ahead.min()).max(axis=1))


def _stretches(wanted: Plateaus, t: Array, filled: Array, trial: Ints) -> list[Cut]:
    """Plateaus of rows that all have pressures, `filled` (n, chambers) Pa at `t` (n,) s; rows of them that are averaged."""
    n = len(t)
    if not n:
        return []
    step = float(np.median(np.diff(t))) if n > 1 else wanted.shortest
    # by time rather than by rows: clocks are coarse, rows come in bursts, and some are missing
    ends = np.searchsorted(t, t + wanted.shortest * (1 + 1e-9), side="right")
    ends = np.clip(np.maximum(ends, np.arange(n) + 3), None, n)
    calm = (_spread(filled, ends) <= wanted.steady) & (t[-1] - t >= wanted.shortest * (1 - 1e-6) - step)
    # a row is steady if a calm window, from its first row to that before its end, holds it
    steady = np.cumsum(calm - np.bincount(ends[calm], minlength=n + 1)[:n]) > 0
    apart = (
        (np.abs(np.diff(filled, axis=0)).max(axis=1) > wanted.steady) | (np.diff(trial) != 0) | (np.diff(steady.astype(int)) != 0)
    )
    edges = [0, *(np.flatnonzero(apart) + 1).tolist(), n]
    plateaus_found = []
    for a, b in zip(edges, edges[1:], strict=False):
        long = float(t[b - 1] - t[a])
        if not steady[a] or b - a < 2 or long < wanted.shortest * (1 - 1e-6) - step:
            continue
        skip = int(np.searchsorted(t[a:b], t[a] + wanted.settling)) if long > wanted.shortest + wanted.settling else 0
        rows = slice(a + skip, b)
        plateaus_found.append(Cut(rows, float(t[rows].mean() - t[a])))
    return plateaus_found


# ------------------------------------------------------------------ trials
@dataclass(frozen=True)
class Change:
    """Another value of a column."""

    key: str
    """Of the map, which names the column."""
    column: str
    first: int
    """The first row that may hold the new value, from 0: cells up to `row` are missing."""
    row: int
    """The first row that holds it."""
    before: str
    after: str


@dataclass(frozen=True)
class Stages:
    """m times at which pressures stood, in their order: plateaus, or all rows."""

    begin: Ints
    """(m,) first row of each."""
    start: Ints
    """(m,) first row at which the robot has settled."""
    stop: Ints
    """(m,) row behind each."""
    pressures: Array
    """(m, chambers) Pa"""
    resting: Mask
    """(m,) without pressure."""

    @classmethod
    def of(cls, q: FileRows, states: States, below: float) -> Stages:
        """Of rows not cut into trials yet; at rest no pressure is above `below` (Pa), as in the row before where one lacks."""
        start, held = np.arange(len(q.t)), q.table.pressures
        begin, stop = start, start + 1
        if states.plateaus is not None:
            whole = states.plateaus.model_copy(update={"settling": 0.0})
            rows, settled = ([cut.rows for cut in plateaus(p, q.t, held, q.run)] for p in (whole, states.plateaus))
            begin, start, stop = (
                np.array([(r.start, s.start, r.stop) for r, s in zip(rows, settled, strict=True)], np.int64).reshape(-1, 3).T
            )
            held = np.array([np.nanmean(held[r], axis=0) for r in rows]).reshape(len(rows), held.shape[1])
        known = np.isfinite(held).all(axis=1)
        resting = carried(np.where(known, np.abs(held).max(axis=1, initial=0.0) < below, np.nan)) > 0
        return cls(begin, start, stop, held, resting)

    def inflated(self, rows: int) -> Mask:
        """(rows,) in stages under pressure."""
        begun, ended = (np.bincount(of[~self.resting], minlength=rows + 1)[:rows] for of in (self.start, self.stop))
        return np.asarray(np.cumsum(begun - ended) > 0)

    def border(self, row: int) -> int:
        """The row with which a trial begins whose first settled one is `row`."""
        after = int(np.searchsorted(self.stop, row, side="right"))
        settling = after < len(self.stop) and self.begin[after] < row <= self.start[after]
        return int(self.begin[after]) if settling else row

    def around(self, of: Sequence[Change]) -> tuple[Ints, Ints]:
        """Of each change the stage before the first row that may hold the new value, and that of the first which surely does."""
        first, row = np.array([(c.first, c.row) for c in of], np.int64).reshape(-1, 2).T
        before = np.searchsorted(self.start, first - 1, side="right") - 1
        return np.maximum(before, 0), np.searchsorted(self.stop, row, side="right")

    def at_rest(self, of: Sequence[Change]) -> list[bool]:
        """Whether the robot rests at each change, just before it or just after it."""
        before, after = self.around(of)
        resting = np.concatenate([[0], np.cumsum(self.resting)])
        return (resting[np.minimum(after + 1, len(self.resting))] > resting[before]).tolist()

    def within(self, of: Sequence[Change], spans: Sequence[tuple[int, int]]) -> list[list[Change]]:
        """For each span [a, b) of stages the changes in it, or just before or behind it."""
        before, after = self.around(of)
        return [[of[k] for k in np.flatnonzero((before < b) & (after >= a)).tolist()] for a, b in spans]

    def returns(self) -> list[tuple[int, int]]:
        """Stages [a, b) at rest between two sweeps."""
        edges = [0, *(np.flatnonzero(np.diff(self.resting.astype(int))) + 1).tolist(), len(self.resting)]
        return [(a, b) for a, b in pairwise(edges) if 0 < a < b < len(self.resting) and self.resting[a]]


def trials_of_rows(series: Series, q: FileRows, wanted: Map, drive: Words) -> tuple[Ints, tuple[str, ...]]:
    """(n,) trial of each row of one file, from 0, and notes about columns that change away from rest.

    A trial begins with each run, at each return to rest (`begin: rest`), and with each change of a column that counts trials."""
    below, by_rest = wanted.trials.below, wanted.trials.begin == "rest" and "trial" not in wanted.columns
    stages = Stages.of(q, wanted.states, below)
    all_changes, returns = changes(q, stages), stages.returns()
    away = [c for c, rests in zip(all_changes, stages.at_rest(all_changes), strict=True) if not rests]
    # a column that changes away from rest as a rule is followed: it does not count what rests part
    strange = away if returns and (by_rest or 2 * len(away) < len(all_changes)) else []
    followed = [c for c in all_changes if not (by_rest and c in strange)]  # these begin trials; a note names the strange ones
    begins = np.concatenate([[False], np.diff(q.run) > 0])
    if by_rest and wanted.states.windows:
        begins[1:] |= stages.resting[1:] & ~stages.resting[:-1]
    moved = np.abs(np.diff(stages.pressures, axis=0)).max(axis=1, initial=0.0) >= below
    edges = np.flatnonzero(moved | (np.diff(stages.resting.astype(int)) != 0)) + 1
    # numbers of stages in which an inflated robot keeps its pressures
    lengths = [b - a for a, b in pairwise([0, *edges.tolist(), len(stages.resting)]) if b > a and not stages.resting[a]]
    level_stages, used = float(np.median(lengths)) if lengths else 1.0, set[Change]()
    for (a, b), here in zip(returns, stages.within(followed, returns), strict=True):
        used.update(here)
        if not here and not by_rest:
            continue
        # a rest that is longer than levels usually are ends one sweep and begins the next
        middle = (b - a) // 2 if b - a >= max(2.0, 1.5 * level_stages) and not wanted.states.windows else 0
        begins[[stages.border(row) for row in _borders(here, int(stages.begin[a + middle]))]] = True
    begins[[stages.border(c.row) for c in followed if c not in used]] = True
    return np.cumsum(begins).astype(np.int64), tuple(_notes(series, q, strange, by_rest, drive))


def _borders(own: Sequence[Change], middle: int) -> list[int]:
    """Rows with which trials begin in a rest: changes of the column that changes most often, else the one nearest to `middle`."""
    most = max(own, key=lambda c: sum(o.column == c.column for o in own), default=None)
    several = [c.row for c in own if most is not None and c.column == most.column]
    if len(several) > 2:
        return several
    return [min((int(np.clip(middle, c.first, c.row)) for c in own), key=lambda r: abs(r - middle), default=middle)]


def _notes(series: Series, q: FileRows, strange: Sequence[Change], by_rest: bool, drive: Words) -> Iterator[str]:
    """Name the first changes away from rest and the pressure of the highest chamber then, and count the others."""
    for c in strange[:MOST_NOTES]:
        held = q.table.pressures[c.row]
        chamber = int(np.nanargmax(np.abs(held))) if np.isfinite(held).any() else 0
        place = f"{series.path.name}, {series.place(int(q.row[c.row]))}"
        yield (
            f"{place}: column {c.column!r} ({c.key}) changes from {c.before[:40]!r} to {c.after[:40]!r} "
            f"while p{chamber + 1} is {held[chamber] / drive.pascal:.3g} {drive.unit}, not at rest: {'no' if by_rest else 'a'} "
            "trial begins there; correct the cell, or name another column"
        )
    if len(strange) > MOST_NOTES:
        yield f"{series.path.name}: {len(strange) - MOST_NOTES} further changes of columns contradict the rests"


def changes(q: FileRows, stages: Stages) -> list[Change]:
    """The changes of all columns that count trials or repeats or name what is inflated.

    A word that stands only at rest names nothing there, if it comes again and again ("none" between the chambers' names) or if
    the same word precedes and follows it."""
    inflated = stages.inflated(len(q.t))
    all_changes = []
    for (key, column), cells in q.counts.items():
        named = set(cells[inflated].tolist())
        runs = [w for w, _ in groupby(w for w in cells.tolist() if w)]
        nameless = {w for w, times in Counter(runs).items() if named and w not in named and times > 1}
        nameless |= {w for before, w, after in zip(runs, runs[1:], runs[2:], strict=False)
                    if named and w not in named and before == after}  # fmt: skip
        all_changes += [
            Change(key, column, before + 1, row, str(cells[before]), str(cells[row]))
            for before, row in pairwise([k for k, w in enumerate(cells.tolist()) if w and w not in nameless])
            if cells[before] != cells[row]
        ]
    return all_changes


def carried(values: Array) -> Array:
    """Values, where one is missing the one before it, at the begin the first."""
    import pandas as pd

    return np.asarray(pd.Series(values).ffill().bfill().fillna(0.0), np.float64)
