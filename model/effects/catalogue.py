"""All effects by id: the project's own, those of installed packages, and those of a file of one's own.

A package announces effects as entry points of the group `softlab.effects`, each an `EffectSpec` or a tuple of them. A
file announces them by a module-level name EFFECTS.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType

from model.effects.laws import actuation, measurement, structure, surroundings
from model.effects.spec import STAGES, EffectSpec
from model.errors import BadEffect

GROUP = "softlab.effects"

# Laws on one quantity act in this order: what happens first on the way from gauge to reading comes first.
CATALOGUE: Mapping[str, EffectSpec] = MappingProxyType(
    {s.id: s for s in (*actuation.SPECS, *structure.SPECS, *surroundings.SPECS, *measurement.SPECS)}
)


def with_effects(more: Iterable[EffectSpec], base: Mapping[str, EffectSpec] = CATALOGUE) -> Mapping[str, EffectSpec]:
    """`base` and more effects, which act after it; raises `BadEffect` when an id is taken."""
    merged = dict(base)
    for spec in more:
        if spec.id in merged:
            raise BadEffect(f"effect {spec.id!r}: the id is taken, choose another")
        merged[spec.id] = spec
    return MappingProxyType(merged)


def effects_from_file(path: Path) -> tuple[EffectSpec, ...]:
    """The EFFECTS of a Python file; raises `BadEffect` when it cannot be run or holds none."""
    found = importlib.util.spec_from_file_location(path.stem, path)
    if found is None or found.loader is None:
        raise BadEffect(f"{path}: not a Python file")
    module = importlib.util.module_from_spec(found)
    try:
        found.loader.exec_module(module)
    except Exception as error:
        raise BadEffect(f"{path}: cannot be run: {type(error).__name__}: {error}") from error
    return _checked(getattr(module, "EFFECTS", None), str(path))


def installed_effects() -> tuple[EffectSpec, ...]:
    """The effects that installed packages announce; raises `BadEffect` when one is not an effect: a diagnosis that silently
    weighs fewer than it should would not be honest."""
    found: list[EffectSpec] = []
    for entry in importlib.metadata.entry_points(group=GROUP):
        where = f"entry point {entry.name} = {entry.value} of {GROUP}"
        try:
            announced = entry.load()
        except Exception as error:
            raise BadEffect(f"{where}: cannot be loaded: {type(error).__name__}: {error}") from error
        found += _checked(announced, where)
    return tuple(found)


def _checked(value: object, where: str) -> tuple[EffectSpec, ...]:
    specs = (value,) if isinstance(value, EffectSpec) else value
    if not isinstance(specs, (tuple, list)) or not specs or not all(isinstance(s, EffectSpec) for s in specs):
        raise BadEffect(f"{where}: EFFECTS must be a tuple of EffectSpec (stages: {', '.join(STAGES)})")
    return tuple(specs)
