"""A real instrument is never late because a computer is busy; a fake asks for the processor before others, where it may."""

from __future__ import annotations

import contextlib
import os
import threading

import timing

PRIORITY = -10
LATE = 0.1
"""Host s between two looks beyond which a fake was not awake: it did not hear what came meanwhile."""


def punctual(process: int | None = None) -> None:
    """Put the calling thread (Linux), or a process just started, before others, as far as the system lets it."""
    if timing.together():
        return
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, process or threading.get_native_id(), PRIORITY)


class Silence:
    """How long nobody has spoken, host s, as a device's watchdog counts it: a device is always awake, a fake is not."""

    def __init__(self) -> None:
        self._seconds, self._looked = 0.0, timing.now()

    def heard(self) -> None:
        """Somebody has spoken."""
        self._seconds, self._looked = 0.0, timing.now()

    def now(self) -> float:
        """Seconds of silence; to be asked again and again."""
        now = timing.now()
        self._seconds += min(now - self._looked, LATE)
        self._looked = now
        return self._seconds
