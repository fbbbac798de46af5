"""A real instrument is never late because a computer is busy; a fake asks for the processor before others, where it may."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from pathlib import Path

PRIORITY = -10
SESSION = -20
"""Of a fake's own session among the others: Linux schedules by session first (sched(7), autogroup)."""
LATE = 0.1
"""Host s between two looks beyond which a fake was not awake: it did not hear what came meanwhile."""


def punctual() -> None:
    """Put the calling thread (Linux) before others. Without CAP_SYS_NICE the system says no, and all stays as it is."""
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), PRIORITY)


def punctual_session() -> None:
    """The same for a process that leads a session of its own, as a fake does that is a process."""
    punctual()
    if os.getsid(0) == os.getpid():
        with contextlib.suppress(OSError):
            Path("/proc/self/autogroup").write_text(str(SESSION), encoding="ascii")


class Silence:
    """How long nobody has spoken, host s, as a device's watchdog counts it: a device is always awake, a fake is not."""

    def __init__(self) -> None:
        self._seconds, self._looked = 0.0, time.monotonic()

    def heard(self) -> None:
        """Somebody has spoken."""
        self._seconds, self._looked = 0.0, time.monotonic()

    def now(self) -> float:
        """Seconds of silence; to be asked again and again."""
        now = time.monotonic()
        self._seconds += min(now - self._looked, LATE)
        self._looked = now
        return self._seconds
