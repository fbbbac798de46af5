"""The noise of the measured values: its size, and how long an error lasts.

Instruments wander, and a model is never exact, so errors of rows that follow each other are alike. Of each output

    C_ij = sd^2 ((1 - q) [i = j] + q exp(-|i - j| / T))

for rows i and j of one series, with the share q of the variance that lasts over T rows. Repeats show it where there are enough;
else it is what the richest model leaves, by restricted likelihood, which takes account of what that model has absorbed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.linalg import orth

from ..arrays import Array, Ints, rows_by
from ..data.noise import Lasting, Noise, blocks
from .table import Table

LEAST_DIFFERENCES = 5
"""Independent differences between repeats from which an output's noise is taken from them."""
NOISE_FLOOR = 1e-4
"""Least noise of an output, standard deviations of its measured values."""
LASTING_SHARES, MEMORIES = np.array([0.3, 0.5, 0.7, 0.85, 0.95, 0.99]), (1.5, 4.0, 10.0, 30.0, 100.0)
"""Shares q and memories T (rows) that are tried."""
LASTING_GAIN = 4.0
"""Log likelihood that lasting errors must gain over independent ones: chance gives less than 2 in 19 of 20 tables."""
LONGEST, MOST_VALUES = 100, 800
"""Rows beyond which errors count as independent, and values of an output from which the shares are estimated: for speed."""


@dataclass(frozen=True)
class NoiseEstimate:
    """Of each output."""

    sd: Array
    """(outputs,) in each output's unit, with what lasts."""
    share: Array
    """(outputs,) q."""
    memory: Array
    """(outputs,) T, rows."""
    floor: Array
    """(outputs,) what readings err by: with what lasts, as far as the rows show it, but without what is smooth over the rows, as
    no instrument's error is but a model's."""

    def noise(self, table: Table, row: Ints, output: Ints) -> Noise:
        """Of values (n,) of rows and outputs of a table."""
        n, sd, share = len(row), self.sd[output], self.share[output]
        block, place = (of_row[row] for of_row in parts(table))
        own = np.where(share > 0, block * len(self.sd) + output, -1)
        lasting = Lasting(own, place.astype(float), output, sd * np.sqrt(share), np.zeros(n), self.memory[output])
        return Noise(np.arange(n), sd * np.sqrt(1 - share), np.zeros((n, 0)), lasting)


def parts(table: Table) -> tuple[Ints, Ints]:
    """(n,) part of a series that each row belongs to, at most `LONGEST` rows long, and its place in it."""
    place = pd.Series(table.group).groupby(table.group).cumcount().to_numpy()
    return blocks(table.group, place.astype(float), LONGEST), np.asarray(place % LONGEST, np.int64)


def of_repeats(table: Table, repeat: Ints) -> NoiseEstimate:
    """What readings differ by from the mean of their repeats; sd NaN where there are too few, or all are equal."""
    outputs = table.measured.shape[1]
    sd, share, memory = np.full(outputs, np.nan), np.zeros(outputs), np.ones(outputs)
    block, place = parts(table)
    by = pd.DataFrame(table.measured).groupby(repeat)
    count, free = by.transform("count").to_numpy(), (by.count() - 1).clip(lower=0).sum().to_numpy()
    missed = (table.measured - by.transform("mean").to_numpy()) * np.sqrt(count / np.maximum(count - 1, 1))
    for i in np.flatnonzero(free >= LEAST_DIFFERENCES).tolist():
        own = table.kept[:, i] & (count[:, i] > 1)
        away = missed[own, i]
        if away.any():  # else copies of one reading
            share[i], memory[i], _ = _lasting(block[own], place[own], away, np.zeros((len(away), 0)))
            sd[i] = max(np.sqrt(np.mean(away**2)), NOISE_FLOOR * table.spread[i])
    return NoiseEstimate(sd, share, memory, sd)


def left(block: Ints, place: Ints, missed: Array, columns: Array) -> tuple[float, float, float, float]:
    """sd, q, T and floor, of what a model leaves of the values (n,) of one output, with what `columns` (n, c) absorb of them."""
    share, memory, smooth = _lasting(block, place, missed, columns)
    turned, value = _turned(block, place, np.column_stack([_basis(columns), missed]), memory)
    sd = float(np.sqrt(_restricted(turned, value, share)[1]))
    # over a series that is shorter than T less shows of what lasts
    return sd, share, memory, sd * np.sqrt(1 - share) if smooth else min(sd, float(np.sqrt(np.mean(missed**2)))) if share else sd


def _basis(columns: Array) -> Array:
    """(n, r) orthonormal columns of the same span."""
    size = np.linalg.norm(columns, axis=0)
    return np.asarray(orth(columns[:, size > 0] / size[size > 0], rcond=1e-8))


def _lasting(block: Ints, place: Ints, values: Array, columns: Array) -> tuple[float, float, bool]:
    """q and T that make values (n,) most probable, up to `columns` (n, c), and whether a smooth function of the row, of squared
    exponential covariance, makes them more probable still; q = 0 where that gains less than `LASTING_GAIN`."""
    kept = block % int(np.ceil(len(values) / MOST_VALUES)) == 0
    together = np.column_stack([_basis(columns[kept]), values[kept]])
    if len(together) < together.shape[1] + LEAST_DIFFERENCES:
        return 0.0, 1.0, False

    def most_probable(smooth: bool) -> tuple[float, float, float]:
        best = LASTING_GAIN, 0.0, 1.0
        for memory in MEMORIES:
            turned, value = _turned(block[kept], place[kept], together, memory, smooth)
            alone = _restricted(turned, value, 0.0)[0]
            best = max(best, *((_restricted(turned, value, q)[0] - alone, q, memory) for q in LASTING_SHARES.tolist()))
        return best

    gain, share, memory = most_probable(False)
    return share, memory, bool(share) and most_probable(True)[0] > gain + LASTING_GAIN


def _turned(block: Ints, place: Ints, columns: Array, memory: float, smooth: bool = False) -> tuple[Array, Array]:
    """Columns (n, c), those of each block turned onto the principal axes of what lasts there, and its variances (n,)."""
    out, value = np.empty(columns.shape), np.empty(len(columns))
    known: dict[bytes, tuple[Array, Array]] = {}
    for own in rows_by(block):
        at = place[own]
        if at.tobytes() not in known:
            apart = np.abs(at[:, None] - at) / memory
            known[at.tobytes()] = np.linalg.eigh(np.exp(-0.5 * apart**2 if smooth else -apart))
        value[own], axes = known[at.tobytes()]
        out[own] = axes.T @ columns[own]
    return out, value


def _restricted(turned: Array, value: Array, share: float) -> tuple[float, float]:
    """Restricted log likelihood, at the variance that is most probable, of the last of turned columns (n, c + 1) up to the
    others, where errors of a `share` of the variance last; and that variance."""
    variance = 1 - share + share * np.maximum(value, 0.0)
    white = turned / np.sqrt(variance)[:, None]
    *of_others, away = np.abs(np.diag(np.linalg.qr(white, mode="r"))).tolist()
    free = max(len(white) - len(of_others), 1)
    size = max(away**2 / free, 1e-300)
    log_det = 0.5 * float(np.log(variance).sum()) + float(np.log(of_others).sum())
    return -0.5 * free * float(np.log(size)) - log_det, size
