"""The noise of the measured values: each channel's own, and what wrong readings of the pressures do to a whole state.

Chambers of one regulator are read wrongly together, and so are all channels of a state: with the columns
s_g = d(prediction)/d(pressure of regulator g) * sd(pressure) its covariance is diag(sd^2) + sum_g s_g s_g^T, whose inverse
square root needs no more than an eigenvalue problem as small as the regulators are many.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Noise:
    """Noise of n measured values that belong to some states; values and sd in the unit of each channel."""

    state: NDArray[np.intp]
    """(n,) which state each value belongs to."""
    sd: Array
    """(n,) each value's own standard deviation."""
    shared: Array
    """(n, r) response of each value to one standard deviation of its state's pressure reading, of each regulator."""

    @cached_property
    def _ratio(self) -> Array:
        """(n, r) s / sd of each value."""
        out: Array = self.shared / self.sd[:, None]
        return out

    @cached_property
    def _norm(self) -> tuple[Array, Array]:
        """Eigenvalues (states, r) and vectors (states, r, r) of a state's s^T s / sd^2."""
        squares = self._summed(self._ratio[:, :, None] * self._ratio[:, None, :])
        value, vector = np.linalg.eigh(squares)
        return np.maximum(value, 0.0), vector

    def whiten(self, values: Array) -> Array:
        """Values (n,) or columns (n, k) as they would look with independent noise of standard deviation 1."""
        return self._stretched((values.T / self.sd).T, -0.5)

    def colour(self, white: Array) -> Array:
        """The inverse of `whiten`."""
        return (self._stretched(white, 0.5).T * self.sd).T

    def _stretched(self, values: Array, power: float) -> Array:
        """Within each state, (I + ratio ratio^T)^power values."""
        columns = values.reshape(len(values), -1)
        value, vector = self._norm
        grown = np.expm1(power * np.log1p(value)) / np.maximum(value, 1e-300)
        inner = (vector * grown[:, None, :]) @ vector.swapaxes(1, 2)
        along = self._summed(self._ratio[:, :, None] * columns[:, None, :])
        return (columns + np.einsum("nr,nrk->nk", self._ratio, (inner @ along)[self.state])).reshape(values.shape)

    def _summed(self, values: Array) -> Array:
        """Values (n, ...) summed over each state (states, ...)."""
        order = np.argsort(self.state, kind="stable")
        first = np.flatnonzero(np.diff(self.state[order], prepend=-1))
        out = np.zeros((int(self.state.max(initial=-1)) + 1, *values.shape[1:]))
        out[self.state[order][first]] = np.add.reduceat(values[order], first, axis=0)
        return out

    @property
    def log_sd(self) -> float:
        """Half the log determinant of the covariance."""
        return float(np.log(self.sd).sum() + 0.5 * np.log1p(self._norm[0]).sum())

    def take(self, kept: NDArray[np.bool_]) -> Noise:
        """The noise of some of the values."""
        return Noise(self.state[kept], self.sd[kept], self.shared[kept])
