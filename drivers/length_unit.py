"""What the length units have in common: a motor that winds the spine's cord on a drum, counted from a reference run.

A fault is latched until the call that answers it; each driver's text lists which call that is.
"""

from __future__ import annotations

import contextlib
import math
from abc import ABC, abstractmethod
from typing import ClassVar, Literal

from pydantic import Field

import timing
from timing import Clock

from .configs import LengthUnitConfig
from .errors import DeviceFault, InstrumentError, LimitExceeded, NotReady
from .interfaces import Identity
from .serial_line import SerialPort, meeting


class DrumConfig(LengthUnitConfig):
    """Length unit with a drum on a serial line."""

    port: str
    metres_per_turn: float = Field(gt=0, le=1, json_schema_extra={"unit": "m"})
    """Spine length per turn of the drum."""
    direction: Literal[1, -1] = 1
    """1 when the spine grows as the motor counts up."""
    homing_speed: float = Field(default=0.02, gt=0, le=0.1, json_schema_extra={"unit": "m/s"})
    tolerance: float = Field(default=0.0005, gt=0, le=0.01, json_schema_extra={"unit": "m"})
    """Distance from its goal at which a motion has ended."""

    @property
    def homing_reach(self) -> float:
        """Farthest retraction in search of the reference, m: all there can be, and some slack."""
        return 1.2 * self.max_length + 0.02


class DrumLengthUnit(ABC):
    """The calls that do not depend on the motor's maker; see `LengthUnit`. They may come from several threads."""

    stranger: ClassVar[str]
    """What answers when it is not this unit, for messages."""

    def __init__(self, name: str, config: DrumConfig, clock: Clock, bus: SerialPort) -> None:
        self.name = name
        self._config = config
        self._clock = clock
        self._bus = bus
        self._lock = timing.RLock()
        self._goal = 0.0
        self._fault = ""

    def open(self) -> Identity:
        """Connect, check the motor and its settings; a motion left over from before is stopped.

        Raises `Unreachable` when nobody answers, `WrongDevice` for another device and for a setting that only a person may
        change, `LimitExceeded` for a limit of the motor below the one in rig.yaml.
        """
        with self._lock:
            if not self._bus.is_open:
                self._bus.open()
                self._forget_position()  # while nobody listened the motor may have lost it
            with meeting(self.name, self._bus.close, self.stranger):
                return self._meet()

    def close(self) -> None:
        """Stop and disconnect; the motor holds."""
        with self._lock:
            if self._bus.is_open:
                with contextlib.suppress(InstrumentError):
                    self.stop()
                self._release()
            self._bus.close()
            self._forget_position()

    def move_to(self, length: float, speed: float) -> float:
        """Start moving to `length` (m) at `speed` (m/s), both clipped; returns the goal that the motor confirmed.

        Raises `NotReady` before `home` has found the zero and `LimitExceeded` for what is not a length or speed
        (nothing is sent then), `DeviceFault` while the motor reports a fault.
        """
        with self._lock:
            if not self._bus.is_open:
                raise NotReady(self.name, "not open; call open() first")
            if not self._homed:
                raise NotReady(self.name, "length unknown; call home() and wait until read().homed")
            if not math.isfinite(length) or not (math.isfinite(speed) and speed > 0):
                raise LimitExceeded(
                    self.name, f"length {length} m at {speed} m/s is not a valid motion; give a number and a speed above 0 m/s"
                )
            self._answer_fault()
            self._goal = self._start(min(max(length, 0.0), self._config.max_length), min(speed, self._config.max_speed))
            return self._goal

    def take_notices(self) -> list[str]:
        """See the module `interfaces`."""
        return self._bus.take_notices()

    @abstractmethod
    def stop(self) -> None:
        """Hold the present position; answers a latched fault, and ends a reference run without result."""

    @property
    @abstractmethod
    def _homed(self) -> bool:
        """Whether the zero is known."""

    @abstractmethod
    def _forget_position(self) -> None:
        """The zero is no longer known."""

    @abstractmethod
    def _meet(self) -> Identity:
        """Check who answers and bring its settings into the state on which the driver relies."""

    @abstractmethod
    def _release(self) -> None:
        """Last requests before the line is closed."""

    @abstractmethod
    def _answer_fault(self) -> None:
        """Clear what a motion answers; raises `DeviceFault` for what the motor still reports."""

    @abstractmethod
    def _start(self, length: float, speed: float) -> float:
        """Start a motion (m, m/s) within the limits; returns the goal confirmed, m."""

    def _raise_fault(self) -> None:
        if self._fault:
            raise DeviceFault(self.name, self._fault)
