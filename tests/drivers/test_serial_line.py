"""The request/reply line, against a pty whose other end the test holds."""

import contextlib
import fcntl
import os
import pty
import re
import termios
import tty
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

import timing
from drivers import line_quality, serial_line
from drivers.dynamixel.bus import Servo
from drivers.errors import BadReply, NoReply, NotReady, Unreachable
from drivers.line_quality import adapter
from drivers.serial_line import SerialLine, SerialPort
from drivers.tmcl.bus import MotorAxis
from tests.sim_fakes.plugged import Plugged
from tests.simulated.bench import raises


@dataclass
class OtherEnd:
    """What sits at the far end of the cable: it says things before it is asked."""

    master: int
    slave: int

    def say(self, data: bytes) -> None:
        os.write(self.master, data)
        timing.sleep(0.01)

    def heard(self) -> bytes:
        return os.read(self.master, 1000)


def far_end() -> Iterator[OtherEnd]:
    master, slave = pty.openpty()
    tty.setraw(master)
    tty.setraw(slave)
    yield OtherEnd(master, slave)
    for fd in (master, slave):
        with contextlib.suppress(OSError):
            os.close(fd)


end, other = pytest.fixture(far_end), pytest.fixture(far_end)


@pytest.fixture
def line(end: OtherEnd) -> Iterator[SerialLine]:
    with contextlib.closing(SerialLine("gauge", os.ttyname(end.slave), 19200, timeout=0.1)) as line:
        line.open()
        yield line


def test_an_answer_comes_without_its_terminator_and_what_follows_stays(end: OtherEnd, line: SerialLine) -> None:
    end.say(b"first\r\nsecond\r\nthird")
    assert line.read_until(b"\r\n") == b"first"
    assert line.read_until(b"\r\n") == b"second"
    assert line.read_exactly(5) == b"third"


def test_a_binary_frame_keeps_a_first_byte_that_looks_like_white_space(end: OtherEnd) -> None:
    with contextlib.closing(SerialLine("board", os.ttyname(end.slave), 19200, 0.1, padding=b"")) as line:
        line.open()
        end.say(b"\n\0 10 bytes\x7e\n\2AB")
        assert line.read_until(b"\x7e") == b"\n\0 10 bytes"
        assert line.read_exactly(line.read_exactly(2)[1]) == b"AB"


def test_asking_throws_stale_input_away_first(end: OtherEnd, line: SerialLine) -> None:
    end.say(b"late answer\rrest")
    raises(NoReply, None, line.ask, b"A\r", b"\r")
    assert end.heard() == b"A\r"


def test_silence_is_no_reply_and_names_the_instrument_the_port_and_the_request(line: SerialLine) -> None:
    raises(NoReply, rf"gauge: no answer on {line.port}.*request was b'AVE\\r'", line.ask, b"AVE\r", b"\r")


def test_an_answer_without_its_end_is_shown(end: OtherEnd, line: SerialLine) -> None:
    end.say(b"half an ans")
    raises(BadReply, "half an ans", line.read_until, b"\r")


def test_an_endless_answer_is_given_up_before_its_time(end: OtherEnd, line: SerialLine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serial_line, "LONGEST_ANSWER", 100)
    end.say(b"x" * 200)
    start = timing.now()
    raises(BadReply, r"\.\.\. \(200 bytes\)", line.read_until, b"\r", timeout=20.0)
    assert timing.now() - start < 10.0


def test_listening_returns_what_came_and_silence_is_no_error(end: OtherEnd, line: SerialLine) -> None:
    assert line.listen(0.03) == b""
    end.say(b"noise")
    assert line.listen(0.03) == b"noise"


