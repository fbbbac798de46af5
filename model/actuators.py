"""What bends a robot, as robot.yaml describes it: chambers under pressure, or tendons."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat


class Chambers(BaseModel):
    """The pressure chambers: equal round channels that run along the body."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    radius: FiniteFloat = Field(gt=0, le=0.5, json_schema_extra={"unit": "m"})
    path_radius: FiniteFloat = Field(gt=0, le=1, json_schema_extra={"unit": "m"})
    azimuths_deg: tuple[Annotated[FiniteFloat, Field(ge=-360, le=360)], ...] = Field(
        min_length=1, max_length=64, json_schema_extra={"unit": "deg"}
    )

    ends: tuple[Annotated[FiniteFloat, Field(gt=0, le=5)], ...] = Field(default=(), json_schema_extra={"unit": "m"})
    """Arc length at which each ends; at the tip unless given."""

    @property
    def area(self) -> float:
        """Geometric cross-section of one chamber (A_norm of the paper), m^2."""
        return math.pi * self.radius**2


PULL_AREA = 1e-4
"""m^2: the tension T of a tendon stands in tables as the pressure T / 1 cm^2, so that 10 N are 100 kPa."""


class Tendons(BaseModel):
    """Tendons that run along the body in its wall, parallel to its axis, each pulled by a known tension."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    path_radius: FiniteFloat = Field(gt=0, le=1, json_schema_extra={"unit": "m"})
    azimuths_deg: tuple[Annotated[FiniteFloat, Field(ge=-360, le=360)], ...] = Field(
        min_length=1, max_length=64, json_schema_extra={"unit": "deg"}
    )
    ends: tuple[Annotated[FiniteFloat, Field(gt=0, le=5)], ...] = Field(default=(), json_schema_extra={"unit": "m"})
    """Arc length at which each is fastened; at the tip unless given."""

    @property
    def area(self) -> float:
        """m^2 that a pressure of the tables acts on; it pulls, so it counts as negative."""
        return -PULL_AREA

    @property
    def radius(self) -> float:
        """m of the channel that it takes up in the wall: none to speak of."""
        return 0.0
