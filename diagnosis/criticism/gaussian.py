"""The distribution of the readings under a hypothesis, everything in it integrated out."""

from __future__ import annotations

import numpy as np

from ..arrays import Array, Mask
from ..inference.linear import Linear, SizePrior


class Gaussian:
    """A linear problem with everything integrated out: y ~ N(0, I + X X^T)."""

    def __init__(self, linear: Linear, prior: SizePrior, size: float, form_error: float) -> None:
        self.linear = linear
        blocks = [linear.effects * np.sqrt(prior.variance), linear.nuisance.whole]
        if form_error:
            blocks.append(form_error * linear.form_error)
        if large := linear.discrepancy_size(size, form_error):
            blocks.append(large * linear.discrepancy)
        self._x = np.hstack(blocks)
        self._information = np.eye(self._x.shape[1]) + self._x.T @ self._x
        self._inverse = np.linalg.inv(self._information)
        missed = linear.observed - linear.effects @ prior.mean
        self.residual = missed - self._x @ (self._inverse @ (self._x.T @ missed))
        """(n,) (I + X X^T)^-1 r."""

    def surprise(self, own: Mask) -> tuple[float, int]:
        """Squared Mahalanobis distance of some values from what all the others predict, and how many they are."""
        x, left = self._x[own], self.residual[own]
        # The block of the inverse covariance, I - x (I + X^T X)^-1 x^T, is the inverse covariance of the prediction's error.
        pulled = x.T @ left
        return float(left @ left + pulled @ np.linalg.solve(self._information - x.T @ x, pulled)), len(x)

    def misfit_per_dof(self) -> float:
        """Squared residual after the fit per remaining degree of freedom."""
        spent = self._x.shape[1] - float(np.trace(self._inverse))
        return float(self.residual @ self.residual) / max(len(self.residual) - spent, 1.0)

    def covariance(self, of_effect: Mask) -> Array:
        """(k, k) posterior covariance of all parameters, `of_effect` (k,) those of effects, in units of priors."""
        order = np.concatenate([np.flatnonzero(of_effect), np.flatnonzero(~of_effect)])
        out = np.empty((len(order), len(order)))
        out[np.ix_(order, order)] = self._inverse[: len(order), : len(order)]
        return 0.5 * (out + out.T)

    def inner(self, columns: Array) -> Array:
        """C^T (I + X X^T)^-1 C (c, c) of columns (n, c)."""
        across = self._x.T @ columns
        return np.asarray(columns.T @ columns - across.T @ self._inverse @ across)
