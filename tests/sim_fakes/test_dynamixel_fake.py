"""The fake servo on its wire, without any driver: strictness, physics, faults."""

import struct

import dynamixel_sdk
import pytest
import serial

from drivers.dynamixel.bus import _Port as Port
from sim_fakes.dynamixel import DynamixelFake, crc16, stuffed, unstuffed
from tests.simulated.bench import Bench

RANGE, LENGTH, LIMIT, ACCESS, CRC, UNDEFINED = 4, 5, 6, 7, 3, 2
TORQUE, GOAL_CURRENT, GOAL, POSITION = 64, 102, 116, 132


class Wire:
    """A host that speaks Protocol 2.0 byte by byte."""

    def __init__(self, fake: DynamixelFake) -> None:
        self.fake = fake
        self.port = serial.serial_for_url(fake.port, 57600)

    def ask(
        self, instruction: int, params: bytes = b"", servo: int = 1, damage: bool = False, within: float = 20.0
    ) -> tuple[int, bytes] | None:
        """Error byte and parameters of the answer; None on silence."""
        self.port.timeout = within
        body = stuffed(bytes([instruction]) + params)
        packet = b"\xff\xff\xfd\x00" + bytes([servo]) + struct.pack("<H", len(body) + 2) + body
        packet += struct.pack("<H", crc16(packet) ^ damage)
        self.port.write(packet)
        head = self.port.read(7)
        if len(head) < 7:
            return None
        rest = self.port.read(struct.unpack("<H", head[5:7])[0])
        assert crc16(head + rest[:-2]) == struct.unpack("<H", rest[-2:])[0]
        answer = unstuffed(rest[:-2])
        assert answer[0] == 0x55
        return answer[1], answer[2:]

    def write(self, address: int, data: bytes) -> int:
        answer = self.ask(3, struct.pack("<H", address) + data)
        assert answer is not None
        return answer[0]

    def position(self) -> int:
        answer = self.ask(2, struct.pack("<HH", POSITION, 4))
        assert answer is not None
        return int(struct.unpack("<i", answer[1])[0])


@pytest.fixture
def wire(bench: Bench) -> Wire:
    wire = Wire(bench.started(DynamixelFake(bench.plant, bench.clock)))
    bench.closing(wire.port)
    return wire


@pytest.mark.parametrize(
    ("address", "data", "error"),
    [
        (POSITION, b"\0\0\0\0", ACCESS),
        (99, b"\0", ACCESS),
        (GOAL, b"\0\0", LENGTH),
        (TORQUE, b"\2", RANGE),
        (11, b"\2", RANGE),
        (GOAL, struct.pack("<i", 2_000_000), RANGE),
        (GOAL_CURRENT, struct.pack("<h", 1193), 0),
        (GOAL_CURRENT, struct.pack("<h", 1194), RANGE),
        (GOAL, struct.pack("<i", 5000), LIMIT),
        (38, struct.pack("<H", 1193), 0),
    ],
)
def test_writes_are_checked(wire: Wire, address: int, data: bytes, error: int) -> None:
    assert wire.write(address, data) == error


def test_goal_current_cannot_exceed_the_current_limit(wire: Wire) -> None:
    assert wire.write(38, struct.pack("<H", 500)) == 0
    assert wire.write(GOAL_CURRENT, struct.pack("<h", 501)) == LIMIT


def test_eeprom_is_locked_while_torque_is_on(wire: Wire) -> None:
    assert wire.write(11, b"\5") == 0
    assert wire.write(TORQUE, b"\1") == 0
    assert wire.write(11, b"\4") == ACCESS


def test_what_is_undefined_reads_as_zero_and_beyond_the_table_is_refused(wire: Wire) -> None:
    assert wire.ask(2, struct.pack("<HH", 64, 6)) == (0, b"\0\0\0\0\2\0")
    assert wire.ask(2, struct.pack("<HH", 140, 40)) is not None
    assert wire.ask(2, struct.pack("<HH", 660, 4)) == (ACCESS, b"")


