"""The noise of the measured values: each channel's own, and what one wrong reading of the pressure does to a whole state.

One state is read at one pressure reading, so its channels err together by s = d(prediction)/d(pressure) * sd(pressure).
Its covariance is diag(sd^2) + s s^T, whose inverse square root is known in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass

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
    """(n,) response of each value to one standard deviation of its state's pressure reading."""

    @property
    def _ratio(self) -> tuple[Array, Array]:
        """s / sd of each value, and its squared norm in each state."""
        ratio = self.shared / self.sd
        return ratio, np.bincount(self.state, ratio**2).astype(np.float64)

    def whiten(self, values: Array) -> Array:
        """Values (n,) or columns (n, k) as they would look with independent noise of standard deviation 1."""
        ratio, norm = self._ratio
        share = (1 / np.sqrt(1 + norm) - 1) / np.maximum(norm, 1e-300)
        return self._stretched((values.T / self.sd).T, ratio, share)

    def colour(self, white: Array) -> Array:
        """The inverse of `whiten`."""
        ratio, norm = self._ratio
        share = (np.sqrt(1 + norm) - 1) / np.maximum(norm, 1e-300)
        return (self._stretched(white, ratio, share).T * self.sd).T

    def _stretched(self, values: Array, ratio: Array, share: Array) -> Array:
        """Within each state, (I + share ratio ratio^T) values."""
        columns = values.reshape(len(values), -1)
        order = np.argsort(self.state, kind="stable")
        first = np.flatnonzero(np.diff(self.state[order], prepend=-1))
        summed = np.zeros((len(share), columns.shape[1]))
        summed[self.state[order][first]] = np.add.reduceat((ratio[:, None] * columns)[order], first, axis=0)
        return (columns + (ratio * share[self.state])[:, None] * summed[self.state]).reshape(values.shape)

    @property
    def log_sd(self) -> float:
        """Half the log determinant of the covariance."""
        return float(np.log(self.sd).sum() + 0.5 * np.log1p(self._ratio[1]).sum())

    def take(self, kept: NDArray[np.bool_]) -> Noise:
        """The noise of some of the values."""
        return Noise(self.state[kept], self.sd[kept], self.shared[kept])
