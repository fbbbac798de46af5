"""One motor of a Trinamic module as parameters that are read and written, in the frames of pytrinamic.

A TMCL frame is nine bytes with no mark at its start: the first nine that carry the host's address and add up are the
answer. What comes before it is thrown away: noise of an RS-485 line that is turned round, and the echo of an adapter. All
commands used here are absolute and may be repeated.

An answer names its command but not its parameter, and a late one may still arrive. A module answers in order,
so after a failure the line is caught up first: the module's tick timer is set to a new value and asked for, and what
comes before an answer near that value is thrown away. The timer counts milliseconds and starts from 0 without power.
"""

from __future__ import annotations

import math
import random
from enum import IntEnum

import serial
from pytrinamic.helpers import to_signed_32
from pytrinamic.tmcl import TMCLCommand, TMCLReply, TMCLRequest, TMCLStatus

import timing

from ..errors import BadReply, InstrumentError, NoReply, Refused
from ..serial_line import SerialPort


class AxisParameter(IntEnum):
    """Parameters of the motor."""

    TARGET_POSITION = 0
    ACTUAL_POSITION = 1
    ACTUAL_SPEED = 3
    MAX_SPEED = 4
    ACCELERATION = 5
    MAX_CURRENT = 6
    STANDBY_CURRENT = 7
    RIGHT_SWITCH_OFF = 12
    LEFT_SWITCH_OFF = 13
    DECELERATION = 17
    SOFT_STOP = 26
    MICROSTEPS = 140
    SEARCH_MODE = 193
    SEARCH_SPEED = 194
    SWITCH_SPEED = 195
    FULLSTEPS = 202
    FREEWHEELING = 204
    ERROR_FLAGS = 207
    DRIVER_STATUS = 208
    ENCODER = 209
    MAX_DEVIATION = 212
    STEP_DIRECTION = 254
    UNITS = 255


class ModuleParameter(IntEnum):
    """Parameters of the module."""

    HEARTBEAT = 68
    """ms of silence on the serial line after which the motor stops; 0 = never."""
    HOST_ADDRESS = 76
    AUTO_START = 77
    SECONDARY_ADDRESS = 87
    PROGRAM = 128
    TICK_TIMER = 132
    """ms since the module started, or since it was set."""


class SearchMode(IntEnum):
    """Which limit switch a reference search looks for."""

    LEFT_SWITCH = 1
    RIGHT_SWITCH = 65


ATTEMPTS = 2
FRAME_BYTES = 9
DONE = 100
"""Least status of a command that was done."""
FIRST_TICK, LAST_TICK = 1_000_000, 2**30
"""The timer is set to something between: a module just started shows less for a quarter of an hour."""
NEAR = 60_000
"""ms by which the timer may have gone on when it is read."""
CATCH_UP_WAITS = 2.0
"""How many time-outs the answers may take that are owed."""