def test_sync_and_bulk_instructions_reach_the_servo_among_others(wire: Wire) -> None:
    goal_current, led = struct.pack("<h", 321), b"\1"
    assert wire.ask(0x83, struct.pack("<HH", GOAL_CURRENT, 2) + b"\7\0\0\1" + goal_current, 254, within=0.1) is None
    assert wire.ask(0x82, struct.pack("<HH", GOAL_CURRENT, 2) + b"\1\7", 254) == (0, goal_current)
    block = b"\7" + struct.pack("<HH", GOAL, 4) + bytes(4) + b"\1" + struct.pack("<HH", 65, 1) + led
    assert wire.ask(0x93, block, 254, within=0.1) is None
    reads = b"\1" + struct.pack("<HH", 65, 1) + b"\7" + struct.pack("<HH", GOAL, 4)
    assert wire.ask(0x92, reads, 254) == (0, led)
    assert wire.ask(0x82, struct.pack("<HH", GOAL_CURRENT, 2) + b"\7", 254, within=0.1) is None


def test_the_makers_own_groups_read_and_write(wire: Wire) -> None:
    wire.port.timeout = 0.005
    port, packets = Port(wire.port, wire.fake.port, 57600, 1.0), dynamixel_sdk.PacketHandler(2.0)
    assert packets.broadcastPing(port)[0] == {1: [1020, 45]}
    write = dynamixel_sdk.GroupSyncWrite(port, packets, GOAL_CURRENT, 2)
    assert write.addParam(1, [100, 0]) and write.txPacket() == dynamixel_sdk.COMM_SUCCESS
    sync = dynamixel_sdk.GroupSyncRead(port, packets, POSITION, 4)
    bulk = dynamixel_sdk.GroupBulkRead(port, packets)
    assert sync.addParam(1) and bulk.addParam(1, GOAL_CURRENT, 2)
    for group, read, where, value in (
        (bulk, bulk.txRxPacket, (GOAL_CURRENT, 2), 100),
        (sync, sync.fastSyncRead, (POSITION, 4), wire.fake.motor.get(POSITION)),
    ):
        assert any(read() == dynamixel_sdk.COMM_SUCCESS for _ in range(5))  # its time-out is 34 ms
        assert group.getData(1, *where) == value


def test_a_registered_write_waits_for_the_action(wire: Wire) -> None:
    goal = struct.pack("<Hi", GOAL, 2000)
    assert wire.ask(4, struct.pack("<Hi", GOAL, 2**30)) == (RANGE, b"")
    assert wire.ask(2, struct.pack("<HH", 69, 1)) == (0, b"\0")
    assert wire.ask(4, goal) == (0, b"")
    assert wire.ask(2, struct.pack("<HH", 69, 1)) == (0, b"\1")
    assert wire.fake.motor.get(GOAL) != 2000
    assert wire.ask(5, servo=254, within=0.1) is None
    assert wire.ask(2, struct.pack("<HH", GOAL, 4)) == (0, struct.pack("<i", 2000))


def test_turns_are_cleared_and_settings_reset(wire: Wire) -> None:
    wire.fake.motor.place(10_000)
    assert wire.ask(0x10, b"\x01\x44\x58\x4c\x22") == (0, b"")
    assert wire.position() == 10_000 % 4096
    assert wire.ask(0x10, b"\x02\x44\x58\x4c\x22") == (UNDEFINED, b"")
    assert wire.write(11, b"\4") == wire.write(31, struct.pack("<B", 60)) == 0
    assert wire.ask(6, b"\x02") == (0, b"")
    assert wire.ask(2, struct.pack("<HH", 11, 1)) == (0, b"\3")
    assert wire.ask(2, struct.pack("<HH", 31, 1)) == (0, bytes([80]))


@pytest.mark.parametrize(("level", "answered"), [(0, [True, False, False]), (1, [True, True, False])])
def test_the_status_return_level_decides_what_is_answered(wire: Wire, level: int, answered: list[bool]) -> None:
    assert wire.write(68, bytes([level])) is not None
    asked = [(1, b""), (2, struct.pack("<HH", 65, 1)), (3, struct.pack("<H", 65) + b"\1")]
    for (instruction, params), expected in zip(asked, answered, strict=True):
        answer = wire.ask(instruction, params, within=20.0 if expected else 0.1)
        assert (answer is not None) is expected
    assert wire.fake.motor.get(65) == 1


def test_its_secondary_id_is_obeyed_and_not_answered(wire: Wire) -> None:
    assert wire.write(12, b"\5") == 0
    assert wire.ask(3, struct.pack("<H", 65) + b"\1", servo=5, within=0.1) is None
    assert wire.ask(2, struct.pack("<HH", 65, 1)) == (0, b"\1")


def test_an_unknown_instruction_and_a_damaged_packet_are_refused(wire: Wire) -> None:
    assert wire.ask(0x77) == (UNDEFINED, b"")
    assert wire.ask(1, damage=True) == (CRC, b"")
