"""What each kind of instrument offers, independent of its maker.

Conventions for every driver
- Units are SI; pressures are gauge unless a name says absolute.
- `open()` returns the identity, or raises `Unreachable` or `WrongDevice`.
- `close()` lands safe (vented, stopped), from any state, and never raises.
- Every public call returns within the wire time-out: a long motion is started, then watched by `read()`.
- `t` of a sample is the clock's time (s) when the reading arrived. Wire time-outs and ages are host monotonic time.
- A stream counts in `lost` the samples known to be missing (gaps, damaged frames).
- A command returns what was sent, after clipping to the limits.
- Public commands are idempotent and confirmed by read-back.

Two optional methods
- `confirm_settings() -> None` reads again, as `open()` does, the settings on which safety rests and which may change at a
  panel, by another program or by a loss of power. It may write a setting that has one right value. It raises `WrongDevice`
  (setting, register, value found, value needed, remedy) or `NoReply`. The guard calls it before the first pressure after a
  vent and when a pressure jumps, and lands the rig after any error.
- `take_notices() -> list[str]` returns sentences worth a warning, each once, such as frequent retries.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntFlag
from typing import Any, Protocol, TypeVar, runtime_checkable

Vector3 = tuple[float, float, float]
Vector6 = tuple[float, float, float, float, float, float]
Quaternion = tuple[float, float, float, float]
"""w, x, y, z"""


@dataclass(frozen=True)
class Identity:
    """Who answered at `open()`; empty strings for what the instrument does not report."""

    maker: str
    model: str
    serial: str = ""
    firmware: str = ""


@dataclass(frozen=True)
class PressureSample:
    """All channels of the regulators, in channel order, Pa gauge."""

    t: float
    setpoint: tuple[float, ...]
    measured: tuple[float, ...]


@dataclass(frozen=True)
class SpineSample:
    """The length unit: spine length (m), its speed (m/s), and its goal (m)."""

    t: float
    length: float
    speed: float
    goal: float
    moving: bool
    homed: bool


@dataclass(frozen=True)
class ValveSample:
    """Read-back of the jamming valve: True when vacuum is applied to the spine."""

    t: float
    on: bool


@dataclass(frozen=True)
class GaugeSample:
    """Absolute pressure in the spine, Pa."""

    t: float
    absolute: float


@dataclass(frozen=True)
class WrenchSample:
    """Force (N) and moment (N m) in the sensor frame as the sensor sends them, and the software zero to subtract."""

    t: float
    raw: Vector6
    zero: Vector6

    @property
    def wrench(self) -> Vector6:
        """raw - zero: fx, fy, fz (N), mx, my, mz (N m)."""
        a, b = self.raw, self.zero
        return (a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3], a[4] - b[4], a[5] - b[5])


class SafetyBit(IntFlag):
    """What an arm's safety system reports: the bits of `ArmSample.safety_bits`, as a UR controller numbers them."""

    NORMAL = 1 << 0
    REDUCED = 1 << 1
    PROTECTIVE_STOP = 1 << 2
    RECOVERY = 1 << 3
    SAFEGUARD_STOP = 1 << 4
    SYSTEM_EMERGENCY_STOP = 1 << 5
    ROBOT_EMERGENCY_STOP = 1 << 6
    EMERGENCY_STOP = 1 << 7
    VIOLATION = 1 << 8
    FAULT = 1 << 9
    STOPPED = 1 << 10
    THREE_POSITION_STOP = 1 << 11


@dataclass(frozen=True)
class ArmSample:
    """The arm: its own stamp (s), joint angles (rad), TCP pose (m, rotation vector rad) and TCP speed in its base frame."""

    t: float
    device_time: float
    joints: Vector6
    tcp_pose: Vector6
    tcp_speed: Vector6
    safety_bits: int
    """See `SafetyBit`."""
    program_running: bool


@dataclass(frozen=True)
class BodySample:
    """One rigid body seen by motion capture, in the robot's base frame; `valid` False means: do not use the pose."""

    t: float
    device_time: float
    frame: int
    position: Vector3
    orientation: Quaternion
    marker_error: float
    valid: bool
    markers: tuple[Vector3, ...] = ()


