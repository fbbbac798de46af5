"""The protocol's sign of life, and what it may shout: fixed records on a pipe that nothing else uses.

A thread sends a beat every 0.1 s with the time since the experiment last moved on. A frozen process sends none; a hung
experiment is told by that time. A stop is one record too, so that a signal handler or a sensor's thread can send it
without waiting for anything: records are written whole and never mix.
"""

from __future__ import annotations

import contextlib
import os
import struct
import threading
from collections.abc import Iterator

from .awake import Awake

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
        """Time that this process was awake: what a silence, or a step that takes long, is measured on."""
        self._last = self.awake.now
        self._held = 0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._beat, name="pulse", daemon=True)
        self._thread.start()

    def mark(self) -> None:
        """The experiment has moved on."""
        self._last = self.awake.now

    @property
    def waiting(self) -> bool:
        """True while a person is waited for."""
        return self._held > 0

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """Waiting for a person: takes as long as it takes."""
        self._held += 1
        try:
            yield
        finally:
            self._held -= 1
            self.mark()

    def shout(self, kind: bytes, value: float) -> None:
        """Send one record now; never waits, never raises. The guard lands when the pipe breaks or falls silent anyway."""
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
            self.shout(BEAT, 0.0 if self._held else now - self._last)


class Listener:
    """The receiving end, in the guard."""

    def __init__(self, pipe: int) -> None:
        os.set_blocking(pipe, False)
        self.pipe = pipe
        self.gone = False
        """True once the other end is closed: the program has ended."""
        self._rest = b""

    def take(self) -> list[tuple[bytes, float]]:
        """All records that have come."""
        try:
            data = os.read(self.pipe, 65536)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data:
            self.gone = True
            return []
        self._rest += data
        whole = len(self._rest) // RECORD.size * RECORD.size
        records, self._rest = list(RECORD.iter_unpack(self._rest[:whole])), self._rest[whole:]
        return records
