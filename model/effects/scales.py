"""What the sizes of effects are multiples of: a robot's own length, stiffness and largest pressure, and its campaign's pace.

The catalogue holds sizes of a robot with the scales `STANDARD`; those of another robot are in proportion to its own. Of similar
robots (lengths, moduli and pressures in proportion, gravity to match) the same share of a scale moves the tip by the same share
of the length.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from model.arrays import Array
from model.body import body_of
from model.errors import BadRobot
from model.robot import Robot

BALLOONING, MEMORY = "chamber_ballooning", "viscoelastic"
"""Effects whose sizes are those at a pressure, and at a pace."""
NEAR = 0.6
"""Share of robot.yaml's max_pressure from which states use all of it."""


@dataclass(frozen=True)
class Scales:
    """Scales of one robot and its campaign."""

    length: float
    """m, of the body."""
    stiffness: float
    """N m^2, E I of the body."""
    pressure: float
    """Pa, the largest; at which sizes that grow with pressure are quoted."""
    gravity: float = 9.81
    """m/s^2."""
    time: float = 16.0
    """s, the pace of the campaign (`States.pace`) to the nearest decade; what is much faster or slower is not seen in it."""
    tip_mass: float = 0.0
    """kg, stated at the tip: another mass may be wrong, or forgotten, by as much."""

    def of(self, unit: str) -> float:
        """The scale of quantities with this unit; 1 for pure numbers and angles.

        >>> STANDARD.of("rad/m"), STANDARD.of("Pa"), STANDARD.of("1")
        (2.5, 250000.0, 1.0)
        """
        force = self.stiffness / self.length**2
        return {
            "Pa": self.pressure, "m": self.length, "1/m": 1 / self.length, "rad/m": 1 / self.length, "N": force,
            "N m": force * self.length, "N/m": force / self.length, "m/N": self.length / force,
            "rad/(N m)": 1 / (force * self.length), "kg": force / self.gravity, "s": self.time, "1/s": 1 / self.time,
        }.get(unit, 1.0)  # fmt: skip


STANDARD = Scales(0.4, 507147.0 * math.pi / 4 * (0.05**4 - 0.029**4), 250e3)
"""A cast body of 40 cm and 10 cm across."""


def scales(robot: Robot, pressure: Array | None = None, pace: float | None = None) -> Scales:
    """Scales of a robot whose states have these pressures (n, chambers), Pa, and this pace, s; None: of any states.

    Its pressure is that of robot.yaml where it states one (`quoted_pressure`), or `max_pressure` where it states a size that is
    quoted there or states come near it; else the largest of the states, to two digits, so that noise does not change what a
    size means. Its pace is that of robot.yaml (`quoted_time`), the standard one where it states a memory without it, else that of
    the states. Raises `BadRobot` where a size that is quoted at a pressure is stated without it.
    """
    quoted = robot.quoted_pressure
    if quoted is None and (BALLOONING in robot.effects or pressure is None):
        quoted = robot.highest_limit
        if quoted is None and BALLOONING in robot.effects:
            raise BadRobot(
                f"robot {robot.name!r}: effects.{BALLOONING} needs quoted_pressure, the pressure at which its growth is stated"
            )
    if quoted is None:
        highest = 0.0 if pressure is None else float(np.abs(pressure).max(initial=0.0))
        highest_stated = robot.highest_limit or STANDARD.pressure
        near = robot.max_pressure is not None and NEAR * highest_stated <= highest <= highest_stated / NEAR
        quoted = highest_stated if near or highest == 0 else float(f"{highest:.2g}")
    stiffness = robot.youngs_modulus * body_of(robot).mean_second
    gravity = float(np.linalg.norm(robot.gravity)) or STANDARD.gravity
    measured_pace = STANDARD.time if pace is None or MEMORY in robot.effects else pace
    decades = round(math.log10(measured_pace / STANDARD.time))
    return Scales(robot.length, stiffness, quoted, gravity, robot.quoted_time or STANDARD.time * 10.0**decades, robot.tip_mass)
