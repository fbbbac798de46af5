"""rig.yaml: the instruments, how to reach them, their limits, and the place of the specimens."""

from __future__ import annotations

import functools
import hashlib
import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Optional, Union

import yaml
from pydantic import ConfigDict, Field, PrivateAttr, StringConstraints, create_model, field_validator, model_validator

from drivers.configs import (
    HOSTS,
    PORTS,
    ArmConfig,
    ForceConfig,
    GaugeConfig,
    InstrumentConfig,
    LengthUnitConfig,
    MocapConfig,
    RegulatorsConfig,
    SensorConfig,
    ValveConfig,
)
from drivers.interfaces import Vector3
from drivers.registry import GROUP, QUANTITY, ROLES, Driver, faults, own
from model.plain_yaml import FileTable

from .config import ConfigError, Source, check, read_yaml
from .packages import Registered, installed, without

if TYPE_CHECKING:
    from model.robot import Robot


@functools.cache
def found_drivers() -> Registered[Driver]:
    """All drivers by name, the project's own and those of packages; looked up once."""
    good, missing = own()
    return installed(GROUP, good, without(faults), missing)


def drivers() -> Mapping[str, Driver]:
    """Those that can be used, by name."""
    return found_drivers().usable


SENSOR = "sensor"
SENSORS = "sensors."
"""A sensor's place in `instruments`, and the name of the instrument: this and its own."""
SensorName = Annotated[str, StringConstraints(pattern=f"^{QUANTITY.pattern}$")]
"""The lab's own name for a sensor: it goes into topics and columns."""


class NotInstalled(InstrumentConfig):
    """Placeholder for an instrument's table if no driver of its kind is installed."""

    model_config = ConfigDict(extra="allow")

    @field_validator("driver")
    @classmethod
    def _none(cls, driver: str) -> str:
        raise ValueError("no driver of this kind is installed; see docs/howto/driver.md for how to add one")


def _tables() -> dict[str, Any]:
    """For each key of `instruments` the tables of its registered drivers, told apart by `driver`."""
    fields: dict[str, Any] = {}
    for role in ROLES:
        tables = tuple(_table(name, driver.config) for name, driver in drivers().items() if driver.role == role)
        if role == SENSOR:
            one: Any = _one_of(tables)
            fields["sensors"] = (dict[SensorName, one], {})
        else:
            fields[role] = (Optional[_one_of(tables)], None)  # noqa: UP045
    return fields


def _one_of(tables: tuple[type[InstrumentConfig], ...]) -> Any:
    """A table of one of these kinds: of as many as are registered, which no type checker can know."""
    kinds: Any = tables or (NotInstalled,)
    one: Any = Union[kinds]  # noqa: UP007
    return Annotated[one, Field(discriminator="driver")] if len(tables) > 1 else one


def _table(name: str, config: type[InstrumentConfig]) -> type[InstrumentConfig]:
    """A driver's table in which `driver` must be given."""
    named: Any = Literal[name]
    return create_model(f"{name} table", __base__=config, __doc__=config.__doc__, driver=(named, ...))


if TYPE_CHECKING:

    class Instruments(FileTable):
        """The instruments of the rig; one that is not there is left out."""

        arm: ArmConfig | None = None
        force: ForceConfig | None = None
        pressure: RegulatorsConfig | None = None
        spine: LengthUnitConfig | None = None
        valve: ValveConfig | None = None
        gauge: GaugeConfig | None = None
        mocap: MocapConfig | None = None
        sensors: dict[str, SensorConfig] = {}

else:
    about = "The instruments of the rig; one that is not there is left out."
    Instruments = create_model("Instruments", __base__=FileTable, __doc__=about, **_tables())


def present(instruments: Instruments) -> tuple[str, ...]:
    """The instruments that are there: their keys in rig.yaml, and the names of the lab's own sensors."""
    keys = tuple(key for key in ROLES if key != SENSOR and getattr(instruments, key) is not None)
    return keys + tuple(SENSORS + name for name in instruments.sensors)


def table_of(instruments: Instruments, name: str) -> InstrumentConfig:
    """The table of an installed instrument in rig.yaml; the arm's state is in the arm's table."""
    if name.startswith(SENSORS):
        return instruments.sensors[name.removeprefix(SENSORS)]
    found: InstrumentConfig = getattr(instruments, "arm" if name == "arm_state" else name)
    return found


