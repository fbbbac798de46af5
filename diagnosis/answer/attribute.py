"""Attribute the gap to effects: search, posterior probabilities, model criticism, and the decision."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from ..arrays import Array, rms
from ..criticism.gaussian import Gaussian, outlier_trial
from ..criticism.outside import log_weight_of, related
from ..criticism.stage_errors import StageError, odds_unnamed, smooth_functions, stage_errors, total_gain
from ..data.case import lacking
from ..data.levels import SPINE_GAP
from ..inference.budget import Budget, WeighedCauses
from ..inference.candidate import Candidate
from ..inference.evidence import NONE, Hypothesis
from ..inference.executor import Executor
from ..inference.fit import Fit, fit_alone
from ..inference.posterior import EffectPosterior, Related, alike, odds_of_relatives, with_unknown
from ..inference.prepare import AREA, MODULUS, PAYLOAD, Prepared
from ..judgement import BEYOND_SD, LEAST_STATED, LISTED, REDUCIBLE_RATIO, STAGE_GAIN
from .decision import Decision, decide, without_nothing
from .distinguishability import Distinguishability, distinguishability
from .result import FittedRobot
from .size import Size, as_fitted, sizes

MOST_INSTEAD = 3
"""Effects that are tried in the place of numbers beyond their tolerances."""


@dataclass(frozen=True)
class Attribution:
    """The result: probabilities of all hypotheses, their fits, and the criticism."""

    prepared: Prepared
    posterior: EffectPosterior
    best: Candidate
    """Stands for what is named: the hypothesis of just that, or the most probable that holds it."""
    calibrated: Fit
    """The baseline: area factor and tolerances fitted, no effect."""
    outlier_trial: int | None
    """The trial that the others contradict most, if one does."""
    decision: Decision
    distinguishability: Distinguishability
    budget: Budget
    """Each effect's part of the gap."""
    alone: Mapping[Hypothesis, Candidate]
    """What is stated beside the decision, with all other effects absent: its sizes are those of a robot with it alone."""
    stage_errors: tuple[StageError, ...]
    """Of free form, that the readings ask for beside the leading hypothesis: those of a stage that gain enough, most first."""
    relatives: tuple[Related, ...]
    """Causes outside the catalogue, most probable first."""

    def sizes(self, c: Candidate, fitted: FittedRobot | None) -> tuple[Size, ...]:
        """Of what a hypothesis names: as it was `fitted`, if that is the decision."""
        robot, found = fitted if c.named == self.decision.effects else None, sizes(self.prepared, c)
        return found if robot is None else tuple(as_fitted(s, robot.parameters[s.name]) for s in found)

    def tense(self, fitted: Mapping[str, float] | None) -> Mapping[str, Mapping[int, float]]:
        """Numbers of robot.yaml that a fit of the answer moves far beyond their tolerance (`Parameters.tense`), by that fit: the
        robot `fitted` with what is named, which must ask for them too, and, for others, the calibrated model where that is the
        answer, or leaves nothing above the noise floor. One number of the body has one value, that of the statement."""
        p, best = self.prepared.problem.parameters, self.best.fit.theta
        alone = best if fitted is None else np.array([fitted.get(*own) for own in zip(p.names, best.tolist(), strict=True)])
        own, closes = p.tense(alone, best), dict[int, float]()
        for r in self.relatives:  # where what is not in the catalogue explains more, it moves less
            if self.decision.verdict == "unknown" and r.sizes and r.relative in self.decision.relatives:
                own = {i: value for i, value in own.items() if i in r.tense}
        if self.decision.verdict == "none" or self.closes(self.calibrated):
            closes = p.tense(np.where(np.isin(np.arange(len(best)), [*own]), 0.0, self.calibrated.theta))
        found = {"the fit with the cause": own, "calibration, which alone closes the gap,": closes}
        found = found if fitted is not None else {"the fit": own | closes}
        stated = self.calibrated.theta if fitted is None else alone  # of the body, what the statement says
        body = [i for i in np.flatnonzero(np.abs(stated) > BEYOND_SD * p.sd).tolist() if p.names[i] in (AREA, MODULUS)]
        return {fit: moved | {i: float(stated[i]) for i in body if i in moved} for fit, moved in found.items() if moved}

    @cached_property
    def closing_alone(self) -> Mapping[str, Array]:
        """Of the named effect, a load at the tip and what is stated beside, at most `MOST_INSTEAD`, those that each leave no gap
        alone: effect -> parameters (k,)."""
        p, likely = self.prepared.problem, [self.decision.effects, (PAYLOAD.partition(".")[0],), *self.alone]
        tried = [h for h in dict.fromkeys(likely) if len(h) == 1 and h[0] in p.parameters.ids][:MOST_INSTEAD]
        fits = {h[0]: fit_alone(p, h, self.calibrated.theta, 30) for h in tried}
        return {effect: fit.theta for effect, fit in fits.items() if self.closes(fit)}

    def closes(self, fit: Fit) -> bool:
        """Whether a fit leaves no gap above the noise floor."""
        left = rms(self.prepared.gap(self.prepared.problem.observed - fit.predicted))
        return left < REDUCIBLE_RATIO * self.prepared.noise_floor


