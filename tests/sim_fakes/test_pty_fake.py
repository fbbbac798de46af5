"""The common faults of a fake on a pty, seen by a plain serial port, and silence as the watchdog of a device counts it."""

import os
from collections.abc import Iterator

import pytest
import serial

import timing
from sim_fakes.pty_fake import PtyFake
from sim_fakes.punctual import LATE, Silence
from timing import RigClock


class Echo(PtyFake):
    """Sends every line back, and counts the rig time that its physics has seen."""

    def __init__(self) -> None:
        super().__init__("echo", RigClock(), baud=115200, seed=1)
        self.processed = 0.0

    def process(self, dt: float) -> None:
        self.processed += dt

    def feed(self) -> bool:
        line, end, rest = self.buffer.partition(b"\n")
        if not end:
            return False
        self.buffer = rest
        self.send(line + end)
        return True


@pytest.fixture
def echo() -> Iterator[Echo]:
    echo = Echo()
    echo.start()
    yield echo
    echo.stop()


@pytest.fixture
def port(echo: Echo) -> Iterator[serial.Serial]:
    with serial.Serial(echo.port, 115200, parity="E", timeout=5.0) as port:
        ask(port)
    with serial.Serial(echo.port, 115200, parity="E", timeout=5.0) as port:  # again, though a pty drops parity
        yield port


def ask(port: serial.Serial, request: bytes = b"0123456789\n", size: int = 11) -> bytes:
    """The answer; a whole one is waited for generously, since a busy computer is no fault."""
    port.write(request)
    return port.read(size)


@pytest.mark.parametrize(
    ("fault", "arrives"),
    [
        ({}, b"0123456789\n"),
        ({"silent": True}, b""),
        ({"truncate": True}, b"01234"),
        ({"garbage": b"\x00\xff"}, b"\x00\xff0123456789\n"),
        ({"split": True}, b"0123456789\n"),
    ],
    ids=str,
)
def test_what_arrives_with_each_fault(echo: Echo, port: serial.Serial, fault: dict[str, object], arrives: bytes) -> None:
    for name, value in fault.items():
        setattr(echo.faults, name, value)
    assert ask(port, size=len(arrives)) == arrives
    timing.sleep(0.2)
    assert port.in_waiting == 0


def test_corrupt_changes_exactly_one_bit(echo: Echo, port: serial.Serial) -> None:
    echo.faults.corrupt = True
    differing = [a ^ b for a, b in zip(ask(port), b"0123456789\n", strict=True) if a != b]
    assert len(differing) == 1
    assert differing[0].bit_count() == 1


def test_freeze_stops_the_physics_but_not_the_answers(echo: Echo, port: serial.Serial) -> None:
    echo.faults.freeze = True
    ask(port)
    before = echo.processed
    timing.sleep(0.1)
    assert ask(port) == b"0123456789\n"
    assert echo.processed == before


def test_answers_that_nobody_reads_do_not_stop_the_fake(echo: Echo) -> None:
    for _ in range(1000):
        echo.send(b"0123456789", line_time=False)
    with serial.Serial(echo.port, 115200, timeout=1) as port:
        assert ask(port, b"still here\n") == b"still here\n"


def test_a_port_that_is_plugged_in_again_has_the_same_path_and_another_pty_that_no_other_line_got() -> None:
    pulled = Echo()
    before = os.path.realpath(pulled.port)
    pulled.unplug()
    others = [Echo() for _ in range(3)]
    try:
        with pytest.raises(OSError, match=pulled.port):
            serial.Serial(pulled.port)
        pulled.plug()
        assert before not in {os.path.realpath(line.port) for line in (pulled, *others)}
    finally:
        for line in (pulled, *others):
            line.stop()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_an_error_in_a_fake_s_own_code_is_no_silence(echo: Echo) -> None:
    with pytest.raises(TypeError, match="Echo.faults = 0: PtyFake has a Faults there"):
        echo.faults = 0  # type: ignore[assignment]  # bits of its own
    echo.feed = lambda: {}["none"]  # type: ignore[method-assign]
    with serial.Serial(echo.port, 115200, timeout=1) as port, pytest.raises(OSError):
        ask(port)
        serial.Serial(echo.port)
    assert repr(echo.ended_by) == "KeyError('none')"


def test_silence_is_counted_while_the_fake_is_awake(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr("timing.now", lambda: now)
    silence = Silence()
    for _ in range(20):
        now += 0.02
        silence.now()
    assert silence.now() == pytest.approx(0.4)
    now += 5.0  # the computer was busy: what came meanwhile waits to be read
    assert silence.now() == pytest.approx(0.4 + LATE)
    silence.heard()
    assert silence.now() == 0.0
