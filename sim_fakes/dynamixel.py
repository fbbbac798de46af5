"""Fake Dynamixel X servo (Protocol 2.0) that winds the spine's cord on a drum.

Stricter than the device: registers are written whole, EEPROM is locked while torque is on, values are checked against their
ranges. Its firmware is old: a bus watchdog that trips forgets the homing offset and moves the shaft by it.

Faults by name in `faults.extra`:
- "stuck" (bool): the shaft does not turn and draws no current, as with a broken gear.
- "nak" (int): every write is refused with this error number.
- "wrong_id" (bool): answers carry the next id.
- "glitch" (int): this many readings of the position are a turn too low, as of old firmware at a turn's last count.
- "hardware_error" (int): these bits are set in register 70 at the next step, and torque drops.
- "restart" (bool): the supply fails for an instant: torque off, watchdog off, turns forgotten.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from functools import partial
from typing import Any, ClassVar

from timing import RigClock

from .drum import Drum, DrumFake
from .plant import Plant

HEADER = b"\xff\xff\xfd\x00"


class Instruction(IntEnum):
    """What a packet asks for; STATUS is the servo's answer."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REG_WRITE = 0x04
    ACTION = 0x05
    FACTORY_RESET = 0x06
    REBOOT = 0x08
    CLEAR = 0x10
    STATUS = 0x55
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83
    FAST_SYNC_READ = 0x8A
    BULK_READ = 0x92
    BULK_WRITE = 0x93


CLEAR_TURNS = b"\x01\x44\x58\x4c\x22"
"""Content of the only kind of CLEAR that this model knows."""
KEPT_BY_RESET: dict[bytes, tuple[int, ...]] = {b"\xff": (), b"\x01": (7,), b"\x02": (7, 8)}
"""Content of FACTORY_RESET: the registers that it leaves as they are."""
BROADCAST, LAST_ID = 254, 252
ANSWER_READS, ANSWER_ALL = 1, 2
"""Status return levels starting at which reads, and everything else, are answered; a ping always is."""
TABLE_END = 662
"""First address beyond the control table; what is undefined inside reads as 0."""


class Refusal(IntEnum):
    """Why an instruction was not done: the error of a status packet."""

    INSTRUCTION = 2
    CRC = 3
    RANGE = 4
    LENGTH = 5
    LIMIT = 6
    ACCESS = 7


ALERT = 0x80
COUNTS = 4096
RPM = 0.229


@dataclass(frozen=True)
class Motor:
    """The motor of an XM430-W350; its raw unit of current is 2.69 mA."""

    no_load_speed: float = 46.0  # rpm
    friction: float = 25.0  # raw current that turning alone takes
    stiffness: float = 0.9  # raw current per count of position error, at `p_gain`
    p_gain: int = 900  # position P gain from the factory
    stall_current: float = 2.3 / 2.69e-3  # raw current of the blocked motor at `full_pwm`
    full_pwm: int = 885  # the full supply voltage
    overload_current: float = 0.9 / 2.69e-3  # raw current
    overload_time: float = 1.0  # s of rig time at more than that
    lag: float = 0.02  # s by which the shaft follows its trajectory


MOTOR = Motor()

FAR_AWAY = 2_000_000
"""Counts by which the encoder jumps as a fault."""


@dataclass(frozen=True)
class Slot:
    """One entry of the control table with what may be written into it; `low > high` marks a read-only one."""

    size: int
    low: int = 1
    high: int = 0


