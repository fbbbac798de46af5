"""Processes of ours: how each is started, what it begins with, and how it ended.

A child leads a session of its own, imports no file of the folder that it is started in, and leaves the signals of the
terminal to its program, which ends it. Those that hold instruments come first on a busy computer.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import timing

PRIORITY = -10
"""Of the process among those of its session (nice)."""
SESSION = -20
"""Of its session among the others: Linux schedules by session (sched(7), autogroup), whatever the nice of what runs in it."""


Child = subprocess.Popen[bytes]


def start_child(module: str, passed: Sequence[int] = (), *more: str, **streams: Any) -> Child:
    """Start `python -m MODULE FD .. MORE ..`, which inherits the file descriptors `passed`; `streams` as of `Popen`."""
    return timing.made(new_process, module, passed, more, streams)


def new_process(module: str, passed: Sequence[int], more: Sequence[str], streams: Mapping[str, Any]) -> Child:
    command = [sys.executable, "-P", "-m", module, *map(str, passed), *more]
    return subprocess.Popen(command, pass_fds=passed, start_new_session=True, **{"stdin": subprocess.DEVNULL, **streams})


def start_served(module: str, first: object) -> tuple[Child, Connection]:
    """The same with a pipe, whose other end is the child's; `first` is the first message."""
    ours, theirs = Pipe()
    process = start_child(module, (theirs.fileno(),))
    theirs.close()
    ours.send(first)
    return process, ours


def how_it_ended(process: Child, within: float | None = None) -> str:
    """In words, after at most `within` host seconds."""
    code = process.wait(within)
    return f"signal {-code} ({signal.Signals(-code).name})" if code < 0 else f"code {code}"


def begin_child() -> list[int]:
    """What a child that holds instruments does first; returns the file descriptors that it was given."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    take_place(SESSION, PRIORITY)
    return [int(given) for given in sys.argv[1:]]


def take_place(session: int, niceness: int) -> None:
    """Of this process's session among the others, and of the process in it; without CAP_SYS_NICE or RLIMIT_NICE the system says
    no to who comes forward, and nothing else changes."""
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, niceness)
    if sys.platform == "linux":
        with contextlib.suppress(OSError):
            Path("/proc/self/autogroup").write_text(str(session), encoding="ascii")
