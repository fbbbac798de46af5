"""Time that this process was awake to see.

A process that was stopped (SIGSTOP, a paused virtual machine, a computer without a free core) finds a silence when it
wakes that says nothing about its partner: it was itself away. Silence is therefore measured on a clock that advances with
each look, and by no more than a look may take.
"""

from __future__ import annotations

from collections.abc import Callable

import timing

LONGEST_LOOK = 0.3
"""Host seconds between two looks that still count in full."""


class Awake:
    """Advanced by `look`, from one thread; read from any."""

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