def test_a_board_that_resets_when_its_port_opens_is_given_time_and_what_it_says_is_dropped(
    end: OtherEnd, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits = list[float]()

    def booting(seconds: float) -> None:
        waits.append(seconds)
        os.write(end.master, b"bootloader 1.0\r")

    monkeypatch.setattr(timing, "sleep", booting)
    line = SerialLine("gauge", os.ttyname(end.slave), 19200, timeout=0.1, settle=2.0)
    line.open()
    line.open()  # is open and answers: nothing resets
    assert waits == [2.0] and line.listen(0.02) == b""
    line.close()


def test_a_port_is_set_to_the_boards_parity_and_stop_bits(end: OtherEnd, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    monkeypatch.setattr(termios, "tcsetattr", lambda fd, when, to: asked.append(to[2]))  # a pty has neither and drops them
    with contextlib.closing(SerialLine("board", os.ttyname(end.slave), 19200, 0.1, framing="8E2")) as line:
        line.open()
    assert asked[0] & (termios.PARENB | termios.PARODD | termios.CSTOPB) == termios.PARENB | termios.CSTOPB
    raises(Unreachable, "parity: 'X'", SerialLine("board", os.ttyname(end.slave), 19200, 0.1, framing="8X1").open)


def test_a_port_that_is_not_there_is_unreachable_and_says_what_to_check() -> None:
    raises(Unreachable, "cannot open /dev/nothing.*rig.yaml", SerialLine("gauge", "/dev/nothing", 9600, 0.1).open)


def test_a_port_that_another_line_has_is_unreachable(line: SerialLine) -> None:
    raises(Unreachable, "no other program", SerialLine("valve", line.port, 9600, 0.1).open)


@pytest.fixture
def link(tmp_path: Path) -> Path:
    return tmp_path / "by-id"


@pytest.fixture
def by_id(end: OtherEnd, link: Path) -> Iterator[SerialLine]:
    link.symlink_to(os.ttyname(end.slave))
    with contextlib.closing(SerialLine("gauge", str(link), 19200, timeout=5.0)) as line:
        line.open()
        yield line


def test_a_lost_line_is_closed_says_so_until_it_is_opened_and_opens_what_is_behind_the_same_path(
    end: OtherEnd, other: OtherEnd, link: Path, by_id: SerialLine
) -> None:
    os.close(end.master)
    for _ in range(2):
        raises(Unreachable, "lost .*by-id", by_id.ask, b"A\r", b"\r")
        assert not by_id.is_open
    link.unlink()
    raises(Unreachable, "cannot open", by_id.open)
    link.symlink_to(os.ttyname(other.slave))
    by_id.open()
    other.say(b"here\r")
    assert by_id.read_until(b"\r") == b"here"


def test_an_open_line_whose_path_leads_elsewhere_by_now_is_opened_anew(
    end: OtherEnd, other: OtherEnd, link: Path, by_id: SerialLine
) -> None:
    """The old handle may still take bytes: nothing says that it is the instrument's no longer."""
    link.unlink()
    by_id.open()  # a path that is gone proves nothing
    by_id.write(b"1")
    assert end.heard() == b"1"
    link.symlink_to(os.ttyname(other.slave))
    by_id.open()
    by_id.write(b"2")
    assert other.heard() == b"2"


def test_a_silent_line_gets_a_new_handle_when_it_is_opened_again(
    end: OtherEnd, line: SerialLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An adapter that was reset has forgotten its baud rate, and learns it when its port is opened."""
    made: list[str] = []
    known = serial_line.serial.Serial

    def make(port: str, *how: Any, **more: Any) -> Any:
        made.append(port)
        return known(port, *how, **more)

    monkeypatch.setattr(serial_line.serial, "Serial", make)
    line.open()
    assert not made
    raises(NoReply, None, line.ask, b"A\r", b"\r")
    line.open()
    assert len(made) == 1


def test_a_closed_line_is_not_ready_and_closing_again_does_nothing(line: SerialLine) -> None:
    line.close()
    line.close()
    raises(NotReady, "not open", line.write, b"A")


class Timers:
    """A computer whose ports have USB adapters with a latency timer, as Linux describes and serves them."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(line_quality, "TTYS", folder)
        self.folder, self.flags, self._ioctl = folder, 0, fcntl.ioctl
        monkeypatch.setattr(fcntl, "ioctl", self._served)

    def _served(self, number: int, request: int, *arguments: Any) -> Any:
        if request == termios.TIOCGSERIAL:
            arguments[0][4] = self.flags
        elif request == termios.TIOCSSERIAL:
            self.flags = arguments[0][4]
        else:
            return self._ioctl(number, request, *arguments)
        return 0

    def is_set(self, port: str, milliseconds: int) -> None:
        file = self.folder / Path(port).name / "device" / "latency_timer"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(f"{milliseconds}\n")


@pytest.fixture
def timers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Timers:
    return Timers(tmp_path, monkeypatch)


@pytest.mark.parametrize("kind", ["line", "tmcl", "dynamixel"])
def test_each_serial_port_is_opened_at_low_latency_where_its_driver_has_that(end: OtherEnd, timers: Timers, kind: str) -> None:
    port = os.ttyname(end.slave)
    ports: dict[str, Callable[[], SerialPort]] = {
        "line": lambda: SerialLine("gauge", port, 19200, 0.1),
        "tmcl": lambda: MotorAxis("spine", port, 115200, 1, 2, 0, 0.1),
        "dynamixel": lambda: Servo("spine", port, 57600, 1, 0.1),
    }
    opened = ports[kind]()
    opened.open()
    assert timers.flags & 0x2000
    opened.close()


@pytest.mark.parametrize(
    ("timer", "said"),
    [
        (16, "because the latency timer of its adapter is 16 ms; set it to 1 ms: echo 1"),
        (1, "although the latency timer .* 1 ms"),
    ],
)
def test_a_notice_of_late_answers_says_what_the_adapters_timer_is_set_to(
    line: SerialLine, timers: Timers, timer: int, said: str
) -> None:
    timers.is_set(line.port, timer)
    for _ in range(20):
        line.quality.sent(2)
        line.quality.answered(timing.now() - 0.016, 10)
    (told,) = line.take_notices()
    assert re.search(said, told)


def test_an_adapter_is_known_by_its_serial_number_or_by_its_socket(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    port = tmp_path / "ttyUSB0"
    (tmp_path / "by-id").symlink_to(port)
    plugged = Plugged(monkeypatch, [str(port)])
    assert adapter(str(tmp_path / "by-id")) == "0403:6014 serial number FT1"
    plugged.numbered = False
    assert adapter(str(port)) == "0403:6014 at USB socket 1-FT1"
    assert adapter(str(tmp_path / "ttyS0")) == ""
