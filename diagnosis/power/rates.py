"""How often a plan would tell the cause right, by cause and size, and what it would be taken for."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ..judgement import CAUSE_PROBABILITY, PRIOR_OF_NUMBER
from .worlds import CAUSE, CLUTTER, Planned, drawn, probabilities

SIZES = ("small", "medium", "large")
"""Thirds of the range of sizes."""
OTHER_LAWS = {"clean": 0.82, "cluttered": 0.71}
"""Of what such worlds promise, the share that sealed robots of other laws kept: 61 of 80 told exactly where 74.5 were promised,
46 of 106 where 65.1 were (in-sample: ten worlds without thrust on the walls, whole sweep, read while ramping)."""


@dataclass(frozen=True)
class EffectPower:
    """What becomes of worlds with one cause; its floor of scatter is the repeats'."""

    effect: str
    carries: float
    """Noise floors that it carries after calibration at its plausible size, median."""
    right: Mapping[str, float | None]
    """By size (thirds of 0.5 to 1.5 plausible scales): share in which it, and nothing else, is most probable."""
    sure: float
    """Share in which it is named with p > 0.9."""
    taken_for: tuple[tuple[str, float], ...]
    """Others that are named instead, with their share."""


@dataclass(frozen=True)
class Power:
    """What a plan can tell."""

    worlds: int
    right: float
    """Share of all worlds whose cause, or that there is none, is most probable."""
    right95: tuple[float, float]
    stated: float
    """Mean probability of what is most probable: as honest as it comes near `right`."""
    effects: tuple[EffectPower, ...]
    unseen: tuple[str, ...]
    """Effects that change nothing here that could be seen."""

    @property
    def pairs(self) -> tuple[tuple[str, str, float], ...]:
        """Effect, what it is taken for, and in which share; most first."""
        found = [(e.effect, other, share) for e in self.effects for other, share in e.taken_for if share >= 0.1]
        return tuple(sorted(found, key=lambda x: -x[2]))

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {"schema": "power/1", **asdict(self), "pairs": [list(p) for p in self.pairs]}


def power(plan: Planned, catalogue: Sequence[str], each: int = 40, seed: int = 1, clutter: Sequence[float] = CLUTTER) -> Power:
    """What the plan can tell, from worlds drawn under its design and weighed: `each` of none and of every effect it can draw.

    Shares of all worlds count each world with the prior probability of its cause, as the diagnosis has it.
    """
    rng = np.random.default_rng(seed)
    worlds = [drawn(plan, rng, cause, clutter) for cause in ("", *plan.effects) for _ in range(each)]
    hypotheses, p = probabilities(plan, np.array([w.readings for w in worlds]))
    cause, size = np.array([w.cause for w in worlds]), np.array([w.size for w in worlds])
    named, probability = np.array(["".join(h) for h in hypotheses])[p.argmax(axis=1)], p.max(axis=1)
    right = cause == named
    weight = np.where(cause == "", PRIOR_OF_NUMBER[0], (1 - PRIOR_OF_NUMBER[0]) / len(plan.effects))
    weight /= weight.sum()
    size_class = np.clip(np.digitize(size, np.linspace(*CAUSE, len(SIZES) + 1)) - 1, 0, len(SIZES) - 1)

    def rates_of(effect: str) -> EffectPower:
        with_cause = cause == effect
        floors = [plan.floors(w.done[effect]) / w.size for w in worlds if w.cause == effect]
        right_by_size = {name: right[with_cause & (size_class == k)] for k, name in enumerate(SIZES)}
        taken_for = Counter(str(n) or "none" for n in named[with_cause & ~right])
        return EffectPower(
            effect,
            carries=float(np.median(floors)),
            right={name: float(part.mean()) if part.size else None for name, part in right_by_size.items()},
            sure=float(np.mean((right & (probability > CAUSE_PROBABILITY))[with_cause])),
            taken_for=tuple((n, count / int(with_cause.sum())) for n, count in taken_for.most_common()),
        )

    share, sd = float(weight @ right), float(np.sqrt(weight**2 @ (right - weight @ right) ** 2))
    interval = (max(share - 1.96 * sd, 0.0), min(share + 1.96 * sd, 1.0))
    unseen = tuple(e for e in catalogue if e not in plan.effects)
    return Power(len(worlds), share, interval, float(weight @ probability), tuple(map(rates_of, plan.effects)), unseen)
