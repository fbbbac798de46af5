"""The project's own effects by id, and what a package or a file announces effects by.

A package announces effects as entry points of the group `softlab.effects`, each an `EffectSpec` or a tuple of them. A
file announces them by a module-level name EFFECTS.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from types import MappingProxyType

from model.effects.laws import actuation, measurement, structure, surroundings, tendons
from model.effects.spec import STAGES, EffectSpec
from model.errors import BadEffect

GROUP = "softlab.effects"

# Laws on one quantity act in this order: what happens first on the way from gauge to reading comes first.
CATALOGUE: Mapping[str, EffectSpec] = MappingProxyType(
    {
        s.id: replace(s, standard=True)
        for s in (*actuation.SPECS, *tendons.SPECS, *structure.SPECS, *surroundings.SPECS, *measurement.SPECS)
    }
)


def with_effects(more: Iterable[EffectSpec], base: Mapping[str, EffectSpec] = CATALOGUE) -> Mapping[str, EffectSpec]:
    """`base` and more effects, which act after it; raises `BadEffect` when an id is taken."""
    merged = dict(base)
    for spec in more:
        if spec.id in merged:
            raise BadEffect(f"effect {spec.id!r}: the id is taken, choose another")
        merged[spec.id] = spec
    return MappingProxyType(merged)


def announced(value: object) -> tuple[EffectSpec, ...]:
    """The effects that a package or a file announces; raises `BadEffect` when it is none."""
    specs = (value,) if isinstance(value, EffectSpec) else value
    if not isinstance(specs, (tuple, list)) or not specs or not all(isinstance(s, EffectSpec) for s in specs):
        raise BadEffect(f"EFFECTS must be a tuple of EffectSpec (stages: {', '.join(STAGES)})")
    return tuple(specs)
