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
from scipy.sparse import bsr_array, csr_array, diags_array, eye_array

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Noise:
    """Noise of n measured values that belong to some states; values and sd in the unit of each channel."""

    state: NDArray[np.intp]
    """(n,) which state each value belongs to."""
    sd: Array
    """(n,) each value's own standard deviation."""
    pressure_response: Array
    """(n, r) response of each value to one standard deviation of its state's pressure reading, of each regulator."""

    @cached_property
    def _norm(self) -> tuple[csr_array, Array, Array]:
        """s / sd (n, states r), and eigenvalues (states, r) and vectors (states, r, r) of each state's s^T s / sd^2."""
        n, r = self.pressure_response.shape
        states = int(self.state.max(initial=-1)) + 1
        ratio = self.pressure_response / self.sd[:, None]
        place = self.state[:, None] * r + np.arange(r)
        spread = csr_array((ratio.ravel(), place.ravel(), np.arange(0, n * r + 1, r)), shape=(n, states * r))
        squares = np.zeros((states, r, r))
        np.add.at(squares, self.state, ratio[:, :, None] * ratio[:, None, :])
        value, vector = np.linalg.eigh(squares)
        return spread, np.maximum(value, 0.0), vector

    @cached_property
    def _white(self) -> csr_array:
        """(n, n)"""
        return csr_array(self._power(-0.5) @ diags_array(1 / self.sd))

    @cached_property
    def _root(self) -> csr_array:
        """(n, n)"""
        return self._power(0.5)

    def whiten(self, values: Array) -> Array:
        """Values (n,) or columns (n, k) as they would look with independent noise of standard deviation 1."""
        return np.asarray(self._white @ values)

    def colour(self, white: Array) -> Array:
        """The inverse of `whiten`."""
        return np.asarray(diags_array(self.sd) @ (self._root @ white))

    def _power(self, power: float) -> csr_array:
        """(n, n) (I + s s^T / sd^2)^power, state by state."""
        spread, value, vector = self._norm
        grown = np.expm1(power * np.log1p(value)) / np.maximum(value, 1e-300)
        inner = (vector * grown[:, None, :]) @ vector.swapaxes(1, 2)
        states = len(value)
        blocks = bsr_array((inner, np.arange(states), np.arange(states + 1)), shape=(spread.shape[1],) * 2)
        return csr_array(eye_array(len(self.sd)) + spread @ blocks @ spread.T)

    @property
    def log_sd(self) -> float:
        """Half the log determinant of the covariance."""
        return float(np.log(self.sd).sum() + 0.5 * np.log1p(self._norm[1]).sum())

    def take(self, kept: NDArray[np.bool_]) -> Noise:
        """The noise of some of the values."""
        return Noise(self.state[kept], self.sd[kept], self.pressure_response[kept])
