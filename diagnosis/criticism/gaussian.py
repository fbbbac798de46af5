"""The distribution of the readings under a hypothesis, everything in it integrated out, and how they contradict it."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtrc

from ..arrays import Array, Ints, Mask
from ..inference.candidate import Candidate
from ..inference.jacobian import Columns
from ..inference.linear import Linear, SizePrior
from ..inference.problem import Problem
from ..judgement import PREDICTIVE_DISCREPANCY


class Gaussian:
    """A linear problem with everything integrated out: y ~ N(0, I + X X^T)."""

    def __init__(self, linear: Linear, prior: SizePrior, size: float, form_error: float) -> None:
        self.linear, nuisance, p = linear, linear.nuisance, linear.effects.shape[1]
        large = linear.discrepancy_size(size, form_error)
        errors = [columns * scale for columns, scale in ((linear.form_error, form_error), (linear.discrepancy, large)) if scale]
        dense = np.hstack([linear.effects * np.sqrt(prior.variance), nuisance.dense, *errors])
        of_errors = p + nuisance.shape[1] + np.arange(dense.shape[1] - p - nuisance.at.size)
        at = np.concatenate([np.arange(p), p + nuisance.at, of_errors])
        self._x = Columns(dense, at, nuisance.sparse, p + nuisance.rest)
        self._factors = self._x.normal(np.zeros((len(dense), 0))).plus(np.ones(self._x.shape[1])).factorised()
        missed = linear.observed - linear.effects @ prior.mean
        self.residual = missed - self._x.along(self._factors.solve(self._x.against(missed)))
        """(n,) (I + X X^T)^-1 r."""

    def surprise(self, own: Mask) -> tuple[float, int]:
        """Squared Mahalanobis distance of some values from their prediction by all others, and their number."""
        x, left = self._x.rows(own), self.residual[own]
        # The block of the inverse covariance, I - x (I + X^T X)^-1 x^T, is the inverse covariance of the prediction's error.
        block = np.eye(len(left)) - self._factors.quadratic(x.whole.T)
        return float(left @ np.linalg.solve(block, left)), len(left)

    def covariance(self, of_effect: Mask, chosen: Ints) -> Array:
        """(c, c) posterior covariance of chosen parameters (c,), `of_effect` (k,) those of effects, in units of priors."""
        columns = np.argsort(np.argsort(~of_effect, kind="stable"))[chosen]  # those of effects come first
        unit = np.zeros((self._x.shape[1], len(chosen)))
        unit[columns, np.arange(len(chosen))] = 1.0
        out = self._factors.solve(unit)[columns]
        return np.asarray(0.5 * (out + out.T))

    def inner(self, columns: Array) -> Array:
        """C^T (I + X X^T)^-1 C (c, c) of columns (n, c)."""
        return np.asarray(columns.T @ columns - self._factors.quadratic(self._x.against(columns)))


def outlier_trial(problem: Problem, best: Candidate, trial: Ints) -> int | None:
    """The trial that the others predict worst under the best hypothesis, where its p-value times the number of trials is below
    0.001; `trial` (n,) number of each measured value's trial."""
    size, trials = max(best.weighed.peak.size, PREDICTIVE_DISCREPANCY), np.unique(trial)
    predictive = Gaussian(best.fit.linear(problem), best.prior(problem.parameters), size, best.weighed.peak.form_error)
    surprise, value_count = np.array([predictive.surprise(trial == t) for t in trials]).T
    probability = chdtrc(value_count, surprise)
    worst = int(np.argmin(probability))
    return int(trials[worst]) if probability[worst] * len(trials) < 1e-3 else None
