"""Model criticism: misfit diagnostics of a cause outside the catalogue.

Whatever comes nearest to such a cause is fitted in its place, and leaves little in the residual. What shows it instead:
parameters and model-form errors far from their priors (prior tension), one trial with an outlying spine, repeats that scatter
more than instruments and re-grown spines do (excess scatter), and evidence for laws that are wrong by more than the forms of a
known cause differ (law error). The last two make a cause outside the catalogue more probable (`outside`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, logsumexp

from ..arrays import Ints
from ..inference.candidate import Candidate
from ..inference.evidence import KNOWN
from ..inference.problem import FitParameters, Problem
from ..judgement import PREDICTIVE_DISCREPANCY, TENSE_SD
from .gaussian import Gaussian

SPINE_SOURCES = ("spine_length", "spine_stiffness")
"""Parameters of each trial that describe its newly grown and jammed spine."""


@dataclass(frozen=True)
class MisfitDiagnostics:
    """Misfit diagnostics around the best hypothesis."""

    lack_of_fit: float
    """Squared misfit per degree of freedom after the fit, without discrepancy; 1 where the model holds."""
    prior_tension: float
    """(chi^2 - r) / sqrt(2 r) of all parameters with a prior, chi^2 their squared Mahalanobis distance from it and r its degrees
    of freedom; about 0 where the model holds. Of the best hypothesis or the answer, whichever is less tense."""
    furthest_from_prior: str
    """The parameter furthest from its prior; empty when none lies beyond `TENSE_SD`."""
    spine_outlier: float
    """Distance of the most outlying trial's spine from its prior, in standard deviations; 0 without spines."""
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

    `trial` (n,) numbers each measured value's trial; `excess_scatter` as in `NoiseComponents`;
    `answer` the hypothesis of what is named, where that is another: a tolerance of the best hypothesis may be the cause.
    """
    p = problem.parameters

    def around(c: Candidate, size: float) -> Gaussian:
        return Gaussian(c.linear(problem), c.prior(p), size, c.grid_point.form_error)

    prior_tension, furthest_from_prior, spine_outlier = _prior_tension(around(best, best.grid_point.size), p, best.named)
    if answer is not best:
        # A tolerance of the best hypothesis may be strained because it is the cause that the answer names.
        of_answer = _prior_tension(around(answer, answer.grid_point.size), p, answer.named)
        prior_tension, furthest_from_prior = min((prior_tension, furthest_from_prior), of_answer[:2])
    within, numbers = around(best, max(best.grid_point.size, PREDICTIVE_DISCREPANCY)), np.unique(trial)
    surprise, values = np.array([within.surprise(trial == t) for t in numbers]).T
    probability = chdtrc(values, surprise)
    worst = int(np.argmin(probability))
    return MisfitDiagnostics(
        lack_of_fit=around(best, 0.0).misfit_per_dof(),
        prior_tension=prior_tension,
        furthest_from_prior=furthest_from_prior,
        spine_outlier=spine_outlier,
        excess_scatter=excess_scatter,
        outlier_trial=int(numbers[worst]) if probability[worst] * len(numbers) < 1e-3 else None,
        outlier_surprise=float(surprise[worst] / values[worst]),
        law_error_gain=_law_error_gain(answer) if answer.linear(problem).form_error.shape[1] else 0.0,
    )


def _law_error_gain(c: Candidate) -> float:
    by_share = logsumexp(c.weighed.log_terms, axis=(0, 1)) - np.log(KNOWN.form_error_weights)
    return float(by_share[-1] - by_share[0])


def _prior_tension(g: Gaussian, p: FitParameters, named: tuple[str, ...]) -> tuple[float, str, float]:
    """Prior tension of all but the calibration and the trials' own parameters, the furthest parameter, the outlying spine."""
    order = np.argsort(~p.of_effect, kind="stable")  # of the columns: effects first
    effects, tested = p.of_effect[order], ~(p.calibration | p.recurs)[order]
    wide = np.isin(np.array(p.effects)[order], named)
    groups = [np.flatnonzero(own) for own in (effects & wide, effects & ~wide, ~effects & tested)]
    groups.append(np.arange(len(order), len(order) + g.form_columns))
    found = [g.distance(own) for own in groups if own.size]
    squares, rank = (float(sum(x)) for x in zip(*found, strict=True)) if found else (0.0, 0.0)
    single = g.single()[: len(order)]
    furthest = int(np.argmax(np.where(tested, single, 0.0)))
    tense = tested[furthest] and single[furthest] > TENSE_SD
    of_spine = p.recurs[order] & np.isin([p.infos[i].source for i in order], SPINE_SOURCES)
    return (
        (squares - rank) / np.sqrt(2 * max(rank, 1.0)),
        p.names[order[furthest]] if tense else "",
        float(np.max(single[of_spine], initial=0.0)),
    )
