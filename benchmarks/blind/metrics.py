"""Judge answers against the truth: figures with 95 % intervals, exact for shares, by bootstrap for everything else.

An answer is exact if it is just the truth. It is right by mm if all that is named carries at least half of what the largest
carrier does, and at least a floor (the scatter of repeats); where nothing carries two floors, none is right.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.stats import beta

from diagnosis.judgement import CAUSE_PROBABILITY
from model.arrays import Array

from .answers import Answer, Effects
from .truth import KINDS

LEAST_PROBABILITY = 1e-4
"""A truth that was given no probability costs as much as this."""
HALF, FLOORS = 0.5, 2.0
APART = 1.5
"""Noise floors that the nearest known effect leaves of a cause that is to be flagged."""


@dataclass(frozen=True)
class Interval:
    """A value with its 95 % interval, from n cases; NaN from none."""

    value: float
    low: float
    high: float
    n: int


def share(right: Array) -> Interval:
    """Share of trues with its Clopper-Pearson interval (Biometrika 26, 1934)."""
    n, k = len(right), int(np.sum(right))
    if n == 0:
        return Interval(np.nan, np.nan, np.nan, 0)
    return Interval(k / n, *clopper_pearson(k, n), n)


def counted(right: Sequence[bool] | Array, nothing: str = "none") -> str:
    """How many of how many are true, with the interval of their share, in words; `nothing` where there are none at all."""
    found = share(np.array(right, float))
    return f"{int(np.sum(right))} of {found.n} ({found.low:.2f} .. {found.high:.2f})" if found.n else nothing


def clopper_pearson(hits: int, n: int) -> tuple[float, float]:
    """95 % interval of a share."""
    low = float(beta.ppf(0.025, hits, n - hits + 1)) if hits else 0.0
    return low, float(beta.ppf(0.975, hits + 1, n - hits)) if hits < n else 1.0


def bootstrap(values: Array, statistic: Callable[[Array], float], seed: int = 0) -> Interval:
    """A statistic of the cases (first axis) with its percentile interval."""
    n = len(values)
    if n == 0:
        return Interval(np.nan, np.nan, np.nan, 0)
    rng = np.random.default_rng(seed)
    drawn = [statistic(values[rng.integers(n, size=n)]) for _ in range(2000)]
    low, high = np.percentile(drawn, [2.5, 97.5])
    return Interval(float(statistic(values)), float(low), float(high), n)


def carries_enough(named: Collection[str], carries: Mapping[str, float], floor: float) -> bool:
    """Whether what is named, or that nothing is, is right where effects carry this much; `floor` in the same unit."""
    most = max(carries.values(), default=0.0)
    least = max(HALF * most, floor)
    return all(carries.get(e, 0.0) >= least for e in named) if named else most < FLOORS * floor


@dataclass(frozen=True)
class JudgedAnswer:
    """One case: what is true, and what was answered."""

    stratum: str
    causes: Effects
    """What was drawn; one outside the catalogue among them."""
    answer: Answer
    carries: Mapping[str, float] = field(default_factory=dict)
    """mm after calibration, by effect; one outside the catalogue among them."""
    floor: float = math.nan
    nearest: Mapping[str, Any] | None = None
    stage: str | None = None
    """Of a cause outside the catalogue."""

    @property
    def kind(self) -> str:
        """single, pair, none or outside; thrust on the walls of a robot without another cause is one."""
        kind = KINDS[self.stratum]
        return "single" if kind == "none" and self.causes else kind

    @property
    def truth(self) -> Effects:
        """What the catalogue could name."""
        return frozenset() if self.kind == "outside" else self.causes

    @property
    def exact(self) -> bool:
        """The verdict is the truth: exactly these effects, none, or unknown."""
        verdict = {"outside": "unknown", "none": "none"}.get(self.kind, "effect")
        return self.answer.verdict == verdict and self.answer.effects == self.truth

    @property
    def first(self) -> bool:
        """The most probable set of effects is the truth, whatever the verdict."""
        return bool(self.truth) and self.answer.best == self.truth

    @property
    def covered(self) -> bool:
        """The truth is in the 95 % set."""
        return (frozenset({"unknown"}) if self.kind == "outside" else self.truth) in self.answer.credible

    @property
    def probability_on_truth(self) -> float:
        """Stated probability of what is true."""
        a = self.answer
        return a.unknown_probability if self.kind == "outside" else a.probability_of(self.truth)

    @property
    def named(self) -> bool:
        """An effect is named with a high probability."""
        return self.answer.verdict == "effect" and self.answer.probability > CAUSE_PROBABILITY

    @property
    def unknown(self) -> bool:
        """The cause is called unknown."""
        return self.answer.verdict == "unknown"

    @property
    def largest(self) -> str:
        """The effect that carries most; empty where none does."""
        return max(self.carries, key=lambda e: self.carries[e], default="")

    @property
    def right(self) -> bool:
        """Right by mm."""
        effects = self.answer.effects
        return self.answer.verdict == ("effect" if effects else "none") and carries_enough(effects, self.carries, self.floor)

    @property
    def spurious(self) -> bool:
        """Something is named that carries less than half of the largest, or less than a floor."""
        return self.answer.verdict == "effect" and not carries_enough(self.answer.effects, self.carries, self.floor)

    @property
    def inside(self) -> bool | None:
        """Whether the mm of the largest carrier lies in the interval that the budget states; None where it states none."""
        stated = self.answer.budget.get(self.largest)
        return None if stated is None else stated[0] <= self.carries[self.largest] <= stated[1]

    @property
    def apart(self) -> bool:
        """The nearest known effect leaves so much of an outside cause that calling it by that name is an error."""
        return self.nearest is not None and float(self.nearest["leaves_mm"]) >= APART * self.floor


def judged(truth: Mapping[str, Any], answer: Answer) -> JudgedAnswer:
    """A sealed truth beside its answer; a convention that was settled first, and rightly, is left out of both."""
    settled = answer.settled_first & frozenset(truth["effects"])
    carries = {str(e): float(mm) for e, mm in truth["calibrated_mm"].items() if e not in settled}
    causes, effects = frozenset(truth["effects"]) - settled, answer.effects - settled
    answer = replace(answer, effects=effects, verdict="none" if answer.effects and not effects else answer.verdict)
    return JudgedAnswer(truth["stratum"], causes, answer, carries, float(truth["floor_mm"]), truth["nearest"], truth["stage"])


@dataclass(frozen=True)
class Metric:
    """One figure of the bench."""

    key: str
    label: str
    found: Interval


def _share(group: Sequence[JudgedAnswer], test: Callable[[JudgedAnswer], bool]) -> Interval:
    return share(np.array([test(c) for c in group], float))


def _mean(values: Sequence[float]) -> Interval:
    return bootstrap(np.array(values, float), lambda v: float(v.mean()))


def _median(values: Sequence[float]) -> Interval:
    return bootstrap(np.array(values, float), lambda v: float(np.median(v)))


def metrics(cases: Sequence[JudgedAnswer]) -> list[Metric]:
    """Figures of exact answers by kind; those without a case have n = 0."""
    single, pair, none, outside = ([c for c in cases if c.kind == k] for k in ("single", "pair", "none", "outside"))
    known = single + none
    sure, closed = [c for c in single if c.named], [c.answer.share_closed for c in single if c.exact]
    return [
        Metric("top1", "single: most probable effect is the true one", _share(single, lambda c: c.first)),
        Metric("named", "single: verdict names exactly the true one", _share(single, lambda c: c.exact)),
        Metric("detected", "single: not called none", _share(single, lambda c: c.answer.verdict in ("effect", "unknown"))),
        Metric("p_truth", "single: mean probability on the true one", _mean([c.probability_on_truth for c in single])),
        Metric("sure_right", f"single: right when p > {CAUSE_PROBABILITY}", _share(sure, lambda c: c.exact)),
        Metric("sure_share", f"single: share answered with p > {CAUSE_PROBABILITY}", _share(single, lambda c: c.named)),
        Metric("coverage", "single and none: truth in the 95 % set", _share(known, lambda c: c.covered)),
        Metric("set_size", "single: mean size of the 95 % set", _mean([len(c.answer.credible) for c in single])),
        Metric("pair_both", "pair: both named", _share(pair, lambda c: c.truth <= c.answer.effects)),
        Metric("pair_exact", "pair: exactly those named", _share(pair, lambda c: c.exact)),
        Metric("pair_spurious", "pair: spurious effects a case", _mean([len(c.answer.effects - c.truth) for c in pair])),
        Metric("false_alarm", "none: an effect named", _share(none, lambda c: c.answer.verdict == "effect")),
        Metric("false_unknown", "single, pair, none: called unknown", _share(known + pair, lambda c: c.unknown)),
        Metric("flagged_at_10", "outside: flagged at 10 % false flags", flagged_at(known + pair, outside)),
        Metric("outside_named", f"outside: an effect named with p > {CAUSE_PROBABILITY}", _share(outside, lambda c: c.named)),
        Metric("ece", "calibration error of the verdict's probability", bootstrap(confidence(cases), calibration_error)),
        Metric("log_score", "single and none: mean -log p of the truth",
               _mean([-math.log(max(c.probability_on_truth, LEAST_PROBABILITY)) for c in known])),
        Metric("closed", "single, right: median share of the gap closed", _median([x for x in closed if math.isfinite(x)])),
        Metric("seconds", "median seconds a case", _median([c.answer.seconds for c in cases])),
        Metric("failed", "diagnosis failed", _share(cases, lambda c: c.answer.verdict == "failed")),
    ]  # fmt: skip


def mm_metrics(cases: Sequence[JudgedAnswer]) -> list[Metric]:
    """Figures by stratum, by what carries; those without a case have n = 0."""
    out: list[Metric] = []
    for name in sorted({c.stratum for c in cases}):
        own = [c for c in cases if c.stratum == name]
        if name.endswith("outside"):
            out += _outside(name, own, [c for c in cases if not c.stratum.endswith("outside")])
        else:
            out += _known(name, own)
    return out


def _known(name: str, own: Sequence[JudgedAnswer]) -> list[Metric]:
    sure, caused = [c for c in own if c.named], [c for c in own if c.causes]
    largest, budgeted = [c for c in caused if c.largest in c.causes], [c for c in own if c.inside is not None]
    return [Metric(f"{name}.{key}", f"{name}: {label}", found) for key, label, found in (
        ("right", "right by mm", _share(own, lambda c: c.right)),
        ("named", "drawn causes among the named", _share(caused, lambda c: c.causes <= c.answer.effects)),
        ("exact", "exactly the drawn causes named", _share(caused, lambda c: c.answer.effects == c.causes)),
        ("exact_largest", "the same where a drawn cause is the largest carrier",
         _share(largest, lambda c: c.answer.effects == c.causes)),
        ("spurious", "something named that carries too little", _share(own, lambda c: c.spurious)),
        ("unknown", "called unknown", _share(own, lambda c: c.unknown)),
        ("covered", "drawn causes in the 95 % set", _share(own, lambda c: c.covered)),
        ("set", "mean size of the 95 % set", _mean([len(c.answer.credible) for c in own])),
        ("sure_right", f"right by mm when p > {CAUSE_PROBABILITY}", _share(sure, lambda c: c.right)),
        ("sure_share", f"share answered with p > {CAUSE_PROBABILITY}", _share(own, lambda c: c.named)),
        ("inside", "mm of the largest carrier inside its interval", _share(budgeted, lambda c: bool(c.inside))),
    )]  # fmt: skip


def _outside(name: str, own: Sequence[JudgedAnswer], known: Sequence[JudgedAnswer]) -> list[Metric]:
    apart, near = [c for c in own if c.apart], [c for c in own if c.nearest is not None and not c.apart]
    cluttered = name.startswith("cluttered")
    comparable = [c for c in known if c.stratum.startswith("cluttered") == cluttered] or known
    staged = [c for c in own if c.stage and c.unknown]
    return [Metric(f"{name}.{key}", f"{name}: {label}", found) for key, label, found in (
        ("flagged", "verdict unknown", _share(own, lambda c: c.unknown)),
        ("flagged_apart", "verdict unknown where the nearest effect leaves 1.5 floors", _share(apart, lambda c: c.unknown)),
        ("at_10", "flagged at 10 % false flags where the nearest effect leaves 1.5 floors", flagged_at(comparable, apart)),
        ("stage", "the right stage asks for an error, of those called unknown",
         _share(staged, lambda c: c.answer.stage == c.stage)),
        ("named", f"an effect named with p > {CAUSE_PROBABILITY}", _share(own, lambda c: c.named)),
        ("nearest", "named after the nearest effect where it leaves less",
         _share(near, lambda c: (c.nearest or {})["effect"] in c.answer.effects)),
    )]  # fmt: skip


def flagged_at(known: Sequence[JudgedAnswer], outside: Sequence[JudgedAnswer], share_allowed: float = 0.10) -> Interval:
    """Share of unknowns whose stated probability of "unknown" exceeds that of all but a tenth of the known cases.

    A score that is the same for all (always 0) flags nothing.
    """
    if not known or not outside:
        return Interval(math.nan, math.nan, math.nan, 0)
    limit = float(np.quantile([c.answer.unknown_probability for c in known], 1 - share_allowed, method="higher"))
    return share(np.array([c.answer.unknown_probability > limit for c in outside], float))


def confidence(cases: Sequence[JudgedAnswer]) -> Array:
    """(n, 2): stated probability of the verdict, and whether it was right; failed answers left out."""
    rows = [(c.answer.probability, float(c.exact)) for c in cases if c.answer.verdict != "failed"]
    return np.array(rows, float).reshape(-1, 2)


def calibration_error(pairs: Array) -> float:
    """Expected calibration error over ten equal bins of probability: mean of |right - stated|, weighted by cases."""
    bins = np.minimum((pairs[:, 0] * 10).astype(int), 9)
    off = (abs(float(np.subtract(*pairs[bins == b].mean(axis=0)))) * np.sum(bins == b) for b in np.unique(bins))
    return float(sum(off) / max(len(pairs), 1))
