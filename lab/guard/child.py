"""Child processes: how each is started and set up, and how it ended.

A child runs in a session of its own, imports nothing from the folder in which it is started, and leaves the terminal's signals
to its program, which ends it. The starting program sets its priority before it imports anything: processes that hold
instruments come first.
"""

from __future__ import annotations

import contextlib
import math
import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import timing

from ..priority import FIRST, Priority, put_in_place

Child = subprocess.Popen[bytes]
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Those that a terminal sends to everybody; a child must not even see them while it starts."""


def start_child(module: str, passed: Sequence[int] = (), *more: str, place: Priority = FIRST, **streams: Any) -> Child:
    """Start `python -m MODULE FD .. MORE ..`, which inherits the file descriptors `passed`; `streams` as of `Popen`."""
    return timing.made(new_process, module, passed, more, place, streams)


def new_process(module: str, passed: Sequence[int], more: Sequence[str], place: Priority, streams: Mapping[str, Any]) -> Child:
    command = [sys.executable, "-P", "-m", module, *map(str, passed), *more]
    child = subprocess.Popen(command, pass_fds=passed, start_new_session=True, **{"stdin": subprocess.DEVNULL, **streams})
    put_in_place(child.pid, place)
    return child


def end_child(process: Child, within: float) -> None:
    """Wait for a process to end; kill it after `within` host seconds."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(within)
    process.kill()
    process.wait(5.0)


def how_it_ended(process: Child, within: float | None = None) -> str:
    """In words, after at most `within` host seconds."""
    code = process.wait(within)
    return f"signal {-code} ({signal.Signals(-code).name})" if code < 0 else f"code {code}"


def processor_time(process: Child) -> float:
    """Processor seconds that a process has used; NaN if the system does not say."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        ticks = Path(f"/proc/{process.pid}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()[11:13]
        return sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")
    return math.nan


def begin_child() -> list[int]:
    """What a child that holds instruments does first; returns the file descriptors that it was given."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    return [int(given) for given in sys.argv[1:]]
