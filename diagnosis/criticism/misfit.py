"""Model criticism: misfit diagnostics of a cause outside the catalogue.

Whatever comes nearest to such a cause is fitted in its place, and leaves little in the residual. What shows it instead:
repeats that scatter more than instruments and re-grown spines do (excess scatter), and evidence for laws that are wrong by more
than the forms of a known cause differ (law error). Both make a cause outside the catalogue more probable (`outside`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, logsumexp

from ..arrays import Ints
from ..inference.candidate import Candidate
from ..inference.evidence import KNOWN
from ..inference.problem import Problem
from ..judgement import PREDICTIVE_DISCREPANCY
from .gaussian import Gaussian


@dataclass(frozen=True)
class MisfitDiagnostics:
    """Misfit diagnostics around the best hypothesis."""

    lack_of_fit: float
    """Squared misfit per degree of freedom after the fit, without discrepancy; 1 where the model holds."""
    excess_scatter: float
    """Factor by which repeats scatter more than the default, see `NoiseComponents`."""
    outlier_trial: int | None
    """The trial that the others predict worst, where its p-value times the number of trials is below 0.001."""
    outlier_surprise: float
    """Chi-square per value of that trial, predicted from the others."""
    law_error_gain: float
    """Log evidence that the largest share of model-form error adds to the least, under the answer's hypothesis; 0 without any."""


def misfit_diagnostics(
    problem: Problem, best: Candidate, trial: Ints, excess_scatter: float, answer: Candidate
) -> MisfitDiagnostics:
    """All diagnostics around the best hypothesis.

    `trial` (n,) number of each measured value's trial; `excess_scatter` as in `NoiseComponents`; `answer` the hypothesis named.
    """

    def distribution(size: float) -> Gaussian:
        return Gaussian(best.linear(problem), best.prior(problem.parameters), size, best.grid_point.form_error)

    predictive, trials = distribution(max(best.grid_point.size, PREDICTIVE_DISCREPANCY)), np.unique(trial)
    surprise, value_count = np.array([predictive.surprise(trial == t) for t in trials]).T
    probability = chdtrc(value_count, surprise)
    worst = int(np.argmin(probability))
    return MisfitDiagnostics(
        lack_of_fit=distribution(0.0).misfit_per_dof(),
        excess_scatter=excess_scatter,
        outlier_trial=int(trials[worst]) if probability[worst] * len(trials) < 1e-3 else None,
        outlier_surprise=float(surprise[worst] / value_count[worst]),
        law_error_gain=_law_error_gain(answer) if answer.linear(problem).form_error.shape[1] else 0.0,
    )


def _law_error_gain(c: Candidate) -> float:
    by_share = logsumexp(c.weighed.log_terms, axis=(0, 1)) - np.log(KNOWN.form_error_weights)
    return float(by_share[-1] - by_share[0])
