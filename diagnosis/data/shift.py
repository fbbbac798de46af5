"""Whether a run of rows holds the places of other rows, as from a row on that a logger lost or wrote twice.

Places y_i (m) of the tip follow the settings u_i of their rows, pressures and loads over their ranges, by

    y_i = f(u_(i + k)) in rows a <= i < b,   y_i = f(u_i) elsewhere,   f: a polynomial,

with the a, b, k and f of the least squares. From f(u_i) to f(u_(i + k)) places lie at a share w of the way (least squares): 1 in
these rows, 0 elsewhere. A lag or hysteresis begins at no row, and its w is in between.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import combinations, combinations_with_replacement

import numpy as np

from recordings.trials import Table, counted

from .. import judgement
from ..arrays import Array, Ints, rms
from ..findings import Finding, finding
from .levels import FORCE_GAP, LOADS, pressure_gap
from .plausible import FARTHEST


def shifted(states: Table, length: float, place: Callable[[int], str] | None = None) -> Iterator[Finding]:
    """A finding if states of a robot of `length` (m) hold the places of other rows; `place` names one, from 0."""
    rows, most = np.flatnonzero(~states.pushed), judgement.SHIFT_MOST
    table, every, none = states.take(rows), np.arange(len(rows)), np.full(len(rows), most)
    tip, given = table.tip, np.linalg.norm(table.tip, axis=1) <= FARTHEST * length
    if not given.any():
        return
    terms, seen = _terms(table, int(given.sum()) // judgement.SHIFT_ROWS_PER_TERM), given
    whence = every + np.arange(-most, most + 1)[:, None]  # (shifts, n) row whose settings count
    known, whence = (whence >= 0) & (whence < len(every)), whence.clip(0, len(every) - 1)

    def fitted(shift: Ints) -> tuple[Array, Array]:
        """f (n, 3) of each row's settings, where places are those of a shift (n,), and squares (shifts, n) that each leaves."""
        use = seen & known[shift, every]
        own = terms[whence[shift, every][use]]
        f = terms @ np.linalg.lstsq(own.T @ own, own.T @ tip[use], rcond=1e-10)[0]
        return f, np.where(known & given, ((tip - f[whence]) ** 2).sum(axis=2), 0.0)

    ends = combinations(np.linspace(0, len(every), judgement.SHIFT_PARTS + 1).astype(int).tolist(), 2)
    starts = [np.where((every >= a) & (every < b), k, most) for a, b in ends for k in range(2 * most + 1) if k != most]
    shift = min(starts, key=lambda shift: float(fitted(shift)[1][shift, every].sum()))
    for _ in range(judgement.SHIFT_ROUNDS):
        f, squares = fitted(shift)
        least = np.where(known, squares, np.inf).min(axis=0)  # a place that the settings of no row near it explain says nothing
        seen = given & (least <= judgement.SHIFT_STRAY**2 * np.median(least[given]))
        run = np.pad(np.cumsum(np.where(known & seen, squares - squares[most], 0.0), axis=1), ((0, 0), (1, 0)))
        k, end = divmod(int(np.argmin(run - np.maximum.accumulate(run, axis=1))), len(every) + 1)
        begin = end - int(np.argmax(run[k, end::-1]))
        shift = np.where((every >= begin) & (every < end), k, most)
    there, by, use = shift != most, k - most, seen & known[k]
    way, off = f[whence[k]] - f, tip - f
    size, left = np.linalg.norm(way, axis=1), np.linalg.norm(off - way * there[:, None], axis=1)
    telling = use & (size > rms(left[use]))
    inside, outside, whole = telling & there, telling & ~there, np.count_nonzero(use & ~there) < judgement.SHIFT_LEAST
    w_in, w_out = ((off * way)[own].sum() / max((size[own] ** 2).sum(), 1e-300) for own in (inside, outside))
    own, mm = rms(off[inside]), rms(left[inside])
    if (
        min(inside.sum(), len(every) if whole else outside.sum()) < judgement.SHIFT_LEAST
        or max(abs(w_in - 1), abs(w_out)) > judgement.SHIFT_WAY
        or np.linalg.norm(way[inside].sum(axis=0)) > judgement.SHIFT_ONE_WAY * size[inside].sum()
        or mm > judgement.SHIFT_LEFT * np.sqrt(fitted(none)[1][most, inside].mean())
        or (whole and by < 0 and mm > judgement.SHIFT_DELAY * own)
    ):
        return
    begin, end = begin * bool(use[:begin].any()), end if use[end:].any() else len(every)
    first, last = map(place or states.place, (int(rows[begin]), int(rows[end - 1])))
    when, where, back = ("early", "below", "down") if by > 0 else ("late", "above", "up")
    yield finding("shifted", first=first, last=last, states=end - begin, by=counted(abs(by), "row"), when=when, where=where,
                  back=back, own_mm=1e3 * own, mm=1e3 * mm)  # fmt: skip


def _terms(table: Table, most: int) -> Array:
    """(n, terms) products of the settings that vary, up to the degree of which there are no more than `most`."""
    gaps = [*[pressure_gap(table)] * table.pressures.shape[1], *LOADS.values(), *[FORCE_GAP] * 3]
    settings = np.column_stack([table.pressures, *(table.get(name, 0.0) for name in LOADS), table.tip_force])
    varied = settings[:, np.ptp(settings, axis=0) > gaps]
    u, out = (varied - varied.mean(axis=0)) / np.ptp(varied, axis=0), [np.ones((len(varied), 1))]
    for degree in range(1, judgement.SHIFT_DEGREE + 1):
        factors = list(combinations_with_replacement(range(u.shape[1]), degree))
        if len(out) + len(factors) <= most:
            out += [u[:, list(of)].prod(axis=1) for of in factors]
    return np.column_stack(out)
