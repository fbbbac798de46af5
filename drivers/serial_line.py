"""One serial port that is asked and answers: the line under every driver that speaks a short request/reply protocol.

Usage: `line.ask(b"A\\r", until=b"\\r")`. Stale input is thrown away before each request, the answer is read up to its
terminator or to a deadline in host time, and every failure is one of the drivers' errors with the bytes that were seen.
A port that is lost is closed at once, and `open` opens it anew: the device may have returned under another name.
Hold `line.lock` to keep several requests together; `ask` takes it by itself. A stop takes it by `line.lock.stopping()`, and
everything else on the line gives way.
"""

from __future__ import annotations

import contextlib
import os
import termios
from collections.abc import Callable, Iterator
from typing import TypeVar

import serial

import timing

from .configs import known_port
from .errors import BadReply, InstrumentError, NoReply, NotReady, Refused, Unreachable, WrongDevice
from .line_quality import LineQuality
from .stop_first import SLICE, StopFirst

PADDING = b"\0\xff \t\r\n"
"""What breakout boxes, terminal servers and an RS-485 line that is turned round put between two lines."""
LONGEST_ANSWER = 4096
"""Bytes after which an answer without its terminator is given up: nothing here answers at such length."""
WRITE_WITHIN = 1.0
"""s, least time to write a request. The kernel takes those few bytes at once, but pyserial checks the clock after the last byte,
and a busy computer may return late from a write that was done."""
T = TypeVar("T")


def show(data: bytes, longest: int = 48) -> str:
    """The bytes as they go into an error message, cut where they get long."""
    return repr(data) if len(data) <= longest else f"{data[:longest]!r}... ({len(data)} bytes)"


@contextlib.contextmanager
def meeting(name: str, close: Callable[[], None], stranger: str) -> Iterator[None]:
    """Ask for the first time who answers: silence becomes `Unreachable`, and what is not understood `WrongDevice` with what
    `stranger` says of it. After any failure the line is closed by `close`."""
    try:
        yield
    except BaseException as e:
        close()
        if isinstance(e, NoReply):
            raise Unreachable(name, e.message) from e
        if isinstance(e, BadReply):
            raise WrongDevice(name, f"{stranger}: {e.message}") from e
        raise