S = TypeVar("S")
Sink = Callable[[S], None]
"""Where a streaming driver delivers its samples; called from the driver's own thread."""


@runtime_checkable
class Instrument(Protocol):
    """What all drivers share."""

    name: str

    def open(self) -> Identity:
        """Connect, check the identity, start a stream."""

    def close(self) -> None:
        """Land safe and disconnect."""


class PressureRegulators(Instrument, Protocol):
    """N pressure channels.

    While the unit latches a fault (its emergency button), `set` raises `DeviceFault`, `vent` succeeds, and `read` returns the
    measurement, by which a landing confirms the safe state; `read` may raise the fault once, to end a run. `take_notices` names
    the cause; `open` may reset it.
    """

    channels: int

    def set(self, pressures: Sequence[float]) -> tuple[float, ...]:
        """Set all channels (Pa gauge), clipped to limits and rate (Pa/s); returns the set-points the instrument confirmed."""

    def read(self) -> PressureSample:
        """Poll all channels."""

    def vent(self) -> None:
        """Set all channels to zero at once, without rate limit; a channel that fails does not delay the others."""


class LengthUnit(Instrument, Protocol):
    """The unit that grows and retracts the spine."""

    def home(self) -> None:
        """Start the reference run to length 0; `read().homed` is True when it is done."""

    def move_to(self, length: float, speed: float) -> float:
        """Start moving to a length (m) at a speed (m/s); returns the clipped goal. `NotReady` when not homed."""

    def stop(self) -> None:
        """Stop now and hold."""

    def read(self) -> SpineSample:
        """Poll; raises `DeviceFault` when the unit reports one."""


class JammingValve(Instrument, Protocol):
    """The valve between the spine and the vacuum."""

    def set(self, on: bool) -> bool:
        """Switch and return the state read back; `DeviceFault` when it differs from the request."""

    def read(self) -> ValveSample:
        """Poll the relay's state."""


class VacuumGauge(Instrument, Protocol):
    """The gauge at the spine."""

    def read(self) -> GaugeSample:
        """Poll the absolute pressure."""


class Arm(Instrument, Protocol):
    """Motion of the robot arm. Never blocking: start a move, then watch `moving()`."""

    def move_to(self, pose: Sequence[float], speed: float, acceleration: float) -> None:
        """Start a straight TCP motion to pose (m, rotation vector rad, base frame); m/s, m/s^2."""

    def moving(self) -> bool:
        """True until the last motion has ended; `DeviceFault` after a protective or emergency stop."""

    def stop(self) -> None:
        """Decelerate now."""


class ArmDriver(Arm, Protocol):
    """An arm as its driver offers it, with what a landing must know."""

    def standing(self) -> bool:
        """True when the newest state shows the arm standing; `NotReady` before `open`."""

    def glance(self) -> bool:
        """The same without `open` and without control, for an arm whose own safety system has stopped it."""


class Stream(Instrument, Protocol):
    """An instrument that sends by itself; each sample goes to the constructor's sink."""

    lost: int
    """Samples known to be lost: gaps in stamps or counters, damaged frames."""

    def latest(self) -> Any:
        """The newest sample; `StaleReading` when it is older than `max_age`."""


class ForceSensor(Stream, Protocol):
    """Force-torque sensor."""

    def latest(self) -> WrenchSample:
        """The newest sample; `StaleReading` when it is older than `max_age`."""

    def zero(self, samples: int) -> Vector6:
        """Average the next `samples` raw readings as the new zero, and return it."""


class ArmState(Stream, Protocol):
    """State of the robot arm as it streams it."""

    def latest(self) -> ArmSample:
        """The newest sample; `StaleReading` when it is older than `max_age`."""


class MotionCapture(Stream, Protocol):
    """The tip as motion capture sees it."""

    def latest(self) -> BodySample:
        """The newest sample; `StaleReading` when it is older than `max_age`."""
