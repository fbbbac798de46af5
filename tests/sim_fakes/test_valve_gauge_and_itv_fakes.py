"""The fake relay module, the fake gauge and the fake ITV, asked what their drivers never ask."""

import pytest
import serial

from sim_fakes.numato import NumatoFake
from sim_fakes.pfeiffer import PfeifferFake, checksum
from sim_fakes.plant import Plant
from sim_fakes.smc_itv import SmcItvFake
from tests.simulated.bench import Bench, started_fake


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


# -- the ITV
fake = started_fake(SmcItvFake, chambers=(4, 5), seed=3)


@pytest.fixture
def itv(bench: Bench, fake: SmcItvFake) -> serial.Serial:
    return bench.closing(serial.serial_for_url(fake.port, 9600, timeout=20))


def told(itv: serial.Serial, words: str) -> str:
    itv.write(words.encode() + b"\r\n")
    return str(itv.read_until(b"\r\n").decode().strip())


def test_steps_of_two_go_up_and_down_and_stop_at_the_ends(itv: serial.Serial) -> None:
    assert told(itv, "DEC") == "OUT OF RANGE"
    assert [told(itv, "INC"), told(itv, "INC"), told(itv, "DEC")] == ["2", "4", "2"]


@pytest.mark.parametrize("words", ["SET 1024", "SET 99999"])
def test_set_points_out_of_range_are_refused_and_change_nothing(itv: serial.Serial, fake: SmcItvFake, words: str) -> None:
    assert told(itv, words) == "OUT OF RANGE"
    assert fake.device.setpoint == 0


@pytest.mark.parametrize("words", ["SET", "SET -1", "SET  5", "set 5", "SET 5.0", "WHO", ""])
def test_what_is_not_exact_is_an_unknown_command(itv: serial.Serial, words: str) -> None:
    assert told(itv, words) == "UNKNOWN COMMAND"


def test_a_line_without_carriage_return_and_line_feed_is_not_a_line(itv: serial.Serial) -> None:
    itv.write(b"SET 5\r")
    itv.timeout = 0.1
    assert itv.read(10) == b""
    itv.timeout = 20
    itv.write(b"\n")
    assert itv.read_until(b"\r\n") == b"5\r\n"