def related_ahead(p: Prepared, w: WeighedCauses, executor: Executor) -> Callable[[], list[tuple[Related, ...]]]:
    """Start to fit what stands beside the catalogue; the function returned waits for it, and is to be called once."""
    found = w.whole.candidates
    asked = {c.named: c for c in (w.leading, w.best)}
    if NONE not in asked:
        asked[NONE] = w.search.with_all_derivatives(found[NONE])
    reached = {h: c.log_evidence for h, c in found.items()}
    return executor.ahead(partial(related, p, reached=reached), [tuple(asked.values())])


def attribute(p: Prepared, w: WeighedCauses, baseline: Fit, relatives_of: Callable[[], list[tuple[Related, ...]]]) -> Attribution:
    """Weigh hypotheses of the catalogue, `w`, against causes outside it (`related_ahead`), and decide; `baseline`: area
    factor and tolerances fitted, no effect."""
    leading, best, candidates = w.leading, w.best, w.whole.candidates
    # Where a tolerance of the leading hypothesis is the cause that is named, an error of its stage is that cause: the least gain.
    free_forms = min((_stage_errors(p, c) for c in {leading.named: leading, best.named: best}.values()), key=total_gain)
    (relatives,) = relatives_of()
    effects = len(p.problem.parameters.ids)
    odds = odds_of_relatives(w.search.tried, [log_weight_of(r, effects) for r in relatives], effects)
    odds += odds_unnamed(total_gain(free_forms), p.noise_components.excess_scatter)
    ranked = with_unknown(w.known, candidates[NONE], odds)
    decision = decide(ranked, not lacking(p.states), w.budget.nothing_stands_out)
    floors_at_least = {e: w.budget.interval(e, 0.025)[0] / p.noise_floor for e in decision.effects}
    known = [(s.effect, s.role == "size" and s.certain) for s in sizes(p, best)]
    decision = without_nothing(decision, known, floors_at_least, ranked.probability(NONE))
    answered = best if decision.verdict == "effect" else leading
    decision = replace(
        decision,
        relatives=alike(relatives, decision.effects, answered.log_evidence),
        second=w.budget.second(decision.effects) if decision.effects else {},
    )
    likely = [h for h, p in ranked.ranking[:LISTED] if p >= LEAST_STATED and h not in (NONE, decision.effects)]
    return Attribution(
        prepared=p,
        posterior=ranked,
        best=best,
        calibrated=baseline,
        outlier_trial=outlier_trial(p.problem, leading, p.states.trial[p.labels.state]),
        decision=decision,
        distinguishability=distinguishability(p.problem, best, ranked),
        budget=w.budget,
        alone={h: w.search.alone(c) for h in likely if (c := ranked.candidates[h]).named == h},  # not another that holds it
        stage_errors=tuple(dict.fromkeys(e for e in free_forms if e.gain > STAGE_GAIN)),
        relatives=relatives,
    )


def _stage_errors(p: Prepared, c: Candidate) -> tuple[StageError, ...]:
    parameters, s = p.problem.parameters, p.states
    g = Gaussian(c.fit.linear(p.problem), c.prior(parameters), c.weighed.peak.size, c.weighed.peak.form_error)
    functions = smooth_functions(s.spine_length, np.maximum(s.highest, 0.0), s.branch, s.time, p.robot.length)
    if np.ptp(s.kind[p.labels.state]):
        functions["experiment"] = (s.kind[:, None] == np.unique(s.kind)).astype(float)
    stages = {effect: spec.stage for effect, spec in p.forward.catalogue.items()}
    found = stage_errors(g, parameters, stages, {name: f[p.labels.state] for name, f in functions.items()})
    if np.ptp(s.spine_length) > SPINE_GAP:
        return found
    without: Mapping[str, str] = {"spine length": "nothing", "pressure and spine length": "pressure"}
    return tuple(replace(e, dependence=without.get(e.dependence, e.dependence)) for e in found)


def calibrated(p: Prepared) -> Fit:
    """The baseline fitted: area factor and tolerances, no effect."""
    # the numbers of a robot.yaml may be far from the data, where a few rounds are not enough
    return fit_alone(p.problem, NONE, np.zeros_like(p.problem.parameters.sd), 30)
