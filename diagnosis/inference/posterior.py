"""From evidence to probabilities: prior over hypotheses, calibrated evidence, the 95 % set.

Prior: none, one effect, two or three have fixed shares; within a share all combinations of the catalogue are equally probable. A
pair must therefore pay not only for its free parameters but also for being one of several hundred. The probability of a cause
outside the catalogue is that of `criticism.outside`; the catalogue shares the rest. The probabilities in an answer follow
from these: `budget.by_what_is_carried`, then `with_unknown`.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import comb, exp, inf, log

import numpy as np
from scipy.special import logsumexp, softmax

from .. import judgement
from ..arrays import Array
from .candidate import Candidate
from .evidence import Hypothesis

UNKNOWN: Hypothesis = ("unknown",)
"""Stands in credible sets and rankings for a cause outside the catalogue."""


@dataclass(frozen=True)
class EffectPosterior:
    """Probabilities of all hypotheses weighed, most probable first."""

    ranking: tuple[tuple[Hypothesis, float], ...]
    """`UNKNOWN` stands for a cause outside the catalogue, () for none."""
    candidates: Mapping[Hypothesis, Candidate]

    def probability(self, named: Hypothesis) -> float:
        """Of exactly this hypothesis."""
        return dict(self.ranking).get(named, 0.0)

    def of_effect(self, effect: str) -> float:
        """Probability that an effect is among those named."""
        return sum(p for named, p in self.ranking if effect in named)

    @property
    def credible_set(self) -> tuple[Hypothesis, ...]:
        """The fewest hypotheses that hold 95 % together."""
        before = itertools.accumulate((p for _, p in self.ranking), initial=0.0)
        return tuple(named for (named, _), held in zip(self.ranking, before, strict=False) if held < judgement.CREDIBLE_SHARE)


def hypothesis_prior(named: Hypothesis, effects: int) -> float:
    """Prior probability of a hypothesis of a catalogue of that many effects."""
    most = min(len(named), max(judgement.PRIOR_OF_NUMBER))
    return judgement.PRIOR_OF_NUMBER[most] * judgement.PRIOR_OF_MORE ** (len(named) - most) / comb(effects, len(named))


def log_weight(named: Hypothesis, log_evidence: float, effects: int) -> float:
    """log(prior p^(1/T)) of a hypothesis of a catalogue of that many effects, from its log evidence log p; T: `TEMPERATURE`."""
    return log_evidence / judgement.TEMPERATURE + log(hypothesis_prior(named, effects))


@dataclass(frozen=True)
class Related:
    """A relative, weighed beside listed effects in the place of another."""

    relative: str
    beside: Hypothesis
    log_evidence: float
    sizes: tuple[tuple[float, float], ...] = ()
    """Mean and standard deviation of each of its parameters, where it was fitted."""
    tense: Mapping[int, float] = field(default_factory=dict)
    """Numbers that its fit moves far beyond their tolerance (`FitParameters.tense`)."""


def alike(among: Sequence[Related], named: Hypothesis, log_evidence: float) -> tuple[str, ...]:
    """Relatives that do the same as an effect of what is named, as far as these readings tell, best first; where nothing is, that
    explain more than the best hypothesis, whose `log_evidence` is given."""
    own = [r for r in among if set(r.beside) < set(named) and r.log_evidence > log_evidence - judgement.SEPARATED_EVIDENCE]
    if not named and among and among[0].log_evidence > log_evidence + judgement.SEPARATED_EVIDENCE:
        own = [r for r in among if r.log_evidence > among[0].log_evidence - judgement.SEPARATED_EVIDENCE]
    return tuple(dict.fromkeys(r.relative for r in own))


def odds_of_relatives(tried: Sequence[Candidate], weights: Sequence[float], effects: int) -> float:
    """Odds of relatives, of these log weights, against all hypotheses of a catalogue of `effects` effects that were tried."""
    of_catalogue = logsumexp([log_weight(c.named, c.log_evidence, effects) for c in tried])
    return judgement.RELATIVE_ODDS * exp(min(logsumexp([*weights, -inf]) - of_catalogue, judgement.LARGEST_ODDS))


def shares(candidates: Sequence[Candidate], effects: int) -> Array:
    """Probabilities of candidates that exclude each other, within a catalogue of `effects` effects."""
    return np.asarray(softmax([log_weight(c.named, c.log_evidence, effects) for c in candidates]))


def posterior(candidates: Sequence[Candidate], effects: int) -> EffectPosterior:
    """Probabilities within a catalogue of `effects` effects."""
    by_name = {c.named: c for c in candidates}
    ranking = zip((c.named for c in candidates), shares(candidates, effects).tolist(), strict=True)
    return EffectPosterior(tuple(sorted(ranking, key=lambda entry: -entry[1])), by_name)


def with_unknown(known: EffectPosterior, unknown: Candidate, odds: float) -> EffectPosterior:
    """The same with a cause outside the catalogue beside it, with its odds against all that are known."""
    probability = odds / (1 + odds)
    ranking = [*((named, p * (1 - probability)) for named, p in known.ranking), (UNKNOWN, probability)]
    return EffectPosterior(tuple(sorted(ranking, key=lambda entry: -entry[1])), {**known.candidates, UNKNOWN: unknown})
