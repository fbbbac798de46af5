"""A clock for the threads of one process that jumps over the time in which all of them wait.

One thread runs at a time, until it waits; the next is the first in the order of waiting whose condition holds. When no
condition holds, time jumps to the earliest deadline. So a run takes only its computation, and its events come in the
same order on any computer under any load. The model is the clock of trio's tests.

A thread that lives in no such clock may set what is waited for, and must not wait for it.
"""

import math
import os
import queue
import select
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Any, ClassVar, Self, cast

from lab.guard.child import new_process
from sim_fakes.pty_fake import PtyLine
from sim_fakes.ur.process import UrProcess
from timing import Host, Thread, live_in, readable_now

from .lodger import started
from .memory_line import MemoryLine

START = 1000.0
"""Its first time, s: what never happened lies before."""
TICK = 1e-9
"""s that a look at the clock takes: who waits for a time that rounding has put a little later must reach it."""
STUCK_AFTER = 20.0
"""Real s for which all threads may wait without a deadline: something outside may end that."""


CORES = sorted(os.sched_getaffinity(0))
CORE = CORES[int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")) % len(CORES)]
"""Of all threads that live in such a clock: since one of them runs at a time, more cores only make handing over slower."""


class Deadlock(RuntimeError):
    """All threads wait, and none has a deadline."""


class Stopped(BaseException):
    """The clock was closed: the thread ends."""


def _never() -> bool:
    """The condition of a sleeper."""
    return False


def _always() -> bool:
    """The condition of who waits for file descriptors alone."""
    return True


class _Waiter:
    """A thread that waits."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.condition: Callable[[], bool] = bool
        self.until = math.inf
        self.numbers: tuple[int, ...] = ()
        """File descriptors of which one must be readable before its condition is looked at."""
        self.failure: Deadlock | None = None
        self.turn = threading.Lock()
        self.turn.acquire()

    def holds(self) -> bool:
        """Whether it may go on; what its condition raises, it shall see itself."""
        try:
            return bool(self.condition())
        except Exception:  # noqa: BLE001
            return True


def _arm(*args: Any, **how: Any) -> Any:
    from .arm_thread import UrThread  # with the maker's library

    return UrThread(*args, **how)


class SimulatedClock:
    """A `timing.Host`. Enter it to live in it: `with clock: ..`. It may be left and entered again, and stands still meanwhile."""

    stand_ins: ClassVar = {PtyLine: MemoryLine, UrProcess: _arm, new_process: started}

    def __init__(self) -> None:
        self._now = START
        self._waiting: deque[_Waiter] = deque()
        self._mine = threading.local()
        self._closed = False
        self._threads: list[Thread] = []
        self._before: list[Host | None] = []
        self._poll = select.poll()
        self._polled: Counter[int] = Counter()
        """Who waits for a file descriptor, how many."""

    # -- who lives in it
    def __enter__(self) -> Self:
        os.sched_setaffinity(0, {CORE})
        self._before.append(live_in(self))
        if not hasattr(self._mine, "waiter"):
            self._mine.waiter = _Waiter(threading.current_thread().name)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        live_in(self._before.pop())
        if not self._before:
            os.sched_setaffinity(0, CORES)

    def close(self) -> None:
        """End all threads that still live in it, for good."""
        self._closed = True
        for waiter in self._waiting:
            waiter.turn.release()
        for thread in self._threads:
            threading.Thread.join(thread, 1.0)

    def start(self, thread: Thread) -> None:
        run, waiter = thread.run, _Waiter(thread.name)

        def live() -> None:
            live_in(self)
            self._mine.waiter = waiter
            waiter.turn.acquire()
            try:
                if not self._closed:
                    run()
            except Stopped:
                pass
            finally:
                thread.over = True
                if not self._closed:
                    self._pass_on()

        waiter.condition = _always
        self._waiting.append(waiter)
        self._threads = [t for t in self._threads if t.is_alive()] + [thread]
        thread.run = live  # type: ignore[method-assign]
        threading.Thread.start(thread)

    def join(self, thread: Thread, timeout: float | None) -> None:
        self.wait(lambda: thread.over or thread.ident is None, math.inf if timeout is None else self._now + timeout)

    # -- waiting
    def now(self) -> float:
        self._now += TICK
        return self._now

    def sleep(self, duration: float) -> None:
        # who sleeps no time at all would keep it from going on
        self.wait(_never, self._now + max(1e-6, duration))

    def wait(self, condition: Callable[[], bool], until: float = math.inf) -> bool:
        """See Host. Raises Deadlock when nothing can happen any more."""
        if self._closed:
            raise Stopped
        if condition():
            return True
        self._suspend(condition, until)
        return condition()

    def _suspend(self, condition: Callable[[], bool], until: float, numbers: tuple[int, ...] = ()) -> None:
        """Let others run until it is this thread's turn again."""
        me: _Waiter | None = getattr(self._mine, "waiter", None)
        if me is None:
            raise RuntimeError(f"{threading.current_thread().name} does not live in this clock, so it must not wait on it")
        me.condition, me.until, me.numbers = condition, until, numbers
        self._waiting.append(me)
        self._watch(numbers, 1)
        try:
            self._pass_on(me)
        finally:
            self._watch(numbers, -1)
        if me.failure is not None:
            failure, me.failure = me.failure, None
            raise failure

    def _pass_on(self, me: _Waiter | None = None) -> None:
        """Let the next thread run; returns when it is this one's turn again (None: it ends)."""
        chosen = self._next()
        if chosen is me:
            return
        chosen.turn.release()
        if me is None:
            return
        try:
            me.turn.acquire()
        except BaseException:  # a signal's handler has raised: it goes on from here, in its turn
            me.condition, me.numbers = _always, ()
            me.turn.acquire()
            raise
        if self._closed:
            raise Stopped

    def _watch(self, numbers: tuple[int, ...], more: int) -> None:
        for number in numbers:
            self._polled[number] += more
            if more > 0 and self._polled[number] == 1:
                self._poll.register(number, select.POLLIN)
            elif not self._polled[number]:
                self._poll.unregister(number)

    def _next(self) -> _Waiter:
        stuck = 0.0
        while True:
            ready = {number for number, _ in self._poll.poll(0)}
            first, until = None, math.inf
            for waiter in self._waiting:
                asleep = waiter.condition is _never or (waiter.numbers and ready.isdisjoint(waiter.numbers))
                if not asleep and waiter.holds():
                    self._waiting.remove(waiter)
                    return waiter
                if waiter.until < until:
                    first, until = waiter, waiter.until
            if first is not None:
                self._now = max(self._now, until)
                self._waiting.remove(first)
                return first
            time.sleep(0.001)  # something outside may yet come
            stuck += 0.001
            if stuck > STUCK_AFTER:
                names = ", ".join(w.name for w in self._waiting)
                told = next((w for w in self._waiting if w.name == threading.main_thread().name), self._waiting[0])
                told.failure = Deadlock(f"all threads wait without a deadline: {names}")
                self._waiting.remove(told)
                return told

    def readable(self, lines: Sequence[Any], longest: float) -> list[Any]:
        if self._closed:
            raise Stopped
        if found := readable_now(lines):
            return found
        numbers = tuple(line if isinstance(line, int) else line.fileno() for line in lines)
        self._suspend(_always if numbers else _never, self._now + max(0.0, longest), numbers)
        return readable_now(lines)

    # -- what waits on it
    def event(self) -> threading.Event:
        return cast(threading.Event, _Event(self))

    def lock(self) -> threading.Lock:
        return cast(threading.Lock, _Lock(self, again=False))

    def rlock(self) -> threading.RLock:
        return cast(threading.RLock, _Lock(self, again=True))

    def condition(self) -> threading.Condition:
        return cast(threading.Condition, _Condition(self))

    def queue(self) -> queue.Queue[Any]:
        return cast("queue.Queue[Any]", _Queue(self))

    def _end(self, timeout: float | None) -> float:
        return math.inf if timeout is None or timeout < 0 else self._now + timeout


class _Event:
    """See threading.Event."""

    def __init__(self, clock: SimulatedClock) -> None:
        self._clock, self._set = clock, False

    def is_set(self) -> bool:
        return self._set

    def set(self) -> None:
        self._set = True

    def clear(self) -> None:
        self._set = False

    def wait(self, timeout: float | None = None) -> bool:
        return self._clock.wait(self.is_set, self._clock._end(timeout))


class _Lock:
    """See threading.Lock and threading.RLock."""

    def __init__(self, clock: SimulatedClock, again: bool) -> None:
        self._clock, self._again = clock, again
        self._owner, self._count = 0, 0

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        me = threading.get_ident()
        if self._again and self._owner == me:
            self._count += 1
            return True
        if self._count and not blocking:
            return False
        if not self._clock.wait(lambda: not self._count, self._clock._end(timeout)):
            return False
        self._owner, self._count = me, 1
        return True

    def release(self) -> None:
        if not self._count:
            raise RuntimeError("release of a lock that nobody has")
        self._count -= 1
        if not self._count:
            self._owner = 0

    def locked(self) -> bool:
        return self._count > 0

    def __enter__(self) -> bool:
        return self.acquire()

    def __exit__(self, *_: object) -> None:
        self.release()


class _Condition(_Lock):
    """See threading.Condition: waiting needs no notice here, since every condition is looked at again."""

    def __init__(self, clock: SimulatedClock) -> None:
        super().__init__(clock, again=True)

    def wait_for(self, predicate: Callable[[], bool], timeout: float | None = None) -> bool:
        count, self._count = self._count, 0
        try:
            return self._clock.wait(predicate, self._clock._end(timeout))
        finally:
            self._clock.wait(lambda: not self._count)
            self._owner, self._count = threading.get_ident(), count

    def notify_all(self) -> None:
        """Nothing to do."""


class _Queue:
    """See queue.Queue."""

    def __init__(self, clock: SimulatedClock) -> None:
        self._clock = clock
        self._items: deque[Any] = deque()

    def put(self, item: Any) -> None:
        self._items.append(item)

    def get(self, block: bool = True, timeout: float | None = None) -> Any:
        if not self._clock.wait(lambda: bool(self._items), self._clock._end(timeout if block else 0.0)):
            raise queue.Empty
        return self._items.popleft()

    def get_nowait(self) -> Any:
        if not self._items:
            raise queue.Empty
        return self._items.popleft()

    def qsize(self) -> int:
        return len(self._items)

    def empty(self) -> bool:
        return not self._items
