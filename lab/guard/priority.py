"""First in line on a busy computer."""

from __future__ import annotations

import contextlib
import os
import sys
from pathlib import Path

PRIORITY = -10
"""Of the process among those of its session (nice)."""
SESSION = -20
"""Of its session among the others: Linux schedules by session (sched(7), autogroup), whatever the nice of what runs in it."""


def come_first() -> None:
    """Put this process, which leads a session of its own, and what it starts before others. Without CAP_SYS_NICE or
    RLIMIT_NICE the system says no, and nothing else changes."""
    take_place(SESSION, PRIORITY)


def take_place(session: int, niceness: int) -> None:
    """Of this process's session among the others, and of the process in it; who may not come forward stays where it is."""
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, niceness)
    if sys.platform == "linux":
        with contextlib.suppress(OSError):
            Path("/proc/self/autogroup").write_text(str(session), encoding="ascii")