class MotorAxis(SerialPort):
    """Motor `motor` of module `address`."""

    longest_read = math.inf  # one read waits for the whole frame

    def __init__(self, name: str, port: str, baud: int, address: int, host: int, motor: int, timeout: float) -> None:
        """`timeout` (s, host time) bounds each answer; an exchange is tried twice."""
        super().__init__(name, port, baud, timeout)
        self._address, self._host, self._motor = address, host, motor
        self._behind = False
        """Whether answers to earlier questions may still come."""
        self._other_host: int | None = None
        """To whom the module's last answer was addressed, where that was not this host."""
        self.caught_up = False
        """The line was caught up since the driver cleared this, so that `restarted` may have missed a restart."""
        self._tick = 0
        """What the tick timer was set to last."""

    def version(self) -> tuple[int, str]:
        """Number of the module and version of its firmware."""
        value = self._send(TMCLCommand.GET_FIRMWARE_VERSION, 1, 0)  # type 1 answers with numbers instead of text
        return value >> 16 & 0xFFFF, f"{value >> 8 & 0xFF}.{value & 0xFF:02d}"

    def get(self, parameter: int) -> int:
        """Axis parameter, signed."""
        return self._send(TMCLCommand.GAP, parameter, 0)

    def put(self, parameter: int, value: int) -> None:
        """Set an axis parameter."""
        self._send(TMCLCommand.SAP, parameter, value)

    def put_global(self, parameter: int, value: int) -> None:
        """Set a parameter of the module (bank 0)."""
        self._send(TMCLCommand.SGP, parameter, value, bank=0)

    def get_global(self, parameter: int) -> int:
        """Parameter of the module (bank 0)."""
        return self._send(TMCLCommand.GGP, parameter, 0, bank=0)

    def stop_program(self) -> None:
        """Stop the program that is stored in the module."""
        self._send(TMCLCommand.STOP_APPLICATION, 0, 0)

    def set_tick(self) -> None:
        """Give the tick timer a new value; from now on `restarted` knows."""
        self._tick = random.randrange(FIRST_TICK, LAST_TICK)
        self.put_global(ModuleParameter.TICK_TIMER, self._tick)

    def restarted(self) -> bool:
        """Whether the tick timer has gone back, which it does without power only; it is asked twice."""
        return all(self.get_global(ModuleParameter.TICK_TIMER) & 0xFFFFFFFF < self._tick for _ in range(ATTEMPTS))

    def move_to(self, position: int) -> None:
        """Start moving to a position, microsteps."""
        self._send(TMCLCommand.MVP, 0, position)

    def stop(self) -> None:
        """Decelerate now."""
        self._send(TMCLCommand.MST, 0, 0)

    def start_search(self) -> None:
        """Start the module's reference search."""
        self._send(TMCLCommand.RFS, 0, 0)

    def stop_search(self) -> None:
        """End the reference search."""
        self._send(TMCLCommand.RFS, 1, 0)

    def searching(self) -> bool:
        """Whether the reference search is under way."""
        return self._send(TMCLCommand.RFS, 2, 0) != 0

    def _send(self, command: int, kind: int, value: int, bank: int | None = None) -> int:
        """One request and its answer, again after silence or noise."""
        what = f"{TMCLCommand.get_name(command)} {kind}, {value}"
        where = f"module {self._address} on {self.port} at {self.baud} Bd"
        failure: InstrumentError = NoReply(
            self.name, f"no answer from {where} before {what}; check its power, address and baud rate"
        )
        request = TMCLRequest(self._address, command, kind, self._motor if bank is None else bank, value)
        with self._guarded() as line:
            for attempt in range(ATTEMPTS):
                if self._behind and not self._catch_up(line):
                    break
                line.write(request.to_buffer())
                self.quality.sent(FRAME_BYTES)
                reply, heard = self._reply(line, request)
                if reply is None and self._other_host is not None:
                    failure = Refused(
                        self.name,
                        f"{where} answers {what} to host {self._other_host}, not {self._host}: correct `host` in rig.yaml, or "
                        f"the module's host address (global parameter {ModuleParameter.HOST_ADDRESS})",
                    )
                elif reply is None and heard:
                    failure = BadReply(self.name, f"damaged answer from {where} to {what}; check cable and baud rate")
                elif reply is None:
                    remedy = timing.busy_or("check its power, address and baud rate")
                    failure = NoReply(self.name, f"no answer from {where} to {what}; {remedy}")
                elif reply.module_address != self._address or reply.command != command:
                    failure = BadReply(
                        self.name,
                        f"{where} was sent {what}, but module {reply.module_address} answered command {reply.command}; "
                        "check the addresses on the bus",
                    )
                elif reply.status < DONE:
                    refusal = f"{where} refuses {what}: status {reply.status}, {TMCLStatus.get_name(reply.status)}"
                    if reply.status != TMCLStatus.WRONG_CHECKSUM:
                        failure = Refused(self.name, refusal)
                        break
                    failure = BadReply(self.name, refusal)
                else:
                    self.quality.count(attempt > 0)
                    return int(to_signed_32(reply.value))
                self._behind = True
                timing.sleep(self.timeout)
                line.reset_input_buffer()
            raise failure

    def _reply(self, line: serial.Serial, request: TMCLRequest) -> tuple[TMCLReply | None, bool]:
        """The next answer, None on silence; and whether anything but the echo of the request came."""
        self._other_host = None
        heard, window, echo = False, b"", request.to_buffer()
        began, count = timing.now(), 0
        give_up = began + self.timeout
        while timing.now() <= give_up and (piece := line.read(FRAME_BYTES - len(window))):
            window += piece
            count += len(piece)
            if window == echo:
                self.quality.echoes, window = True, b""
            elif len(window) == FRAME_BYTES:
                heard = True
                reply = TMCLReply.from_buffer(window)
                if reply.reply_address == self._host and reply.is_checksum_correct():
                    self.quality.answered(began, count)
                    return reply, True
                if reply.is_checksum_correct() and (reply.module_address, reply.command) == (self._address, request.command):
                    self._other_host = reply.reply_address
                window = window[1:]
        return None, heard or bool(window)

    def _catch_up(self, line: serial.Serial) -> bool:
        """Throw away what comes late; True once the answer to the question asked last has come."""
        for _ in range(ATTEMPTS):
            tick = random.randrange(FIRST_TICK, LAST_TICK)
            line.reset_input_buffer()
            if self._await(line, TMCLRequest(self._address, TMCLCommand.SGP, ModuleParameter.TICK_TIMER, 0, tick), range(2**32)):
                self._tick = tick
                ask = TMCLRequest(self._address, TMCLCommand.GGP, ModuleParameter.TICK_TIMER, 0, 0)
                if self._await(line, ask, range(tick, tick + NEAR)):
                    self._behind, self.caught_up = False, True
                    return True
        return False

    def _await(self, line: serial.Serial, request: TMCLRequest, values: range) -> bool:
        """Send a request and read answers until one to its command has one of these values; False when they cease before."""
        line.write(request.to_buffer())
        give_up = timing.now() + CATCH_UP_WAITS * self.timeout
        while timing.now() < give_up:
            reply, _ = self._reply(line, request)
            if reply is None or (reply.module_address, reply.command) != (self._address, request.command):
                continue
            if reply.value in values:
                return True
        return False