class SerialPort:
    """A serial port of this process alone, and at low latency where its driver allows that.

    A port that fails is closed at once, since its handle stays dead even if the device returns under the same path; every use
    raises that failure again until it is opened anew.
    """

    longest_read = SLICE
    """s of one read of the port, host time."""

    def __init__(
        self, name: str, port: str, baud: int, timeout: float, lock: StopFirst | None = None, framing: str = "8N1"
    ) -> None:
        """`timeout` (s, host time) bounds each answer and each write; `lock`: one that several lines of an instrument share;
        `framing`: data bits, parity (N, E, O) and stop bits of a character."""
        self.name = name
        self.port = port
        self.baud = baud
        self.timeout = timeout
        self._framing = data_bits, parity, stop_bits = int(framing[0]), framing[1], int(framing[2])
        self.lock = lock or StopFirst(name)
        self.quality = LineQuality(port, (1 + data_bits + (parity != "N") + stop_bits) / baud)
        self.lost = ""
        """Why the port was lost; empty while it is open and after it was closed on purpose."""
        self._serial: serial.Serial | None = None
        self._is_socket = port.startswith("socket:")  # on which nothing is older than its opening

    @property
    def is_open(self) -> bool:
        """True between `open` and `close`, unless the port was lost."""
        return self._serial is not None

    def open(self) -> None:
        """Open the port; raises `Unreachable`."""
        with self.lock:
            self.close()
            try:
                port = serial.serial_for_url(
                    known_port(self.port),
                    self.baud,
                    *self._framing,
                    timeout=min(self.longest_read, self.timeout),
                    write_timeout=max(WRITE_WITHIN, self.timeout),
                    exclusive=True,
                    do_not_open=True,
                )
                if self._is_socket:  # pyserial would discard a greeting while it opens
                    port.reset_input_buffer = lambda: None  # type: ignore[method-assign]
                port.open()
                vars(port).pop("reset_input_buffer", None)
                self._serial = port
            except (OSError, ValueError, termios.error) as e:
                raise Unreachable(
                    self.name,
                    f"cannot open {self.port} at {self.baud} Bd ({e}); check that it is plugged in, that rig.yaml "
                    "names this port, that you may use it (group dialout), and that no other program has it open",
                ) from e
            with contextlib.suppress(AttributeError, OSError, ValueError):  # no such mode: sockets, other systems and adapters
                self._serial.set_low_latency_mode(True)

    def close(self) -> None:
        """Close the port; may be called twice and never raises."""
        with self.lock:
            self.lost = ""
            port, self._serial = self._serial, None
            if port is not None:
                with contextlib.suppress(OSError, termios.error):
                    port.close()

    def demand_open(self) -> None:
        """Raise `Unreachable` for a port that was lost, `NotReady` for one that is not open."""
        if self.lost:
            raise Unreachable(self.name, self.lost)
        if self._serial is None:
            raise NotReady(self.name, f"{self.port} is not open; call open() first")

    def take_notices(self) -> list[str]:
        """See the module `interfaces`."""
        return self.quality.notices()

    @contextlib.contextmanager
    def _guarded(self) -> Iterator[serial.Serial]:
        """The open port under the lock, with pyserial's failures turned into the drivers' errors."""
        with self.lock:
            self.demand_open()
            assert self._serial is not None
            self.lock.give_way()
            try:
                yield self._serial
            except serial.SerialTimeoutException as e:
                remedy = timing.busy_or("check the cable")
                raise NoReply(self.name, f"{self.port} accepts no bytes within {self.timeout} s; {remedy}") from e
            except (OSError, termios.error) as e:
                if isinstance(e, InstrumentError):
                    raise
                self.close()
                self.lost = f"lost {self.port} ({e}); check its plug and power, then open it again"
                raise Unreachable(self.name, self.lost) from e


