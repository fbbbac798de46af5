"""What the fake ITV answers, line by line, to a plain serial port."""

from collections.abc import Callable, Iterator

import pytest
import serial

import timing
from sim_fakes.plant import Plant
from sim_fakes.smc_itv import SmcItvFake
from timing import RigClock

Ask = Callable[[str], str]


@pytest.fixture
def fake(plant: Plant) -> Iterator[SmcItvFake]:
    fake = SmcItvFake(plant, RigClock(speed=20), chambers=(4, 5), seed=3)
    fake.start()
    yield fake
    fake.stop()


@pytest.fixture
def ask(fake: SmcItvFake) -> Iterator[Ask]:
    with serial.serial_for_url(fake.port, 9600, timeout=20) as port:

        def ask(words: str, end: str = "\r\n") -> str:
            port.reset_input_buffer()
            port.write((words + end).encode())
            return port.read_until(b"\r\n").decode().strip()

        yield ask


def test_steps_of_two_go_up_and_down_and_stop_at_the_ends(ask: Ask) -> None:
    assert ask("DEC") == "OUT OF RANGE"
    assert [ask("INC"), ask("INC"), ask("DEC")] == ["2", "4", "2"]


@pytest.mark.parametrize("words", ["SET 1024", "SET 99999"])
def test_set_points_out_of_range_are_refused_and_change_nothing(ask: Ask, fake: SmcItvFake, words: str) -> None:
    assert ask(words) == "OUT OF RANGE"
    assert fake.device.setpoint == 0


@pytest.mark.parametrize("words", ["SET", "SET -1", "SET  5", "set 5", "SET 5.0", "WHO", ""])
def test_what_is_not_exact_is_an_unknown_command(ask: Ask, words: str) -> None:
    assert ask(words) == "UNKNOWN COMMAND"


def test_a_poll_that_comes_too_soon_is_not_answered(ask: Ask, fake: SmcItvFake) -> None:
    with serial.serial_for_url(fake.port, 9600, timeout=20) as port:
        port.write(b"REQ\r\nREQ\r\n")
        assert port.read_until(b"\r\n") == b"0\r\n"
        port.timeout = 0.2
        assert port.read(1) == b""
    timing.sleep(0.1)
    assert ask("REQ") == "0"


def test_a_line_without_carriage_return_and_line_feed_is_not_a_line(fake: SmcItvFake) -> None:
    with serial.serial_for_url(fake.port, 9600, timeout=0.1) as port:
        port.write(b"SET 5\r")
        assert port.read(10) == b""
        port.timeout = 20
        port.write(b"\n")
        assert port.read_until(b"\r\n") == b"5\r\n"
