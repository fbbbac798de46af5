"""A fake instrument on a serial line, whose other end the real client library opens (see `lines`).

A fake is a device (state and physics, `process(dt)`) plus a wire interface (`feed`). Line time is simulated at the configured
baud rate. Faults are set through `faults`, from a test or through the back door.
"""

from __future__ import annotations

import contextlib
import os
import pty
import random
import tempfile
import termios
import tty
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import timing
from timing import RigClock

from .punctual import punctual


class PtyLine:
    """A pty; `port` is a link to it, as `/dev/serial/by-id` has them, which stays while the pty behind it changes."""

    def __init__(self, name: str) -> None:
        self._master = self._slave = self._kept = -1
        """Ends of the line; the end kept from the last one that was unplugged."""
        self._folder = tempfile.TemporaryDirectory(prefix="softlab-")
        os.chmod(self._folder.name, 0o755)  # who may use a line is said at its pty
        self.port = str(Path(self._folder.name) / name)

    @property
    def plugged(self) -> bool:
        """Whether the cable is in."""
        return self._master >= 0

    def plug(self) -> None:
        """Put the cable in: a new line under the same path."""
        self._master, self._slave = pty.openpty()
        tty.setraw(self._master)
        tty.setraw(self._slave)
        # what nobody reads is lost, as on a real line; a blocking write would stop the fake for ever
        os.set_blocking(self._master, False)
        os.symlink(os.ttyname(self._slave), self.port)

    def unplug(self) -> None:
        """Pull the cable out."""
        Path(self.port).unlink(missing_ok=True)
        for fd in (self._master, self._kept):
            with contextlib.suppress(OSError):
                os.close(fd)
        self._kept = self._slave
        self._master = self._slave = -1

    def await_bytes(self, longest: float) -> bool:
        """Whether something has come, after at most `longest` host seconds. Raises OSError when unplugged meanwhile."""
        return bool(timing.readable([self._master] if self._master >= 0 else [], longest))

    def read(self) -> bytes:
        """What has come. Raises OSError."""
        speedless = termios.tcgetattr(self._slave)
        speedless[4:6] = termios.B50, termios.B50  # a pty drops parity, which tcsetattr reports where nothing else changes
        termios.tcsetattr(self._slave, termios.TCSANOW, speedless)
        return os.read(self._master, 4096)

    def write(self, data: bytes) -> None:
        """Send; what nobody reads is lost."""
        with contextlib.suppress(OSError):
            os.write(self._master, data)

    def close(self) -> None:
        """Free what it holds."""
        self.unplug()
        with contextlib.suppress(OSError):
            os.close(self._kept)
        self._kept = -1
        self._folder.cleanup()


