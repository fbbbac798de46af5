"""The host's time and all that waits on it: one clock for drivers, fakes, guard, rig and protocols.

A program runs on the host's own clock. `tests.simulated.clock.SimulatedClock` replaces it for the threads that live in
it: its time stands still while any of them computes, and jumps to the earliest deadline when all of them wait. What a thread
makes here (`Event`, `Lock`, `Thread` ...) belongs to the clock that the thread lives in.
"""

from __future__ import annotations

import contextlib
import math
import os
import queue
import select
import selectors
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar

Made = TypeVar("Made")


class Clock(Protocol):
    """The time of the rig (s); real instruments run at the pace of the host, a sped-up rig runs faster."""

    speed: float
    """Seconds of it that pass in one of the host's."""

    def now(self) -> float:
        """Time since the clock was made, s."""

    def sleep(self, duration: float) -> None:
        """Wait for `duration` seconds of this clock."""


class Host(Protocol):
    """A source of the host's time, and of what waits on it."""

    stand_ins: Mapping[Callable[..., Any], Callable[..., Any]]
    """What is made here in place of what keeps the system's own time, such as a pty or a process."""

    def now(self) -> float:
        """Monotonic time, s."""

    def sleep(self, duration: float) -> None:
        """Wait, s."""

    def wait(self, condition: Callable[[], bool], until: float) -> bool:
        """Wait until the condition holds, or `until` this time; returns whether it holds. It is looked at by any thread."""

    def readable(self, lines: Sequence[Any], longest: float) -> list[Any]:
        """Which of these sockets and file descriptors can be read, after at most `longest` s."""

    def event(self) -> threading.Event:
        """Make an event."""

    def lock(self) -> threading.Lock:
        """Make a lock."""

    def rlock(self) -> threading.RLock:
        """Make a re-entrant lock."""

    def condition(self) -> threading.Condition:
        """Make a condition variable."""

    def queue(self) -> queue.Queue[Any]:
        """Make a queue."""

    def start(self, thread: Thread) -> None:
        """Start a thread, which lives in this clock."""

    def join(self, thread: Thread, timeout: float | None) -> None:
        """Wait for the end of a thread."""


def readable_now(lines: Sequence[Any]) -> list[Any]:
    """Which of these can be read without waiting, or have ended."""
    poll = select.poll()
    for line in lines:
        poll.register(line, select.POLLIN)
    ready = {number for number, _ in poll.poll(0)}
    return [line for line in lines if (line if isinstance(line, int) else line.fileno()) in ready]


class _Real:
    """The clock of the computer."""

    stand_ins: Mapping[Callable[..., Any], Callable[..., Any]] = {}

    def now(self) -> float:
        return time.monotonic()

    def sleep(self, duration: float) -> None:
        time.sleep(max(0.0, duration))

    def wait(self, condition: Callable[[], bool], until: float) -> bool:
        while not condition():
            if time.monotonic() > until:
                return False
            time.sleep(0.005)
        return True

    def readable(self, lines: Sequence[Any], longest: float) -> list[Any]:
        # not select or poll, which keep a line open that another thread closes meanwhile
        try:
            selector: selectors.BaseSelector = selectors.DefaultSelector()
        except OSError:  # it takes a file descriptor, and none is left; a guard must hear all the same
            selector = selectors.PollSelector()
        with selector:
            for line in lines:
                selector.register(line, selectors.EVENT_READ)
            return [key.fileobj for key, _ in selector.select(None if longest == math.inf else max(0.0, longest))]

    def event(self) -> threading.Event:
        return threading.Event()

    def lock(self) -> threading.Lock:
        return threading.Lock()

    def rlock(self) -> threading.RLock:
        return threading.RLock()

    def condition(self) -> threading.Condition:
        return threading.Condition()

    def queue(self) -> queue.Queue[Any]:
        return queue.Queue()

    def start(self, thread: Thread) -> None:
        threading.Thread.start(thread)

    def join(self, thread: Thread, timeout: float | None) -> None:
        threading.Thread.join(thread, timeout)


_REAL: Host = _Real()
_LIVES_IN = threading.local()


def host() -> Host:
    """The clock that this thread lives in."""
    clock: Host = getattr(_LIVES_IN, "host", _REAL)
    return clock


def live_in(clock: Host | None) -> Host | None:
    """This thread lives in a clock from now on (None: in that of the computer); returns the one before."""
    previous: Host | None = getattr(_LIVES_IN, "host", None)
    _LIVES_IN.host = clock or _REAL
    return previous


