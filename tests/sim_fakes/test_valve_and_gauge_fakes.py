"""The fake relay module and the fake gauge on their wires, without any driver."""

import random
from collections.abc import Iterator

import pytest
import serial

from sim_fakes.numato import NumatoFake
from sim_fakes.pfeiffer import PfeifferFake, checksum, pressure_digits
from sim_fakes.plant import Plant
from timing import RigClock


@pytest.fixture
def relay(plant: Plant) -> Iterator[serial.Serial]:
    fake = NumatoFake(plant, RigClock(20.0))
    fake.start()
    with serial.serial_for_url(fake.port, 19200, timeout=20) as port:
        yield port
    fake.stop()


@pytest.fixture
def gauge(plant: Plant) -> Iterator[serial.Serial]:
    fake = PfeifferFake(plant, RigClock(20.0), noise=0.0)
    fake.start()
    with serial.serial_for_url(fake.port, 9600, timeout=20) as port:
        yield port
    fake.stop()


def typed(port: serial.Serial, command: str) -> bytes:
    port.write(command.encode() + b"\r")
    return port.read_until(b">")


def test_all_relays_are_written_at_once_and_reset(relay: serial.Serial, plant: Plant) -> None:
    assert typed(relay, "relay writeall 05") == b"relay writeall 05\n\r>"
    assert typed(relay, "relay readall") == b"relay readall\n\r05\n\r>"
    assert typed(relay, "reset") == b"reset\n\r>"
    assert typed(relay, "relay readall") == b"relay readall\n\r00\n\r>"
    assert typed(relay, "relay writeall 5") == b"relay writeall 5\n\r>"
    assert not plant.valve_on


@pytest.mark.parametrize("command", ["RELAY ON 0", "relay  on 0", "relay on 9", "relay on", "on 0", "relay on 00"])
def test_anything_else_does_nothing(relay: serial.Serial, plant: Plant, command: str) -> None:
    assert typed(relay, command) == command.encode() + b"\n\r>"
    assert typed(relay, "relay readall").split()[-2] == b"00"
    assert not plant.valve_on


def telegram(text: str) -> bytes:
    return f"{text}{checksum(text)}\r".encode()


@pytest.mark.parametrize(("pascal", "digits"), [(101_325.0, "101323"), (100.0, "100020"), (99_999.0, "100023"), (0.0, "100010")])
def test_digits_are_mantissa_and_exponent(pascal: float, digits: str) -> None:
    assert pressure_digits(pascal) == digits


def test_an_unknown_parameter_is_told_so(gauge: serial.Serial) -> None:
    gauge.write(telegram("0010099902=?"))
    assert gauge.read_until(b"\r") == telegram("0011099906NO_DEF")


@pytest.mark.parametrize("request_", [b"0010074002=?000\r", telegram("0020074002=?"), telegram("0010074001?")])
def test_a_telegram_that_is_not_exact_or_not_for_this_gauge_meets_silence(gauge: serial.Serial, request_: bytes) -> None:
    gauge.write(request_)
    gauge.timeout = 0.2
    assert gauge.read(1) == b""


def test_noise_is_a_share_of_the_reading() -> None:
    fake = PfeifferFake(Plant(), RigClock(), noise=0.01)
    fake.random = random.Random(1)
    sent: list[bytes] = []
    fake.send = sent.append  # type: ignore[method-assign]
    for _ in range(200):
        fake._answer(740)
    values = [int(a[10:14]) / 1000 * 10 ** (int(a[14:16]) - 20) * 100 for a in sent]
    mean = sum(values) / len(values)
    spread = (sum((v - mean) ** 2 for v in values) / len(values)) ** 0.5
    assert mean == pytest.approx(101_325, rel=0.003)
    assert spread == pytest.approx(1013, rel=0.2)
