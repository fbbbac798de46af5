"""The catalogue as a person uses it: the project's effects, those of installed packages, those of a file of one's own."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from model.effects import EffectSpec, effects_from_file, installed_effects, with_effects
from model.effects.proof import prove
from model.robot import Robot


def catalogue(robot: Robot, file: Path | None) -> Mapping[str, EffectSpec]:
    """All effects by id; those that are not the project's are tried on the robot first. Raises `BadEffect`."""
    own = installed_effects() + (effects_from_file(file) if file is not None else ())
    merged = with_effects(own)
    prove(robot, own)
    return merged
