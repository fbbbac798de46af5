"""The catalogue as a person uses it: the project's effects, those of installed packages, those of a file of one's own."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from model.effects import CATALOGUE, EffectSpec, with_effects
from model.effects.catalogue import GROUP, announced
from model.effects.proof import prove
from model.errors import BadEffect
from model.robot import Robot

from .config import ConfigError
from .packages import Unusable, installed, python_file


def effects_from_file(path: Path) -> tuple[EffectSpec, ...]:
    """The EFFECTS of a Python file; raises ConfigError when it cannot be run or holds none."""
    module, _ = python_file(path)
    try:
        return announced(getattr(module, "EFFECTS", None))
    except BadEffect as error:
        raise ConfigError(f"{path}: {error}") from error


def stated_by(robot: Robot, file: Path | None = None) -> Mapping[str, EffectSpec]:
    """A catalogue that knows the effects in robot.yaml: the project's own where they suffice. Raises as `catalogue`."""
    if file is None and set(robot.effects) <= set(CATALOGUE):
        return CATALOGUE
    return catalogue(robot, file)[0]


def catalogue(robot: Robot, file: Path | None = None) -> tuple[Mapping[str, EffectSpec], tuple[str, ...]]:
    """All effects by id, and complaints about those that an installed package announces but that cannot be used: an answer that
    weighs fewer effects than it seems to must say so.

    Effects that are not the project's are tried on the robot first. Raises ConfigError, and `BadEffect` for one of the file."""

    def tried(name: str, thing: object) -> dict[str, EffectSpec]:
        try:
            specs = announced(thing)
            prove(robot.plain, specs)
        except BadEffect as error:
            raise Unusable(str(error)) from error
        return {spec.id: spec for spec in specs}

    packaged = installed(GROUP, CATALOGUE, tried)
    of_file = effects_from_file(file) if file is not None else ()
    merged = with_effects(of_file, packaged.usable)
    prove(robot.plain, of_file)
    return merged, (*packaged.broken.values(), *packaged.doubts.values())
