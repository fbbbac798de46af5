"""Model criticism: misfit diagnostics of a cause outside the catalogue.

Whatever comes nearest to such a cause is fitted in its place, and leaves little in the residual. What shows it instead:
parameters and model-form errors far from their priors (prior tension), one trial with an outlying spine, repeats that scatter
more than instruments and re-grown spines do (excess scatter), and evidence for laws that are wrong by more than the forms of a
known cause differ (law error). The last two make a cause outside the catalogue more probable (`outside`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, logsumexp

from ..inference.candidate import Candidate
from ..inference.evidence import KNOWN
from ..inference.linear import Linear
from ..inference.problem import Parameters, Problem
from ..judgement import PREDICTIVE_DISCREPANCY, TENSE_SD
from .gaussian import Gaussian

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]


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
    problem: Problem, best: Candidate, trial: Ints, excess_scatter: float, answer: Candidate | None = None
) -> MisfitDiagnostics:
    """All diagnostics around the best hypothesis.

    `trial` (n,) numbers each measured value's trial; `excess_scatter` as in `NoiseComponents`;
    `answer` the hypothesis of what is named, where that is another: a tolerance of the best hypothesis may be the cause.
    """
    linear, p = best.linear(problem), problem.parameters
    of_answer = linear if answer is None else answer.linear(problem)
    prior = best.prior(p)
    form_error = best.grid_point.form_error
    lack_of_fit = Gaussian(linear, prior, 0.0, form_error).misfit_per_dof()
    prior_tension, furthest_from_prior, spine_outlier = _prior_tension(
        Gaussian(linear, prior, best.grid_point.size, form_error), p, best.named
    )
    within = Gaussian(linear, prior, max(best.grid_point.size, PREDICTIVE_DISCREPANCY), form_error)
    surprise, numbers, probability = [], np.unique(trial), []
    for t in numbers:
        value, n = within.surprise(trial == t)
        surprise.append(value / n)
        probability.append(float(chdtrc(n, value)))
    worst = int(np.argmin(probability))
    significant = probability[worst] * len(numbers) < 1e-3
    if answer is not None and answer is not best:
        # A tolerance of the best hypothesis may be strained because it is the cause that the answer names.
        point = answer.grid_point
        named = Gaussian(of_answer, answer.prior(p), point.size, point.form_error)
        prior_tension, furthest_from_prior = min((prior_tension, furthest_from_prior), _prior_tension(named, p, answer.named)[:2])
    return MisfitDiagnostics(
        lack_of_fit=lack_of_fit,
        prior_tension=prior_tension,
        furthest_from_prior=furthest_from_prior,
        spine_outlier=spine_outlier,
        excess_scatter=excess_scatter,
        outlier_trial=int(numbers[worst]) if significant else None,
        outlier_surprise=float(surprise[worst]),
        law_error_gain=_law_error_gain(answer or best, of_answer),
    )


def _law_error_gain(best: Candidate, linear: Linear) -> float:
    if not linear.form_error.shape[1]:
        return 0.0
    by_share = logsumexp(best.weighed.log_terms, axis=(0, 1)) - np.log(KNOWN.form_error_weights)
    return float(by_share[-1] - by_share[0])


def _prior_tension(g: Gaussian, p: Parameters, named: tuple[str, ...]) -> tuple[float, str, float]:
    """Prior tension of all but the calibration and the trials' own parameters, the furthest parameter, the outlying spine."""
    order = np.concatenate([np.flatnonzero(p.of_effect), np.flatnonzero(~p.of_effect)])
    names, sources = np.array(p.names)[order], np.array([i.source for i in p.infos])[order]
    effects = int(p.of_effect.sum())
    free = np.zeros(len(names), bool)
    free[effects:] = p.calibrated
    by_trial = p.recurs[order]
    mask = np.zeros(len(names), bool)
    mask[:effects] = p.mask(named)
    nuisance = np.arange(len(names)) >= effects
    form = np.arange(len(names), len(names) + g.form_columns)
    groups = [np.flatnonzero(~nuisance & mask), np.flatnonzero(~nuisance & ~mask)]
    groups += [np.flatnonzero(nuisance & ~free & ~by_trial), form]
    found = [g.distance(own) for own in groups if own.size]
    squares, rank = (float(sum(x)) for x in zip(*found, strict=True)) if found else (0.0, 0.0)
    single = g.single()[: len(names)]
    tension = np.where(free | by_trial, 0.0, single)
    furthest = int(np.argmax(tension))
    return (
        (squares - rank) / np.sqrt(2 * max(rank, 1.0)),
        str(names[furthest]) if tension[furthest] > TENSE_SD else "",
        float(np.max(single[by_trial & np.isin(sources, SPINE_SOURCES)], initial=0.0)),
    )
