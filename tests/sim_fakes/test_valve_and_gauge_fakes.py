"""The fake relay module and the fake gauge, asked what their drivers never ask."""

import pytest
import serial

from sim_fakes.numato import NumatoFake
from sim_fakes.pfeiffer import PfeifferFake, checksum
from sim_fakes.plant import Plant
from tests.simulated.bench import Bench


@pytest.fixture
def relay(bench: Bench) -> serial.Serial:
    fake = bench.started(NumatoFake(bench.plant, bench.clock))
    return bench.closing(serial.serial_for_url(fake.port, 19200, timeout=20))


@pytest.fixture
def gauge(bench: Bench) -> serial.Serial:
    fake = bench.started(PfeifferFake(bench.plant, bench.clock))
    return bench.closing(serial.serial_for_url(fake.port, 9600, timeout=20))


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


def test_an_unknown_parameter_is_told_so(gauge: serial.Serial) -> None:
    gauge.write(telegram("0010099902=?"))
    assert gauge.read_until(b"\r") == telegram("0011099906NO_DEF")


@pytest.mark.parametrize("request_", [b"0010074002=?000\r", telegram("0020074002=?"), telegram("0010074001?")])
def test_a_telegram_that_is_not_exact_or_not_for_this_gauge_meets_silence(gauge: serial.Serial, request_: bytes) -> None:
    gauge.write(request_)
    gauge.timeout = 0.2
    assert gauge.read(1) == b""
