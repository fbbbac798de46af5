"""Whether a run of rows holds the places of other rows, as from a row on that a logger lost or wrote twice.

Places y_i (m) of the tip follow the settings u_i of their rows, pressures and loads over their ranges, by

    y_i = f(u_(i + k)) in rows a <= i < b,   y_i = f(u_i) elsewhere,   f: a polynomial.

For each k, f is fitted by least squares and then a, b by the least sum of distances, in turn, from a shift of all rows on. From
f(u_i) to f(u_(i + k)) places lie at a share w of the way (least squares): 1 in these rows. A lag or hysteresis begins at no row,
and its w is less.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import combinations_with_replacement

import numpy as np

from recordings.trials import Table, counted

from .. import judgement
from ..arrays import Array, Mask
from ..findings import Finding, finding
from .levels import LOADS, pressure_gap
from .plausible import FARTHEST


def shifted(states: Table, length: float, place: Callable[[int], str] | None = None) -> Iterator[Finding]:
    """A finding if states of a robot of `length` (m) hold the places of other rows; `place` names one, from 0."""
    rows = np.flatnonzero(~states.pushed)
    table = states.take(rows)
    given = (np.linalg.norm(table.tip, axis=1) <= FARTHEST * length) & np.isfinite(table.pressures).all(axis=1)
    if given.sum() < judgement.SHIFT_LEAST:
        return
    terms = terms_of(table, min(int(given.sum()) // judgement.SHIFT_ROWS_PER_TERM, judgement.SHIFT_TERMS))
    runs = {by: _run(table.tip, given, terms, by) for by in judgement.SHIFTS}
    by = min(runs, key=lambda by: float(np.nanmean(runs[by][-1])))
    there, off, way, left = runs[by]
    known, size = np.isfinite(left), np.linalg.norm(way, axis=1)
    telling = known & there & (size > np.nanmean(left))
    if telling.sum() < judgement.SHIFT_LEAST:
        return
    w = (off * way)[telling].sum() / (size[telling] ** 2).sum()
    own, mean = (float(distance[telling].mean()) for distance in (np.linalg.norm(off, axis=1), left))
    delay = by < 0 and np.count_nonzero(known & ~there) < judgement.SHIFT_LEAST
    if (
        abs(w - 1) > judgement.SHIFT_WAY
        or np.linalg.norm(way[telling].sum(axis=0)) > judgement.SHIFT_ONE_WAY * size[telling].sum()
        or mean > (judgement.SHIFT_DELAY if delay else judgement.SHIFT_LEFT) * own
    ):
        return
    run = rows[there]
    first, last = map(place or states.place, run[[0, -1]].tolist())
    when, where, back = ("early", "below", "down") if by > 0 else ("late", "above", "up")
    yield finding("shifted", first=first, last=last, states=len(run), by=counted(abs(by), "row"), when=when, where=where,
                  back=back, own_mm=1e3 * own, mm=1e3 * mean)  # fmt: skip


def _run(tip: Array, given: Mask, terms: Array, by: int) -> tuple[Mask, Array, Array, Array]:
    """Which rows (n,) come nearer with the settings of those `by` below; places from f of their own settings, NaN where not
    `given` or without such a row, f of the others from that (n, 3), and places from f of the settings that count (n,); m."""
    every = np.arange(len(tip))
    whence = (every + by).clip(0, len(tip) - 1)
    there = usable = given & (whence == every + by)
    for _ in range(judgement.SHIFT_ROUNDS):
        settings = terms[np.where(there, whence, every)[usable]]
        f = terms @ np.linalg.lstsq(settings.T @ settings, settings.T @ tip[usable], rcond=1e-10)[0]
        off, way = np.where(usable[:, None], tip - f, np.nan), f[whence] - f
        own, other = np.linalg.norm(off, axis=1), np.linalg.norm(off - way, axis=1)
        gained = np.append(0.0, np.nancumsum(own - other))
        rise = gained - np.minimum.accumulate(gained)
        end = len(tip) - np.argmax(rise[::-1])  # the last of equal ones: places that are not known are moved with those beside
        there = (every >= np.argmin(gained[: end + 1])) & (every < end)
    return there, off, way, np.where(there, other, own)


def terms_of(table: Table, most: int) -> Array:
    """(n, terms) products of the settings that vary, up to the degree of which there are no more than `most`."""
    gaps = [*[pressure_gap(table)] * table.pressures.shape[1], *LOADS.values()]
    settings = np.nan_to_num(np.column_stack([table.pressures, *(table.get(name, 0.0) for name in LOADS)]))
    varied = settings[:, np.ptp(settings, axis=0) > gaps]
    u, out = (varied - varied.mean(axis=0)) / np.ptp(varied, axis=0), [np.ones((len(varied), 1))]
    for degree in range(1, judgement.SHIFT_DEGREE + 1):
        factors = list(combinations_with_replacement(range(u.shape[1]), degree))
        if len(out) + len(factors) <= most:
            out += [u[:, list(of)].prod(axis=1) for of in factors]
    return np.column_stack(out)