MODEL, FIRMWARE, ID, MODE, SECONDARY_ID, PROTOCOL, HOMING_OFFSET = 0, 6, 7, 11, 12, 13, 20
PWM_LIMIT, CURRENT_LIMIT, HIGHEST, LOWEST, STARTUP, SHUTDOWN = 36, 38, 48, 52, 60, 63
TORQUE, LEVEL, REGISTERED, HARDWARE_ERROR, P_GAIN, WATCHDOG = 64, 68, 69, 70, 84, 98
GOAL_PWM, GOAL_CURRENT, GOAL_VELOCITY, ACCELERATION, PROFILE, GOAL = 100, 102, 104, 108, 112, 116
TICK, MOVING, MOVING_STATUS, CURRENT, VELOCITY, POSITION, TRAJECTORY = 120, 122, 123, 126, 128, 132, 140
"""Addresses in the control table: kept without power below `TORQUE`; `LEVEL` is the status return level."""
REGISTERS = {
    0: Slot(2), 2: Slot(4), 6: Slot(1), 7: Slot(1, 0, 252), 8: Slot(1, 0, 7),
    9: Slot(1, 0, 254), 10: Slot(1, 0, 13), 11: Slot(1, 0, 16),
    12: Slot(1, 0, 255), 13: Slot(1, 1, 2), 20: Slot(4, -1044479, 1044479), 24: Slot(4, 0, 1023),
    31: Slot(1, 0, 100), 32: Slot(2, 95, 160), 34: Slot(2, 95, 160), 36: Slot(2, 0, 885),
    38: Slot(2, 0, 1193), 44: Slot(4, 0, 1023), 48: Slot(4, 0, 4095), 52: Slot(4, 0, 4095),
    60: Slot(1, 0, 3), 63: Slot(1, 0, 255), 64: Slot(1, 0, 1), 65: Slot(1, 0, 1), 68: Slot(1, 0, 2),
    69: Slot(1), 70: Slot(1), 76: Slot(2, 0, 16383), 78: Slot(2, 0, 16383), 80: Slot(2, 0, 16383),
    82: Slot(2, 0, 16383), 84: Slot(2, 0, 16383), 88: Slot(2, 0, 16383), 90: Slot(2, 0, 16383),
    98: Slot(1, 0, 127), 100: Slot(2, -885, 885), 102: Slot(2, -1193, 1193),
    104: Slot(4, -1023, 1023), 108: Slot(4, 0, 32767), 112: Slot(4, 0, 32767),
    116: Slot(4, -1048575, 1048575), 120: Slot(2), 122: Slot(1), 123: Slot(1), 124: Slot(2),
    126: Slot(2), 128: Slot(4), 132: Slot(4), 136: Slot(4), 140: Slot(4), 144: Slot(2),
    146: Slot(1),
}  # fmt: skip
TRIPPED = 0xFF
"""Value of the bus watchdog once it has tripped."""
GOALS = (GOAL_PWM, GOAL_CURRENT, GOAL_VELOCITY, GOAL)
"""Read-only while the bus watchdog is tripped."""
MODES = (0, 1, 3, 4, 5, 16)


def crc16(data: bytes) -> int:
    """CRC-16 of Protocol 2.0: polynomial 0x8005, start 0, most significant bit first."""
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x8005 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


def stuffed(body: bytes) -> bytes:
    """Break up what looks like a header inside a packet."""
    return body.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")


def unstuffed(body: bytes) -> bytes:
    """Undo `stuffed`."""
    return body.replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")


