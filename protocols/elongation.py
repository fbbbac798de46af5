"""Elongation: the bending sweep with all chambers at once, by which the robot gets longer; the pressures are the paper's."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from .bending import NEEDS, Bending, run
from .bending import plan as bending_plan
from .experiment import Plan
from .parameters import Chamber, Pressure, RobotFacts

__all__ = ["NEEDS", "PARAMETERS", "Elongation", "plan", "run"]


class Elongation(Bending):
    """Parameters of an elongation run."""

    pressures: list[Pressure] = Field(
        [30e3, 60e3, 90e3, 120e3, 150e3], min_length=1, max_length=200, json_schema_extra={"unit": "Pa"}
    )
    """Where the tip is read on the way up, increasing."""
    chambers: list[Chamber] = Field([1, 2, 3, 4, 5, 6, 7, 8, 9], min_length=1, max_length=64)
    """Chambers that are inflated together; by default all that are connected."""
    unload: bool = False
    """Whether the pressures are read on the way down, too."""

    @classmethod
    def defaults_for(cls, robot: RobotFacts) -> dict[str, Any]:
        """All chambers that are connected; no spine where there is none."""
        defaults = super().defaults_for(robot)
        return {**defaults, "chambers": sorted(c for group in robot.channels for c in group)} if robot.channels else defaults


PARAMETERS = Elongation


def plan(p: Elongation) -> Plan:
    """What will be done and how long it takes."""
    return bending_plan(p, "elongation")
