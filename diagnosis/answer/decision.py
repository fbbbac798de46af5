"""Decide which effects are named, with their probability, without using the rod."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from .. import judgement
from ..inference.evidence import NONE, Hypothesis
from ..inference.posterior import UNKNOWN, EffectPosterior

SCHEMA = "diagnosis/1"
"""Of an answer as JSON."""
Verdict = Literal["effect", "none", "unknown"]


@dataclass(frozen=True)
class Decision:
    """What is answered."""

    verdict: Verdict
    effects: tuple[str, ...]
    probability: float
    """Of the verdict: of what is named, of none, or of a cause outside the catalogue."""
    outside: float = 0.0
    """Probability of a cause outside the catalogue."""
    enough: bool = True
    """Whether the table suffices to name a cause."""
    too_small: tuple[str, ...] = ()
    """Effects that lead but are not named, as probably nothing stands out."""
    relatives: tuple[str, ...] = ()
    """Causes outside the catalogue with the same signature in these readings (`criticism.relatives`), of any model in words."""
    second: Mapping[str, float] = field(default_factory=dict)
    """Effects of which one acts together with what is named, and the probability of each (`Budget.second`)."""
    limited: bool = False
    """Whether the probability is the largest that is stated of an answer in doubt, and no result."""

    @property
    def p(self) -> str:
        """The probability as a headline states it."""
        return f"p {'≤' if self.limited else '='} {self.probability:.2f}"


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


def without_nothing(d: Decision, fitted: Sequence[tuple[str, bool]], lowest: Mapping[str, float], none: float) -> Decision:
    """The decision without effects whose size is zero within its error and which may carry less than a noise floor; none, of
    probability `none` so far, where no other is named. `fitted`: effect of each of its parameters, and whether that is a size
    surely beyond zero; `lowest`: noise floors that each carries at least, with 97.5 %."""
    zero = {effect for effect, _ in fitted} - {effect for effect, certain in fitted if certain}
    named = tuple(e for e in d.effects if e not in zero or lowest[e] > judgement.LEAST_NAMED_FLOORS)
    if named == d.effects:
        return d
    nothing = min(d.probability + none, 1 - d.outside)
    return replace(d, effects=named) if named else Decision("none", (), nothing, d.outside, too_small=d.effects)


def doubted(d: Decision, why: Sequence[object], as_good: int) -> Decision:
    """The decision with a probability that leaves room for its doubts: it is shared with the effects that do `as_good`, and never
    more than `DOUBTED_PROBABILITY`. What is taken off, of all answers of the catalogue alike, goes to causes outside and mistakes
    in the description."""
    most = judgement.DOUBTED_PROBABILITY if why else 1.0
    kept = min(1 / (1 + as_good), most / max(d.probability, most))
    shared = d.probability / (1 + as_good)
    limited = d.limited or (bool(why) and shared >= most)
    return replace(d, probability=min(shared, most), outside=1 - kept * (1 - d.outside), limited=limited)


def outside_at_most(d: Decision, probability: float) -> Decision:
    """The decision that the cause is outside the catalogue, with no more than `DOUBTED_PROBABILITY`."""
    most = min(probability, judgement.DOUBTED_PROBABILITY)
    return replace(d, verdict="unknown", effects=(), probability=most, outside=most, limited=probability > most)


def capped(d: Decision, closed: float | None) -> Decision:
    """The decision to name effects, no more probable than the share `closed` (None: not known) of the gap that they close on
    unseen states: a cause outside the catalogue is more probable than effects that do not explain it."""
    if d.verdict != "effect" or closed is None or closed >= d.probability:
        return d
    explains = closed >= judgement.EXPLAINS
    return replace(d, probability=closed, outside=1 - closed, limited=False) if explains else outside_at_most(d, 1 - closed)


def share_closed(before: float, after: float, floor: float) -> float | None:
    """Share of the reducible gap that is closed, from root mean squares; None where before is at the floor."""
    return None if before <= judgement.REDUCIBLE_RATIO * floor else 1 - (after**2 - floor**2) / (before**2 - floor**2)


def behaves_like(d: Decision, best: Hypothesis, posterior: EffectPosterior, closed: float | None) -> Decision:
    """The decision to name the `best` effects of the catalogue, although the readings follow no law of theirs exactly, where they
    close `FOLLOWED_SHARE` of the gap on unseen states (`closed`; None: not known) and no relative explains more: a law of another
    form is more probable than a cause outside."""
    within = 1 - posterior.probability(UNKNOWN)
    followed = closed is not None and closed >= judgement.FOLLOWED_SHARE and not d.relatives
    if d.verdict != "unknown" or not d.enough or not best or not followed or not within:
        return d
    most = judgement.DOUBTED_PROBABILITY
    probability = most * posterior.probability(best) / within
    return replace(d, verdict="effect", effects=best, probability=probability, outside=1 - most, limited=True)
