"""Length unit: a Dynamixel X servo that winds the spine's cord on a drum, in current-based position mode.

    length = direction * (counts - zero) / 4096 * metres_per_turn

The servo counts turns only while it is powered. `home` retracts with little current until the end stop holds the motor. Un-jam
the spine first: jammed granules hold the motor, too.

Faults, each latched until the call that answers it:
- stall (the motor pushes and does not move): the driver holds; answered by `move_to`, `stop`, `home`.
- bus watchdog (the host was silent): the servo stopped; answered by `stop` or `home`.
- hardware error or restart of the servo: it holds or torque is off, the zero is lost; answered by `home`, which restarts it.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Literal

from pydantic import Field, model_validator

import timing
from timing import Clock

from ..errors import BadReply, DeviceFault, InstrumentError, LimitExceeded, NoReply, WrongDevice
from ..interfaces import Identity, SpineSample
from ..length_unit import DrumConfig, DrumLengthUnit
from ..registry import Driver
from . import table
from .bus import Servo


class StallWatch:
    """A motor is stalled when it pushed with nearly all it may while it stayed in place for `duration` seconds."""

    SHARE = 0.8
    """Share of the allowed current that counts as pushing with all it may."""
    READINGS = 3
    """Readings that must agree, so that one late reading is not taken for a long stall."""

    def __init__(self, allowed: float, window: float, duration: float) -> None:
        """`allowed` current and `window` (how far a standing motor may creep) in units of `update`; `duration` in s."""
        self._threshold = self.SHARE * allowed
        self._window = window
        self._duration = duration
        self._anchor = 0.0
        self._since = 0.0
        self._readings = 0

    def update(self, t: float, position: float, current: float) -> bool:
        """Take one reading at time t (s); True once the motor is stalled."""
        if abs(current) < self._threshold or self._readings == 0 or abs(position - self._anchor) > self._window:
            self._anchor, self._since = position, t
            self._readings = 1 if abs(current) >= self._threshold else 0
            return False
        self._readings += 1
        return self._readings >= self.READINGS and t - self._since >= self._duration


RESTARTED = "the servo has restarted (power failure?) and lost its position; check its supply, then home()"
REBOOT_TIME = 2.0
"""Longest wait for a restarted servo, s of host time."""


class Config(DrumConfig):
    """Length unit by Dynamixel."""

    baud: Literal[9600, 57600, 115200, 1000000, 2000000, 3000000, 4000000] = Field(
        default=57600, json_schema_extra={"unit": "Bd"}
    )
    id: int = Field(default=1, ge=0, le=252)
    current_limit: float = Field(default=1.0, gt=0, le=5, json_schema_extra={"unit": "A"})
    homing_current: float = Field(default=0.3, gt=0, le=5, json_schema_extra={"unit": "A"})
    homing_tolerance: float = Field(default=0.005, gt=0, le=0.1, json_schema_extra={"unit": "m"})
    """Largest change of the end stop's place."""
    stall_time: float = Field(default=0.5, gt=0, le=10, json_schema_extra={"unit": "s"})
    watchdog: float = Field(default=2.0, ge=0.1, le=2.54, json_schema_extra={"unit": "s"})
    """The servo stops after this long a silence of the host."""
    timeout: float = Field(default=0.1, gt=0, le=1, json_schema_extra={"unit": "s"})
    release_on_close: bool = False
    """Torque off at close; the spine can be moved by hand."""

    @model_validator(mode="after")
    def _homing_is_gentle(self) -> Config:
        if self.homing_current > self.current_limit:
            raise ValueError(f"homing_current {self.homing_current} A is above current_limit {self.current_limit} A; lower it")
        return self


@dataclass(frozen=True)
class _ServoState:
    """One reading of the servo: time (s), counts, counts/s, current (A)."""

    t: float
    counts: int
    velocity: float
    current: float


