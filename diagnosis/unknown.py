"""Signs that no effect of the catalogue explains the data.

Four signs, each a number that grows with doubt: the evidence for a large smooth discrepancy beside the best hypothesis,
lack of fit against pure error, surprise on kinds of experiment that the fit did not see, and a single trial that the
others do not predict. What each is worth was found on a bench (see tempering).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from .evidence import KNOWN, LARGE, weigh
from .linear import Linear
from .problem import Problem
from .search import Candidate

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


LEAST_DISCREPANCY = 0.1
"""Size of the discrepancy that is always allowed for when values are predicted from others."""
LARGE_SHARE = 0.1
"""Prior share of a large discrepancy beside a named effect."""


@dataclass(frozen=True)
class Signs:
    """Signs of a cause outside the catalogue."""

    discrepancy_gain: float
    """Log evidence that a large discrepancy adds to the best hypothesis."""
    discrepancy_size: float
    """Expected size of the discrepancy, in units of the noise floor."""
    lack_of_fit: float
    """Squared misfit per degree of freedom after the fit, without discrepancy; 1 where the model holds."""
    transport: float | None
    """Squared surprise per value on experiments of another kind; None where all states are of one kind."""
    outlier_trial: int | None
    """The trial that fits least with the others, when its surprise has a probability below 0.001 over all trials."""
    outlier_surprise: float
    """Squared surprise per value of the least fitting trial."""


def signs(problem: Problem, best: Candidate, trial: Ints, kind: Ints) -> Signs:
    """Look for all four around the best hypothesis; `trial`, `kind` (n,) of each measured value."""
    linear = best.fit.linear
    large = LARGE.part(best.loose)
    beside = weigh(linear, large, problem.parameters, [best.named])[0]
    cells = [np.logaddexp.reduce(w.cells, axis=2) for w in (best.weighed, beside)]
    both = np.concatenate([cells[0], cells[1] + np.log(LARGE_SHARE)], axis=1)
    weight = np.exp(both - both.max())
    sizes = np.concatenate([KNOWN.sizes, LARGE.sizes])
    expected = float((weight.sum(axis=0) * sizes).sum() / weight.sum())
    variance = problem.parameters.variance(best.named, best.cell.spike)
    form = best.cell.form
    plain = _Gaussian(linear, variance, 0.0, form)
    within = _Gaussian(linear, variance, max(best.cell.size, LEAST_DISCREPANCY), form)
    surprise, numbers, probability = [], np.unique(trial), []
    for t in numbers:
        value, n = within.surprise(trial == t)
        surprise.append(value / n)
        probability.append(float(chi2.sf(value, n)))
    worst = int(np.argmin(probability))
    odd = probability[worst] * len(numbers) < 1e-3
    other = kind > 0
    transport = None
    if other.any() and not other.all():
        value, n = within.surprise(other)
        transport = value / n
    return Signs(
        discrepancy_gain=beside.log_evidence - best.log_evidence,
        discrepancy_size=expected,
        lack_of_fit=plain.misfit_per_dof(),
        transport=transport,
        outlier_trial=int(numbers[worst]) if odd else None,
        outlier_surprise=float(surprise[worst]),
    )


class _Gaussian:
    """A linear problem with everything integrated out: y ~ N(0, I + X X^T)."""

    def __init__(self, linear: Linear, variance: Array, size: float, form: float) -> None:
        blocks = [linear.effects * np.sqrt(variance), linear.nuisance, form * linear.form]
        if large := linear.discrepancy_size(size, form):
            blocks.append(large * linear.discrepancy)
        self._x = np.hstack(blocks)
        self._inverse = np.linalg.inv(np.eye(self._x.shape[1]) + self._x.T @ self._x)
        self._left = linear.observed - self._x @ (self._inverse @ (self._x.T @ linear.observed))

    def surprise(self, own: NDArray[np.bool_]) -> tuple[float, int]:
        """Squared Mahalanobis distance of some values from what all the others predict, and how many they are."""
        x, left = self._x[own], self._left[own]
        # The block of the inverse covariance is the inverse covariance of the prediction's error.
        block = np.eye(len(x)) - x @ self._inverse @ x.T
        return float(left @ np.linalg.solve(block, left)), len(x)

    def misfit_per_dof(self) -> float:
        """Squared residual after the fit per remaining degree of freedom."""
        spent = self._x.shape[1] - float(np.trace(self._inverse))
        return float(self._left @ self._left) / max(len(self._left) - spent, 1.0)
