"""Parameters that the protocols share. Every number is SI and has a limit; the defaults are the paper's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field


@dataclass(frozen=True)
class RobotFacts:
    """What protocols know of the robot before anything is opened."""

    chambers: int
    channels: tuple[tuple[int, ...], ...]
    """Chambers on each channel of the regulators; empty when the rig has none."""
    tip_mass: float
    """Hung at its tip, kg."""
    spine: bool
    """It has one; else neither length unit nor valve nor gauge is needed."""
    arm: Mapping[str, Any] = field(default_factory=dict)
    """Where the rig lets its arm go: parameters of `arm_accuracy`."""


class Parameters(BaseModel):
    """A table of protocol parameters: no unknown keys, no NaN, unchangeable."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True)
    renamed: ClassVar[Mapping[str, str]] = {}
    """Keys under their earlier names, which files may still have -> the names they have now."""

    @classmethod
    def defaults_for(cls, robot: RobotFacts) -> dict[str, Any]:
        """Values that fit a robot, of keys that a person has left out; where none is given here the default holds."""
        return {}


PREPARING = 8.0
"""Planned s of venting, releasing and jamming, without the spine's way."""
SpineLength = Annotated[float, Field(ge=0, le=0.35)]
Pressure = Annotated[float, Field(ge=1e3, le=300e3)]
Vacuum = Annotated[float, Field(ge=0, le=95e3)]
Chamber = Annotated[int, Field(ge=1, le=64)]


class Jam(Parameters):
    """When the gauge shows the spine jammed or released."""

    share: float = Field(0.9, gt=0.1, le=1.0, json_schema_extra={"unit": ""})
    """Share of the supply's vacuum at which the spine counts as jammed; below, as soft."""
    released_below: float = Field(5e3, gt=0, le=50e3, json_schema_extra={"unit": "Pa"})
    """Released when the gauge changes by less than a fifth of this over `rest`."""
    rest: float = Field(2.0, gt=0, le=60, json_schema_extra={"unit": "s"})
    """Rest of the gauge after the release; its mean is ambient pressure."""
    within: float = Field(30.0, gt=0, le=600, json_schema_extra={"unit": "s"})
    """Longest time for jamming or releasing."""


class Settle(Parameters):
    """When a state counts as settled, and its average."""

    band: float = Field(1.5e3, gt=0, le=20e3, json_schema_extra={"unit": "Pa"})
    """Largest distance of a chamber from its set-point."""
    still: float = Field(1.5, gt=0, le=60, json_schema_extra={"unit": "s"})
    """How long chambers and tip must stay settled."""
    still_distance: float = Field(0.6e-3, gt=0, le=0.05, json_schema_extra={"unit": "m"})
    """Largest motion of the smoothed tip over `still`."""
    average: float = Field(1.0, gt=0, le=60, json_schema_extra={"unit": "s"})
    """Shortest time of the average."""
    min_samples: int = Field(10, ge=1, le=10_000)
    """Fewest samples of each stream in the average."""
    smooth: int = Field(20, ge=1, le=1000)
    """Samples in the moving average of the tip, against camera noise."""
    max_gap: float = Field(3.0, gt=0, le=60, json_schema_extra={"unit": "s"})
    """Longest pause of a stream meanwhile."""
    max_hidden: float = Field(0.5, gt=0, le=60, json_schema_extra={"unit": "s"})
    """Longest time without the tip meanwhile."""
    within: float = Field(120.0, gt=0, le=3600, json_schema_extra={"unit": "s"})
    """Longest time to settle."""


class SpineMotion(Parameters):
    """How the spine is grown."""

    speed: float = Field(0.02, gt=0, le=0.1, json_schema_extra={"unit": "m/s"})
    """Of growing and shrinking."""
    tolerance: float = Field(0.5e-3, gt=0, le=0.01, json_schema_extra={"unit": "m"})
    """Distance from its goal at which the spine has arrived."""
    settle: float = Field(0.5, ge=0, le=60, json_schema_extra={"unit": "s"})
    """Between the spine's arrival and jamming."""