class DynamixelSpine(DrumLengthUnit):
    """Length unit by Dynamixel; see the module's text."""

    stranger = "no Dynamixel servo"
    _config: Config

    def __init__(self, name: str, config: Config, clock: Clock) -> None:
        self._servo = Servo(name, config.port, config.baud, config.id, config.timeout)
        super().__init__(name, config, clock, self._servo)
        self._ampere = 0.0
        self._zero: int | None = None
        self._end_stop: int | None = None
        """Where the last reference run met the stop, as long as the servo kept counting."""
        self._homing: int | None = None
        """Counts at which the reference run under way gives up."""
        self._place: tuple[float, int] | None = None
        """When the position was read last (s), and what it was (counts)."""
        self._stall = self._watch(config.current_limit)
        self._lost = False

    def confirm_settings(self) -> None:
        """Ask for the settings once more. Raises `WrongDevice` or `LimitExceeded` when another host has changed one."""
        with self._lock:
            self._check_current_limit()
            table.settings(self._servo).confirm()

    def _release(self) -> None:
        """The watchdog goes off, as holding is meant to last, and the torque if so configured."""
        with contextlib.suppress(InstrumentError):
            self._servo.write(table.WATCHDOG, 0)
        if self._config.release_on_close:
            with contextlib.suppress(InstrumentError):
                self._servo.write(table.TORQUE, 0)

    def home(self) -> None:
        """Start the reference run into the retracted end stop; un-jam the spine before. `read` carries it on.

        A servo with a hardware error is restarted first (up to 2 s). Raises `DeviceFault` when the error stays.
        """
        with self._lock:
            if self._lost or self._servo.read(table.HARDWARE_ERROR):
                self._restart()
            self._zero = None
            self._fault = ""
            self._arm_watchdog()
            start = self._position()
            self._set_goal(start, self._config.homing_speed)  # before torque: the old goal may be far away
            self._limit_current(self._config.homing_current)
            self._servo.write(table.TORQUE, 1)
            # beyond any end stop: the whole length and a fifth more, and one turn
            target = start - self._counts(1.2 * self._config.max_length) - self._config.direction * table.COUNTS_PER_TURN
            self._set_goal(target, self._config.homing_speed)
            self._homing = target
            self._goal = 0.0

    def _answer_fault(self) -> None:
        self._fault = ""
        self._check(self._poll())

    def _start(self, length: float, speed: float) -> float:
        goal = (self._zero or 0) + self._counts(length)
        self._limit_current(self._config.current_limit)
        self._set_goal(goal, speed)
        return self._length(goal)

    @property
    def _homed(self) -> bool:
        return self._zero is not None

    def _forget_position(self) -> None:
        self._zero = self._end_stop = self._homing = None

    def stop(self) -> None:
        """Hold the present position; answers a watchdog trip or a stall, and ends a reference run without result."""
        with self._lock:
            self._homing = None
            self._fault = ""
            restarted = self._homed and self._has_restarted()  # setting the watchdog would hide it
            try:
                self._hold()
            except BadReply:
                if self._servo.read(table.WATCHDOG) != table.WATCHDOG_TRIPPED:
                    raise
                self._hold()  # this host was held up, and the watchdog has bitten again
            if restarted:
                self._lose_zero(RESTARTED)

    def _hold(self) -> None:
        self._arm_watchdog()
        counts = self._position()
        self._set_goal(counts, self._config.max_speed)
        self._goal = self._length(counts)

    def read(self) -> SpineSample:
        """Poll. Until homed, `length` counts from where the servo was switched on and says nothing about the spine."""
        with self._lock:
            state = self._poll()
            self._check(state)
            if self._homing is not None:
                self._continue_homing(state, self._homing)
            length = self._length(state.counts)
            speed = self._config.direction * state.velocity / table.COUNTS_PER_TURN * self._config.metres_per_turn
            arrived = abs(length - self._goal) <= self._config.tolerance and abs(speed) <= self._speed_step
            moving = self._homing is not None or (self._homed and not arrived)
            return SpineSample(state.t, length, speed, self._goal, moving, self._homed)

    # -- units
    @property
    def _speed_step(self) -> float:
        """Spine speed of one unit of the velocity registers, m/s."""
        return table.RPM / 60 * self._config.metres_per_turn

    def _counts(self, length: float) -> int:
        return round(self._config.direction * length / self._config.metres_per_turn * table.COUNTS_PER_TURN)

    def _length(self, counts: int) -> float:
        turns = (counts - (self._zero or 0)) / table.COUNTS_PER_TURN
        return self._config.direction * turns * self._config.metres_per_turn

    def _watch(self, current: float) -> StallWatch:
        """Stalled: hardly any counts made while pushing with `current` (A)."""
        return StallWatch(current, abs(self._counts(self._config.tolerance)), self._config.stall_time)

    # -- talking to the servo
    def _meet(self) -> Identity:
        """Check who answers and bring its settings into the state this driver relies on."""
        model = self._servo.ping()
        if model not in table.MODELS:
            supported = ", ".join(name for name, _ in table.MODELS.values())
            raise WrongDevice(
                self.name,
                f"id {self._config.id} on {self._config.port} is Dynamixel model number {model}, which is not supported; "
                f"use one of {supported}, or correct the id in rig.yaml",
            )
        name, self._ampere = table.MODELS[model]
        firmware = self._servo.read(table.FIRMWARE)
        self._arm_watchdog()  # clears a trip, which locks some of the settings
        self._end_motion()  # before anything is refused
        table.settings(self._servo).apply()
        self._check_current_limit()
        return Identity("ROBOTIS", name, firmware=str(firmware))

    def _end_motion(self) -> None:
        """Hold, or release the torque in a mode in which the servo cannot hold."""
        if self._servo.read(table.TORQUE):
            if self._servo.read(table.OPERATING_MODE) == table.CURRENT_BASED_POSITION:
                self._set_goal(self._position(), self._config.max_speed)
            else:
                self._servo.write(table.TORQUE, 0)

    def _check_current_limit(self) -> None:
        allowed = self._servo.read(table.CURRENT_LIMIT) * self._ampere
        if self._config.current_limit > allowed:
            raise LimitExceeded(
                self.name,
                f"current_limit {self._config.current_limit} A is above the {allowed:.2f} A that the servo allows (current "
                "limit, register 38); lower it in rig.yaml",
            )

    def _arm_watchdog(self) -> None:
        """Clear a trip (0 does it) and set the time anew."""
        self._servo.write(table.WATCHDOG, 0)
        self._servo.write(table.WATCHDOG, self._watchdog_raw)

    @property
    def _watchdog_raw(self) -> int:
        return round(self._config.watchdog / table.WATCHDOG_UNIT)

    def _limit_current(self, current: float) -> None:
        """Allow this current (A) and watch for stalls against it."""
        self._servo.write(table.GOAL_CURRENT, round(current / self._ampere))
        self._stall = self._watch(current)

    def _set_goal(self, counts: int, speed: float) -> None:
        """Profile velocity and goal, read back. Velocity 0 would mean "as fast as can be", so one step is the least."""
        data = table.PROFILE_AND_GOAL.pack(max(1, round(speed / self._speed_step)), counts)
        self._servo.write_block(table.Address.PROFILE_AND_GOAL, data)
        echo = self._servo.read_block(table.Address.PROFILE_AND_GOAL, len(data))
        if echo != data:
            raise DeviceFault(
                self.name,
                f"(velocity, goal) was set to {table.PROFILE_AND_GOAL.unpack(data)} raw, but the servo holds "
                f"{table.PROFILE_AND_GOAL.unpack(echo)}; check that no other host writes to it",
            )

    def _position(self) -> int:
        """Where the motor stands, counts."""
        return self._placed(self._servo.read(table.PRESENT_POSITION))

    def _placed(self, counts: int) -> int:
        """A reading of the position; what no motion explains is read once more: old firmware may be a turn off, now and then."""
        now = self._clock.now()
        read_at, previous = self._place or (now, counts)
        fastest = 2 * max(self._config.max_speed, self._config.homing_speed)
        if abs(counts - previous) > table.COUNTS_PER_TURN / 2 + abs(self._counts(fastest)) * (now - read_at):
            counts = self._servo.read(table.PRESENT_POSITION)
        self._place = now, counts
        return counts

    def _relax(self) -> int:
        """Hold where the motor stands and return that, counts; its trajectory, which ran on, starts anew with the torque."""
        self._servo.write(table.TORQUE, 0)
        counts = self._position()
        self._set_goal(counts, self._config.max_speed)
        try:
            self._servo.write(table.TORQUE, 1)
        except BadReply:
            self._fault = ""
            self._poll()
            if self._fault:  # it has just failed, and says why
                raise DeviceFault(self.name, self._fault) from None
            raise
        return counts

    def _restart(self) -> None:
        """Reboot the servo and wait for it; raises `DeviceFault` when its hardware error stays."""
        with contextlib.suppress(NoReply):  # it may restart before its answer is out
            self._servo.reboot()
        deadline = timing.now() + REBOOT_TIME
        while True:
            try:
                self._servo.ping()
                break
            except (NoReply, BadReply):
                if timing.now() > deadline:
                    raise
        self._zero = self._end_stop = None
        if bits := self._servo.read(table.HARDWARE_ERROR):
            raise DeviceFault(
                self.name, f"hardware error persists after a restart: {table.hardware_errors(bits)}; check supply and motor"
            )
        table.settings(self._servo).apply()
        self._lost = False

    # -- judging what was read
    def _poll(self) -> _ServoState:
        """One reading; latches what the servo reports as wrong."""
        block = self._servo.read_block(table.Address.STATE, table.STATE.size)
        watchdog, *_, current, velocity, counts = table.STATE.unpack(block)
        alert = self._servo.alert
        if watchdog not in (self._watchdog_raw, table.WATCHDOG_TRIPPED):
            watchdog = self._servo.read(table.WATCHDOG)  # one odd answer is no proof of anything
        if alert and (bits := self._servo.read(table.HARDWARE_ERROR)):
            holds = self._servo.read(table.TORQUE) != 0
            if holds and not self._lost:  # its shutdown setting does not name this error
                self._hold()
            self._lose_zero(
                f"hardware error: {table.hardware_errors(bits)}; {'it was stopped and holds' if holds else 'torque is off'}. "
                "Remove the cause (un-jam the spine, check the supply), then home()"
            )
        elif watchdog == table.WATCHDOG_TRIPPED:
            self._fault = (
                f"stopped by its bus watchdog: the host was silent for {self._config.watchdog} s. "
                "Call stop() to acknowledge, then move again"
            )
        elif watchdog != self._watchdog_raw and self._has_restarted():
            self._lose_zero(RESTARTED)
        elif watchdog != self._watchdog_raw:
            self._fault = (
                f"its bus watchdog was set to {watchdog * table.WATCHDOG_UNIT:g} s by another host, it should be "
                f"{self._config.watchdog:g} s; disconnect that host, then call stop() to reset it"
            )
        counts = self._placed(counts)
        counts_per_second = velocity * table.RPM / 60 * table.COUNTS_PER_TURN
        return _ServoState(self._clock.now(), counts, counts_per_second, current * self._ampere)

    def _has_restarted(self) -> bool:
        """Whether the servo has lost its volatile registers; read twice before it is believed."""
        return all(
            self._servo.read(table.WATCHDOG) == 0
            and self._servo.read(table.TORQUE) == 0
            and not any(self._servo.read_block(table.Address.PROFILE_AND_GOAL, 4))
            for _ in range(2)
        )

    def _lose_zero(self, fault: str) -> None:
        self._forget_position()
        self._lost = True
        self._fault = fault

    def _check(self, state: _ServoState) -> None:
        """Raise the latched fault, or a stall that this reading shows; a reference run is meant to stall."""
        if not self._fault and self._homing is None and self._stall.update(state.t, state.counts, state.current):
            goal = self._goal
            here = self._goal = self._length(self._relax())
            self._fault = (
                f"stalled at {here:.4f} m on the way to {goal:.4f} m, current {abs(state.current):.2f} A of "
                f"{self._config.current_limit} A for {self._config.stall_time} s; un-jam the spine or clear its way, "
                "then move again"
            )
        self._raise_fault()

    def _continue_homing(self, state: _ServoState, target: int) -> None:
        """Zero the length where the end stop holds the motor."""
        if abs(state.counts - target) <= abs(self._counts(self._config.tolerance)):
            self._homing = None
            self._fault = (
                f"found no end stop within {self._config.homing_reach:.3f} m; check the cord, `direction` and "
                "`metres_per_turn`, then home() again"
            )
        elif self._stall.update(state.t, state.counts, state.current):
            self._homing = None
            self._relax()
            self._limit_current(self._config.current_limit)
            self._judge_end_stop(state.counts)
        self._raise_fault()

    def _judge_end_stop(self, counts: int) -> None:
        """Take the stop as zero, unless an earlier run found it elsewhere: jammed granules held one of the two."""
        known_stop = counts if self._end_stop is None else self._end_stop
        short = self._config.direction * (counts - known_stop) / table.COUNTS_PER_TURN * self._config.metres_per_turn
        if short > self._config.homing_tolerance:
            self._fault = (
                f"blocked {short:.3f} m before the end stop that was found earlier (tolerance "
                f"{self._config.homing_tolerance} m); un-jam the spine, then home() again"
            )
        elif short < -self._config.homing_tolerance:
            self._end_stop = None
            self._fault = (
                f"found the end stop {-short:.3f} m beyond where an earlier run found it: lengths since then are wrong "
                "by that much; discard them and home() again"
            )
        else:
            self._zero = self._end_stop = counts
            self._goal = 0.0


DRIVER = Driver("spine", Config, DynamixelSpine)
