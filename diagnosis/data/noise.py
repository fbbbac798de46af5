"""The noise of the measured values: independent errors of each reading, errors of the pressure readings (which move a whole
state), and errors that last from one reading to the next.

Cameras and pressure sensors wander: an error is forgotten over a time T, not from reading to reading. Within a block of readings
(those of a trial) the covariance of two values i and j, read |t_i - t_j| apart, is

    C_ij = sd_i^2 [i = j] + slow_i slow_j k_ij [same channel] + sum_g s_ig s_jg ((1 - q) [same state] + q k_ij),
    k_ij = exp(-|t_i - t_j| / T),

with s_g the response to one standard deviation of the pressure reading of regulator g, and q the share of its variance that
lasts. Chambers of one regulator share their reading error. Readings of different blocks are independent.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..arrays import Array, Ints, Mask, rows_by

AT_ONCE = 1 << 16
"""Numbers that are whitened at once: they stay in a processor's cache."""


@dataclass(frozen=True)
class Lasting:
    """Errors that last from one reading of a block to the next."""

    block: Ints
    """(n,) readings of one trial, or of a part of it; -1 for values without lasting errors."""
    time: Array
    """(n,) s."""
    channel: Ints
    """(n,) values of a channel share its lasting error."""
    sd: Array
    """(n,) in the unit of each channel."""
    pressure: Array
    """(n,) share of the variance of pressure readings, one a block."""
    memory: Array
    """(n,) s over which an error falls to 1/e, one a block."""

    def take(self, kept: Mask) -> Lasting:
        """Of some of the values."""
        return Lasting(*(a[kept] for a in vars(self).values()))

    @staticmethod
    def none(count: int) -> Lasting:
        """Of values of which nothing lasts."""
        zero, one = np.zeros(count), np.ones(count)
        return Lasting(np.full(count, -1), zero, np.zeros(count, np.intp), zero, zero, one)

    def then(self, other: Lasting) -> Lasting:
        """With other values after these, of other blocks."""
        later = replace(other, block=np.where(other.block < 0, -1, other.block + self.block.max(initial=-1) + 1))
        return Lasting(*(np.concatenate(both) for both in zip(vars(self).values(), vars(later).values(), strict=True)))


