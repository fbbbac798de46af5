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

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

from pydantic import Field

from timing import Clock

from ..errors import DeviceFault, WrongDevice
from ..interfaces import Identity, SpineSample
from ..kept_settings import KeptSettings, Setting
from ..length_unit import DrumConfig, DrumLengthUnit
from ..registry import Driver
from .bus import AxisParameter, ModuleParameter, MotorAxis, SearchMode

MODULE = 1260
RESTARTED = "the module has restarted (power failure?) and lost its position; check its supply"
STALLED, DEVIATED = 1, 2
"""Bits of ERROR_FLAGS; some firmware clears them when they are read, hence the latch here."""
STOPS_WITHIN = 1.0
"""s that the motor may take from its maximum speed to a standstill."""
CONFIRM_EVERY = 10
"""Readings between two looks whether another host has set the deviation stop."""
DRIVER_ERRORS = {1: "overheated", 3: "short to ground, coil A", 4: "short to ground, coil B"}
"""Bits of DRIVER_STATUS that mean damage; the others are warnings or states."""


class Config(DrumConfig):
    """Length unit by Trinamic module."""

    baud: Literal[9600, 19200, 38400, 57600, 115200] = Field(115200, json_schema_extra={"unit": "Bd"})
    address: int = Field(default=1, ge=1, le=255, json_schema_extra={"unit": ""})
    host: int = Field(default=2, ge=1, le=255, json_schema_extra={"unit": ""})
    motor: int = Field(default=0, ge=0, le=5, json_schema_extra={"unit": ""})
    microsteps_per_turn: int = Field(default=51200, ge=200, le=10_000_000, json_schema_extra={"unit": ""})
    max_deviation: float = Field(default=0.003, gt=0, le=0.05, json_schema_extra={"unit": "m"})
    """Difference of steps and encoder at which the module stops."""
    settle_time: float = Field(default=0.5, gt=0, le=10, json_schema_extra={"unit": "s"})
    """A motor at rest this long away from its goal has stopped short of it."""
    heartbeat: float = Field(default=2.0, ge=0, le=60, json_schema_extra={"unit": "s"})
    """The module stops after this long a silence of the host; 0: its own setting."""
    timeout: float = Field(default=0.15, gt=0, le=2, json_schema_extra={"unit": "s"})


@dataclass(frozen=True)
class _AxisState:
    """One reading of the module: time (s), encoder (microsteps), speed (microsteps/s)."""

    t: float
    encoder: int
    speed: int


