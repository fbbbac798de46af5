"""Elongation: all nine chambers at once, per spine length; the robot gets longer instead of bending.

It is the bending sweep with another group of chambers and the paper's lower pressures, 30..150 kPa by 30 kPa.
"""

from __future__ import annotations

from pydantic import Field

from .bending import NEEDS, Bending, run
from .bending import plan as bending_plan
from .experiment import Plan
from .parameters import Chamber, Pressure

__all__ = ["NEEDS", "PARAMETERS", "Elongation", "plan", "run"]


class Elongation(Bending):
    """Parameters of an elongation run."""

    pressures: list[Pressure] = Field(
        [30e3, 60e3, 90e3, 120e3, 150e3], min_length=1, max_length=200, json_schema_extra={"unit": "Pa"}
    )
    chambers: list[Chamber] = Field([1, 2, 3, 4, 5, 6, 7, 8, 9], min_length=1, max_length=9)
    unload: bool = False


PARAMETERS = Elongation


def plan(p: Elongation) -> Plan:
    """What will be done and how long it takes."""
    return bending_plan(p, "elongation")
