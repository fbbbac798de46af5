"""The protocol's heartbeat and urgent messages: fixed records on a pipe that nothing else uses.

A thread sends a beat every 0.1 s with the time since the experiment last moved on. A frozen process sends none; a hung
experiment shows in that time. A stop is one record too, so that a signal handler or a sensor's thread can send it
without waiting for anything: records are written whole and never mix.
"""

from __future__ import annotations

import contextlib
import os
import struct
from collections.abc import Callable, Iterator

import timing

LONGEST_LOOK = 0.3
"""Host seconds between two looks that still count in full."""


class Awake:
    """Time that this process was awake to see; advanced by `look`, from one thread, and read from any.

    A process that was stopped (SIGSTOP, a paused virtual machine, a computer without a free core) finds a silence when it
    wakes that says nothing about its partner: it was itself away. Silence is therefore measured on a clock that advances with
    each look, and by no more than a look may take.
    """

    def __init__(self, host: Callable[[], float] = timing.now) -> None:
        """`host`: the host's time, s."""
        self._host = host
        self._now = 0.0
        self._looked = host()

    def look(self) -> float:
        """The process is awake; returns the time awake, s."""
        now = self._host()
        self._now += min(LONGEST_LOOK, now - self._looked)
        self._looked = now
        return self._now

    @property
    def now(self) -> float:
        """Seconds awake, as of the last look."""
        return self._now


RECORD = struct.Struct("<cd")
BEAT, SIGNAL, FORCE, MOMENT = b"B", b"S", b"F", b"M"
"""Kinds: age of the last step (s), signal number, force (N) or moment (N m) beyond the limit."""
FORCE_RANGE, MOMENT_RANGE, FRESH = b"f", b"m", b"W"
"""More kinds: raw force (N) or moment (N m) beyond the sensor's range; a sample of it has come (host time, s)."""
PERIOD = 0.1


class Pulse:
    """The sending end; owns the pipe."""

    def __init__(self, pipe: int) -> None:
        os.set_blocking(pipe, False)
        self._pipe = pipe
        self.awake = Awake()
        """Clock that runs only while this process is awake; silences and long steps are measured on it."""
        self._last_step = self.awake.now
        """When the experiment last moved on, s of `awake`."""
        self._waits = 0
        """How many `waiting_for_person` are entered: they nest."""
        self._ended = timing.Event()
        self._thread = timing.Thread(target=self._beat, name="pulse", daemon=True)
        self._thread.start()

    def mark(self) -> None:
        """The experiment has moved on."""
        self._last_step = self.awake.now

    @property
    def waiting(self) -> bool:
        """True while the protocol waits for a person."""
        return self._waits > 0

    @contextlib.contextmanager
    def waiting_for_person(self) -> Iterator[None]:
        """While this is entered the guard does not count the time as a hang."""
        self._waits += 1
        try:
            yield
        finally:
            self._waits -= 1
            self.mark()

    def send(self, kind: bytes, value: float) -> None:
        """Send one record now; never waits, never raises. If the pipe breaks or falls silent the guard lands the rig anyway."""
        with contextlib.suppress(OSError):
            os.write(self._pipe, RECORD.pack(kind, value))

    def close(self) -> None:
        """End; the guard takes it for the program's death unless it was told to end before."""
        self._ended.set()
        self._thread.join(1.0)
        os.close(self._pipe)

    def _beat(self) -> None:
        while not self._ended.wait(PERIOD):
            now = self.awake.look()
            self.send(BEAT, 0.0 if self._waits else now - self._last_step)


class Listener:
    """The receiving end, in the guard."""

    def __init__(self, pipe: int) -> None:
        os.set_blocking(pipe, False)
        self.pipe = pipe
        self.gone = False
        """True once the other end is closed: the program has ended."""
        self._rest = b""

    def close(self) -> None:
        """Hear no more."""
        os.close(self.pipe)

    def take(self) -> list[tuple[bytes, float]]:
        """All records that have come since the last call: kind (see BEAT ..) and its value. Never waits; notes when the sender is
        `gone`. A record of which only a part has come is kept for the next call."""
        try:
            data = os.read(self.pipe, 65536)
        except BlockingIOError:  # nothing has come
            return []
        except OSError:
            data = b""
        if not data:  # the other end is closed
            self.gone = True
            return []
        self._rest += data
        whole = len(self._rest) // RECORD.size * RECORD.size
        records, self._rest = list(RECORD.iter_unpack(self._rest[:whole])), self._rest[whole:]
        return records
