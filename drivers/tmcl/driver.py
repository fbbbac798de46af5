"""Length unit driven by a Trinamic TMCM-1260 stepper module with encoder (TMCL).

    length = direction * encoder / microsteps_per_turn * metres_per_turn

The encoder must be scaled to microsteps in the module. `home` searches the limit switch at the retracted end. The module stops
when steps and encoder differ too much.

Faults, each latched until the call that answers it:
- deviation stop, and a motion that ended short of its goal: the zero is kept; answered by `move_to`, `stop`, `home`.
- restart of the module, driver errors: the zero is lost; answered by `home`.

Other modules number some parameters differently and are refused.
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass
from typing import Literal

from pydantic import Field

import timing
from timing import Clock

from ..configs import LengthUnitConfig
from ..errors import DeviceFault, InstrumentError, LimitExceeded, NotReady, WrongDevice
from ..interfaces import Identity, SpineSample
from ..serial_line import meeting
from ..spec import Driver
from . import settings
from .bus import Axis
from .parameters import Global, Parameter, SearchMode

MODULE = 1260
RESTARTED = "the module has restarted (power failure?) and lost its position; check its supply"
STALLED, DEVIATED = 1, 2
"""Bits of ERROR_FLAGS; some firmware clears them when they are read, hence the latch here."""
CONFIRM_EVERY = 10
"""Readings between two looks whether another host has set the deviation stop."""
DRIVER_ERRORS = {1: "overheated", 3: "short to ground, coil A", 4: "short to ground, coil B"}
"""Bits of DRIVER_STATUS that mean damage; the others are warnings or states."""


class Config(LengthUnitConfig):
    """Length unit by Trinamic module."""

    port: str
    baud: Literal[9600, 19200, 38400, 57600, 115200] = Field(115200, json_schema_extra={"unit": "Bd"})
    address: int = Field(default=1, ge=1, le=255, json_schema_extra={"unit": ""})
    host: int = Field(default=2, ge=1, le=255, json_schema_extra={"unit": ""})
    motor: int = Field(default=0, ge=0, le=5, json_schema_extra={"unit": ""})
    metres_per_turn: float = Field(gt=0, le=1, json_schema_extra={"unit": "m"})
    microsteps_per_turn: int = Field(default=51200, ge=200, le=10_000_000, json_schema_extra={"unit": ""})
    direction: Literal[1, -1] = 1
    """1 when the spine grows as the module counts up."""
    homing_speed: float = Field(default=0.02, gt=0, le=0.1, json_schema_extra={"unit": "m/s"})
    max_deviation: float = Field(default=0.003, gt=0, le=0.05, json_schema_extra={"unit": "m"})
    """Difference of steps and encoder at which the module stops."""
    tolerance: float = Field(default=0.0005, gt=0, le=0.01, json_schema_extra={"unit": "m"})
    """Distance from its goal at which a motion has ended."""
    settle_time: float = Field(default=0.5, gt=0, le=10, json_schema_extra={"unit": "s"})
    """A motor at rest this long away from its goal has stopped short of it."""
    heartbeat: float = Field(default=2.0, ge=0, le=60, json_schema_extra={"unit": "s"})
    """The module stops after this long a silence of the host; 0: its own setting."""
    timeout: float = Field(default=0.15, gt=0, le=2, json_schema_extra={"unit": "s"})


@dataclass(frozen=True)
class _State:
    """One reading of the module: time (s), encoder (microsteps), speed (microsteps/s)."""

    t: float
    encoder: int
    speed: int


class TmclSpine:
    """Length unit by Trinamic module; see the module's text. Calls may come from several threads."""

    def __init__(self, name: str, config: Config, clock: Clock) -> None:
        self.name = name
        self._config = config
        self._clock = clock
        self._axis = Axis(name, config.port, config.baud, config.address, config.host, config.motor, config.timeout)
        self._lock = timing.RLock()
        self._homed = False
        self._homing_until: float | None = None
        self._goal = 0.0
        self._standing_since: float | None = None
        self._readings = 0
        self._fault = ""

    def open(self) -> Identity:
        """Connect, check module and settings, switch deviation stop and heartbeat on; a motion left over is stopped.

        Raises `Unreachable` when nobody answers, `WrongDevice` for another module and for a setting that only a person may
        change.
        """
        with self._lock:
            if not self._axis.is_open:
                self._axis.open()
                self._homed = False  # while nobody listened the module may have lost its position
            with meeting(self.name, self._axis.close, f"no TMCM-{MODULE}"):
                return self._meet()

    def confirm_settings(self) -> None:
        """Ask for the settings once more. Raises `WrongDevice` when another host has changed one."""
        with self._lock:
            settings.confirm(self._axis, self._needs)

    def take_notices(self) -> list[str]:
        """See the module `interfaces`."""
        return self._axis.take_notices()

    def close(self) -> None:
        """Stop and disconnect; the motor holds with its standby current."""
        with self._lock:
            if self._axis.is_open:
                with contextlib.suppress(InstrumentError):
                    self.stop()
            self._axis.close()
            self._homed = False

    def home(self) -> None:
        """Start the search for the switch at the retracted end; un-jam the spine before. `read` follows it."""
        with self._lock:
            self._homed = False
            self._fault = ""
            self._axis.put(Parameter.MAX_DEVIATION, 0)
            self._axis.stop()
            far = self._config.direction * self._microsteps(2 * self._search_reach)
            self._axis.put(Parameter.ACTUAL_POSITION, far)  # a search that ends without the switch cannot end near 0
            self._axis.put(Parameter.ENCODER, far)
            self._prepare()
            self._goal = 0.0
            self._standing_since = None
            left = self._config.direction > 0
            self._axis.put(Parameter.SEARCH_MODE, SearchMode.LEFT_SWITCH if left else SearchMode.RIGHT_SWITCH)
            self._axis.put(Parameter.SEARCH_SPEED, self._microsteps(self._config.homing_speed))
            self._axis.put(Parameter.SWITCH_SPEED, self._microsteps(0.25 * self._config.homing_speed))
            self._axis.start_search()
            self._homing_until = self._clock.now() + self._search_reach / self._config.homing_speed

    def move_to(self, length: float, speed: float) -> float:
        """Start moving to `length` (m) at `speed` (m/s), both clipped; returns the goal that the module confirmed.

        Raises `NotReady` before `home` has found the zero and `LimitExceeded` for what is not a length or speed
        (nothing is sent then), `DeviceFault` while the module reports a fault.
        """
        with self._lock:
            if not self._axis.is_open:
                raise NotReady(self.name, "not open; call open() first")
            if not self._homed:
                raise NotReady(self.name, "length unknown; call home() and wait until read().homed")
            if not math.isfinite(length) or not (math.isfinite(speed) and speed > 0):
                raise LimitExceeded(
                    self.name,
                    f"length {length} m at {speed} m/s is not a valid motion; give a number and a speed above 0 m/s",
                )
            if self._fault:
                self._follow_encoder()
                self._fault = ""
            self._poll(confirm=True)
            self._raise_fault()
            goal = self._config.direction * self._microsteps(min(max(length, 0.0), self._config.max_length))
            self._set_goal(goal, max(1, self._microsteps(min(speed, self._config.max_speed))))
            self._goal = self._length(goal)
            self._standing_since = None
            return self._goal

    def stop(self) -> None:
        """Stop and hold; answers a deviation stop, and ends a reference run without result."""
        with self._lock:
            if self._homing_until is not None:
                self._homing_until = None
                self._axis.stop_search()
            self._axis.stop()
            self._fault = ""
            restarted = self._homed and (self._axis.restarted() or self._forgotten(self._axis.get(Parameter.MAX_DEVIATION)))
            self._prepare()
            self._follow_encoder()
            if restarted:
                self._lose_zero(RESTARTED)

    def read(self) -> SpineSample:
        """Poll. Until homed, `length` counts from where the module was switched on and says nothing about the spine."""
        with self._lock:
            self._readings += 1
            state = self._poll(self._readings % CONFIRM_EVERY == 0)
            if self._homing_until is not None and not self._fault:
                self._continue_homing(state, self._homing_until)
                state = self._poll()
            length = self._length(state.encoder)
            arrived = abs(length - self._goal) <= self._config.tolerance and state.speed == 0
            if self._homed:
                self._watch_for_end(state, length, arrived)
            self._raise_fault()
            speed = self._config.direction * state.speed / self._per_metre
            moving = self._homing_until is not None or (self._homed and not arrived)
            return SpineSample(state.t, length, speed, self._goal, moving, self._homed)

    # -- units
    @property
    def _per_metre(self) -> float:
        """Microsteps per metre of spine."""
        return self._config.microsteps_per_turn / self._config.metres_per_turn

    @property
    def _search_reach(self) -> float:
        """How far to retract in search of the switch, m: all there can be, and some slack."""
        return 1.2 * self._config.max_length + 0.02

    def _microsteps(self, length: float) -> int:
        """Of a length (m) or a speed (m/s)."""
        return round(length * self._per_metre)

    def _length(self, microsteps: int) -> float:
        return self._config.direction * microsteps / self._per_metre

    # -- talking to the module
    @property
    def _needs(self) -> settings.Needs:
        config = self._config
        return settings.Needs(
            self._microsteps(config.max_speed),
            config.microsteps_per_turn,
            config.direction > 0,
            round(1000 * config.heartbeat) if config.heartbeat else None,
        )

    def _meet(self) -> Identity:
        module, firmware = self._axis.version()
        if module != MODULE:
            raise WrongDevice(
                self.name,
                f"module {self._config.address} on {self._config.port} is a TMCM-{module}; this driver supports the "
                f"TMCM-{MODULE} only",
            )
        self._axis.stop()
        settings.apply(self._axis, self._needs)
        self._prepare()
        self._axis.stop()  # a stored program may have moved it until now
        self._follow_encoder()
        return Identity("Trinamic", f"TMCM-{module}", firmware=firmware)

    def _prepare(self) -> None:
        """What a restarted module has forgotten."""
        self._axis.put(Parameter.MAX_DEVIATION, self._microsteps(self._config.max_deviation))
        self._axis.set_tick()
        if self._needs.heartbeat is not None:
            self._axis.put_global(Global.HEARTBEAT, self._needs.heartbeat)
        self._axis.get(Parameter.ERROR_FLAGS)  # clears what was flagged before

    def _follow_encoder(self) -> None:
        """Take the encoder's position for the steps' too, and hold there: steps made in vain are forgotten."""
        self._axis.stop()
        encoder = self._axis.get(Parameter.ENCODER)
        self._axis.put(Parameter.ACTUAL_POSITION, encoder)
        self._axis.put(Parameter.TARGET_POSITION, encoder)
        self._axis.get(Parameter.ERROR_FLAGS)  # what was flagged until now is answered
        self._goal = self._length(encoder)
        self._standing_since = None

    def _set_goal(self, goal: int, speed: int) -> None:
        """Speed, then goal, both read back."""
        self._axis.put(Parameter.MAX_SPEED, speed)
        self._axis.move_to(goal)
        echo = (self._axis.get(Parameter.MAX_SPEED), self._axis.get(Parameter.TARGET_POSITION))
        if echo != (speed, goal):
            raise DeviceFault(
                self.name,
                f"(speed, goal) was set to {(speed, goal)} microsteps, but the module holds {echo}; check its limits and "
                "that no other host writes to it",
            )

    # -- judging what was read
    def _poll(self, confirm: bool = False) -> _State:
        """One reading; latches what the module reports as wrong. `confirm`: also when its deviation stop was changed."""
        encoder = self._axis.get(Parameter.ENCODER)
        speed = self._axis.get(Parameter.ACTUAL_SPEED)
        t = self._clock.now()
        flags = self._axis.get(Parameter.ERROR_FLAGS)
        status = self._axis.get(Parameter.DRIVER_STATUS)
        damage = [text for bit, text in DRIVER_ERRORS.items() if status >> bit & 1]
        deviation = found = self._microsteps(self._config.max_deviation)
        restarted = self._axis.restarted()
        if confirm or self._axis.caught_up:  # catching up sets the tick timer anew, which hides a restart before it
            found = self._axis.get(Parameter.MAX_DEVIATION)
            restarted = restarted or self._forgotten(found)
            self._axis.caught_up = False
        if restarted:
            self._lose_zero(RESTARTED)
        elif found != deviation:
            self._fault = (
                f"its deviation stop was set to {found} microsteps by another host, it should be {deviation}; disconnect "
                "that host, then call stop() to reset it"
            )
        elif damage:
            self._lose_zero(f"motor driver: {', '.join(damage)}; check motor and cable")
        elif flags & (STALLED | DEVIATED):
            # Without a zero it can only have been homing, also where the search was found ended a moment ago.
            homing, self._homing_until = not self._homed, None
            where = "while homing" if homing else f"at {self._length(encoder):.4f} m on the way to {self._goal:.4f} m"
            self._fault = (
                f"stopped itself {where}: the spine did not follow (limit {self._config.max_deviation} m). Un-jam it "
                f"or clear its way, then {'home()' if homing else 'move'} again"
            )
        return _State(t, encoder, speed)

    def _forgotten(self, max_deviation: int) -> bool:
        """Whether the deviation stop is off, as after a restart; asked again before it is believed."""
        return max_deviation == 0 and self._axis.get(Parameter.MAX_DEVIATION) == 0

    def _lose_zero(self, fault: str) -> None:
        self._homed = False
        self._homing_until = None
        self._fault = f"{fault}, then home()"

    def _continue_homing(self, state: _State, until: float) -> None:
        """The module zeroes its steps at the switch; the encoder is zeroed here."""
        if not self._axis.searching():
            self._homing_until = None
            zeroed = self._axis.get(Parameter.ACTUAL_POSITION)
            if abs(zeroed) > self._microsteps(self._config.tolerance):
                self._axis.stop()
                self._fault = (
                    f"the search ended without reaching the switch: the host was silent for {self._config.heartbeat} s "
                    "(heartbeat), or another host stopped it; home() again"
                )
                return
            self._axis.put(Parameter.ENCODER, zeroed)
            self._homed = True
        elif state.t > until:
            self._homing_until = None
            self._axis.stop_search()
            self._axis.stop()
            self._fault = "found no switch at the retracted end; check the switch and `direction`, then home() again"

    def _watch_for_end(self, state: _State, length: float, arrived: bool) -> None:
        """A motor that stands away from its goal, with no error flag, was stopped by the heartbeat or by a switch."""
        if arrived or state.speed != 0 or self._fault:
            self._standing_since = None
            return
        if self._standing_since is None:
            self._standing_since = state.t
        elif state.t - self._standing_since > self._config.settle_time:
            self._fault = (
                f"stopped at {length:.4f} m, short of {self._goal:.4f} m: the host was silent for "
                f"{self._config.heartbeat} s (heartbeat) or a limit switch is pressed. Call stop(), then move again"
            )

    def _raise_fault(self) -> None:
        if self._fault:
            raise DeviceFault(self.name, self._fault)


DRIVER = Driver("spine", Config, TmclSpine)
