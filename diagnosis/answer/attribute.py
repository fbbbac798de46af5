"""Which effect: the search, the posterior, the signs of something else, and the decision."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..criticism.probability_calibration import CALIBRATED, ProbabilityCalibration
from ..criticism.trend import trend
from ..criticism.unknown import Signs, signs
from ..data.case import enough
from ..inference.effort import ALONE, Effort
from ..inference.evidence import NONE, Hypothesis
from ..inference.fit import Fit, fit
from ..inference.posterior import Posterior, beside_unknown, posterior, prior
from ..inference.prepare import Prepared
from ..inference.search import Candidate, Search
from .distinguishability import Apart, apart
from .verdict import Decision, decide

Array = NDArray[np.float64]

BESIDE = 8
"""Leading hypotheses beside which a cause outside the catalogue is weighed."""
WORTH = 0.01
"""Effects less probable than this are no rivals."""
LEAST_DISCREPANCY = 0.25
"""Size of the discrepancy at which effects must at least be told apart: the honest floor."""
CALIBRATING = 30
"""Rounds: far from the data, as the paper's numbers may be on another robot, a few do not do."""


@dataclass(frozen=True)
class Found:
    """What the attribution found."""

    prepared: Prepared
    posterior: Posterior
    none: Candidate
    best: Candidate
    """The most probable hypothesis of the catalogue, none included."""
    calibrated: Fit
    """The baseline: area factor and tolerances fitted, no effect."""
    signs: Signs
    trend: float
    """Probability that repeats follow time so well by chance."""
    decision: Decision
    apart: Apart
    probability_calibration: ProbabilityCalibration

    @property
    def rivals(self) -> tuple[tuple[str, ...], ...]:
        """Groups of effects that carry weight, would be seen at all, and could pass for each other."""
        seen = [e for e in self.apart.effects if self.apart.detectable(e)]
        worth = [e for e in seen if self.posterior.of_effect(e) > WORTH]
        groups = (tuple(e for e in worth if e == one or e in self.apart.rivals(one)) for one in worth)
        return tuple(dict.fromkeys(g for g in groups if len(g) > 1))


def attribute(p: Prepared, effort: Effort = ALONE) -> Found:
    """Weigh the catalogue against the data."""
    search = Search(p.problem, effort=effort)
    candidates = search.run()
    found = {c.named: c for c in candidates}
    effects = len(p.problem.parameters.ids)
    leading = sorted(candidates, key=lambda c: -(c.log_evidence + np.log(prior(c.named, effects))))[:BESIDE]
    unknown = search.unknown(leading, [prior(c.named, effects) for c in leading], CALIBRATED.temperature)
    known = posterior(candidates, effects, CALIBRATED.temperature)
    best = search.whole(found[known.ranking[0][0]])
    sign = signs(p.problem, best, p.labels.trial, p.labels.experiment, p.floor.beyond)
    trended = trend(p, found[NONE].fit.slope)
    weighed = beside_unknown(known, unknown, CALIBRATED.outside(sign, trended))
    decision = decide(weighed, CALIBRATED, enough(p.states))
    separations = _apart(p, found, weighed, best)
    return Found(
        p, weighed, found[NONE], best, _calibrated(p), sign, trended, decision, separations, CALIBRATED
    )  # fmt: skip


def _calibrated(p: Prepared) -> Fit:
    parameters = p.problem.parameters
    return fit(p.problem, parameters.absent(), 0.0, parameters.mean, CALIBRATING)


def _apart(p: Prepared, found: Mapping[Hypothesis, Candidate], weighed: Posterior, best: Candidate) -> Apart:
    """Separations of all single effects: at the fitted size where an effect carries weight, else at its scale."""
    parameters = p.problem.parameters
    size = np.ones(len(parameters.scale))
    for effect in parameters.ids:
        if weighed.of_effect(effect) > WORTH:
            mask = parameters.mask((effect,))
            size[mask] = (found[(effect,)].fit.theta[parameters.of_effect] / parameters.scale)[mask]
    linear = best.fit.linear
    reduced = linear.reduced(max(best.cell.size, LEAST_DISCREPANCY), best.cell.form)
    return apart(reduced, parameters, parameters.ids, size, best.cell.spike, linear.reach)
