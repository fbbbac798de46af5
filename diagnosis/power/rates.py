"""How often a plan would tell the cause right, by cause and size, and what it would be taken for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ..arrays import Array, Mask
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
    made = [drawn(plan, rng, cause, clutter) for cause in ("", *plan.effects) for _ in range(each)]
    worlds = [w for w, _ in made]
    hypotheses, p = probabilities(plan, np.array([w.readings for w in worlds]))
    named, probability = ["".join(hypotheses[k]) for k in p.argmax(axis=1)], p.max(axis=1)
    right = np.array([w.cause == n for w, n in zip(worlds, named, strict=True)])
    weight = np.array([PRIOR_OF_NUMBER[0] if not w.cause else (1 - PRIOR_OF_NUMBER[0]) / len(plan.effects) for w in worlds])
    weight /= weight.sum()
    share, sd = float(weight @ right), float(np.sqrt(weight**2 @ (right - weight @ right) ** 2))
    effects = []
    for effect in plan.effects:
        caused = np.array([w.cause == effect for w in worlds])
        floors = [plan.floors(done[effect]) / w.size for w, done in made if w.cause == effect]
        size, mistaken = np.array([w.size for w in worlds])[caused], [n for n in np.array(named)[caused] if n != effect]
        effects.append(_effect_power(effect, floors, size, right[caused], probability[caused], mistaken))
    unseen = tuple(e for e in catalogue if e not in plan.effects)
    interval = (max(share - 1.96 * sd, 0.0), min(share + 1.96 * sd, 1.0))
    return Power(len(worlds), share, interval, float(weight @ probability), tuple(effects), unseen)


def _effect_power(
    effect: str,
    floors: Sequence[float],
    size: Array,
    right: Mask,
    probability: Array,
    mistaken: Sequence[str],
) -> EffectPower:
    """Of the w worlds that one effect causes: the noise floors that it carries, per plausible scale; its size, plausible scales;
    whether it alone is most probable; the largest probability (w, each); and the names that are most probable where it is not.
    """
    edges = np.linspace(*CAUSE, len(SIZES) + 1)
    third = np.clip(np.digitize(size, edges) - 1, 0, len(SIZES) - 1)
    by_size = {name: float(right[third == k].mean()) if (third == k).any() else None for k, name in enumerate(SIZES)}
    sure = float(np.mean(right & (probability > CAUSE_PROBABILITY)))
    taken_for = {str(n) or "none": mistaken.count(n) / len(right) for n in mistaken}
    ordered = tuple(sorted(taken_for.items(), key=lambda x: -x[1]))
    return EffectPower(effect, float(np.median(floors)), by_size, sure, ordered)
