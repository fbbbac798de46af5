"""How often a plan would tell the cause right, by cause and size, and what it would be taken for."""

from __future__ import annotations

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


def power(
    d: Planned, catalogue: Sequence[str], each: int = 40, seed: int = 1, clutter: Sequence[float] = CLUTTER
) -> Power:
    """`each` worlds of every effect that can be drawn and of none, drawn under the design and weighed."""
    rng = np.random.default_rng(seed)
    made = [drawn(d, rng, cause, clutter) for cause in ("", *d.effects) for _ in range(each)]
    worlds = [w for w, _ in made]
    named, p = probabilities(d, np.array([w.readings for w in worlds]))
    first = p.argmax(axis=1)
    told = ["".join(named[k]) for k in first]
    right = np.array([w.cause == t for w, t in zip(worlds, told, strict=True)])
    weight = np.array(
        [PRIOR_OF_NUMBER[0] if not w.cause else (1 - PRIOR_OF_NUMBER[0]) / len(d.effects) for w in worlds]
    )
    weight /= weight.sum()
    share, spread = float(weight @ right), float(np.sqrt(weight**2 @ (right - weight @ right) ** 2))
    effects = []
    for effect in d.effects:
        own = np.array([w.cause == effect for w in worlds])
        size = np.array([w.size for w in worlds])
        edges = np.linspace(*CAUSE, len(SIZES) + 1)
        third = np.clip(np.digitize(size, edges) - 1, 0, len(SIZES) - 1)
        others = [t for t, o, r in zip(told, own, right, strict=True) if o and not r]
        taken = {t or "none": float(others.count(t) / own.sum()) for t in others}
        sure = float(np.mean(right[own] & (p.max(axis=1)[own] > CAUSE_PROBABILITY)))
        carries = float(
            np.median([d.floors(done[effect]) / w.size for (w, done), o in zip(made, own, strict=True) if o])
        )
        cells = {name: own & (third == k) for k, name in enumerate(SIZES)}
        by_size = {name: float(right[cell].mean()) if cell.any() else None for name, cell in cells.items()}
        effects.append(EffectPower(effect, carries, by_size, sure, tuple(sorted(taken.items(), key=lambda x: -x[1]))))
    unseen = tuple(e for e in catalogue if e not in d.effects)
    interval = (max(share - 1.96 * spread, 0.0), min(share + 1.96 * spread, 1.0))
    return Power(len(worlds), share, interval, float(weight @ p.max(axis=1)), tuple(effects), unseen)
