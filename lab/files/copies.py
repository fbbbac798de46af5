"""Find copies of states: rows that equal earlier ones to the last digit, although the table's readings scatter.

Repeats read alike by chance where the resolution is coarse, and always where nothing scatters, as in a simulated table. With r
the readings of a condition less their mean, in steps of each column's resolution, and sigma_k their standard deviations along
principal axes (columns that err together count once), two repeats are alike with the probability

    p = prod_k min(1, 1 / (2 sqrt(pi) sigma_k)),

the density of a normal difference at 0. Of conditions in which readings differ, the rows alike are counted: k, of which p times
the pairs are expected. Where none differ, r are the pressures less the mean of each chamber's level. Rows that are alike are
copies where k is improbable, and always where they share trial, step and time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import scipy

from diagnosis.data.case import campaign_of, finite
from diagnosis.data.levels import distinct, levels
from diagnosis.data.plausible import complete
from model.arrays import Array, Ints
from recordings.trials import INTEGERS, TEXTS, Table

CHANCE, MARGIN = 1e-3, 10.0
"""Probability of k or more rows alike, below which they are copies; the factor by which more are expected than computed, as
readings are not quite normal."""
ROUNDING = 1e-9
"""Share of a column's largest value below which a difference comes from arithmetic, not from an instrument."""
NOT_READ = {"t", "rate", "hold", "clipped", *INTEGERS, *TEXTS}
"""Columns in which a copy may differ: a person or program has numbered it anew."""
MOST_RUNS = 4
"""Named one by one."""


def without_copies(table: Table) -> Table:
    """Each state once, with a warning that names the rows, from 1 below the heading, that are copies."""
    if not len(copies := copies_of(table)):
        return table
    runs = list(_runs(copies))
    named = ", ".join(runs[:MOST_RUNS]) + f" and {len(runs) - MOST_RUNS} more" * (len(runs) > MOST_RUNS)
    said = f"{named} to the last digit, as copies do and repeats do not: each state counts once; delete the copies"
    return replace(table.take(np.setdiff1d(np.arange(len(table)), copies[:, 0])), warnings=(*table.warnings, said))


def copies_of(table: Table) -> Ints:
    """(m, 2) indices of rows that are copies, and of the first row that each equals."""
    values = np.column_stack([np.zeros(len(table)), *(table[name] for name in table.columns if name not in NOT_READ)])
    group = distinct(np.nan_to_num(values, nan=np.inf))
    if group.max(initial=-1) == len(table) - 1:
        return np.zeros((0, 2), np.int64)
    alike = group if improbable(table, values, group) else distinct(group, table.trial, table["step"], table["t"])
    earlier = np.unique(alike, return_index=True)[1][alike]
    return np.column_stack([np.arange(len(table)), earlier])[earlier != np.arange(len(table))]


def improbable(table: Table, values: Array, group: Ints) -> bool:
    """Whether rows that are alike cannot all be repeats: `values` (n, k) are readings, rows of one `group` (n,) are alike."""
    every = np.arange(len(table))
    states = campaign_of(table, every[table.with_tip & finite(table)], every[complete(table)])
    condition = states.condition
    once = np.unique(distinct(condition, group[states.row]), return_index=True)[1]  # a row of those alike in a condition
    several = np.bincount(condition[once], minlength=condition.max(initial=0) + 1) > 1
    readings, level = values[states.row[once]], np.tile(condition[once][:, None], values.shape[1])
    if not several.any():
        several[:], readings = True, states.pressure[once]
        level = np.column_stack([levels(column, states.pressure_gap) for column in readings.T])
    k = int(several[condition].sum() - several[condition[once]].sum())
    sigma = _scatter(readings, level) if k else np.zeros(0)
    p = float(np.minimum(1 / (2 * np.sqrt(np.pi) * np.maximum(sigma, ROUNDING)), 1.0).prod())
    same = np.bincount(condition, minlength=len(several))[several]
    return bool(scipy.stats.poisson.sf(k - 1, MARGIN * p * float((same * (same - 1) / 2).sum())) < CHANCE)


def _scatter(readings: Array, level: Ints) -> Array:
    """Standard deviations along principal axes, in steps of the resolution, of readings (n, k) of which those of one level (n, k)
    in a column differ by scatter alone; columns that lack a reading do not count."""
    off = list[Array]()
    for column, own in zip(readings.T, level.T, strict=True):
        gaps, floor = np.diff(np.sort(column)), ROUNDING * np.abs(column).max()
        step = gaps[gaps > floor].min(initial=np.inf)
        mean = np.bincount(own, column) / np.maximum(np.bincount(own), 1)
        off.append(np.nan_to_num((column - mean[own]) / step))
    freedom = len(readings) - max((len(np.unique(own)) for own in level.T), default=0)
    return np.asarray(np.linalg.svd(np.column_stack(off), compute_uv=False) / np.sqrt(max(freedom, 1)))


def _runs(copies: Ints) -> Iterator[str]:
    """Texts such as "rows 21 to 40 equal rows 1 to 20", of rows and those they equal that both go on one by one."""
    for run in np.split(copies, np.flatnonzero((np.diff(copies, axis=0) != 1).any(axis=1)) + 1):
        (a, b), (c, d) = (run[0] + 1).tolist(), (run[-1] + 1).tolist()
        yield f"row {a} equals row {b}" if a == c else f"rows {a} to {c} equal rows {b} to {d}"