class DrumMotor(Drum):
    """Servo, drum and end stops: what happens behind the control table."""

    def __init__(self, plant: Plant, direction: int, start_length: float, model: int) -> None:
        super().__init__(plant, direction * COUNTS, start_length)
        self._offset = 1234 - round(start_length * self._per_metre)
        self.table = bytearray(TABLE_END)
        self._trajectory = float(self.counts)
        self._overloaded_for = self._tick = 0.0
        self._defaults(model)

    @property
    def counts(self) -> int:
        """Present position: what the encoder counts, and the homing offset."""
        return self._offset + round(self.length * self._per_metre) + self.get(HOMING_OFFSET)

    def place(self, counts: int) -> None:
        """Back door: let the encoder count from somewhere else (standing still)."""
        self._offset += counts - self.counts
        self._hold()

    def get(self, address: int) -> int:
        """Signed value of a register."""
        size = REGISTERS[address].size
        return int.from_bytes(self.table[address : address + size], "little", signed=size > 1)

    def put(self, address: int, value: int) -> None:
        """Set a register, read-only or not."""
        size = REGISTERS[address].size
        self.table[address : address + size] = (value & (1 << 8 * size) - 1).to_bytes(size, "little")

    def wrote(self, address: int) -> None:
        """Consequences of a write into a register."""
        if address == TORQUE and self.get(TORQUE):
            self._trajectory = float(self.counts)
        if address == MODE:
            self.put(GOAL_CURRENT, self.get(CURRENT_LIMIT))
        if address == HOMING_OFFSET:
            self._hold()

    def fail(self, bits: int) -> None:
        """Set hardware error bits; those that the shutdown names drop the torque."""
        self.put(HARDWARE_ERROR, self.get(HARDWARE_ERROR) | bits)
        if bits & self.table[SHUTDOWN]:
            self.put(TORQUE, 0)

    def forget_turns(self) -> None:
        """The encoder knows the angle within a turn only."""
        self._offset -= self.counts // COUNTS * COUNTS
        self._hold()

    def reset(self, keep: tuple[int, ...]) -> None:
        """All registers as they come from the factory, but for those at `keep`; then a restart."""
        kept = {address: self.get(address) for address in keep}
        self._defaults(self.get(MODEL))
        for address, value in kept.items():
            self.put(address, value)
        self.restart()

    def restart(self) -> None:
        """Volatile registers back to their start values; the turns are forgotten."""
        for address in (TORQUE, REGISTERED, HARDWARE_ERROR, WATCHDOG, GOAL_VELOCITY, ACCELERATION, PROFILE):
            self.put(address, 0)
        self.put(TORQUE, self.table[STARTUP] & 1)
        self.put(LEVEL, 2)
        self.put(P_GAIN, MOTOR.p_gain)
        self.put(GOAL_PWM, self.get(PWM_LIMIT))
        self.put(GOAL_CURRENT, self.get(CURRENT_LIMIT))
        self._overloaded_for = 0.0
        self.forget_turns()

    def process(self, dt: float) -> None:
        """Advance by dt seconds of rig time; the bus watchdog counts host time."""
        self._check_watchdog()
        start = self.length
        # what the control table asks of the motion; nobody writes there between two steps
        self._goal, self._homing = self.get(GOAL), self.get(HOMING_OFFSET)
        self._profile = min(self.get(PROFILE) * RPM or MOTOR.no_load_speed, MOTOR.no_load_speed) / 60 * COUNTS
        full_power = MOTOR.stall_current * min(abs(self.get(GOAL_PWM)), self.get(PWM_LIMIT)) / MOTOR.full_pwm
        self._allowed = min(abs(self.get(GOAL_CURRENT)), self.get(CURRENT_LIMIT), full_power)
        self._gain = MOTOR.stiffness * self.get(P_GAIN) / MOTOR.p_gain
        super().process(dt)
        self.put(CURRENT, round(self._current))
        self._tick += 1000 * dt
        velocity = (self.length - start) * self._per_metre / dt if dt > 0 else 0.0
        self.put(TICK, int(self._tick) % 32768)
        self.put(MOVING, abs(velocity) > 10)
        self.put(MOVING_STATUS, (abs(self.get(GOAL) - self.counts) < 20) | (abs(self.get(GOAL) - self._trajectory) > 1) << 1)
        self.put(VELOCITY, round(velocity / COUNTS * 60 / RPM))
        self.put(POSITION, self.counts)
        self.put(TRAJECTORY, round(self._trajectory))

    def _step(self, dt: float) -> None:
        """Move the trajectory towards the goal, the shaft after it, and set the current that this takes."""
        if not self.table[TORQUE]:
            self._trajectory, self._current = float(self.counts), 0.0
            return
        reach = self._profile * dt
        self._trajectory += min(max(self._goal - self._trajectory, -reach), reach)
        error = self._trajectory - (self._offset + self.length * self._per_metre + self._homing)
        fastest = MOTOR.no_load_speed / 60 * COUNTS
        velocity = min(max(error / MOTOR.lag, -fastest), fastest)
        self._turn(velocity * dt)
        push = 0.0 if self.stuck or abs(error) < 2 else self._gain * error + (MOTOR.friction if error > 0 else -MOTOR.friction)
        self._current = min(max(push, -self._allowed), self._allowed)
        self._overloaded_for = self._overloaded_for + dt if abs(self._current) >= MOTOR.overload_current else 0.0
        if self._overloaded_for > MOTOR.overload_time:
            self.fail(1 << 5)  # overload

    def _check_watchdog(self) -> None:
        limit, silent = self.table[WATCHDOG], self.silence.now()
        if self.get(TORQUE) and 1 <= limit <= 127 and silent > 0.02 * limit:  # units of 20 ms
            self.table[WATCHDOG] = TRIPPED
            self._hold()
            self.put(GOAL, self.counts - self.get(HOMING_OFFSET))

    def _hold(self) -> None:
        self.put(POSITION, self.counts)
        self.put(GOAL, self.counts)
        self._trajectory = float(self.counts)

    def _defaults(self, model: int) -> None:
        factory = {MODEL: model, 6: 45, 7: 1, 8: 1, 9: 250, 11: 3, 12: 255, 13: 2, 24: 10, 31: 80, 32: 160, 34: 95,
                   36: MOTOR.full_pwm, 38: 1193, 44: 200, 48: 4095, 63: 52, 68: 2, 76: 1920, 78: 100, 84: MOTOR.p_gain,
                   100: MOTOR.full_pwm, 102: 1193, 144: 120, 146: 31}  # fmt: skip
        self.table[:] = bytes(TABLE_END)
        self._current = 0.0
        for address, value in factory.items():
            self.put(address, value)
        self._hold()


