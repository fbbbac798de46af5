"""Commands: the only form in which a call reaches an instrument in another process.

A `Remote` represents the instrument in the calling process and turns each call into a command; `Command.perform` makes the call
in the driver's process. So the program calls the guard, and the guard a driver that has a process of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import Any, Generic, Protocol, TypeVar

from drivers.interfaces import Arm, ArmDriver, Instrument, JammingValve, LengthUnit, PressureRegulators, VacuumGauge

R = TypeVar("R")


class Order(StrEnum):
    """Requests of the program to the guard itself, and their names."""

    MAKE_SAFE = "the landing"
    PAUSE = "the pause"
    RESUME = "the end of a pause"
    END = "the end"


class ActuatorDriver(Instrument, Protocol):
    """What the guard calls besides: `connect` of every actuator, the others of drivers that have them (see `interfaces`)."""

    def connect(self) -> None:
        """Open the line without asking who is there."""

    def confirm_settings(self) -> None:
        """Read the settings that matter for safety again."""

    def take_notices(self) -> list[str]:
        """Sentences worth a warning."""


OPTIONAL: Mapping[Any, Callable[[], Any]] = MappingProxyType(
    {ActuatorDriver.confirm_settings: lambda: None, ActuatorDriver.take_notices: list}
)
"""Methods that not every driver has, and what stands in for them."""


@dataclass(frozen=True)
class Command(Generic[R]):
    """One call of one instrument, named as in rig.yaml, by the method of its interface."""

    instrument: str
    method: Callable[..., R]
    values: tuple[Any, ...] = ()
    """What the method takes."""

    def perform(self, driver: Any) -> R:
        """Make the call. Raises what the driver raises."""
        name = self.method.__name__
        method = getattr(driver, name, OPTIONAL[self.method]) if self.method in OPTIONAL else getattr(driver, name)
        result: R = method(*self.values)
        return result

    def __str__(self) -> str:
        return f"{self.instrument}.{self.method.__name__}"


def moves(command: Command[Any]) -> bool:
    """Whether it starts a motion that continues by itself."""
    return command.method in (LengthUnit.home, LengthUnit.move_to, Arm.move_to)


def energises(command: Command[Any]) -> bool:
    """Whether the rig leaves its safe state by it."""
    return command.method in (PressureRegulators.set, JammingValve.set) or moves(command)


class Line(Protocol):
    """The way to another process."""

    def ask(self, command: Command[R]) -> R:
        """Send a command and wait for its result. Raises what the driver there raises."""


def called(method: Callable[[Any], R]) -> Callable[[Any], R]:
    """A method of a `Remote` that makes this call there."""

    def call(remote: Remote) -> R:
        return remote.line.ask(Command(remote.name, method))

    return call


class Remote:
    """An instrument in another process; its methods and those of the classes below are those of `drivers.interfaces`. What
    crosses are plain numbers: the process there reads them without NumPy."""

    def __init__(self, line: Line, name: str, channels: int = 0) -> None:
        self.line, self.name, self.channels = line, name, channels

    open, close = called(Instrument.open), called(Instrument.close)
    connect, confirm_settings = called(ActuatorDriver.connect), called(ActuatorDriver.confirm_settings)
    take_notices = called(ActuatorDriver.take_notices)


class RemoteRegulators(Remote):
    """`PressureRegulators`."""

    def set(self, pressures: Sequence[float]) -> tuple[float, ...]:
        return self.line.ask(Command(self.name, PressureRegulators.set, (tuple(map(float, pressures)),)))

    read, vent = called(PressureRegulators.read), called(PressureRegulators.vent)


class RemoteLengthUnit(Remote):
    """`LengthUnit`."""

    def move_to(self, length: float, speed: float) -> float:
        return self.line.ask(Command(self.name, LengthUnit.move_to, (float(length), float(speed))))

    home, stop, read = called(LengthUnit.home), called(LengthUnit.stop), called(LengthUnit.read)


class RemoteValve(Remote):
    """`JammingValve`."""

    def set(self, on: bool) -> bool:
        return self.line.ask(Command(self.name, JammingValve.set, (bool(on),)))

    read = called(JammingValve.read)


class RemoteGauge(Remote):
    """`VacuumGauge`."""

    read = called(VacuumGauge.read)


class RemoteArm(Remote):
    """`ArmDriver`."""

    def move_to(self, pose: Sequence[float], speed: float, acceleration: float) -> None:
        self.line.ask(Command(self.name, Arm.move_to, (tuple(map(float, pose)), float(speed), float(acceleration))))

    moving, stop = called(Arm.moving), called(Arm.stop)
    standing, glance = called(ArmDriver.standing), called(ArmDriver.glance)


REMOTES: Mapping[str, type[Remote]] = MappingProxyType(
    {"pressure": RemoteRegulators, "spine": RemoteLengthUnit, "valve": RemoteValve, "gauge": RemoteGauge, "arm": RemoteArm}
)
"""The remote object of each instrument of the guard."""
