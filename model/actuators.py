"""What bends a robot, as robot.yaml describes it: chambers under pressure, or tendons."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field, FiniteFloat, Tag

from model.arrays import Array
from model.plain_yaml import FORM, FileTable

PULL_AREA = 1e-4
"""m^2: tables hold the tension T of a tendon as the pressure T / 1 cm^2, so 1 N is 10 kPa."""


@dataclass(frozen=True)
class Words:
    """Words for a robot's actuators, and the unit in which people read their pressure or tension."""

    kind: str
    """The table of robot.yaml."""
    unit: str
    pascal: float
    """Size of that unit in tables."""
    digits: int
    """Decimals that matter."""
    by_rig: bool
    """Whether a rig can drive them; otherwise a person does."""
    actuator: str
    actuators: str
    pressure: str
    pressures: str
    inflate: str
    inflated: str
    pushes: str
    area_factor: str
    an_area_factor: str
    actuator_area: str
    actuator_areas: str
    regulators: str

    @property
    def axis(self) -> str:
        """Label of an axis of pressures or tensions."""
        return f"{self.pressure}, {self.unit}"

    def fill(self, template: str, *amounts: str, **values: Any) -> str:
        """Fill a template whose fields are attributes of these words, such as {pressures}, or `values`.

        >>> Tendons.words.fill("{inflate} {actuators} {numbers}", numbers="1, 2"), Chambers.words.fill("{an_area_factor}")
        ('pull tendons 1, 2', 'an area factor')
        """
        return template.format(*amounts, **{**vars(self), **values})

    def number(self, pressure: float, more: int = 0) -> str:
        """A pressure of the tables (Pa) as a number in the unit, with `more` decimals than usual.

        >>> Chambers.words.number(60e3), Tendons.words.number(60e3), Chambers.words.number(-10.0, 1)
        ('60', '6.0', '0.0')
        """
        return f"{pressure / self.pascal:z.{self.digits + more}f}"

    def columns(self, pressures: Array) -> dict[str, Array]:
        """Columns of a table for people, with the unit in their headings, of pressures (n, actuators) Pa."""
        return {f"p{k} [{self.unit}]": values / self.pascal for k, values in enumerate(pressures.T, 1)}

    def group(self, numbers: Sequence[int]) -> str:
        """Which actuators are driven, by their numbers.

        >>> Chambers.words.group([1, 2]), Tendons.words.group([4]), Tendons.words.group([])
        ('chambers 1, 2', 'tendon 4', 'nothing pulled')
        """
        named = self.actuators if len(numbers) > 1 else self.actuator
        return f"{named} {', '.join(map(str, numbers))}" if numbers else f"nothing {self.inflated}"


Distance = Annotated[FiniteFloat, Field(gt=0, le=1)]
NumberOrList = Annotated[Annotated[Distance, Tag("number")] | Annotated[tuple[Distance, ...], Tag("list")], FORM]


class Actuators(FileTable):
    """What chambers and tendons have in common."""

    path_radius: NumberOrList = Field(json_schema_extra={"unit": "m", "uncertainty": "path_radius"})
    """Of all or of each."""
    azimuths_deg: tuple[Annotated[FiniteFloat, Field(ge=-360, le=360)], ...] = Field(
        min_length=1, max_length=64, json_schema_extra={"unit": "deg"}
    )
    ends: tuple[Annotated[FiniteFloat, Field(gt=0, le=5)], ...] = Field(default=(), json_schema_extra={"unit": "m"})
    """Arc length at which each ends; by default the tip's."""

    @property
    def levers(self) -> Array:
        """(actuators,) distance of each from the axis over their mean."""
        return np.broadcast_to(np.divide(self.path_radius, np.mean(self.path_radius)), len(self.azimuths_deg))

    @property
    def area(self) -> float:
        """m^2 that a pressure of the tables acts on, the mean of all; of tendons, which pull, negative."""
        return -PULL_AREA

    @property
    def shares(self) -> Array:
        """(actuators,) area of each over `area`."""
        return np.ones(len(self.azimuths_deg))


class Chambers(Actuators):
    """Pressure chambers: round channels along the body."""

    words: ClassVar[Words] = Words(
        "chambers", "kPa", 1e3, 0, True, "chamber", "chambers", "pressure", "pressures", "inflate", "inflated", "pushes",
        "area factor", "an area factor", "chambers' area", "areas of the chambers", "regulators",
    )  # fmt: skip

    radius: NumberOrList = Field(json_schema_extra={"unit": "m"})
    """Of all or of each."""

    @property
    def area(self) -> float:
        """Geometric cross-section of a chamber (A_norm of the paper), m^2, the mean of all."""
        return math.pi * float(np.mean(np.square(self.radius)))

    @property
    def shares(self) -> Array:
        """(actuators,) area of each over `area`."""
        return np.broadcast_to(math.pi * np.square(self.radius) / self.area, len(self.azimuths_deg))


class Tendons(Actuators):
    """Tendons along the body in its wall, each pulled by a known tension."""

    words: ClassVar[Words] = Words(
        "tendons", "N", 1 / PULL_AREA, 1, False, "tendon", "tendons", "tension", "tensions", "pull", "pulled", "pulls",
        "tension factor", "a tension factor", "tendons' pull", "tensions of the tendons", "motors",
    )  # fmt: skip
