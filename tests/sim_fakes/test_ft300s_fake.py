"""The fake FT 300-S on the wire: Modbus frames as bytes, and the stream."""

import struct

import pytest
import serial

import timing
from sim_fakes.ft300s import Ft300sFake, crc16
from tests.simulated.bench import Bench, started_fake, wait_until

fake = started_fake(Ft300sFake, seed=5)


@pytest.fixture
def port(bench: Bench, fake: Ft300sFake) -> serial.Serial:
    return bench.closing(serial.serial_for_url(fake.port, 19200, timeout=0.1))


def ask(port: serial.Serial, body: str, first_byte: float = 20.0) -> bytes:
    """Send a request given in hex without its CRC; the answer without its CRC, which is checked.

    `first_byte`: how long to wait for one (s); the rest comes in one piece with it.
    """
    request = bytes.fromhex(body)
    port.write(request + crc16(request))
    port.timeout, brief = first_byte, port.timeout
    answer = port.read(1)
    port.timeout = brief
    answer += port.read(100) if answer else b""
    assert crc16(answer[:-2]) == answer[-2:] or not answer
    return answer[:-2]


def test_the_wrench_registers_are_big_endian_hundredths_and_thousandths(fake: Ft300sFake, port: serial.Serial) -> None:
    fake.device.noise[:] = 0.0
    assert struct.unpack(">6h", ask(port, "09 03 00B4 0006")[3:]) == (150, -225, 3000, 125, -500, 1000)


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        ("09 04 00B4 0001", 1),
        ("09 03 00BA 0001", 2),
        ("09 03 01F7 0002", 2),
        ("09 03 00B4 0000", 3),
        ("09 10 01F4 0001 02 0000", 2),
        ("09 10 019A 0001 02 0300", 3),
    ],
)
def test_bad_requests_are_refused_with_the_modbus_code(port: serial.Serial, request_: str, code: int) -> None:
    assert ask(port, request_) == bytes((9, bytes.fromhex(request_)[1] | 0x80, code))


@pytest.mark.parametrize("request_", ["05 03 00B4 0001", "09 03 00B4 0001 00", "09 10 019A 0001 03 0200"])
def test_a_foreign_id_or_a_wrong_length_is_met_with_silence(port: serial.Serial, request_: str) -> None:
    assert ask(port, request_, first_byte=0.1) == b""


def test_a_pause_inside_a_request_or_a_wrong_crc_is_met_with_silence(port: serial.Serial) -> None:
    port.write(bytes.fromhex("0903 00B4 0001 C565"))
    assert port.read(10) == b""
    whole = bytes.fromhex("090300B40001C564")
    port.write(whole[:4])
    timing.sleep(0.05)
    port.write(whole[4:])
    assert port.read(10) == b""


def test_starting_the_stream_is_acknowledged_and_then_modbus_is_dead(port: serial.Serial) -> None:
    port.write(bytes.fromhex("0910019A000102 0200 CDCA"))
    assert port.read(8)[:6] == bytes.fromhex("0910019A0001")
    port.write(bytes.fromhex("090300B40001C564"))
    port.timeout = 60
    heard = port.read(160)
    frames = [heard[i : i + 16] for i in range(0, 160, 16)]
    assert all(f[:2] == b"\x20\x4e" and crc16(f[:14]) == f[14:] for f in frames)


def test_only_fifty_stop_bytes_in_a_row_end_the_stream(fake: Ft300sFake, port: serial.Serial) -> None:
    fake.device.streaming = True
    port.write(b"\xff" * 49 + b"\x00" + b"\xff" * 49)
    timing.sleep(0.1)
    assert fake.device.streaming
    port.write(b"\xff" * 50)
    wait_until(lambda: not fake.device.streaming)