class TmclSpine(DrumLengthUnit):
    """Length unit by Trinamic module; see the module's text."""

    stranger = f"no TMCM-{MODULE}"
    _config: Config
    _homed = False

    def __init__(self, name: str, config: Config, clock: Clock) -> None:
        self._axis = MotorAxis(name, config.port, config.baud, config.address, config.host, config.motor, config.timeout)
        super().__init__(name, config, clock, self._axis)
        self._homing_until: float | None = None
        self._standing_since: float | None = None
        self._readings = 0

    def confirm_settings(self) -> None:
        """Ask for the settings once more. Raises `WrongDevice` when another host has changed one."""
        with self._lock:
            self._settings().confirm()

    def home(self) -> None:
        """Start the search for the switch at the retracted end; un-jam the spine before. `read` follows it."""
        with self._lock:
            self._homed = False
            self._fault = ""
            self._axis.put(AxisParameter.MAX_DEVIATION, 0)
            self._axis.stop()
            far = self._config.direction * self._microsteps(2 * self._config.homing_reach)
            self._axis.put(AxisParameter.ACTUAL_POSITION, far)  # a search that ends without the switch cannot end near 0
            self._axis.put(AxisParameter.ENCODER, far)
            self._prepare()
            self._goal = 0.0
            self._standing_since = None
            left_switch = self._config.direction > 0
            self._axis.put(AxisParameter.SEARCH_MODE, SearchMode.LEFT_SWITCH if left_switch else SearchMode.RIGHT_SWITCH)
            self._axis.put(AxisParameter.SEARCH_SPEED, self._microsteps(self._config.homing_speed))
            self._axis.put(AxisParameter.SWITCH_SPEED, self._microsteps(0.25 * self._config.homing_speed))
            self._axis.start_search()
            self._homing_until = self._clock.now() + self._config.homing_reach / self._config.homing_speed

    def _answer_fault(self) -> None:
        if self._fault:
            self._follow_encoder()
            self._fault = ""
        self._poll(confirm=True)
        self._raise_fault()

    def _start(self, length: float, speed: float) -> float:
        goal = self._config.direction * self._microsteps(length)
        self._set_goal(goal, max(1, self._microsteps(speed)))
        self._standing_since = None
        return self._length(goal)

    def _release(self) -> None:
        """The motor holds with its standby current."""

    def _forget_position(self) -> None:
        self._homed = False

    def stop(self) -> None:
        """Stop and hold; answers a deviation stop, and ends a reference run without result."""
        with self._lock:
            if self._homing_until is not None:
                self._homing_until = None
                self._axis.stop_search()
            self._axis.stop()
            self._fault = ""
            restarted = self._homed and (self._axis.restarted() or self._forgotten(self._axis.get(AxisParameter.MAX_DEVIATION)))
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

    def _microsteps(self, length: float) -> int:
        """Of a length (m) or a speed (m/s)."""
        return round(length * self._per_metre)

    def _length(self, microsteps: int) -> float:
        return self._config.direction * microsteps / self._per_metre

    # -- talking to the module
    @property
    def _heartbeat(self) -> int | None:
        """ms; None: the module's own setting holds."""
        return round(1000 * self._config.heartbeat) if self._config.heartbeat else None

    def _settings(self) -> KeptSettings:
        """The settings on which the promises rest; the module keeps them without power, and its programs can change them."""
        axis = self._axis

        def of_module(name: str, number: ModuleParameter, needed: int, why: str) -> Setting:
            def write(value: int) -> None:
                axis.put_global(number, value)

            return Setting(f"{name} (global parameter {number})", lambda: axis.get_global(number), needed, why, write)

        def of_axis(
            name: str, number: AxisParameter, needed: int | Callable[[int], int], why: str, written: bool = True
        ) -> Setting:
            def write(value: int) -> None:
                axis.put(number, value)

            return Setting(f"{name} (axis parameter {number})", lambda: axis.get(number), needed, why, write if written else None)

        resolution = Setting(
            f"resolution (axis parameters {AxisParameter.FULLSTEPS} and {AxisParameter.MICROSTEPS})",
            lambda: axis.get(AxisParameter.FULLSTEPS) << axis.get(AxisParameter.MICROSTEPS),
            self._config.microsteps_per_turn,
            "lengths would be wrong, unless microsteps_per_turn in rig.yaml is",
        )
        switch = (
            ("left", AxisParameter.LEFT_SWITCH_OFF) if self._config.direction > 0 else ("right", AxisParameter.RIGHT_SWITCH_OFF)
        )
        at_least_one, fast_enough = partial(max, 1), partial(max, round(self._microsteps(self._config.max_speed) / STOPS_WITHIN))
        slow = f"a stop would take longer than {STOPS_WITHIN:g} s"
        program = of_module("program stored in the module", ModuleParameter.PROGRAM, 0, "it would move the motor")
        every = [
            resolution,
            replace(program, write=lambda _: axis.stop_program()),
            of_module("auto start", ModuleParameter.AUTO_START, 0, "a stored program would move the motor"),
            of_module("secondary address", ModuleParameter.SECONDARY_ADDRESS, 0,
                      "the module would obey commands meant for another one"),
            of_axis(f"{switch[0]} limit switch disable", switch[1], 0, "the motor would run past the switch"),
            of_axis("soft stop", AxisParameter.SOFT_STOP, 0, "the motor would run past the switch"),
            of_axis("freewheeling mode", AxisParameter.FREEWHEELING, 0, "the motor would not hold"),
            of_axis("step/direction mode", AxisParameter.STEP_DIRECTION, 0, "other signals would move the motor"),
            of_axis("unit mode", AxisParameter.UNITS, 1, "speeds would not be microsteps per second"),
            of_axis("maximum current", AxisParameter.MAX_CURRENT, at_least_one, "the motor would not turn", False),
            of_axis("standby current", AxisParameter.STANDBY_CURRENT, at_least_one, "the motor would not hold", False),
            of_axis("maximum acceleration", AxisParameter.ACCELERATION, fast_enough, slow, False),
            of_axis("maximum deceleration", AxisParameter.DECELERATION, fast_enough, slow, False),
        ]  # fmt: skip
        if self._heartbeat is not None:
            why = "the motor would not stop without the host"
            every.append(of_module("heartbeat", ModuleParameter.HEARTBEAT, self._heartbeat, why))
        return KeptSettings(axis.name, "module", "TMCL-IDE", every)

    def _meet(self) -> Identity:
        module, firmware = self._axis.version()
        if module != MODULE:
            raise WrongDevice(
                self.name,
                f"module {self._config.address} on {self._config.port} is a TMCM-{module}; this driver supports the "
                f"TMCM-{MODULE} only",
            )
        self._axis.stop()
        self._settings().apply()
        self._prepare()
        self._axis.stop()  # a stored program may have moved it until now
        self._follow_encoder()
        return Identity("Trinamic", f"TMCM-{module}", firmware=firmware)

    def _prepare(self) -> None:
        """What a restarted module has forgotten."""
        self._axis.put(AxisParameter.MAX_DEVIATION, self._microsteps(self._config.max_deviation))
        self._axis.set_tick()
        if self._heartbeat is not None:
            self._axis.put_global(ModuleParameter.HEARTBEAT, self._heartbeat)
        self._axis.get(AxisParameter.ERROR_FLAGS)  # clears what was flagged before

    def _follow_encoder(self) -> None:
        """Take the encoder's position for the steps' too, and hold there: steps made in vain are forgotten."""
        self._axis.stop()
        encoder = self._axis.get(AxisParameter.ENCODER)
        self._axis.put(AxisParameter.ACTUAL_POSITION, encoder)
        self._axis.put(AxisParameter.TARGET_POSITION, encoder)
        self._axis.get(AxisParameter.ERROR_FLAGS)  # what was flagged until now is answered
        self._goal = self._length(encoder)
        self._standing_since = None

    def _set_goal(self, goal: int, speed: int) -> None:
        """Speed, then goal, both read back."""
        self._axis.put(AxisParameter.MAX_SPEED, speed)
        self._axis.move_to(goal)
        echo = (self._axis.get(AxisParameter.MAX_SPEED), self._axis.get(AxisParameter.TARGET_POSITION))
        if echo != (speed, goal):
            raise DeviceFault(
                self.name,
                f"(speed, goal) was set to {(speed, goal)} microsteps, but the module holds {echo}; check its limits and "
                "that no other host writes to it",
            )

    # -- judging what was read
    def _poll(self, confirm: bool = False) -> _AxisState:
        """One reading; latches what the module reports as wrong. `confirm`: also when its deviation stop was changed."""
        encoder = self._axis.get(AxisParameter.ENCODER)
        speed = self._axis.get(AxisParameter.ACTUAL_SPEED)
        t = self._clock.now()
        flags = self._axis.get(AxisParameter.ERROR_FLAGS)
        status = self._axis.get(AxisParameter.DRIVER_STATUS)
        damage = [text for bit, text in DRIVER_ERRORS.items() if status >> bit & 1]
        needed = max_deviation = self._microsteps(self._config.max_deviation)
        restarted = self._axis.restarted()
        if confirm or self._axis.caught_up:  # which set the tick timer: `restarted` sees none before it
            max_deviation = self._axis.get(AxisParameter.MAX_DEVIATION)
            restarted = restarted or self._forgotten(max_deviation)
            self._axis.caught_up = False
        if restarted:
            self._lose_zero(RESTARTED)
        elif max_deviation != needed:
            self._fault = (
                f"its deviation stop was set to {max_deviation} microsteps by another host, it should be {needed}; disconnect "
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
        return _AxisState(t, encoder, speed)

    def _forgotten(self, max_deviation: int) -> bool:
        """Whether the deviation stop is off, as after a restart; asked again before it is believed."""
        return max_deviation == 0 and self._axis.get(AxisParameter.MAX_DEVIATION) == 0

    def _lose_zero(self, fault: str) -> None:
        self._homed = False
        self._homing_until = None
        self._fault = f"{fault}, then home()"

    def _continue_homing(self, state: _AxisState, until: float) -> None:
        """The module zeroes its steps at the switch; the encoder is zeroed here."""
        if not self._axis.searching():
            self._homing_until = None
            zeroed = self._axis.get(AxisParameter.ACTUAL_POSITION)
            if abs(zeroed) > self._microsteps(self._config.tolerance):
                self._axis.stop()
                self._fault = (
                    f"the search ended without reaching the switch: the host was silent for {self._config.heartbeat} s "
                    "(heartbeat), or another host stopped it; home() again"
                )
                return
            self._axis.put(AxisParameter.ENCODER, zeroed)
            self._homed = True
        elif state.t > until:
            self._homing_until = None
            self._axis.stop_search()
            self._axis.stop()
            self._fault = "found no switch at the retracted end; check the switch and `direction`, then home() again"

    def _watch_for_end(self, state: _AxisState, length: float, arrived: bool) -> None:
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


DRIVER = Driver("spine", Config, TmclSpine)