class SerialLine(SerialPort):
    """A serial port that is asked and answers, with deadlines."""

    def __init__(
        self,
        name: str,
        port: str,
        baud: int,
        timeout: float,
        lock: StopFirst | None = None,
        skip_echo: bool = False,
        settle: float = 0.0,
        framing: str = "8N1",
        padding: bytes = PADDING,
    ) -> None:
        """See `SerialPort`. `skip_echo`: a line that repeats the request is the echo of an adapter. `settle`: host s for which a
        board is deaf that resets when its port opens; what it says meanwhile is discarded. `padding`: what `read_until` drops
        before an answer; b"" where an answer may begin with any byte."""
        super().__init__(name, port, baud, timeout, lock, framing)
        self._skip_echo, self._settle, self._padding = skip_echo, settle, padding
        self._buffer = bytearray()
        self._sent = b""
        """The request whose echo may come before the answer that is awaited."""
        self._silent = False
        """Whether the last answer that was waited for did not come."""

    def open(self) -> None:
        """Open the port for this process alone; raises `Unreachable`.

        Does nothing when the port is open and answers; a silent line gets a new handle. Discards what a
        device has sent, but keeps what a unit on socket:// sends on connecting: read this greeting by `read_until` before `ask`.
        """
        with self.lock:
            if self._serial is not None and not self._silent and not self._leads_elsewhere(self._serial):
                return
            super().open()
            timing.sleep(self._settle)
            (self._buffer.clear if self._is_socket else self.flush)()
            self._silent = False

    def _leads_elsewhere(self, port: serial.Serial) -> bool:
        """Whether the path is that of another device than the one that is open; a path that has gone proves nothing."""
        try:
            return os.fstat(port.fileno()).st_rdev != os.stat(self.port).st_rdev
        except OSError:
            return False

    def flush(self) -> None:
        """Discard what has arrived."""
        with self._guarded() as port:
            port.reset_input_buffer()
            self._buffer.clear()

    def write(self, data: bytes, repeated: bool = False) -> None:
        """Send bytes; `NoReply` when the line does not take them in time.

        `repeated`: the answer repeats them, so only an adapter that is known to echo returns them before that.
        """
        with self._guarded() as port:
            self._sent = b"" if repeated and not self.quality.echoes else data
            port.write(data)
            self.quality.sent(len(data))

    def read_some(self) -> bytes:
        """What has arrived, after at most one `SLICE`; empty on silence."""
        with self._guarded() as port:
            self._buffer += port.read(max(1, port.in_waiting))
            return self._take(len(self._buffer))

    def listen(self, duration: float) -> bytes:
        """Everything that arrives within `duration` s, host time."""
        deadline = timing.now() + duration
        heard = b""
        while timing.now() < deadline:
            heard += self.read_some()
        return heard

    def read_until(self, until: bytes, timeout: float | None = None) -> bytes:
        """The next answer without its terminator `until`, leading padding (blank lines too) and echo. Raises `NoReply` on
        silence, `BadReply` on an unfinished answer."""
        with self._guarded() as port:
            began, count = timing.now(), 0
            deadline = began + (self.timeout if timeout is None else timeout)
            while True:
                while (end := self._buffer.find(until)) < 0:
                    self._wait_for_more(port, deadline, f"up to {until!r}")
                whole = self._take(end + len(until))
                count += len(whole)
                whole = whole.lstrip(self._padding)
                if self._skip_echo and whole and whole == self._sent:
                    self.quality.echoes, self._sent = True, b""
                elif whole:
                    self.quality.answered(began, count)
                    return whole[: -len(until)]

    def read_exactly(self, count: int, timeout: float | None = None) -> bytes:
        """`count` bytes; `NoReply` on silence, `BadReply` when fewer arrive."""
        with self._guarded() as port:
            began = timing.now()
            deadline = began + (self.timeout if timeout is None else timeout)
            while len(self._buffer) < count:
                self._wait_for_more(port, deadline, f"of {count} bytes")
            self.quality.answered(began, count)
            return self._take(count)

    def ask(self, request: bytes, until: bytes, timeout: float | None = None) -> bytes:
        """Flush, send `request`, return the answer as `read_until` does. Also raises `Unreachable` (the port went away),
        `NotReady` (not open).
        """
        with self.lock:
            self.flush()
            self.write(request)
            try:
                return self.read_until(until, timeout)
            except (NoReply, BadReply) as e:
                raise type(e)(self.name, f"{e.message}; the request was {show(request)}") from e

    def twice(self, request: Callable[[], T]) -> T:
        """Make a harmless request, and repeat it once on a disturbed line."""
        try:
            answer = request()
        except Refused:
            self.quality.count(False)
            raise
        except (NoReply, BadReply):
            self.quality.count(True)
            self.listen(self.timeout)  # an answer that is only late must not be taken for the next one's
            return request()
        self.quality.count(False)
        return answer

    def _take(self, count: int) -> bytes:
        taken = bytes(self._buffer[:count])
        del self._buffer[:count]
        return taken

    def _wait_for_more(self, port: serial.Serial, deadline: float, wanted: str) -> None:
        """Read once more; past the deadline, or with an endless answer, drop what came and raise."""
        self.lock.give_way()
        late = timing.now() >= deadline
        come = port.read(port.in_waiting if late else max(1, port.in_waiting))
        self._silent = self._silent and not come
        self._buffer += come
        if (late and not come) or len(self._buffer) > LONGEST_ANSWER:
            got = self._take(len(self._buffer))
            if got:
                raise BadReply(self.name, f"expected an answer {wanted} on {self.port}, got only {show(got)}; check the cable")
            self._silent = True
            remedy = timing.busy_or("check its power, cable, address, baud rate and parity")
            raise NoReply(self.name, f"no answer on {self.port} in time; {remedy}")