@dataclass
class Faults:
    """What may go wrong on the line; all off by default."""

    silent: bool = False
    """Requests are read and not answered."""
    delay: float = 0.0
    """Every answer comes this much later, s of host time."""
    corrupt: bool = False
    """One bit of every answer is flipped."""
    truncate: bool = False
    """Only the first half of every answer is sent."""
    split: bool = False
    """Answers arrive in two pieces 5 ms apart."""
    garbage: bytes = b""
    """Sent in front of every answer."""
    freeze: bool = False
    """The device's physics stands still; it still answers."""
    skew: float = 1.0
    """The device's own time runs so much faster than the rig's."""
    echo: bool = False
    """The adapter returns all that is sent."""
    replay: bool = False
    """Every answer is the one before it."""
    extra: dict[str, object] = field(default_factory=dict)
    """Faults of one instrument, by name (its module lists them)."""

    def disturbed(self, answer: bytes, random: random.Random) -> bytes:
        """The bytes that arrive of an answer, for any line: empty where it is silent, else corrupt, cut or behind garbage."""
        if self.corrupt and answer:
            i = random.randrange(len(answer))
            answer = answer[:i] + bytes([answer[i] ^ (1 << random.randrange(7))]) + answer[i + 1 :]
        if self.truncate:
            answer = answer[: len(answer) // 2]
        return b"" if self.silent else self.garbage + answer


KEPT: Mapping[str, type] = {"clock": RigClock, "faults": Faults, "random": random.Random}
"""Attributes of `PtyFake` that a subclass may not use for something else."""


class Device:
    """State and physics of one instrument, without any wire."""

    def process(self, dt: float) -> None:
        """Advance by dt seconds of rig time."""


class PtyFake(timing.Thread):
    """One pty whose complete requests go to `feed`, which answers with `send`."""

    own_faults: ClassVar[Mapping[str, tuple[str, Any]]] = {}
    """Faults of `faults.FAULTS`: name in `faults.extra` and value."""
    checked: ClassVar[slice | None] = None
    """Where answers carry a checksum: the bytes that it covers, without itself, such as slice(0, -3) before two hexadecimal
    digits and CR. The driver contract then demands that the driver verifies it."""

    def __init__(self, name: str, clock: RigClock, baud: int, seed: int = 0) -> None:
        """`baud`: bits/s of the line; `seed`: of `random`, for noise."""
        super().__init__(name=f"fake-{name}", daemon=True)
        self.clock = clock
        self.byte_time = 10 / baud / clock.speed
        self.faults = Faults()
        self.ended_by: Exception | None = None
        """The error in the fake's own code by which its thread ended."""
        self.random = random.Random(seed)
        self.buffer = b""
        self.heard = 0
        """Bytes that have come since the start."""
        self.requests: deque[bytes] = deque(maxlen=10_000)
        """Complete requests in the order they came, for tests; each fake's `feed` appends its own."""
        self.lock = timing.RLock()
        self._cable = timing.made(PtyLine, name)
        self._running = True
        self.plug()
        self._quiet_until = 0.0
        self._last_answer = b""
        self._last_process = clock.now()

    @property
    def port(self) -> str:
        """Path that a driver opens; there is nothing at it while the cable is out."""
        return self._cable.port

    def __setattr__(self, name: str, value: Any) -> None:
        """Refuse another thing under one of the names `KEPT`."""
        if not isinstance(value, KEPT.get(name, object)):
            raise TypeError(f"{type(self).__name__}.{name} = {value!r}: PtyFake has a {KEPT[name].__name__} there; rename yours")
        super().__setattr__(name, value)

    # -- plug and power
    def plug(self) -> None:
        """Make the line, after `unplug` a new one behind the same path."""
        with self.lock:
            if self._running and not self._cable.plugged:
                self._cable.plug()

    def unplug(self) -> None:
        """Pull the cable out: the port is gone, the device goes on."""
        with self.lock:
            self._cable.unplug()
            self.buffer = b""

    def reset(self, silence: float = 0.3) -> None:
        """Lose power for an instant; silent for `silence` s of host time."""
        with self.lock:
            self.buffer = b""
            self._quiet_until = timing.now() + silence
            self.restart()

    def restart(self) -> None:
        """Forget volatile state."""

    def panel(self, *change: Any) -> bool:
        """Change a setting at the panel; False when it is locked."""
        raise ValueError(f"{self.name} has no panel")

    # -- to be written by each fake
    def feed(self) -> bool:
        """Take a complete request from `self.buffer` and answer it by `send`; False when there is none."""
        raise NotImplementedError

    def process(self, dt: float) -> None:
        """Advance the device by dt s of rig time."""

    def idle(self) -> float | None:
        """May send by itself; returns host seconds until the next call (None: 20 ms)."""
        return None

    def begin(self, fault: str) -> Callable[[], None] | None:
        """Begin a fault; returns what ends it."""
        return None

    # -- the line
    def send(self, answer: bytes, line_time: bool = True) -> None:
        """Put an answer on the line, through the faults, at line speed unless `line_time` is False."""
        f = self.faults
        if f.silent or timing.now() < self._quiet_until:
            return
        answer, self._last_answer = self._last_answer if f.replay else answer, answer
        if f.delay:
            timing.sleep(f.delay)
        answer = f.disturbed(answer, self.random)
        if line_time:
            timing.sleep(len(answer) * self.byte_time)
        pieces = [answer[: len(answer) // 2], answer[len(answer) // 2 :]] if f.split else [answer]
        for i, piece in enumerate(pieces):
            if i:
                timing.sleep(0.005)
            self._cable.write(piece)

    def run(self) -> None:
        """Advance the device and answer what comes, until stopped; an error in the fake's own code pulls the cable out."""
        try:
            self._until_stopped()
        except Exception as error:
            self.ended_by = error
            self.unplug()
            raise

    def _until_stopped(self) -> None:
        punctual()
        wait: float | None = None
        while self._running:
            try:
                ready = self._cable.await_bytes(0.02 if wait is None else wait)
            except OSError:
                continue  # unplugged meanwhile
            with self.lock:
                self._advance()
                if ready and self._cable.plugged:
                    try:
                        data = self._cable.read()
                    except OSError:
                        continue
                    self.heard += len(data)
                    timing.sleep(len(data) * self.byte_time)
                    if self.faults.echo:
                        self._cable.write(data)
                    self.buffer += data
                    while self.feed():
                        pass
                wait = self.idle()

    def _advance(self) -> None:
        now = self.clock.now()
        dt, self._last_process = now - self._last_process, now
        if not self.faults.freeze:
            self.process(dt * self.faults.skew)

    def stop(self) -> None:
        """End the thread and close the line."""
        self._running = False
        if self.is_alive():
            self.join(1.0)
        self._cable.close()
