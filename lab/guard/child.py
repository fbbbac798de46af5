"""Processes of ours: how each is started, what it begins with, and how it ended.

A child leads a session of its own, imports no file of the folder that it is started in, and leaves the signals of the
terminal to its program, which ends it. Those that hold instruments come first on a busy computer.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, cast

import timing

PRIORITY = -10
"""Of the process among those of its session (nice)."""
SESSION = -20
"""Of its session among the others: Linux schedules by session (sched(7), autogroup), whatever the nice of what runs in it."""


HOLDERS = {"lab.guard.process", "lab.guard.hosted", "lab.rig.hosted_stream"}
"""Modules whose processes hold instruments, and share the clock of the program that starts them."""
Child = subprocess.Popen[bytes]


class Lodger:
    """A child that is a thread of this process, since it shares a simulated clock with it; used as a `Popen`."""

    returncode = 0

    def __init__(self, module: str, given: list[int]) -> None:
        self.pid = os.getpid()
        serve = importlib.import_module(module).serve
        self._thread = timing.Thread(target=serve, args=(given,), name=module)
        self._thread.start()

    def poll(self) -> int | None:
        """See Popen."""
        return None if self._thread.is_alive() else self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """See Popen."""
        self._thread.join(timeout)
        if self._thread.is_alive():
            raise subprocess.TimeoutExpired(self._thread.name, timeout or 0.0)
        return self.returncode

    def kill(self) -> None:
        """Nothing: a thread ends when its pipes do."""


def start_child(module: str, passed: Sequence[int] = (), *more: str, **streams: Any) -> Child:
    """Start `python -m MODULE FD .. MORE ..`, which inherits the file descriptors `passed`; `streams` as of `Popen`."""
    if timing.together() and module in HOLDERS:
        return cast(Child, Lodger(module, [os.dup(one) for one in passed]))
    command = [sys.executable, "-P", "-m", module, *map(str, passed), *more]
    return subprocess.Popen(
        command, pass_fds=passed, start_new_session=True, **{"stdin": subprocess.DEVNULL, **streams}
    )


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
