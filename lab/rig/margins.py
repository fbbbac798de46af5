"""The largest values that a plan asks of the rig, each beside what limits it."""

from __future__ import annotations

from dataclasses import dataclass

from model.robot import Robot
from protocols.experiment import Ask, Plan

from ..files.rig_file import RigFile
from ..files.units import shown
from .limits import expected_force, within_robot


@dataclass(frozen=True)
class Margin:
    """The largest value of one kind in a plan, and the lowest limit that holds for it; in `unit`, SI."""

    name: str
    value: float
    unit: str
    limit: float | None
    """None: nothing limits it."""

    def __str__(self) -> str:
        """The line that a person reads."""
        value = f"{self.name} {shown(self.value, self.unit)}"
        return value if self.limit is None else f"{value} of {shown(self.limit, self.unit)} allowed: ok"


UNITS = {
    "pressure": "Pa",
    "total pressure": "Pa",
    "pressure rate": "Pa/s",
    "spine length": "m",
    "spine speed": "m/s",
    "vacuum": "Pa",
    "deflection": "m",
    "expected force": "N",
    "arm speed": "m/s",
    "arm acceleration": "m/s^2",
    "tip mass": "kg",
}
"""What steps can ask for, in the order in which it is listed, with the SI unit."""
ACTIVE = ("pressure", "spine length", "deflection")
"""A plan that asks for none of these moves neither robot nor specimen."""


def margins(plan: Plan, rig: RigFile, robot: Robot) -> list[Margin]:
    """Return the largest value of each kind that the steps of an accepted plan ask for, with its limit."""
    asked = [_asked(step.ask, robot) for step in plan.steps]
    largest = {name: max((of[name] or 0.0 for of in asked), default=0.0) for name in UNITS}
    limits = _limits(within_robot(rig, robot))
    return [Margin(name, value, UNITS[name], limits.get(name)) for name, value in largest.items() if value > 0]


def _asked(ask: Ask, robot: Robot) -> dict[str, float | None]:
    """What a step asks for, by the names of `UNITS`."""
    return {
        "pressure": max(ask.pressures, default=None),
        "total pressure": sum(max(0.0, p) for p in ask.pressures),
        "pressure rate": ask.pressure_rate,
        "spine length": ask.spine_length,
        "spine speed": ask.spine_speed if robot.spine is not None else None,
        "vacuum": ask.vacuum,
        "deflection": None if ask.push is None else ask.push.deflection,
        "expected force": None if ask.push is None else expected_force(robot, ask.push),
        "arm speed": ask.arm_speed,
        "arm acceleration": ask.arm_acceleration,
        "tip mass": None if ask.setup is None else ask.setup.tip_mass,
    }


def _limits(rig: RigFile) -> dict[str, float]:
    """The limit of each thing, where rig.yaml or robot.yaml states one; SI units."""
    found = {
        "total pressure": rig.limits.max_total_pressure,
        "vacuum": rig.limits.max_vacuum,
        "expected force": rig.limits.max_force,
    }
    for name, instrument, key in (
        ("pressure", rig.instruments.pressure, "max_pressure"),
        ("pressure rate", rig.instruments.pressure, "max_rate"),
        ("spine length", rig.instruments.spine, "max_length"),
        ("spine speed", rig.instruments.spine, "max_speed"),
        ("arm speed", rig.instruments.arm, "max_speed"),
        ("arm acceleration", rig.instruments.arm, "max_acceleration"),
    ):
        most = getattr(instrument, key, None)
        if most is not None:
            found[name] = most
    return found
