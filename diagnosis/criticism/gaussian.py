"""The distribution of the readings under a hypothesis, everything in it integrated out, and how they contradict it.

A cause outside the catalogue leaves little in the residual, because similar effects are fitted in its place. It shows as repeats
that scatter more than instruments and re-grown spines do (excess scatter), and as evidence for laws in error by more than the
forms of a known cause differ (law error). Both make a cause outside the catalogue more probable (`outside`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, logsumexp

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
        errors = [(columns, scale) for columns, scale in ((linear.form_error, form_error), (linear.discrepancy, large)) if scale]
        dense = np.hstack([linear.effects, nuisance.dense, *(columns for columns, _ in errors)])
        of_each = [np.sqrt(prior.variance), np.ones(nuisance.at.size), *(np.full(e.shape[1], scale) for e, scale in errors)]
        dense *= np.concatenate(of_each)
        of_errors = p + nuisance.shape[1] + np.arange(dense.shape[1] - p - nuisance.at.size)
        at = np.concatenate([np.arange(p), p + nuisance.at, of_errors])
        self._x = Columns(dense, at, nuisance.sparse, p + nuisance.rest)
        normal = self._x.normal(np.zeros((len(dense), 0)))
        self._factors = normal.plus(np.ones(self._x.shape[1])).factorised()
        missed = linear.observed - linear.effects @ prior.mean
        self.residual = missed - self._x.along(self._factors.solve(self._x.against(missed)))
        """(n,) (I + X X^T)^-1 r."""

    def surprise(self, own: Mask) -> tuple[float, int]:
        """Squared Mahalanobis distance of some values from their prediction by all others, and their number."""
        x, left = self._x.rows(own), self.residual[own]
        # The block of the inverse covariance, I - x (I + X^T X)^-1 x^T, is the inverse covariance of the prediction's error.
        block = np.eye(len(left)) - self._factors.covariance(x.dense, x.sparse)
        return float(left @ np.linalg.solve(block, left)), len(left)

    def covariance(self, of_effect: Mask, chosen: Ints) -> Array:
        """(c, c) posterior covariance of chosen parameters (c,), `of_effect` (k,) those of effects, in units of priors."""
        column = np.empty(len(of_effect), np.int64)
        column[np.concatenate([np.flatnonzero(of_effect), np.flatnonzero(~of_effect)])] = np.arange(len(of_effect))
        unit = np.zeros((self._x.shape[1], len(chosen)))
        unit[column[chosen], np.arange(len(chosen))] = 1.0
        out = self._factors.solve(unit)[column[chosen]]
        return np.asarray(0.5 * (out + out.T))

    def inner(self, columns: Array) -> Array:
        """C^T (I + X X^T)^-1 C (c, c) of columns (n, c)."""
        return np.asarray(columns.T @ columns - self._factors.quadratic(self._x.against(columns)))


@dataclass(frozen=True)
class MisfitDiagnostics:
    """Misfit diagnostics around the best hypothesis."""

    lack_of_fit: float
    """Squared misfit per degree of freedom after the fit, without discrepancy; 1 where the model holds."""
    excess_scatter: float
    """Factor by which repeats scatter more than the default, see `NoiseComponents`."""
    outlier_trial: int | None
    """The trial that the others predict worst, where its p-value times the number of trials is below 0.001."""
    law_error_gain: float
    """Log evidence that the largest share of model-form error adds to the least, under the answer's hypothesis; 0 without any."""


def misfit_diagnostics(
    problem: Problem, best: Candidate, trial: Ints, excess_scatter: float, answer: Candidate
) -> MisfitDiagnostics:
    """All diagnostics around the best hypothesis.

    `trial` (n,) number of each measured value's trial; `excess_scatter` as in `NoiseComponents`; `answer` the hypothesis named.
    """
    linear, prior, law_error = best.fit.linear(problem), best.prior(problem.parameters), best.grid_point.form_error
    law_error_gain = 0.0
    if (linear if answer is best else answer.fit.linear(problem)).form_error.shape[1]:
        by_share = logsumexp(answer.weighed.log_terms, axis=(0, 1))  # all shares are equally probable before
        law_error_gain = float(by_share[-1] - by_share[0])
    g = Gaussian(linear, prior, 0.0, law_error)
    free = len(g.residual) - g._x.shape[1] + g._factors.inverse_trace
    lack_of_fit = float(g.residual @ g.residual) / max(free, 1.0)  # squared residual per remaining degree of freedom
    predictive, trials = Gaussian(linear, prior, max(best.grid_point.size, PREDICTIVE_DISCREPANCY), law_error), np.unique(trial)
    surprise, value_count = np.array([predictive.surprise(trial == t) for t in trials]).T
    probability = chdtrc(value_count, surprise)
    worst = int(np.argmin(probability))
    return MisfitDiagnostics(
        lack_of_fit=lack_of_fit,
        excess_scatter=excess_scatter,
        outlier_trial=int(trials[worst]) if probability[worst] * len(trials) < 1e-3 else None,
        law_error_gain=law_error_gain,
    )
