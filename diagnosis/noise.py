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
        return ratio, np.bincount(self.state, ratio**2)

    def whiten(self, values: Array) -> Array:
        """Values (n,) or columns (n, k) as they would look with independent noise of standard deviation 1."""
        ratio, norm = self._ratio
        scaled = (values.T / self.sd).T
        share = np.where(norm > 0, (1 - 1 / np.sqrt(1 + norm)) / np.maximum(norm, 1e-300), 0.0)
        columns = scaled.reshape(len(scaled), -1)
        summed = np.zeros((len(norm), columns.shape[1]))
        np.add.at(summed, self.state, ratio[:, None] * columns)
        return (columns - (ratio * share[self.state])[:, None] * summed[self.state]).reshape(values.shape)

    @property
    def log_sd(self) -> float:
        """Half the log determinant of the covariance."""
        return float(np.log(self.sd).sum() + 0.5 * np.log1p(self._ratio[1]).sum())

    def take(self, kept: NDArray[np.bool_]) -> Noise:
        """The noise of some of the values."""
        return Noise(self.state[kept], self.sd[kept], self.shared[kept])
