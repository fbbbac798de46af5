"""Score answers against the truth: figures with 95 % intervals, exact for shares, by bootstrap for everything else."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta

from diagnosis.judgement import CAUSE_PROBABILITY

from .answers import Answer, Effects

Array = NDArray[np.float64]
LEAST_PROBABILITY = 1e-4
"""A truth that was given no probability costs as much as this."""


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


@dataclass(frozen=True)
class Scored:
    """One case: what was on, and what was answered."""

    kind: str
    truth: Effects
    sizes: dict[str, float]
    answer: Answer

    @property
    def right(self) -> bool:
        """The verdict is the truth: exactly these effects, none, or unknown."""
        a = self.answer
        if self.kind == "outside":
            return a.verdict == "unknown"
        if self.kind == "none":
            return a.verdict == "none"
        return a.verdict == "effect" and a.effects == self.truth

    @property
    def first(self) -> bool:
        """The most probable set of effects is the truth, whatever the verdict."""
        return bool(self.truth) and self.answer.best == self.truth

    @property
    def third(self) -> bool:
        """The truth is among the three most probable sets of effects."""
        return self.truth in [names for names, _ in self.answer.ranking[:3]] or self.first

    @property
    def covered(self) -> bool:
        """The truth is in the 95 % set."""
        mark = frozenset({"unknown"}) if self.kind == "outside" else self.truth
        return mark in self.answer.credible

    @property
    def probability_on_truth(self) -> float:
        """Stated probability of what is true."""
        a = self.answer
        return a.unknown_probability if self.kind == "outside" else a.probability_of(self.truth)


def scored(truth: dict[str, Any], answer: Answer) -> Scored:
    """A sealed truth beside its answer."""
    effects = frozenset(truth["effects"]) if truth["kind"] in ("single", "pair") else frozenset()
    return Scored(truth["kind"], effects, dict(truth["effects"]), answer)


@dataclass(frozen=True)
class Metric:
    """One figure of the bench."""

    key: str
    label: str
    found: Interval


def metrics(cases: Sequence[Scored]) -> list[Metric]:
    """All figures; those without a case have n = 0."""
    of = {k: [c for c in cases if c.kind == k] for k in ("single", "pair", "none", "outside")}
    single, pair, none, outside = of["single"], of["pair"], of["none"], of["outside"]
    known = single + none
    sure = [c for c in single if c.answer.verdict == "effect" and c.answer.probability > CAUSE_PROBABILITY]
    right = [c for c in single if c.right]
    closed = [c.answer.share_closed for c in right if math.isfinite(c.answer.share_closed)]

    def shared(group: Sequence[Scored], test: Callable[[Scored], bool]) -> Interval:
        return share(np.array([test(c) for c in group], float))

    def mean(values: Sequence[float]) -> Interval:
        return bootstrap(np.array(values, float), lambda v: float(v.mean()))

    return [
        Metric("top1", "single: most probable effect is the true one", shared(single, lambda c: c.first)),
        Metric("top3", "single: true one among the three most probable", shared(single, lambda c: c.third)),
        Metric("named", "single: verdict names exactly the true one", shared(single, lambda c: c.right)),
        Metric("detected", "single: not called none", shared(single, lambda c: c.answer.verdict in ("effect", "unknown"))),
        Metric("p_truth", "single: mean probability on the true one", mean([c.probability_on_truth for c in single])),
        Metric("sure_right", f"single: right when p > {CAUSE_PROBABILITY}", shared(sure, lambda c: c.right)),
        Metric("sure_share", f"single: share answered with p > {CAUSE_PROBABILITY}", shared(single, lambda c: c in sure)),
        Metric("coverage", "single and none: truth in the 95 % set", shared(known, lambda c: c.covered)),
        Metric("set_size", "single: mean size of the 95 % set", mean([len(c.answer.credible) for c in single])),
        Metric("pair_both", "pair: both named", shared(pair, lambda c: c.truth <= c.answer.effects)),
        Metric("pair_exact", "pair: exactly those named", shared(pair, lambda c: c.right)),
        Metric("pair_spurious", "pair: spurious effects a case", mean([len(c.answer.effects - c.truth) for c in pair])),
        Metric("false_alarm", "none: an effect named", shared(none, lambda c: c.answer.verdict == "effect")),
        Metric("false_unknown", "single, pair, none: called unknown",
               shared(known + pair, lambda c: c.answer.verdict == "unknown")),
        Metric("flagged", "outside: verdict unknown", shared(outside, lambda c: c.answer.verdict == "unknown")),
        Metric("flagged_at_10", "outside: flagged at 10 % false flags", flagged_at(known + pair, outside)),
        Metric("outside_named", f"outside: an effect named with p > {CAUSE_PROBABILITY}",
               shared(outside, lambda c: c.answer.verdict == "effect" and c.answer.probability > CAUSE_PROBABILITY)),
        Metric("ece", "calibration error of the verdict's probability", bootstrap(confidence(cases), calibration_error)),
        Metric("log_score", "single and none: mean -log p of the truth",
               mean([-math.log(max(c.probability_on_truth, LEAST_PROBABILITY)) for c in known])),
        Metric("closed", "single, right: median share of the gap closed",
               bootstrap(np.array(closed), lambda v: float(np.median(v)))),
        Metric("seconds", "median seconds a case",
               bootstrap(np.array([c.answer.seconds for c in cases]), lambda v: float(np.median(v)))),
        Metric("failed", "diagnosis failed", shared(cases, lambda c: c.answer.verdict == "failed")),
    ]  # fmt: skip


def flagged_at(known: Sequence[Scored], outside: Sequence[Scored], share_allowed: float = 0.10) -> Interval:
    """Share of unknowns whose stated probability of "unknown" exceeds that of all but a tenth of the known cases.

    A score that is the same for all (always 0) flags nothing.
    """
    if not known or not outside:
        return Interval(math.nan, math.nan, math.nan, 0)
    limit = float(np.quantile([c.answer.unknown_probability for c in known], 1 - share_allowed, method="higher"))
    return share(np.array([c.answer.unknown_probability > limit for c in outside], float))


def confidence(cases: Sequence[Scored]) -> Array:
    """(n, 2): stated probability of the verdict, and whether it was right; failed answers left out."""
    rows = [(c.answer.probability, float(c.right)) for c in cases if c.answer.verdict != "failed"]
    return np.array(rows, float).reshape(-1, 2)


def calibration_error(pairs: Array) -> float:
    """Expected calibration error over ten equal bins of probability: mean of |right - stated|, weighted by cases."""
    return float(sum(abs(stated - right) * n for stated, right, n in reliability(pairs)) / max(len(pairs), 1))


def reliability(pairs: Array) -> list[tuple[float, float, int]]:
    """(mean stated, share right, cases) of each bin that holds cases."""
    bins = np.minimum((pairs[:, 0] * 10).astype(int), 9)
    out = []
    for b in np.unique(bins):
        own = pairs[bins == b]
        out.append((float(own[:, 0].mean()), float(own[:, 1].mean()), len(own)))
    return out


def confusion(cases: Sequence[Scored]) -> tuple[list[str], list[str], NDArray[np.int64]]:
    """Rows: single truths, pairs, none, outside; columns: what was named; counts."""
    rows = [*sorted({_one(c.truth) for c in cases if c.kind == "single"}), "pair", "none", "outside"]
    rows = [r for r in rows if r not in ("pair", "none", "outside") or any(c.kind == r for c in cases)]
    named = sorted({x for c in cases for x in c.answer.effects} | {r for r in rows if r not in ("pair", "none", "outside")})
    columns = [*named, "several", "none", "unknown", "failed"]
    counts = np.zeros((len(rows), len(columns)), np.int64)
    for c in cases:
        row = _one(c.truth) if c.kind == "single" else c.kind
        verdict = c.answer.verdict
        if verdict == "effect":
            verdict = _one(c.answer.effects) if len(c.answer.effects) == 1 else "several"
        counts[rows.index(row), columns.index(verdict)] += 1
    # an effect that was never named keeps its column: without it a wrong answer would come to stand on the diagonal
    keep = [j for j, name in enumerate(columns) if counts[:, j].any() or name in rows]
    return rows, [columns[j] for j in keep], counts[:, keep]


def _one(effects: Effects) -> str:
    # where the gas acts belongs to the design of some robots, beside their cause
    return min(effects, key=lambda e: (e == "chamber_thrust", e))


def best_temperature(cases: Sequence[Scored]) -> float:
    """The temperature that would make the stated probabilities of single and no-effect cases score best.

    Each hypothesis' probability is raised to 1/T and all are made to sum to one again; 1 means that they are honest as they
    are, more that they are too bold. NaN without a case.
    """
    known = [c for c in cases if c.kind in ("single", "none") and c.answer.verdict != "failed"]
    if not known:
        return math.nan
    grid = np.exp(np.linspace(math.log(0.5), math.log(30.0), 120))
    losses = [sum(_loss(c, t) for c in known) for t in grid]
    return float(grid[int(np.argmin(losses))])


def _loss(c: Scored, temperature: float) -> float:
    a = c.answer
    stated = np.array([p for _, p in a.ranking] + [a.none_probability, a.unknown_probability, c.probability_on_truth])
    weights = np.maximum(stated, 1e-12) ** (1 / temperature)
    return -math.log(max(float(weights[-1] / weights[:-1].sum()), LEAST_PROBABILITY))
