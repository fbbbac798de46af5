"""What is answered, as deep as the data carry. `sentences` has the words, docs/explanations/diagnosis.md explains them.

cause             named, with a probability of 0.9 at least, no relative outside the catalogue does the same, and no `doubts`
one of several    named with less: the data do not exclude others
stage             outside the catalogue; one stage of the chain asks for an error of its own
outside           outside the catalogue
none              no effect accounts for enough above the noise floor
noise             the same, and nowhere is the gap above the noise
too little data   the table lacks what it takes to name a cause
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from .. import judgement
from ..criticism.stage_errors import StageError
from ..findings import Finding, finding
from ..inference.evidence import NONE, Hypothesis
from ..inference.posterior import UNKNOWN, EffectPosterior
from .result import Carries, Conclusion, FittedRobot, Shrink, Verdict
from .shrink import share_closed
from .size import Size


@dataclass(frozen=True)
class Decision:
    """What is answered."""

    verdict: Verdict
    effects: tuple[str, ...]
    probability: float
    """Of the verdict: of what is named, of none, or of a cause outside the catalogue."""
    outside: float
    """Probability of a cause outside the catalogue."""
    enough: bool = True
    """Whether the table holds what it takes to name a cause."""
    too_small: tuple[str, ...] = ()
    """Effects that lead but are not named, as probably nothing stands out."""
    relatives: tuple[str, ...] = ()
    """Causes outside the catalogue that do the same to these readings (`criticism.relatives`)."""
    second: Mapping[str, float] = field(default_factory=dict)
    """Effects of which one acts together with what is named, and the probability of each (`Budget.second`)."""

    @property
    def within(self) -> float:
        """Probability of a cause of the catalogue, or of none, given that it is not outside."""
        return self.probability / (1 - self.outside)


def decide(posterior: EffectPosterior, enough: bool, nothing_stands_out: float = 0.0) -> Decision:
    """Effect, none or unknown; with too little data (`enough` false) nothing is named however well it fits.

    `nothing_stands_out`: probability, within the catalogue, that no effect carries `OUTSTANDING_FLOORS`.
    """
    outside = posterior.probability(UNKNOWN)
    named, probability = next((h, p) for h, p in posterior.ranking if h != UNKNOWN)
    small = (1 - outside) * nothing_stands_out
    if not enough or outside >= judgement.OUTSIDE_PROBABILITY:
        return Decision("unknown", (), outside, outside, enough)
    if named == NONE:
        return Decision("none", (), probability, outside)
    if probability < min(small, judgement.NAMED_PROBABILITY):
        return Decision("none", (), small, outside, too_small=named)
    return Decision("effect", named, probability, outside)


def without_nothing(d: Decision, known: Sequence[Size], lowest: Mapping[str, float], none: float) -> Decision:
    """The decision without effects whose size is zero within its error and which may carry less than a noise floor; none, of
    probability `none` so far, where no other is named. `lowest`: noise floors that each carries at least, with 97.5 %."""
    certain = {s.effect for s in known if s.role == "size" and s.certain} | ({*d.effects} - {s.effect for s in known})
    named = tuple(e for e in d.effects if e in certain or lowest[e] > judgement.LEAST_NAMED_FLOORS)
    if named == d.effects:
        return d
    nothing = min(d.probability + none, 1 - d.outside)
    return replace(d, effects=named) if named else Decision("none", (), nothing, d.outside, too_small=d.effects)


def behaves_like(d: Decision, best: Hypothesis, posterior: EffectPosterior, unseen: Shrink | None) -> Decision:
    """The decision to name the `best` effects of the catalogue, although the readings follow no law of theirs exactly, where they
    close `FOLLOWED_SHARE` of the gap on unseen states: a law of another form is more probable than a cause outside."""
    closed, within = unseen.share_closed if unseen is not None else None, 1 - posterior.probability(UNKNOWN)
    if d.verdict != "unknown" or not d.enough or not best or closed is None or closed < judgement.FOLLOWED_SHARE or not within:
        return d
    most = judgement.DOUBTED_PROBABILITY
    return replace(d, verdict="effect", effects=best, probability=most * posterior.probability(best) / within, outside=1 - most)


def rivals(d: Decision, posterior: EffectPosterior) -> tuple[str, ...]:
    """Effects of the 95 % set that are not named, most probable first; only where an effect is named and not sure."""
    if d.verdict != "effect" or d.probability >= judgement.CAUSE_PROBABILITY:
        return ()
    others = (h for h in posterior.credible_set if h not in (NONE, UNKNOWN, d.effects))
    return tuple(dict.fromkeys(e for h in others for e in h if e not in d.effects))


def doubts(
    effects: Mapping[str, str],
    sizes: Sequence[Size],
    budget: Sequence[Carries],
    unseen: Shrink | None,
    fitted: FittedRobot | None,
    floor_mm: float,
    alone: Sequence[str] = (),
    follows_law: bool = True,
) -> Iterator[Finding]:
    """Why effects (id -> name) are no certain cause: their sizes, what they carry, what they leave on unseen states, and what the
    robot with them alone does. `alone`: names of effects that do as well without any calibration; `follows_law`: whether the
    readings follow the catalogue's. (That another is the cause if laws are more or less wrong needs no doubt: probabilities are
    means over how wrong they are.)"""
    low = {c.effect: c.low95_mm for c in budget}
    for effect, name in effects.items():
        if any(s.impossible for s in sizes if s.effect == effect):
            yield finding("cause_impossible", effect=name)
        elif low.get(effect, math.inf) < judgement.LEAST_NAMED_FLOORS * floor_mm:
            yield finding("cause_undetermined", effect=name)
    yield from (finding("cause_or_calibration", effect=name) for name in alone[:1])
    partial = {s.effect for s in sizes if s.mean < s.least}
    if other_forms := [name for effect, name in effects.items() if effect in partial or not follows_law]:
        yield finding("law_of_another_form", effect=" and ".join(other_forms))
    if unseen is None:
        return
    if unseen.after_mm > max(judgement.LEFT_FLOORS * unseen.floor_mm, judgement.LEFT_SHARE * unseen.before_mm):
        yield finding("gap_remains", mm=unseen.after_mm)
    by_itself = None if fitted is None else share_closed(fitted.calibrated_mm, fitted.left_mm, floor_mm)
    promised = unseen.share_closed or 0.0
    if fitted is not None and by_itself is not None and by_itself < judgement.EXPLAINS * promised:
        yield finding("fit_not_reached", effect=" and ".join(effects.values()), mm=fitted.left_mm, promised_mm=unseen.after_mm)


def doubted(d: Decision, why: Sequence[Finding], as_good: int) -> Decision:
    """The decision with a probability that leaves room for its doubts: it is shared with the effects that do `as_good`, and never
    more than `DOUBTED_PROBABILITY`. What is taken off goes to causes outside the catalogue and mistakes in the description."""
    most = judgement.DOUBTED_PROBABILITY if why else 1.0
    probability = min(d.probability / (1 + as_good), most)
    return replace(d, probability=probability, outside=d.outside + d.probability - probability)


def conclude(d: Decision, gap: bool, asking: Sequence[StageError], tense: bool = False) -> Conclusion:
    """As deep as the data carry; `gap` whether it is anywhere above the noise floor, `tense` whether anything speaks against a
    certain cause, such as a number of robot.yaml that the fit moves far beyond its tolerance, or `doubts`."""
    if not d.enough:
        return "too little data"
    if d.verdict == "effect":
        sure = d.probability >= judgement.CAUSE_PROBABILITY and not tense and not d.relatives
        return "cause" if sure else "one of several"
    if d.verdict == "none":
        return "none" if gap else "noise"
    return "stage" if stage(asking) else "outside"


def stage(asking: Sequence[StageError]) -> StageError | None:
    """The stage that asks for an error of its own, with what the error goes with most; None where none stands out."""
    if not asking:
        return None
    gains = np.exp((np.array([e.gain for e in asking]) - max(e.gain for e in asking)) / judgement.TEMPERATURE)
    own = np.array([e.stage == asking[0].stage for e in asking])
    return asking[0] if gains[own].sum() >= judgement.STAGE_SHARE * gains.sum() else None
