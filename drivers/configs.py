"""The keys of every instrument's table in rig.yaml that all drivers share; each driver adds how it is reached."""

from __future__ import annotations

import re
from typing import Annotated, ClassVar, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from .chambers import ChamberMap
from .interfaces import Vector3

PORTS, HOSTS = ("port", "ports"), ("host", "server", "local")
"""Keys of an instrument's table that hold the path of a serial line, and the address of a computer: every table has one of them,
which shows whether the instrument is on this computer alone."""

SERVED = re.compile(r"(?:socket|rfc2217)://(?:[A-Za-z0-9._-]+|\[[0-9A-Fa-f:.]+\]):([0-9]{1,5})")
"""Ports of terminal servers, without the options of a URL: some of them write files."""

Framing = Annotated[str, Field(pattern="^[5-8][NEO][12]$")]
"""Data bits, parity (none, even, odd) and stop bits of a serial line, such as 8N1."""


def known_port(port: str) -> str:
    """The same port, where it is a device path or that of a terminal server; raises ValueError."""
    served = SERVED.fullmatch(port)
    if ("://" in port or not port.startswith("/") or not port.isprintable()) and not (served and 0 < int(served[1]) < 65536):
        raise ValueError(
            f"{port[:80]!r} is not a port; write the path of a device, such as /dev/serial/by-id/.., or of a terminal server "
            "socket://HOST:PORT or rfc2217://HOST:PORT, without options"
        )
    return port


MostPressure = Annotated[float, Field(gt=0, le=1e6)]


class InstrumentConfig(BaseModel):
    """One instrument's table: no unknown keys, no NaN, unchangeable."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    driver: str = ""
    """The driver's registered name; rig.yaml must give it."""

    @field_validator(*PORTS, check_fields=False)
    @classmethod
    def _known_port(cls, value: object) -> object:
        for port in value if isinstance(value, tuple) else (value,):
            if isinstance(port, str):
                known_port(port)
        return value


class RegulatorsConfig(InstrumentConfig):
    """Pressure regulators, one channel each."""

    chambers: tuple[tuple[int, ...], ...]
    """Chambers on each channel, in channel order."""
    max_pressure: MostPressure | tuple[MostPressure, ...] = Field(300e3, json_schema_extra={"unit": "Pa"})
    """Of all channels or of each."""
    max_rate: float = Field(100e3, gt=0, le=1e6, json_schema_extra={"unit": "Pa/s"})
    time_constant: float = Field(1.0, gt=0, le=30, json_schema_extra={"unit": "s"})
    """Slowest that a chamber follows its set-point: 63 % of a step in this time."""
    full_scale: float = Field(gt=0, le=2e6, json_schema_extra={"unit": "Pa"})
    """Range of the units."""

    widest: ClassVar[float | None] = None
    """Where the units cannot be asked for their range: the widest that there is, Pa; a first try is made so that even that
    one stays below 5 kPa."""

    @model_validator(mode="after")
    def _wired_and_within_range(self) -> Self:
        ChamberMap(self.chambers)
        if isinstance(self.max_pressure, tuple) and len(self.max_pressure) != len(self.chambers):
            raise ValueError(
                f"max_pressure has {len(self.max_pressure)} values for {len(self.chambers)} channels; give one per channel"
            )
        if (most := max(self.limits)) > self.full_scale:
            raise ValueError(f"max_pressure {most:g} Pa is above the units' full_scale {self.full_scale:g} Pa; lower it")
        return self

    @property
    def limits(self) -> tuple[float, ...]:
        """Highest set-point of each channel, Pa."""
        return self.max_pressure if isinstance(self.max_pressure, tuple) else (self.max_pressure,) * max(1, len(self.chambers))


class LengthUnitConfig(InstrumentConfig):
    """The unit that grows and retracts the spine."""

    max_length: float = Field(0.35, gt=0, le=2, json_schema_extra={"unit": "m"})
    max_speed: float = Field(0.05, gt=0, le=0.5, json_schema_extra={"unit": "m/s"})


class ValveConfig(InstrumentConfig):
    """The jamming valve."""

    on_close: str = "release"
    """What a driver leaves when it is closed: "release", or "keep", which leaves the spine jammed."""


class GaugeConfig(InstrumentConfig):
    """The vacuum gauge at the spine."""


class StreamConfig(InstrumentConfig):
    """An instrument that sends by itself."""

    max_age: float = Field(0.1, gt=0, le=10, json_schema_extra={"unit": "s"})
    """Of the newest sample, host time."""


class SensorConfig(StreamConfig):
    """A sensor of the lab's own, under `instruments.sensors` by a name of its own."""

    max_age: float = Field(10.0, gt=0, le=3600, json_schema_extra={"unit": "s"})
    """Age at which its newest sample is too old and the run ends, host time."""


class ForceConfig(StreamConfig):
    """The force-torque sensor."""

    max_force: float = Field(300.0, gt=0, le=300, json_schema_extra={"unit": "N"})
    """Range per axis, on raw readings."""
    max_moment: float = Field(30.0, gt=0, le=30, json_schema_extra={"unit": "N m"})


class MocapConfig(StreamConfig):
    """Motion capture of the tip."""

    markers: tuple[str, ...] = ()
    """Names of the rigid bodies along the robot, in the order of robot.yaml's `markers`."""


class ArmConfig(StreamConfig):
    """The arm: motion and streamed state. Lengths in its base frame."""

    max_age: float = Field(0.2, gt=0, le=5, json_schema_extra={"unit": "s"})
    """Of its streamed state, host time."""
    workspace_min: Vector3 = Field((-0.75, -0.75, 0.02), json_schema_extra={"unit": "m"})
    workspace_max: Vector3 = Field((0.75, 0.75, 0.90), json_schema_extra={"unit": "m"})
    """Box in which each target must lie."""
    max_speed: float = Field(0.1, gt=0, le=1.0, json_schema_extra={"unit": "m/s"})
    max_acceleration: float = Field(0.5, gt=0, le=5.0, json_schema_extra={"unit": "m/s^2"})