class Thread(threading.Thread):
    """A thread that lives in the clock of the thread that makes it."""

    def __init__(
        self,
        target: Callable[..., object] | None = None,
        name: str | None = None,
        args: Iterable[Any] = (),
        kwargs: Mapping[str, Any] | None = None,
        daemon: bool = True,
    ) -> None:
        super().__init__(target=target, name=name, args=args, kwargs=kwargs, daemon=daemon)
        self.lives_in = host()
        self.over = False
        """It has ended, or is about to and does nothing more."""

    def is_alive(self) -> bool:
        """See threading.Thread."""
        return super().is_alive() and not self.over

    def start(self) -> None:
        """See threading.Thread."""
        self.lives_in.start(self)

    def join(self, timeout: float | None = None) -> None:
        """See threading.Thread; host seconds."""
        self.lives_in.join(self, timeout)


def now() -> float:
    """Monotonic time of the host, s."""
    return host().now()


def sleep(duration: float) -> None:
    """Wait, host seconds."""
    host().sleep(duration)


def wait(condition: Callable[[], bool], within: float) -> bool:
    """Wait until the condition holds; False when it does not within `within` host seconds."""
    return host().wait(condition, now() + within)


def made(kind: Callable[..., Made], *args: Any, **how: Any) -> Made:
    """Make one of this kind, or of what stands in for it in the clock that this thread lives in."""
    instance: Made = host().stand_ins.get(kind, kind)(*args, **how)
    return instance


def together() -> bool:
    """Whether what else is a process of its own, or behind a line of the system, lives in this process with its clock."""
    return host() is not _REAL


BUSY = 2.0
"""Threads that want a processor, for each that there is, above which a computer is busy: each then waits as long as it works."""


def busy() -> str:
    """That this computer is busy, and how; empty where it is not, and in a clock that stands still while anything computes."""
    if together():
        return ""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    load = os.getloadavg()[0]  # the mean of a minute, in which a computer that has just become busy hardly shows
    with contextlib.suppress(OSError, ValueError, IndexError):
        load = max(load, float(Path("/proc/loadavg").read_text().split()[3].partition("/")[0]))
    return f"this computer is busy: load {load:.0f} on {cores} core{'s' * (cores > 1)}" if load > BUSY * cores else ""


def busy_or(remedy: str) -> str:
    """What to do about a silence or an age that is too long: on a busy computer other programs come before `remedy`."""
    reason = busy()
    return f"{reason}, end other programs; if that does not help, {remedy}" if reason else remedy


def recv(line: Any, size: int) -> bytes:
    """What a socket receives within its time-out. Raises OSError."""
    within = line.gettimeout()
    if not readable([line], math.inf if within is None else within):
        raise TimeoutError("timed out")
    data: bytes = line.recv(size)
    return data


def receive(pipe: Any) -> Any:
    """The next message of a connection of multiprocessing. Raises EOFError, OSError."""
    readable([pipe], math.inf)
    return pipe.recv()


def readable(lines: Sequence[Any], longest: float) -> list[Any]:
    """Which of these sockets and file descriptors can be read, after at most `longest` host seconds."""
    return host().readable(lines, longest)


def Event() -> threading.Event:  # noqa: N802 (they stand for the classes of threading and queue)
    """An event."""
    return host().event()


def Lock() -> threading.Lock:  # noqa: N802
    """A lock."""
    return host().lock()


def RLock() -> threading.RLock:  # noqa: N802
    """A re-entrant lock."""
    return host().rlock()


def Condition() -> threading.Condition:  # noqa: N802
    """A condition variable with a lock of its own."""
    return host().condition()


def Queue() -> queue.Queue[Any]:  # noqa: N802
    """A queue without a bound."""
    return host().queue()


class RigClock:
    """The rig's time: that of the host since `start`, multiplied by a speed when the whole rig runs faster than real."""

    def __init__(self, speed: float = 1.0, start: float | None = None) -> None:
        """`start`: a value of `now()`, which is the same in every process of the host. Raises ValueError."""
        if not speed > 0:
            raise ValueError(f"speed factor {speed} must be above 0")
        self.speed = speed
        self.start = now() if start is None else start

    def now(self) -> float:
        """Rig time, s."""
        return (now() - self.start) * self.speed

    def sleep(self, duration: float) -> None:
        """Wait `duration` seconds of rig time."""
        sleep(max(0.0, duration) / self.speed)
