"""Answers scored by what carries: for sets whose truth tells what each effect does in mm after calibration.

Right by mm: something is named, and all that is named carries at least half of what the largest carrier does, and at least a
floor (the scatter of repeats); where nothing carries two floors, none is right.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from diagnosis.judgement import CAUSE_PROBABILITY

from .answers import Answer
from .metrics import Interval, Metric, bootstrap, share

HALF, FLOORS = 0.5, 2.0
APART = 1.5
"""Noise floors that the nearest known effect leaves of a cause that is to be flagged."""


def right(named: Collection[str], carries: Mapping[str, float], floor: float) -> bool:
    """Whether what is named, or that nothing is, is right where effects carry so much; `floor` in the same unit."""
    most = max(carries.values(), default=0.0)
    least = max(HALF * most, floor)
    return all(carries.get(e, 0.0) >= least for e in named) if named else most < FLOORS * floor


@dataclass(frozen=True)
class Weighed:
    """One case: what its effects carry, and what was answered."""

    stratum: str
    causes: frozenset[str]
    carries: Mapping[str, float]
    """mm after calibration, by effect; one outside the catalogue among them."""
    floor: float
    nearest: Mapping[str, Any] | None
    answer: Answer
    stage: str | None = None
    """Of a cause outside the catalogue, where the truth tells it."""

    @property
    def largest(self) -> str:
        """The effect that carries most; empty where none is weighed."""
        return max(self.carries, key=lambda e: self.carries[e], default="")

    @property
    def most(self) -> float:
        """mm of the largest carrier."""
        return max(self.carries.values(), default=0.0)

    @property
    def right(self) -> bool:
        """Right by mm."""
        effects = self.answer.effects
        return (self.answer.verdict == "none" and self.most < FLOORS * self.floor) or (
            self.answer.verdict == "effect" and bool(effects) and right(effects, self.carries, self.floor)
        )

    @property
    def truth_named(self) -> bool:
        """All drawn causes are among what is named."""
        return self.answer.verdict == "effect" and self.causes <= self.answer.effects

    @property
    def spurious(self) -> bool:
        """Something is named that carries less than half of the largest, or less than a floor."""
        return self.answer.verdict == "effect" and not right(self.answer.effects, self.carries, self.floor)

    @property
    def covered(self) -> bool:
        """The drawn causes, or none, are in the 95 % set."""
        return self.causes in self.answer.credible

    @property
    def inside(self) -> bool | None:
        """Whether the mm of the largest carrier lies in the interval that the budget states; None where it states none."""
        stated = self.answer.budget.get(self.largest)
        return None if stated is None else stated[0] <= self.most <= stated[1]


def weighed(truth: Mapping[str, Any], answer: Answer) -> Weighed | None:
    """A sealed truth beside its answer; None where the truth carries no mm."""
    if not truth.get("calibrated_mm"):
        return None
    carries = {str(e): float(mm) for e, mm in truth["calibrated_mm"].items()}
    return Weighed(
        str(truth.get("stratum", truth["kind"])), frozenset(truth["effects"]), carries, float(truth["floor_mm"]),
        truth.get("nearest"), answer, truth.get("stage"),
    )  # fmt: skip


def mm_metrics(cases: Sequence[Weighed]) -> list[Metric]:
    """All figures by stratum; those without a case have n = 0."""
    out: list[Metric] = []
    for name in sorted({c.stratum for c in cases}):
        own = [c for c in cases if c.stratum == name]
        if name.endswith("outside"):
            out += _outside(name, own, [c for c in cases if not c.stratum.endswith("outside")])
        else:
            out += _known(name, own)
    return out


def _known(name: str, own: Sequence[Weighed]) -> list[Metric]:
    sure = [c for c in own if c.answer.verdict == "effect" and c.answer.probability > CAUSE_PROBABILITY]
    largest = [c for c in own if c.largest in c.causes]
    figures = [
        ("right", "right by mm", _share(own, lambda c: c.right)),
        ("spurious", "something named that carries too little", _share(own, lambda c: c.spurious)),
        ("unknown", "called unknown", _share(own, lambda c: c.answer.verdict == "unknown")),
        ("covered", "drawn causes in the 95 % set", _share(own, lambda c: c.covered)),
        ("set", "mean size of the 95 % set", bootstrap(np.array([len(c.answer.credible) for c in own], float), _mean)),
        ("sure_right", f"right by mm when p > {CAUSE_PROBABILITY}", _share(sure, lambda c: c.right)),
        ("sure_share", f"share answered with p > {CAUSE_PROBABILITY}", _share(own, lambda c: c in sure)),
        ("inside", "mm of the largest carrier inside its interval",
         _share([c for c in own if c.inside is not None], lambda c: bool(c.inside))),
    ]  # fmt: skip
    if any(c.causes for c in own):
        exact = [
            ("named", "drawn causes among the named", _share(own, lambda c: c.truth_named)),
            ("exact", "exactly the drawn causes named", _share(own, lambda c: c.answer.effects == c.causes)),
            ("exact_largest", "the same where a drawn cause is the largest carrier",
             _share(largest, lambda c: c.answer.effects == c.causes)),
        ]  # fmt: skip
        figures[1:1] = exact
    return [Metric(f"{name}.{key}", f"{name}: {label}", found) for key, label, found in figures]


def _outside(name: str, own: Sequence[Weighed], known: Sequence[Weighed]) -> list[Metric]:
    # where the nearest known cause explains it, calling it by that name is no error of the data
    apart = [c for c in own if c.nearest is not None and float(c.nearest["leaves_mm"]) >= APART * c.floor]
    cluttered = name.startswith("cluttered")
    comparable = [c for c in known if c.stratum.startswith("cluttered") == cluttered] or known
    limit = float(np.quantile([c.answer.unknown_probability for c in comparable], 0.9, method="higher")) if comparable else np.nan
    figures = [
        ("flagged", "verdict unknown", _share(own, lambda c: c.answer.verdict == "unknown")),
        ("flagged_apart", "verdict unknown where the nearest effect leaves 1.5 floors",
         _share(apart, lambda c: c.answer.verdict == "unknown")),
        ("at_10", "flagged at 10 % false flags where the nearest effect leaves 1.5 floors",
         _share(apart if comparable else [], lambda c: c.answer.unknown_probability > limit)),
        ("stage", "the right stage asks for an error, of those called unknown",
         _share([c for c in own if c.stage and c.answer.verdict == "unknown"], lambda c: c.answer.stage == c.stage)),
        ("named", f"an effect named with p > {CAUSE_PROBABILITY}",
         _share(own, lambda c: c.answer.verdict == "effect" and c.answer.probability > CAUSE_PROBABILITY)),
        ("nearest", "named after the nearest effect where it leaves less",
         _share([c for c in own if c not in apart and c.nearest is not None],
                lambda c: c.nearest is not None and c.nearest["effect"] in c.answer.effects)),
    ]  # fmt: skip
    return [Metric(f"{name}.{key}", f"{name}: {label}", found) for key, label, found in figures]


def _share(group: Sequence[Weighed], test: Callable[[Weighed], bool]) -> Interval:
    return share(np.array([test(c) for c in group], float))


def _mean(values: np.ndarray) -> float:
    return float(values.mean())
