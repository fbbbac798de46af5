"""What the fake ITV answers, line by line, to a plain serial port."""

from collections.abc import Callable

import pytest
import serial

from sim_fakes.smc_itv import SmcItvFake
from tests.simulated.bench import Bench, started_fake

Ask = Callable[[str], str]
fake = started_fake(SmcItvFake, chambers=(4, 5), seed=3)


@pytest.fixture
def ask(bench: Bench, fake: SmcItvFake) -> Ask:
    port = bench.closing(serial.serial_for_url(fake.port, 9600, timeout=20))

    def ask(words: str) -> str:
        port.write(words.encode() + b"\r\n")
        return str(port.read_until(b"\r\n").decode().strip())

    return ask


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


def test_a_line_without_carriage_return_and_line_feed_is_not_a_line(fake: SmcItvFake) -> None:
    with serial.serial_for_url(fake.port, 9600, timeout=0.1) as port:
        port.write(b"SET 5\r")
        assert port.read(10) == b""
        port.timeout = 20
        port.write(b"\n")
        assert port.read_until(b"\r\n") == b"5\r\n"
