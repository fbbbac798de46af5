"""What a campaign must hold for an effect to be seen in it at all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from model.arrays import Array
from model.condition import USED, States
from model.effects.spec import EffectSpec
from model.robot import Robot

REPEATED = 0.5
"""Share of distinct values among pressures up to which they are set-points: of each value there are two or more."""
SAME_SIDE = np.cos(np.radians(20.0))
"""Cosine of two bending directions above which they are one."""


def pushes(robot: Robot, design: States) -> bool:
    """A stiffness trial."""
    return bool(design.stiffness.any())


@dataclass(frozen=True)
class Having:
    """A robot with a part, whatever its campaign holds."""

    part: str

    def __call__(self, robot: Robot, design: States | None = None) -> bool:
        return getattr(robot, self.part) is not None


PARTS = ("spine", "tendons", "chambers")
with_spine, by_tendons, by_chambers = map(Having, PARTS)


def possible(robot: Robot, spec: EffectSpec) -> bool:
    """Whether the robot has the part that an effect is of, whatever its campaign holds."""
    return not isinstance(spec.shown, Having) or spec.shown(robot)


def set_points(robot: Robot, design: States) -> bool:
    """A table that holds what was asked for: the same pressures again and again, to the last digit, as no reading is."""
    pressure = design.pressure[~design.stiffness]
    driven = pressure[pressure > USED * pressure.max(initial=0.0)]
    return driven.size > 0 and len(np.unique(driven)) <= REPEATED * driven.size


def chambers_apart(robot: Robot, design: States) -> bool:
    """Chambers inflated in more than one proportion: with one alone, areas are those of A_eff and the pattern's azimuth."""
    # a larger cosine is the same setting at another pressure
    return _differ(_inflated(design.pressure[~design.stiffness]), 0.97)


def directions_apart(robot: Robot, design: States) -> bool:
    """Chambers that bend the robot to more than one side: with one alone, another order is the robot mounted turned."""
    return sides_apart(robot, design.pressure[~design.stiffness])


def sides_apart(robot: Robot, pressure: Array) -> bool:
    """The same of pressures (n, chambers) Pa."""
    pressure = _inflated(pressure)
    side = pressure @ robot.bending_directions[:, None].view(float)
    # chambers whose vector sum is smaller do not bend the body
    return _differ(side[np.linalg.norm(side, axis=1) > 0.05 * pressure.sum(axis=1)], SAME_SIDE)


def returns(robot: Robot, design: States) -> bool:
    """A state that comes after one of higher pressure."""
    highest = design.pressure[~design.stiffness].max(axis=1, initial=0.0)
    return bool((highest + USED * highest.max() < np.maximum.accumulate(highest)).any()) if highest.size else False


def _inflated(pressure: Array) -> Array:
    """(m, chambers) Pa of the states with pressure, of (n, chambers)."""
    least = USED * pressure.max(initial=0.0)
    return np.where(pressure > least, pressure, 0.0)[pressure.max(axis=1, initial=0.0) > least]


def _differ(vectors: Array, same: float) -> bool:
    """Whether any two of vectors (m, k) point apart."""
    if len(vectors) < 2:
        return False
    unit = np.unique(np.round(vectors / np.linalg.norm(vectors, axis=1, keepdims=True), 3), axis=0)
    return bool((unit @ unit.T).min() < same)
