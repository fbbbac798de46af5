"""rig.yaml: which instruments there are, how to reach them, their limits, and where the specimens stand."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from drivers import alicat, dynamixel, ft300s, natnet_mocap, numato, pfeiffer, smc_itv, tmcl, ur5
from drivers.interfaces import Vector3

from .config import ConfigError, check, read_yaml


class Table(BaseModel):
    """A table of a file: no unknown keys, no NaN, unchangeable."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class ArmConfig(ur5.Config):
    """The arm: motion and streamed state."""

    driver: Literal["ur5"]
    max_age: float = Field(0.2, gt=0, le=5, json_schema_extra={"unit": "s"})
    """How old its streamed state may be, host time."""


class ForceConfig(ft300s.Config):
    """Force-torque sensor."""

    driver: Literal["ft300s"]


class AlicatConfig(alicat.Config):
    """Regulators on one bus."""

    driver: Literal["alicat"]


class ItvConfig(smc_itv.Config):
    """Regulators on a port each."""

    driver: Literal["smc_itv"]


class DynamixelConfig(dynamixel.Config):
    """Length unit."""

    driver: Literal["dynamixel"]


class TmclConfig(tmcl.Config):
    """Length unit."""

    driver: Literal["tmcl"]


class ValveConfig(numato.Config):
    """Jamming valve."""

    driver: Literal["numato"]


class GaugeConfig(pfeiffer.Config):
    """Vacuum gauge at the spine."""

    driver: Literal["pfeiffer"]


class MocapConfig(natnet_mocap.Config):
    """Motion capture of the tip."""

    driver: Literal["natnet"]


PressureConfig = Annotated[AlicatConfig | ItvConfig, Field(discriminator="driver")]
SpineConfig = Annotated[DynamixelConfig | TmclConfig, Field(discriminator="driver")]


class Instruments(Table):
    """The instruments of the rig; one that is not there is left out."""

    arm: ArmConfig | None = None
    force: ForceConfig | None = None
    pressure: PressureConfig | None = None
    spine: SpineConfig | None = None
    valve: ValveConfig | None = None
    gauge: GaugeConfig | None = None
    mocap: MocapConfig | None = None


class ClockConfig(Table):
    """How fast the rig's time runs; 1 for real instruments."""

    speed: float = Field(1.0, ge=0.1, le=200, json_schema_extra={"unit": ""})


class Stand(Table):
    """Where the specimen of a stiffness trial is clamped, in the arm's base frame."""

    origin: Vector3 = Field(json_schema_extra={"unit": "m"})
    """The clamp."""
    axis: Vector3 = Field(json_schema_extra={"unit": ""})
    """Unit vector from the clamp to the specimen's tip."""
    push: Vector3 = Field(json_schema_extra={"unit": ""})
    """Unit vector in which the probe pushes; at a right angle to the axis."""
    tool_rotation: Vector3 = Field(json_schema_extra={"unit": "rad"})
    """Rotation vector of the TCP while pushing."""
    standoff: float = Field(0.08, gt=0, le=0.3, json_schema_extra={"unit": "m"})
    """Distance from the specimen's axis at which an approach starts."""

    @model_validator(mode="after")
    def _directions(self) -> Stand:
        for name in ("axis", "push"):
            length = math.hypot(*getattr(self, name))
            if abs(length - 1) > 1e-3:
                raise ValueError(f"{name} must be a unit vector; its length is {length:.4g}")
        along = sum(a * b for a, b in zip(self.axis, self.push, strict=True))
        if abs(along) > 1e-3:
            raise ValueError(f"push must be at a right angle to axis; their product is {along:.4g}")
        return self


class Safe(Table):
    """What the safe state is."""

    vented_below: float = Field(5e3, gt=0, le=50e3, json_schema_extra={"unit": "Pa"})
    """All chambers must be measured below this."""
    within: float = Field(10.0, gt=0, le=120, json_schema_extra={"unit": "s"})
    """Time allowed to get there, rig time."""
    keep_vacuum: bool = False
    """True keeps the spine jammed."""


class RigFile(Table):
    """The whole of rig.yaml."""

    name: str = Field(min_length=1, max_length=100)
    robot: Path
    """robot.yaml, relative to this file."""
    instruments: Instruments
    clock: ClockConfig = ClockConfig()
    stand: Stand | None = None
    operator: str = Field("console", pattern=r"^(console|tcp://[\w.\-]+:\d+)$")
    """Who mounts specimens: a person at the console, or a program that answers at an address."""
    poll: float = Field(20.0, gt=0, le=200, json_schema_extra={"unit": "Hz"})
    """How often actuators are read, in host time."""
    safe: Safe = Safe()


def load_rig(path: Path) -> RigFile:
    """Read rig.yaml; raises ConfigError. The robot's path in the result is absolute."""
    rig = check(read_yaml(path), RigFile)
    robot = (path.parent / rig.robot).resolve()
    if not robot.is_file():
        raise ConfigError(
            f"{path}: robot = {rig.robot}: no such file; give the path of robot.yaml relative to this file"
        )
    return rig.model_copy(update={"robot": robot})
