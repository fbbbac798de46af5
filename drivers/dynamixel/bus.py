"""One Dynamixel servo (Protocol 2.0) as registers that are read and written, by dynamixel-sdk.

Every exchange is repeated a few times when the line was silent or noisy (register writes are absolute, so repeating one
is harmless); what remains is one of the drivers' errors.

An answer does not tell which question it belongs to, and one that was not in time may still come. A servo answers in
order, so after a failure the line is caught up first: a read of a length that nothing else has is asked for, and what
comes before its answer is thrown away.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Iterator
from typing import NamedTuple, TypeVar

import serial
from dynamixel_sdk import COMM_RX_CORRUPT, COMM_RX_TIMEOUT, COMM_SUCCESS, PortHandler, Protocol2PacketHandler

import timing

from ..errors import BadReply, NoReply, Refused
from ..serial_line import SerialPort

ATTEMPTS = 3
ALERT, DAMAGED = 0x80, 3
"""Bit of the error byte: the servo has a hardware error; and its value for an instruction that arrived damaged."""
MARKS = (6, 7, 9, 10, 11, 12)
"""Lengths (bytes) of a read from address 0 by which the line is caught up, used in turn; no other answer is so long."""
CATCH_UP_WAITS = 3.0
"""How many time-outs its answer may take: those that are owed come before it."""
ID, LENGTH, ERROR, PARAMETERS = 4, 5, 8, 9
"""Where they stand in a status packet."""
REFUSALS = {
    1: "it could not process the instruction",
    2: "undefined instruction",
    DAMAGED: "the instruction arrived damaged (CRC)",
    4: "value out of range",
    5: "wrong data length",
    6: "value beyond the limit set in the servo",
    7: "register not accessible (read-only, undefined, or locked while torque is on)",
}
T = TypeVar("T")
Exchange = tuple[T, int, int]
"""Value, communication result, error byte: how the SDK answers."""


class Register(NamedTuple):
    """An entry of the control table."""

    address: int
    size: int
    signed: bool = False


STATUS_RETURN_LEVEL = Register(68, 1)
ANSWER_ALL = 2
"""Its value at which the servo answers every instruction; at 1 it answers reads and pings, at 0 only pings."""


class _Port(PortHandler):  # type: ignore[misc]
    """The SDK's port on a line that is open, with a time-out of our own (s), monotonic time, and waits instead of spinning."""

    def __init__(self, line: serial.Serial, path: str, baud: int, timeout: float) -> None:
        super().__init__(path)
        self.ser, self.is_open = line, True
        self.timeout = timeout
        self.tx_time_per_byte = 10_000.0 / baud
        self.request, self.heard = b"", bytearray()
        """What was sent last, and what came since."""

    def writePort(self, packet: list[int]) -> int:  # noqa: N802 (the SDK's names)
        self.request, self.heard = bytes(packet), bytearray()
        return int(super().writePort(packet))

    def readPort(self, length: int) -> bytes:  # noqa: N802
        data: bytes = super().readPort(length)
        self.heard += data
        return data

    def setPacketTimeout(self, packet_length: int) -> None:  # noqa: N802
        self.setPacketTimeoutMillis(self.tx_time_per_byte * packet_length + 1000.0 * self.timeout)

    def getCurrentTime(self) -> float:  # noqa: N802
        return 1000.0 * timing.now()