def addresses(instruments: Instruments) -> Iterator[tuple[str, str, str]]:
    """Instrument, key and text of all its ports (`PORTS`) and hosts (`HOSTS`)."""
    for name in present(instruments):
        config = table_of(instruments, name)
        for key in (*PORTS, *HOSTS):
            value = getattr(config, key, None)
            for address in value if isinstance(value, tuple) else (value,):
                if isinstance(address, str) and address:  # TMCL has a `host` that is a number on its bus
                    yield name, key, address


class ClockConfig(FileTable):
    """How fast the rig's time runs; 1 for real instruments."""

    speed: float = Field(1.0, ge=0.1, le=200, json_schema_extra={"unit": ""})


class Stand(FileTable):
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
    """Distance from the specimen's axis where an approach starts."""
    position_sd: float = Field(0.0, ge=0, le=0.05, json_schema_extra={"unit": "m"})
    """Standard deviation of the arm's error along each axis, as `lab run arm_accuracy` reports it; where the probe pushes is as
    uncertain (`uncertainty.push_place` of the recorded robot.yaml)."""

    @model_validator(mode="after")
    def _directions(self) -> Stand:
        for name in ("axis", "push"):
            length = math.hypot(*getattr(self, name))
            if abs(length - 1) > 1e-3:
                raise ValueError(f"{name} must be a unit vector; its length is {length:.4g}")
        along = sum(a * b for a, b in zip(self.axis, self.push, strict=True))
        if abs(along) > 1e-3:
            raise ValueError(f"push must be perpendicular to axis; their dot product is {along:.4g}")
        return self


Actuator = Literal["arm", "pressure", "spine", "valve"]


class Safe(FileTable):
    """Definition of the safe state, how it is reached, and when the guard lands the rig by itself."""

    order: tuple[Actuator, ...] = ("arm", "pressure", "spine", "valve")
    """Order of the stops."""
    vented_below: float = Field(5e3, gt=0, le=50e3, json_schema_extra={"unit": "Pa"})
    """Pressure below which all chambers count as vented."""
    within: float = Field(10.0, gt=0, le=120, json_schema_extra={"unit": "s"})
    """Longest time to reach it, rig time."""
    keep_vacuum: bool = False
    """True keeps the spine jammed."""
    heartbeat: float = Field(1.0, ge=0.2, le=10, json_schema_extra={"unit": "s"})
    """Silence of the program after which the guard lands the rig, host time; the program gives the guard up after twice that."""
    hang: float = Field(10.0, ge=1, le=600, json_schema_extra={"unit": "s"})
    """The same for an experiment that makes no progress, host time."""

    @model_validator(mode="after")
    def _everybody_once(self) -> Safe:
        if sorted(self.order) != ["arm", "pressure", "spine", "valve"]:
            raise ValueError(f"order must name arm, pressure, spine and valve once each, got {', '.join(self.order)}")
        return self


class Limits(FileTable):
    """Limits of the rig as a whole. The defaults are the paper's ranges."""

    max_total_pressure: float = Field(1.5e6, gt=0, le=3e6, json_schema_extra={"unit": "Pa"})
    """Sum over all chambers; set-points beyond it are scaled down together."""
    pressure_error: float = Field(30e3, ge=5e3, le=200e3, json_schema_extra={"unit": "Pa"})
    """Largest distance of a measured pressure from its set-point followed with the regulator's time_constant, and above
    max_pressure at any time."""
    pressure_error_time: float = Field(5.0, gt=0, le=60, json_schema_extra={"unit": "s"})
    """Longest time beyond it, rig time."""
    max_force: float = Field(60.0, gt=0, le=300, json_schema_extra={"unit": "N"})
    """Force beyond the sensor's zero or, before there is one, beyond its first reading; the arm stops above it."""
    max_moment: float = Field(10.0, gt=0, le=30, json_schema_extra={"unit": "N m"})
    max_vacuum: float = Field(95e3, gt=0, le=101e3, json_schema_extra={"unit": "Pa"})
    """Below standard ambient pressure."""
    max_age: float = Field(2.0, gt=0.1, le=10, json_schema_extra={"unit": "s"})
    """Of the newest reading of a polled instrument, host time. Also of all waits of the arm for force samples in a motion."""
    max_age_in_motion: float = Field(0.05, ge=0.02, le=1, json_schema_extra={"unit": "s"})
    """Of the newest force sample while the arm moves, host time; the arm waits while it is older."""
    max_hidden: float = Field(2.0, gt=0.1, le=60, json_schema_extra={"unit": "s"})
    """Time without the tip after which the run pauses, host time."""
    resume_within: float = Field(20.0, gt=0, le=600, json_schema_extra={"unit": "s"})
    """Time that a confirmed repair may take to show in the readings, host time."""


