"""The lock of a line on which a stop goes before everything else.

An ordinary exchange may wait for a silent unit for a second and more. A stop must not: it says that it waits, the exchange
under way gives up at its next look at the line (20 ms at most), and nobody else gets the line before the stop had it.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator

import timing

from .errors import NoReply

SLICE = 0.02
"""Host seconds between two looks whether a stop waits."""


class StopFirst:
    """A lock, taken by `with lock:` for ordinary exchanges and by `with lock.stopping():` for a stop. Re-entrant."""

    def __init__(self, name: str) -> None:
        """`name` of the instrument, for messages."""
        self.name = name
        self._lock = timing.RLock()
        self._count = timing.Lock()
        self._stops = 0
        self._stopping: int | None = None
        """Thread whose stop has the line."""

    def __enter__(self) -> StopFirst:
        self._lock.acquire()
        return self

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    @contextlib.contextmanager
    def stopping(self) -> Iterator[None]:
        """Have the line for a stop; what is under way there ends with NoReply."""
        with self._count:
            self._stops += 1
        try:
            with self._lock:
                before, self._stopping = self._stopping, threading.get_ident()
                try:
                    yield
                finally:
                    self._stopping = before
        finally:
            with self._count:
                self._stops -= 1

    def give_way(self) -> None:
        """Raises NoReply when a stop waits and the caller is not that stop."""
        if self._stops and self._stopping != threading.get_ident():
            raise NoReply(self.name, "cancelled by a stop; repeat it when the stop is done")

    def sleep(self, duration: float) -> None:
        """Wait, host seconds; raises NoReply as soon as a stop wants the line."""
        end = timing.now() + duration
        while (left := end - timing.now()) > 0:
            self.give_way()
            timing.sleep(min(SLICE, left))