@dataclass(frozen=True)
class Noise:
    """Noise of n measured values that belong to some states; values and sd in the unit of each channel."""

    state: Ints
    """(n,) which state each value belongs to."""
    sd: Array
    """(n,) standard deviation of each value's independent error."""
    pressure_response: Array
    """(n, r) response of each value to one standard deviation of its state's pressure reading, of each regulator."""
    lasting: Lasting

    def __getstate__(self) -> dict[str, Any]:
        """Without cached values."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    def whiten(self, values: Array, into: Array | None = None) -> Array:
        """Values (n,) or columns (n, k) as they would look with independent noise of standard deviation 1; written to
        `into`, which may be the columns themselves."""
        return self._applied(values, lambda b: b.white, into)

    def colour(self, white: Array) -> Array:
        """The inverse of `whiten`."""
        return self._applied(white, lambda b: np.asarray(np.linalg.inv(b.white), float))

    @property
    def log_sd(self) -> float:
        """Half the log determinant of the covariance."""
        return float(sum(b.log_sd for b in self._blocks))

    @cached_property
    def block(self) -> Ints:
        """(n,) number of the block that each value belongs to: whitening mixes values of one block alone."""
        block = self.lasting.block
        return np.unique(np.where(block < 0, -1 - self.state, block), return_inverse=True)[1]

    @property
    def own(self) -> Array:
        """(n,) standard deviation of each value's own error, its lasting part included."""
        return np.hypot(self.sd, self.lasting.sd)

    def take(self, kept: Mask) -> Noise:
        """The noise of some of the values."""
        return Noise(self.state[kept], self.sd[kept], self.pressure_response[kept], self.lasting.take(kept))

    def then(self, other: Noise) -> Noise:
        """With the noise of other values after these, of other states."""
        responses = self.pressure_response, other.pressure_response
        wide = max(r.shape[1] for r in responses)
        return Noise(
            np.concatenate([self.state, other.state + self.state.max() + 1]),
            np.concatenate([self.sd, other.sd]),
            np.concatenate([np.pad(r, ((0, 0), (0, wide - r.shape[1]))) for r in responses]),
            self.lasting.then(other.lasting),
        )

    def _applied(self, values: Array, matrix: Callable[[_Blocks], Array], into: Array | None = None) -> Array:
        """Values (n, ..), those of each block multiplied by that block's `matrix` (s, s)."""
        columns = values.reshape(len(values), -1)
        out = np.empty(columns.shape) if into is None else into
        for b in self._blocks:
            at_once, of_block = max(1, AT_ONCE // (b.rows.shape[1] * columns.shape[1] or 1)), matrix(b)
            for first in range(0, len(b.rows), at_once):
                rows, of = b.rows[first : first + at_once], of_block[first : first + at_once]
                out[rows] = of @ columns[rows] if of.shape[1] > 1 else of * columns[rows]
        return out.reshape(values.shape)

    @cached_property
    def _blocks(self) -> Sequence[_Blocks]:
        """Blocks with equally many values stacked, so that each size is one product of matrices."""
        rows_of_each = rows_by(self.block)
        sizes = sorted({len(r) for r in rows_of_each})
        stacked = (np.array([r for r in rows_of_each if len(r) == size]) for size in sizes)
        return [_Blocks(rows, self._covariance(rows)) for rows in stacked]

    def _covariance(self, rows: Ints) -> Array:
        """(b, s, s) covariances C of b blocks of s values, see above; `rows` (b, s): indices of the values."""
        state, response = self.state[rows], self.pressure_response[rows]
        same = (state[:, :, None] == state[:, None, :]).astype(float)  # [same state]
        by_pressure = response @ response.swapaxes(1, 2)  # sum_g s_ig s_jg
        out = np.eye(rows.shape[1]) * self.sd[rows][:, :, None] ** 2
        time, channel, slow = self.lasting.time[rows], self.lasting.channel[rows], self.lasting.sd[rows]
        k = np.exp(-np.abs(time[:, :, None] - time[:, None, :]) / self.lasting.memory[rows][:, :1, None])
        k = np.where(same > 0, 1.0, np.where(np.isfinite(k), k, 0.0))  # without times nothing lasts beyond a state
        q = self.lasting.pressure[rows][:, :1, None]
        out += k * slow[:, :, None] * slow[:, None, :] * (channel[:, :, None] == channel[:, None, :])
        return np.asarray(out + by_pressure * ((1 - q) * same + q * k))


class _Blocks:
    """b blocks of s values."""

    def __init__(self, rows: Ints, covariance: Array) -> None:
        """`rows` (b, s): indices of their values. `white` (b, s, s), C^-1/2, makes them independent, of standard deviation 1;
        `log_sd` is half the log determinant of their `covariance` (b, s, s)."""
        sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        value, vector = np.linalg.eigh(covariance / sd[:, :, None] / sd[:, None, :])
        # rounding errors of a zero eigenvalue
        value = np.maximum(value, 1e-9)
        self.rows, self.log_sd = rows, float(np.log(sd).sum() + 0.5 * np.log(value).sum())
        self.white = (vector / np.sqrt(value)[:, None, :]) @ vector.swapaxes(1, 2) / sd[:, None, :]


def blocks(trial: Ints, time: Array, longest: int) -> Ints:
    """(n,) block of each of n states: its trial, cut so that none has more than `longest` states; -1 where no time is known."""
    order = np.lexsort([time, trial])
    order = order[np.isfinite(time[order])]
    place = np.arange(len(order)) - np.searchsorted(trial[order], trial[order])  # in its trial
    out = np.full(len(trial), -1, np.intp)
    out[order] = np.cumsum(place % longest == 0) - 1
    return out