LONGEST_SOCKET_PATH = 108
"""Bytes that Linux has for the path of a socket, the closing zero included."""
UNIX = "unix:"
"""Prefix of `operator` if a program answers."""
OPERATORS = (
    "write console, or unix:/FOLDER/operator.sock: the socket of a program of yours, in a folder of mode 0700, with a "
    f"path shorter than {LONGEST_SOCKET_PATH} bytes"
)


class RigFile(FileTable):
    """The whole of rig.yaml."""

    name: str = Field(min_length=1, max_length=100)
    robot: Path
    """robot.yaml, relative to this file."""
    instruments: Instruments
    clock: ClockConfig = ClockConfig()
    stand: Stand | None = None
    operator: str = "console"
    """Who mounts specimens and confirms pauses: console, or a program at a Unix socket (unix:/PATH)."""
    poll: float = Field(20.0, gt=0, le=200, json_schema_extra={"unit": "Hz"})
    """Rate at which actuators are read, host time."""
    safe: Safe = Safe()
    limits: Limits = Limits()
    _path: Path | None = PrivateAttr(default=None)
    _texts: Mapping[str, bytes] = PrivateAttr(default={})
    _body: Any = PrivateAttr(default=None)

    @field_validator("operator")
    @classmethod
    def _one_who_may_speak(cls, operator: str) -> str:
        path = operator.removeprefix(UNIX)
        if operator == "console" or (operator.startswith(UNIX + "/") and len(path.encode()) < LONGEST_SOCKET_PATH):
            return operator
        if operator.startswith("tcp:"):
            raise ValueError("anybody on this computer could connect to it; " + OPERATORS)
        raise ValueError(OPERATORS)

    @property
    def path(self) -> Path | None:
        """The file this was read from; None when it was not read from one."""
        return self._path

    @property
    def texts(self) -> Mapping[str, bytes]:
        """rig.yaml and robot.yaml as they were parsed; both are read once, however often they are changed later."""
        return self._texts

    @property
    def sha256(self) -> str:
        """Of the text of rig.yaml, by which another process knows that it has read the same."""
        return hashlib.sha256(self._texts["rig.yaml"]).hexdigest()

    @property
    def body(self) -> Robot:
        """The robot of `load_rig`; ConfigError for a rig that was read without its robot."""
        if self._body is None:
            raise ConfigError(f"{self._path or 'rig.yaml'}: its robot {self.robot} was not read")
        found: Robot = self._body
        return found

    def read_from(self, path: Path | None, texts: Mapping[str, bytes] | None = None, body: Robot | None = None) -> RigFile:
        """The same, known to have been read from this file, with this robot."""
        found = self.model_copy()
        found._path, found._texts, found._body = path, texts or {}, body
        return found


def load_rig(path: Path) -> RigFile:
    """Read rig.yaml and its robot.yaml, each once; raises ConfigError. The robot's path in the result is absolute."""
    from model.robot import Robot  # `lab safe` reads a rig without it, and at once

    source = read_yaml(path)
    if beyond := _unusable(source.data):
        raise ConfigError(*(f"{path}: {why}" for why in beyond.values()))
    rig = check(source, RigFile)
    robot = (path.parent / rig.robot).resolve()
    if not robot.is_file():
        raise ConfigError(f"{path}: robot = {rig.robot}: no such file; give the path of robot.yaml relative to this file")
    of_robot = read_yaml(robot)
    stated = of_robot.table.get("uncertainty", {})
    if rig.stand is not None and rig.stand.position_sd and isinstance(stated, dict):
        table = {**of_robot.table, "uncertainty": {"push_place": rig.stand.position_sd, **stated}}
        of_robot = replace(of_robot, data=table, text=yaml.safe_dump(table, sort_keys=False).encode())
    texts = {"rig.yaml": source.text, "robot.yaml": of_robot.text}
    return rig.model_copy(update={"robot": robot}).read_from(path.resolve(), texts, check(of_robot, Robot))


def same_rig(path: Path, sha256: str) -> RigFile:
    """Read rig.yaml, without its robot, as another process of this run has read it; raises ConfigError when it was changed."""
    source = read_yaml(path)
    if hashlib.sha256(source.text).hexdigest() != sha256:
        raise ConfigError(f"{path}: was changed after the command had read it; repeat the command")
    return check(source, RigFile).read_from(path, {"rig.yaml": source.text})