class DynamixelFake(DrumFake):
    """The servo's wire: Protocol 2.0 packets for its id, its secondary id and everybody; other ids meet silence."""

    own_faults: ClassVar[Mapping[str, tuple[str, Any]]] = {
        "wrong_id": ("wrong_id", True),
        "nak": ("nak", 7),
        "stuck": ("stuck", True),
    }
    checked: ClassVar[slice | None] = slice(0, -2)

    def __init__(
        self, plant: Plant, clock: RigClock, direction: int = 1, start_length: float = 0.03, model: int = 1020, seed: int = 0
    ) -> None:
        """Length in m; `direction` 1 when counts grow with the spine; model 1020 is an XM430-W350."""
        self.motor = DrumMotor(plant, direction, start_length, model)
        super().__init__("dynamixel", self.motor, clock, 57600, seed)
        self._registered: tuple[int, bytes] | None = None
        """Address and data of a write that waits for ACTION."""
        self._actions: dict[tuple[int, bytes], Callable[[], None]] = {
            (Instruction.ACTION, b""): self._act,
            (Instruction.REBOOT, b""): self.motor.restart,
            (Instruction.CLEAR, CLEAR_TURNS): self.motor.forget_turns,
            **{(Instruction.FACTORY_RESET, how): partial(self.motor.reset, kept) for how, kept in KEPT_BY_RESET.items()},
        }

    def process(self, dt: float) -> None:
        if bits := self._number("hardware_error"):
            del self.faults.extra["hardware_error"]
            self.motor.fail(bits)
        super().process(dt)

    def begin(self, fault: str) -> Callable[[], None] | None:
        """Its encoder jumps."""
        if fault != "over_range":
            return None
        self.motor.place(self.motor.counts + FAR_AWAY)
        return lambda: self.motor.place(self.motor.counts - FAR_AWAY)

    def feed(self) -> bool:
        """Take one packet; answer it where it is meant for this servo and sound."""
        start = self.buffer.find(HEADER)
        if start < 0:
            return False
        packet = self.buffer[start:]
        if len(packet) < 7:
            return False
        end = 7 + int.from_bytes(packet[5:7], "little")
        if len(packet) < end:
            return False
        packet, self.buffer = packet[:end], packet[end:]
        self.requests.append(packet)
        table = self.motor.table
        receiver, to_own_id = packet[4], packet[4] == table[ID]
        secondary = receiver == table[SECONDARY_ID] and receiver <= LAST_ID
        if table[PROTOCOL] != 2 or not (to_own_id or secondary or receiver == BROADCAST):
            return True
        if crc16(packet[:-2]) != int.from_bytes(packet[-2:], "little"):
            if to_own_id:
                self._status(Refusal.CRC)
            return True
        self.motor.silence.heard()
        body = unstuffed(packet[7:-2])
        if receiver == BROADCAST:
            self._answer_broadcast(body[0], body[1:])
        else:
            self._answer(body[0], body[1:], to_own_id)
        return True

    def _number(self, fault: str) -> int:
        value = self.faults.extra.get(fault)
        return value if isinstance(value, int) else 0

    def _answer(self, instruction: int, params: bytes, own: bool) -> None:
        """Do an instruction and answer it, if it came to the servo's `own` id; nothing is said to its secondary one."""
        level = self.motor.table[LEVEL] if own else -1
        if instruction == Instruction.PING and not params:
            if own:
                self._status(0, bytes(self.motor.table[0:2]) + bytes([self.motor.table[FIRMWARE]]))
        elif instruction == Instruction.READ and len(params) == 4:
            if level >= ANSWER_READS:
                self._send_registers(*struct.unpack("<HH", params))
        elif instruction == Instruction.WRITE and len(params) > 2:
            error = self._write(int.from_bytes(params[:2], "little"), params[2:])
            if level >= ANSWER_ALL:
                self._status(error)
        elif instruction == Instruction.REG_WRITE and len(params) > 2:
            write = int.from_bytes(params[:2], "little"), params[2:]
            error = self._number("nak") or self._refused(*write)
            self._registered = self._registered if error else write
            self.motor.put(REGISTERED, self._registered is not None)
            if level >= ANSWER_ALL:
                self._status(error)
        elif action := self._actions.get((instruction, params)):
            if level >= ANSWER_ALL:
                self._status(0)
            action()
        elif level >= ANSWER_ALL:
            self._status(Refusal.INSTRUCTION)

    def _answer_broadcast(self, instruction: int, params: bytes) -> None:
        """Only a ping and what asks for it by its id is answered."""
        me, reads = self.motor.table[ID], self.motor.table[LEVEL] >= ANSWER_READS
        if instruction == Instruction.PING and not params:
            self._answer(Instruction.PING, params, True)
        elif instruction in (Instruction.WRITE, Instruction.REG_WRITE, Instruction.ACTION, Instruction.REBOOT):
            self._answer(instruction, params, False)
        elif instruction == Instruction.FAST_SYNC_READ and len(params) > 4:
            address, size = struct.unpack("<HH", params[:4])
            if reads:
                self._send_fast(params[4:], address, size)
        elif instruction == Instruction.SYNC_READ and len(params) > 4:
            if reads and me in params[4:]:
                self._send_registers(*struct.unpack("<HH", params[:4]))
        elif instruction == Instruction.BULK_READ and params and len(params) % 5 == 0:
            for i in range(0, len(params), 5):
                if reads and params[i] == me:
                    self._send_registers(*struct.unpack("<HH", params[i + 1 : i + 5]))
        elif instruction == Instruction.SYNC_WRITE and len(params) > 4:
            address, size = struct.unpack("<HH", params[:4])
            for i in range(4, len(params) - size, size + 1):
                if params[i] == me:
                    self._write(address, params[i + 1 : i + 1 + size])
        elif instruction == Instruction.BULK_WRITE:
            i = 0
            while i + 5 <= len(params):
                address, size = struct.unpack("<HH", params[i + 1 : i + 5])
                if params[i] == me and i + 5 + size <= len(params):
                    self._write(address, params[i + 5 : i + 5 + size])
                i += 5 + size

    def _send_registers(self, address: int, size: int) -> None:
        """Send what stands there, undefined addresses as 0."""
        if size < 1 or address + size > TABLE_END:
            self._status(Refusal.ACCESS)
        else:
            self._status(0, self._content(address, size))

    def _content(self, address: int, size: int) -> bytes:
        if address <= POSITION < address + size and (glitch := self._number("glitch")):
            self.faults.extra["glitch"] = glitch - 1
            self.motor.put(POSITION, self.motor.counts - COUNTS)  # until the next step
        return bytes(self.motor.table[address : address + size])

    def _send_fast(self, servos: bytes, address: int, size: int) -> None:
        """The first of the servos opens the one packet in which all would answer, without stuffing."""
        if servos[0] != self.motor.table[ID] or size < 1 or address + size > TABLE_END:
            return
        length = len(servos) * (size + 4) + 1
        alert = ALERT if self.motor.get(HARDWARE_ERROR) else 0
        head = struct.pack("<BHBBB", BROADCAST, length, Instruction.STATUS, alert, servos[0])
        packet = HEADER + head + self._content(address, size)
        self.send(packet + struct.pack("<H", crc16(packet)))

    def _act(self) -> None:
        """Do what was registered."""
        write, self._registered = self._registered, None
        self.motor.put(REGISTERED, 0)
        if write is not None:
            self._write(*write)

    def _registers(self, address: int, size: int) -> list[int]:
        """Addresses of the whole registers that fill this range exactly; empty when something in it is undefined."""
        registers, at = [], address
        while at < address + size:
            if at not in REGISTERS:
                return []
            registers.append(at)
            at += REGISTERS[at].size
        return registers if at == address + size else []

    def _write(self, address: int, data: bytes) -> int:
        """Check everything, then write; returns the error number."""
        if error := self._number("nak") or self._refused(address, data):
            return error
        self.motor.table[address : address + len(data)] = data
        for register in self._registers(address, len(data)):
            self.motor.wrote(register)
        return 0

    def _refused(self, address: int, data: bytes) -> int:
        """Why data may not be written there; 0 where it may."""
        registers = self._registers(address, len(data))
        if not registers:
            return Refusal.LENGTH if address in REGISTERS else Refusal.ACCESS
        for register in registers:
            kind = REGISTERS[register]
            raw = data[register - address : register - address + kind.size]
            if error := self._refusal(register, kind, int.from_bytes(raw, "little", signed=kind.low < 0)):
                return error
        return 0

    def _refusal(self, address: int, kind: Slot, value: int) -> int:
        """Why a value may not be written into a register; 0 where it may."""
        motor = self.motor
        # registers before the torque are EEPROM
        if kind.low > kind.high or (address < TORQUE and motor.get(TORQUE)):
            return Refusal.ACCESS
        if not kind.low <= value <= kind.high or (address == MODE and value not in MODES):
            return Refusal.RANGE
        if address in GOALS and motor.table[WATCHDOG] == TRIPPED:
            return Refusal.RANGE
        if address == GOAL_CURRENT and abs(value) > motor.get(CURRENT_LIMIT):
            return Refusal.LIMIT
        if address == GOAL and motor.get(MODE) == 3 and not motor.get(LOWEST) <= value <= motor.get(HIGHEST):
            return Refusal.LIMIT
        if address == TORQUE and value and motor.get(HARDWARE_ERROR):
            return Refusal.ACCESS
        return 0

    def _status(self, error: int, params: bytes = b"") -> None:
        motor = self.motor
        body = stuffed(bytes([Instruction.STATUS, error | (ALERT if motor.get(HARDWARE_ERROR) else 0)]) + params)
        sender = motor.table[ID] + bool(self.faults.extra.get("wrong_id"))
        packet = HEADER + bytes([sender]) + struct.pack("<H", len(body) + 2) + body
        self.send(packet + struct.pack("<H", crc16(packet)))
