"""A real instrument is never late because a computer is busy; a fake asks for the processor before others, where it may."""

from __future__ import annotations

import contextlib
import os
import threading

PRIORITY = -10


def punctual() -> None:
    """Put the calling thread (Linux) before others. Without CAP_SYS_NICE the system says no, and all stays as it is."""
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), PRIORITY)