def within_robot(rig: RigFile, most: float | tuple[float, ...] | None) -> RigFile:
    """The rig with regulators limited to `most` Pa, `max_pressure` of robot.yaml, each to the lowest of its chambers. The guard
    uses it to clip set-points and to judge readings by the lower limit."""
    pressure = rig.instruments.pressure
    if pressure is None or most is None:
        return rig
    of_chamber = dict(enumerate(most, 1)) if isinstance(most, tuple) else dict.fromkeys(itertools.chain(*pressure.chambers), most)
    groups = zip(pressure.limits, pressure.chambers, strict=True)
    limits = tuple(min(limit, *(of_chamber.get(chamber, limit) for chamber in group)) for limit, group in groups)
    if limits == pressure.limits:
        return rig
    lower = pressure.model_copy(update={"max_pressure": limits if len(set(limits)) > 1 else limits[0]})
    return rig.model_copy(update={"instruments": rig.instruments.model_copy(update={"pressure": lower})})


@dataclass(frozen=True)
class Readable:
    """The readable part of a rig.yaml, for a landing."""

    rig: RigFile
    missing: Mapping[str, str]
    """The instruments that cannot be used, and why."""
    notes: tuple[str, ...]
    """Other faults, and the replacements used."""


def rig_to_make_safe(path: Path, last: RigFile | None) -> Readable:
    """Read rig.yaml as far as a landing needs it: without its robot, each table by itself, and where one cannot be used,
    as in the `last` rig. Raises ConfigError if nothing is usable."""
    try:
        source = read_yaml(path)
        if not isinstance(source.data, dict) or not isinstance(source.data.get("instruments"), dict):
            raise ConfigError(f"{path}: has no table of instruments")
    except ConfigError as e:
        if last is None:
            raise
        return Readable(last, {}, (f"{e}\nmaking the rig safe by the rig.yaml that it was last used with",))
    sound, notes = _sound_tables(source, last)
    missing = _unusable(source.data)
    tables: dict[str, Any] = {}
    for key, table in source.data["instruments"].items():
        try:
            if key in ROLES and key != SENSOR and key not in missing and table is not None:
                tables[key] = getattr(_with(source, {key: table}).instruments, key)
        except ConfigError as e:
            if (last_table := getattr(last.instruments, key, None) if last is not None else None) is not None:
                tables[key] = last_table
                notes.append(f"{e}\nusing instruments.{key} as the rig was last used with it")
            else:
                missing[key] = str(e)
    for key in set(ROLES) - {SENSOR} - set(source.data["instruments"]):
        if last is not None and (last_table := getattr(last.instruments, key)) is not None:
            tables[key] = last_table
            notes.append(f"{path}: no longer has instruments.{key}; using its last known settings")
    rig = sound.model_copy(update={"instruments": Instruments(**tables), "robot": (path.parent / "robot.yaml").resolve()})
    return Readable(rig.read_from(path.resolve()), missing, tuple(notes))


def _with(source: Source, instruments: dict[str, Any], **tables: Any) -> RigFile:
    """The rig that has these tables alone; raises ConfigError."""
    return check(Source(source.name, {"name": "rig", "robot": "robot.yaml", "instruments": instruments, **tables},
                        source.lines), RigFile)  # fmt: skip


def _sound_tables(source: Source, last: RigFile | None) -> tuple[RigFile, list[str]]:
    """The rig without instruments, with those of its other tables that are sound."""
    rig, notes = _with(source, {}), []
    assert isinstance(source.data, dict)
    for key in ("clock", "safe", "limits", "operator"):
        if key in source.data:
            try:
                found = getattr(_with(source, {}, **{key: source.data[key]}), key)
            except ConfigError as e:
                found = getattr(last or rig, key)
                notes.append(f"{e}\nusing {key} {'as the rig was last used with it' if last else 'as it is by default'}")
            rig = rig.model_copy(update={key: found})
    return rig, notes


def _unusable(data: Any) -> dict[str, str]:
    """The instruments whose driver is known but cannot be used, and why."""
    tables = data.get("instruments") if isinstance(data, dict) else None
    tables = tables if isinstance(tables, dict) else {}
    sensors = tables.get("sensors")
    named = {**tables, **{SENSORS + k: v for k, v in (sensors if isinstance(sensors, dict) else {}).items()}}
    found, broken = {}, found_drivers().broken
    for key, table in named.items():
        name = table.get("driver") if isinstance(table, dict) else None
        if isinstance(name, str) and name in broken:
            found[key] = f"instruments.{key}.driver = {name}: {broken[name]}"
    return found