class Servo(SerialPort):
    """The registers of one servo. `alert` is the hardware-error bit of the last answer."""

    longest_read = 0.005  # the SDK checks its own time-out in between

    def __init__(self, name: str, port: str, baud: int, servo_id: int, timeout: float) -> None:
        """`timeout` (s, host time) bounds each answer beyond its time on the line; an exchange is tried three times."""
        super().__init__(name, port, baud, timeout)
        self.id = servo_id
        self.alert = False
        self._odd = ""
        """What was odd about the last answer, where its checksum was right."""
        self._packets = Protocol2PacketHandler()
        self._marks = itertools.cycle(MARKS)
        self._behind = True
        """Whether answers to earlier questions may still come, those of an earlier program included."""

    def open(self) -> None:
        """Open the serial port. Raises `Unreachable`."""
        super().open()
        self._behind = True

    def ping(self) -> int:
        """The model number. Raises `NoReply` when nobody with this id answers.

        A servo whose status return level has it answer less than everything is set to answer everything.
        """
        with self._bus() as port:
            if self._behind and not self._catch_up(port):
                port.is_using = False
                _, result, _ = self._packets.ping(port, self.id)
                if result != COMM_SUCCESS:
                    raise self._no_reply("ping", result)
                self._answer_all(port)
            elif self.read(STATUS_RETURN_LEVEL) != ANSWER_ALL:
                self._answer_all(port)
        return self._exchange("ping", lambda port: self._packets.ping(port, self.id))

    def _answer_all(self, port: _Port) -> None:
        """Set the status return level, for which no answer can be expected."""
        self._packets.write1ByteTxOnly(port, self.id, STATUS_RETURN_LEVEL.address, ANSWER_ALL)
        self._behind = True

    def read(self, register: Register) -> int:
        """Value of a register, signed where it is defined so."""
        return int.from_bytes(self.read_block(register.address, register.size), "little", signed=register.signed)

    def read_block(self, address: int, size: int) -> bytes:
        """`size` bytes of neighbouring registers."""

        def call(port: _Port) -> Exchange[list[int]]:
            result = self._packets.readTx(port, self.id, address, size)
            if result != COMM_SUCCESS:
                return [], result, 0
            data, result, error = self._status(port)
            wrong = result == COMM_SUCCESS and not error & ~ALERT and len(data) != size
            self._odd = f"{len(data)} bytes" if wrong else ""
            return data, COMM_RX_CORRUPT if wrong else result, error

        return bytes(self._exchange(f"read of {size} bytes at {address}", call))

    def write(self, register: Register, value: int) -> None:
        """Write one register; a refusal raises `BadReply` with the servo's reason."""
        self.write_block(register.address, value.to_bytes(register.size, "little", signed=register.signed))

    def write_block(self, address: int, data: bytes) -> None:
        """Write neighbouring registers with one instruction."""
        self._exchange(
            f"write of {data.hex(' ')} at {address}",
            lambda port: (None, *self._packets.writeTxRx(port, self.id, address, len(data), list(data))),
        )

    def reboot(self) -> None:
        """Restart the servo: clears a latched hardware error; torque goes off and the turn count is lost."""
        self._exchange("reboot", lambda port: (None, *self._packets.reboot(port, self.id)), attempts=1)

    def _exchange(self, what: str, call: Callable[[_Port], Exchange[T]], attempts: int = ATTEMPTS) -> T:
        """Do one request and its answer, again after silence or noise."""
        with self._bus() as port:
            value, result, error, self._odd = None, COMM_RX_TIMEOUT, 0, ""
            for attempt in range(attempts):
                if self._behind and not self._catch_up(port):
                    break
                port.is_using = False  # the SDK leaves it set after an exception
                began = timing.now()
                try:
                    value, result, error = call(port)
                except IndexError:  # the SDK trips over an answer that is shorter than it should be
                    value, result, error, self._odd = None, COMM_RX_CORRUPT, 0, "too few bytes"
                if result == COMM_SUCCESS and error & ~ALERT != DAMAGED:  # what arrived damaged is worth repeating
                    self.quality.sent(len(port.request))
                    self.quality.answered(began, len(port.heard))
                    self.quality.count(attempt > 0)
                    self.quality.echoes |= port.heard.startswith(port.request)
                    break
                self._behind = True
                timing.sleep(self.timeout)
                port.clearPort()
        where = self._where
        if result == COMM_RX_CORRUPT and self._odd:  # its checksum was right
            raise Refused(
                self.name,
                f"{where} answers a {what} with {self._odd}; check that it is an X servo, and the only one with this id",
            )
        if result == COMM_RX_CORRUPT:
            raise BadReply(self.name, f"damaged answer from {where} to a {what}, {attempts} times; check cable and baud rate")
        if result != COMM_SUCCESS:
            raise self._no_reply(what, result)
        self.alert = bool(error & ALERT)
        if refusal := error & ~ALERT:
            raise Refused(self.name, f"{where} refuses a {what}: {REFUSALS.get(refusal, f'error {refusal}')}")
        return value  # type: ignore[return-value]

    @property
    def _where(self) -> str:
        return f"id {self.id} on {self.port} at {self.baud} Bd"

    def _no_reply(self, what: str, result: int) -> NoReply:
        return NoReply(
            self.name,
            f"no answer from {self._where} to a {what} ({self._packets.getTxRxResult(result)}); "
            + timing.busy_or("check the servo's power, id, baud rate and protocol (2.0, register 13)"),
        )

    def _catch_up(self, port: _Port) -> bool:
        """Throw away what comes late; True once the answer to the question asked last has come."""
        for _ in range(ATTEMPTS):
            size = next(self._marks)
            port.is_using = False
            if self._packets.readTx(port, self.id, 0, size) != COMM_SUCCESS:
                continue
            port.setPacketTimeoutMillis(port.tx_time_per_byte * (size + 11) + 1000.0 * CATCH_UP_WAITS * self.timeout)
            result = COMM_SUCCESS
            while result != COMM_RX_TIMEOUT and not port.isPacketTimeout():
                data, result, error = self._status(port)
                if result == COMM_SUCCESS and len(data) == size and not error & ~ALERT:
                    self._behind = False
                    return True
        return False

    def _status(self, port: _Port) -> Exchange[list[int]]:
        """The next status packet of this servo: its parameters, by the length that it gives."""
        while True:
            packet, result = self._packets.rxPacket(port, False)
            if result != COMM_SUCCESS:
                return [], result, 0
            if packet[ID] == self.id:
                count = packet[LENGTH] + 256 * packet[LENGTH + 1] - 4
                return packet[PARAMETERS : PARAMETERS + count], result, packet[ERROR]

    @contextlib.contextmanager
    def _bus(self) -> Iterator[_Port]:
        """The open port as the SDK wants it, under the lock, with failures of the line as the drivers' errors."""
        with self._guarded() as line:
            yield _Port(line, self.port, self.baud, self.timeout)
