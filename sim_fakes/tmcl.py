"""Fake Trinamic TMCM-1260 (TMCL) with encoder, that winds the spine's cord on a drum; switch at the retracted end.

Stricter than the device: unknown parameters and read-only ones are refused, error flags are cleared by reading.

Faults by name in `faults.extra`:
- "stuck" (bool): the shaft does not turn, as with a broken coupling; the steps are counted all the same.
- "nak" (int): every command is refused with this status.
- "wrong_address" (bool): answers carry the next module's address.
- "wrong_command" (bool): answers carry another command's number.
- "driver" (int): bits shown in the motor driver's status.
- "restart" (bool): the supply fails for an instant: parameters and position forgotten.
- "no_switch" (bool): the limit switch never closes.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from enum import IntEnum
from typing import Any, ClassVar

import timing
from timing import RigClock

from .drum import Drum, DrumFake
from .plant import Plant

FRAME = struct.Struct(">BBBBi")


class TmclCommand(IntEnum):
    """Commands of TMCL."""

    ROR = 1
    ROL = 2
    MST = 3
    MVP = 4
    SAP = 5
    GAP = 6
    SGP = 9
    GGP = 10
    RFS = 13
    VERSION = 136
    STOP_PROGRAM = 128


class MoveType(IntEnum):
    """Types of MVP."""

    ABSOLUTE = 0
    RELATIVE = 1


class TmclStatus(IntEnum):
    """Status of an answer: done, or what of the command is wrong."""

    OK = 100
    CHECKSUM = 1
    COMMAND = 2
    TYPE = 3
    VALUE = 4


class AxisNumber(IntEnum):
    """Axis parameters."""

    TARGET = 0
    ACTUAL = 1
    TARGET_SPEED = 2
    SPEED = 3
    MAX_SPEED = 4
    ACCELERATION = 5
    MAX_CURRENT = 6
    STANDBY_CURRENT = 7
    REACHED = 8
    HOME_SWITCH = 9
    RIGHT_SWITCH = 10
    LEFT_SWITCH = 11
    RIGHT_OFF = 12
    LEFT_OFF = 13
    DECELERATION = 17
    SOFT_STOP = 26
    MEASURED_SPEED = 29
    RESOLUTION = 140
    RAMP_DIVISOR = 153
    PULSE_DIVISOR = 154
    FULLSTEPS = 202
    FREEWHEELING = 204
    STEP_DIRECTION = 254
    UNITS = 255
    SEARCH_MODE = 193
    SEARCH_SPEED = 194
    SWITCH_SPEED = 195
    ERRORS = 207
    DRIVER = 208
    ENCODER = 209
    MAX_DEVIATION = 212


class GlobalNumber(IntEnum):
    """Global parameters."""

    SERIAL_ADDRESS = 66
    HEARTBEAT = 68
    HOST_ADDRESS = 76
    TICK_TIMER = 132
    AUTO_START = 77
    SECONDARY_ADDRESS = 87
    PROGRAM = 128


FASTEST = 16_777_215
MICROSTEPS = 51200
"""Of a turn."""
GAP_TIME = 0.05
"""An incomplete frame is forgotten after this silence, s of host time."""
PARAMETERS: dict[int, tuple[int, int, int]] = {
    AxisNumber.MAX_SPEED: (0, FASTEST, 51200),
    AxisNumber.ACCELERATION: (0, FASTEST, 51200),
    AxisNumber.SEARCH_MODE: (1, 255, 1),
    AxisNumber.SEARCH_SPEED: (0, FASTEST, 1000),
    AxisNumber.SWITCH_SPEED: (0, FASTEST, 100),
    AxisNumber.MAX_DEVIATION: (0, 2**31 - 1, 0),
    AxisNumber.MAX_CURRENT: (0, 255, 128),
    AxisNumber.STANDBY_CURRENT: (0, 255, 8),
    AxisNumber.RIGHT_OFF: (0, 1, 0),
    AxisNumber.LEFT_OFF: (0, 1, 0),
    AxisNumber.DECELERATION: (0, FASTEST, 51200),
    AxisNumber.SOFT_STOP: (0, 1, 0),
    AxisNumber.RESOLUTION: (0, 8, 8),
    AxisNumber.RAMP_DIVISOR: (0, 13, 7),
    AxisNumber.PULSE_DIVISOR: (0, 13, 3),
    AxisNumber.FULLSTEPS: (1, 65535, 200),
    AxisNumber.FREEWHEELING: (0, 3, 0),
    AxisNumber.STEP_DIRECTION: (0, 5, 0),
    AxisNumber.UNITS: (0, 1, 1),
}
"""Lowest and highest value of each axis parameter, and the one with which it comes from the factory."""
START = {number: start for number, (_, _, start) in PARAMETERS.items()}


class StepperDrum(Drum):
    """Stepper, encoder, drum, switches; the one at the retracted end closes at 0 m of cord."""

    def __init__(self, plant: Plant, direction: int, start_length: float) -> None:
        super().__init__(plant, direction * MICROSTEPS, start_length)
        self.no_switch = False
        self.auto_start = False
        """Whether the stored program starts with the module; it turns the motor for ever."""
        self.program = False
        """Whether that program runs."""
        self.parameters = dict(START)
        self.errors = 0
        self.searching = False
        self.heartbeat = 0.0
        """s of host time; 0 = off."""
        self.ticks = 0.0
        """ms since the start, or since it was set."""
        self._direction = direction
        self._encoder_offset = -start_length * self._per_metre
        self.steps = 0.0
        self.target = 0.0
        self._moving = False
        self._rotation = 0.0
        """Speed of a motion without a target, microsteps/s."""
        self.speed = 0.0

    @property
    def encoder(self) -> int:
        """Position of the shaft, microsteps."""
        return round(self.length * self._per_metre + self._encoder_offset)

    def set_encoder(self, value: int) -> None:
        """Let the encoder count from `value`."""
        self._encoder_offset = value - self.length * self._per_metre

    @property
    def at_switch(self) -> bool:
        """Whether the switch at the retracted end is closed."""
        return self.length <= 0 and not self.no_switch

    @property
    def _stopped_by_switch(self) -> bool:
        """Whether it is closed and may stop the motor."""
        return self.at_switch and not self.parameters[AxisNumber.LEFT_OFF if self._direction > 0 else AxisNumber.RIGHT_OFF]

    def go(self, target: float) -> None:
        """Start moving to a position, microsteps."""
        self.target = target
        self._moving = True
        self._rotation = 0.0

    def rotate(self, speed: float) -> None:
        """Turn at a speed, microsteps/s, until something stops it."""
        self.searching = self._moving = False
        self._rotation = speed

    def run(self) -> None:
        """Start the stored program."""
        self.program = True
        self.rotate(self._direction * self.parameters[AxisNumber.MAX_SPEED])

    def halt(self) -> None:
        """Stop; also ends a search."""
        self._moving = self.searching = False
        self._rotation = self.speed = 0.0

    def restart(self) -> None:
        """Everything volatile back to its start value."""
        self.halt()
        self.program = False
        self.parameters = dict(START)
        self.errors = 0
        self.heartbeat = self.ticks = 0.0
        self.steps = self.target = 0.0
        self.set_encoder(0)
        if self.auto_start:
            self.run()

    def process(self, dt: float) -> None:
        """Advance by dt seconds of rig time; the heartbeat counts host time."""
        silent = self.silence.now()
        if self.heartbeat and silent > self.heartbeat:
            self.halt()
        self.ticks += 1000 * dt
        super().process(dt)

    def _step(self, dt: float) -> None:
        """Make the steps of dt seconds, turn the shaft by them, and stop at a switch or beyond the largest deviation."""
        steps_before = self.steps
        if self.searching:
            if self._home_reached():
                return
            self.steps -= self._direction * self.parameters[AxisNumber.SEARCH_SPEED] * dt
        elif self._moving:
            reach = self.parameters[AxisNumber.MAX_SPEED] * dt
            self.steps += min(max(self.target - self.steps, -reach), reach)
            self._moving = self.steps != self.target
        else:
            self.steps += self._rotation * dt
        moved = self.steps - steps_before
        if self._stopped_by_switch and moved * self._direction < 0:
            self.steps = steps_before
            moved = 0.0
            self.halt()
        self.speed = moved / dt
        if self.parameters[AxisNumber.MAX_CURRENT]:
            self._turn(moved)
        limit = self.parameters[AxisNumber.MAX_DEVIATION]
        if limit and abs(self.steps - self.encoder) > limit:
            self.errors |= 2
            self.halt()

    def _home_reached(self) -> bool:
        """At the switch that the search mode names, steps and encoder start from 0."""
        right = bool(self.parameters[AxisNumber.SEARCH_MODE] & 64)
        if not self._stopped_by_switch or right != (self._direction < 0):
            return False
        self.halt()
        self.steps = self.target = 0.0
        self.set_encoder(0)
        return True


class TmclFake(DrumFake):
    """The module's wire: nine-byte frames."""

    own_faults: ClassVar[Mapping[str, tuple[str, Any]]] = {
        "wrong_id": ("wrong_address", True),
        "nak": ("nak", 5),
        "stuck": ("stuck", True),
    }
    checked: ClassVar[slice | None] = slice(0, -1)

    def __init__(
        self,
        plant: Plant,
        clock: RigClock,
        direction: int = 1,
        start_length: float = 0.03,
        model: int = 1260,
        host: int = 2,
        seed: int = 0,
    ) -> None:
        """Length in m; `direction` 1 when the steps count up as the spine grows."""
        self.drum = StepperDrum(plant, direction, start_length)
        super().__init__("tmcl", self.drum, clock, 115200, seed)
        self.model, self.address, self.host = model, 1, host
        self.secondary_address = 0
        """Another address that it obeys; 0 for none."""
        self._heard = timing.now()

    def process(self, dt: float) -> None:
        self.drum.no_switch = bool(self.faults.extra.get("no_switch"))
        super().process(dt)

    def idle(self) -> float | None:
        if self.buffer and timing.now() - self._heard > GAP_TIME:
            self.buffer = b""
        return None

    def begin(self, fault: str) -> Callable[[], None] | None:
        """Its encoder jumps; the next reference run finds the switch again."""
        if fault != "over_range":
            return None
        self.drum.set_encoder(self.drum.encoder + 20_000_000)
        return lambda: None

    def feed(self) -> bool:
        """Take one frame of nine bytes; answer it where it is meant for this module."""
        self._heard = timing.now()
        if len(self.buffer) < 9:
            return False
        frame, self.buffer = self.buffer[:9], self.buffer[9:]
        self.requests.append(frame)
        address, command, kind, motor, value = FRAME.unpack(frame[:8])
        if address != self.address and (address != self.secondary_address or not address):
            return True
        self.drum.silence.heard()
        nak = self.faults.extra.get("nak")
        if isinstance(nak, int):
            status, result = nak, value
        elif sum(frame[:8]) & 0xFF != frame[8]:
            status, result = TmclStatus.CHECKSUM, value
        else:
            status, result = self._execute(command, kind, motor, value)
        self._reply(status, command, result)
        return True

    def _reply(self, status: int, command: int, value: int) -> None:
        sender = self.address + bool(self.faults.extra.get("wrong_address"))
        command += bool(self.faults.extra.get("wrong_command"))
        frame = FRAME.pack(self.host, sender, status, command, value)
        self.send(frame + bytes([sum(frame) & 0xFF]))

    def _execute(self, command: int, kind: int, motor: int, value: int) -> tuple[int, int]:
        """Status and value of the answer."""
        drum = self.drum
        if command == TmclCommand.VERSION and kind == 1:
            return TmclStatus.OK, self.model << 16 | 1 << 8 | 16
        if command in (TmclCommand.SGP, TmclCommand.GGP):
            return self._global(command, kind, motor, value)
        if motor != 0:
            return TmclStatus.VALUE, value
        if command == TmclCommand.MST:
            drum.halt()
        elif command == TmclCommand.MVP and kind == MoveType.ABSOLUTE:
            drum.go(value)
        elif command == TmclCommand.MVP and kind == MoveType.RELATIVE:
            drum.go(drum.target + value)
        elif command in (TmclCommand.ROR, TmclCommand.ROL):
            drum.rotate(value if command == TmclCommand.ROR else -value)
        elif command == TmclCommand.STOP_PROGRAM:
            drum.program = False
        elif command == TmclCommand.SAP:
            return self._set(kind, value)
        elif command == TmclCommand.GAP:
            return self._get(kind)
        elif command == TmclCommand.RFS and kind in (0, 1, 2):
            if kind == 2:
                return TmclStatus.OK, int(drum.searching)
            drum.halt()
            drum.searching = kind == 0
        else:
            known_command = command in (TmclCommand.MVP, TmclCommand.RFS, TmclCommand.VERSION)
            return TmclStatus.TYPE if known_command else TmclStatus.COMMAND, value
        return TmclStatus.OK, value

    def _global(self, command: int, kind: int, bank: int, value: int) -> tuple[int, int]:
        """Read or write a global parameter; status and value of the answer."""
        drum = self.drum
        values: dict[int, int] = {
            GlobalNumber.SERIAL_ADDRESS: self.address,
            GlobalNumber.HOST_ADDRESS: self.host,
            GlobalNumber.HEARTBEAT: round(1000 * drum.heartbeat),
            GlobalNumber.TICK_TIMER: int(drum.ticks) & 0x7FFFFFFF,
            GlobalNumber.AUTO_START: int(drum.auto_start),
            GlobalNumber.SECONDARY_ADDRESS: self.secondary_address,
            GlobalNumber.PROGRAM: int(drum.program),
        }
        if bank != 0 or kind not in values:
            return TmclStatus.TYPE, value
        if command == TmclCommand.GGP:
            return TmclStatus.OK, values[kind]
        if kind == GlobalNumber.TICK_TIMER:
            drum.ticks = float(value)
        elif kind == GlobalNumber.HEARTBEAT and 0 <= value <= 65535:
            drum.heartbeat = value / 1000
        elif kind == GlobalNumber.AUTO_START and value in (0, 1):
            drum.auto_start = bool(value)
        elif kind == GlobalNumber.SECONDARY_ADDRESS and 0 <= value <= 255:
            self.secondary_address = value
        else:
            return TmclStatus.VALUE, value
        return TmclStatus.OK, value

    def _set(self, kind: int, value: int) -> tuple[int, int]:
        """Write an axis parameter; status and value of the answer."""
        if kind == AxisNumber.TARGET:
            self.drum.go(value)
        elif kind == AxisNumber.ACTUAL:
            self.drum.steps = float(value)
        elif kind == AxisNumber.ENCODER:
            self.drum.set_encoder(value)
        elif kind not in PARAMETERS:
            return TmclStatus.TYPE, value
        elif not PARAMETERS[kind][0] <= value <= PARAMETERS[kind][1]:
            return TmclStatus.VALUE, value
        else:
            self.drum.parameters[kind] = value
        return TmclStatus.OK, value

    def _get(self, kind: int) -> tuple[int, int]:
        """Read an axis parameter; status and value of the answer."""
        drum = self.drum
        if kind == AxisNumber.ERRORS:
            flags, drum.errors = drum.errors, 0
            return TmclStatus.OK, flags
        driver = self.faults.extra.get("driver")
        values = {
            AxisNumber.TARGET: round(drum.target),
            AxisNumber.ACTUAL: round(drum.steps),
            AxisNumber.TARGET_SPEED: 0,
            AxisNumber.SPEED: round(drum.speed),
            AxisNumber.MEASURED_SPEED: round(drum.speed),
            AxisNumber.REACHED: int(drum.steps == drum.target),
            AxisNumber.HOME_SWITCH: 0,
            AxisNumber.RIGHT_SWITCH: 0,
            AxisNumber.LEFT_SWITCH: int(drum.at_switch),
            AxisNumber.DRIVER: (driver if isinstance(driver, int) else 0) | (drum.speed == 0) << 7,
            AxisNumber.ENCODER: drum.encoder,
            **drum.parameters,
        }
        return (TmclStatus.OK, values[kind]) if kind in values else (TmclStatus.TYPE, 0)
