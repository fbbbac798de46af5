"""Work on processes of this machine, or on the workers of a Dask cluster.

Threads would share Python's lock, which half of the work of a diagnosis holds. Processes start at once, while this one prepares
the work, which then works beside them: each takes the next item that nobody has begun. A process that is lost costs time only:
what it had, and all that comes after, is done here. They end with this one, also when it is killed.
"""

from __future__ import annotations

import operator
import os
import pickle
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from multiprocessing import get_context, parent_process
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from typing import Any, TypeVar

import cloudpickle

from model.warm_up import warm_up

from .files.config import ConfigError

A = TypeVar("A")
B = TypeVar("B")

ONE_THREAD = "OPENBLAS_NUM_THREADS"
"""Of linear algebra: the processes share the processors already."""


class Processes:
    """Processes that wait for work."""

    def __init__(
        self, pool: ProcessPoolExecutor, feeders: ThreadPoolExecutor, folder: Path, first: Sequence[Future[bool]]
    ) -> None:
        self._pool, self._feeders, self._folder, self._first, self._lost = pool, feeders, folder, first, False
        self._do: object = None
        self._sent = 0

    def begun(self) -> None:
        """Wait until what they were to see to ahead is done; what fails there is met again here."""
        wait(self._first)

    @property
    def ready(self) -> bool:
        """Whether that is done."""
        return all(done.done() for done in self._first)

    def in_order(self, do: Callable[[A], B], items: Sequence[A]) -> Iterator[B]:
        """`do` for every item, in order. Raises what `do` raises.

        The processes begin at once, this one when it asks for a result. `do` is read by each process once, however much it holds:
        a method's object is sent as it is when it is first asked."""
        if self._lost:
            return map(do, items)
        if do != self._do:  # two methods are the same where their objects are
            self._do, self._sent = do, self._sent + 1
            with (self._folder / f"{self._sent}").open("wb") as sent:
                cloudpickle.dump(do, sent)  # what a person's file defines goes as a whole
        # One feeder for each process: what none of them has taken can still be done here.
        file = str(self._folder / f"{self._sent}")
        begun = [self._feeders.submit(lambda item: self._pool.submit(_done, file, item).result(), item) for item in items]
        return self._together(do, items, begun)

    def _together(self, do: Callable[[A], B], items: Sequence[A], begun: list[Future[B]]) -> Iterator[B]:
        """The results in order; while one is awaited, this process does the next items that no other has taken."""
        try:
            for place, item in enumerate(items):
                while not begun[place].done():
                    # what can be cancelled nobody has begun
                    free = next((k for k in range(place, len(items)) if begun[k].cancel()), None)
                    if free is None:  # all others are being done elsewhere: wait for this one
                        break
                    begun[free] = _here(do, items[free])
                try:
                    yield begun[place].result()
                except BrokenProcessPool:
                    self._lost = True
                    yield do(item)
        finally:
            for future in begun:
                future.cancel()


def _here(do: Callable[[A], B], item: A) -> Future[B]:
    """What is done here; an error waits for its turn."""
    done: Future[B] = Future()
    try:
        done.set_result(do(item))
    except Exception as e:
        done.set_exception(e)
    return done


FEW_ROWS = 25
"""Fewer are not worth sending anything elsewhere."""


@contextmanager
def for_case(workers: int | None) -> Iterator[Callable[[int], Callable[..., Iterator[Any]] | None]]:
    """Start processes for a case that is still to be read, as many as `workers` with this one, by default one for each core.
    Yields a function that takes the number of rows of the case and returns their `in_order`, or None where one process is as
    quick. Raises ConfigError.

    Kernels of the rod that are not compiled yet on this machine are compiled meanwhile, here and in the processes."""
    cores = workers if workers is not None else len(os.sched_getaffinity(0))
    if cores < 1:
        raise ConfigError(f"--workers {cores}: must be at least 1")
    if cores == 1:
        yield lambda rows: None
        return
    with processes(cores - 1, ("derivatives",)) as others:

        def of(rows: int) -> Callable[..., Iterator[Any]] | None:
            if warm_up(("rods",)):
                others.begun()
            return others.in_order if rows >= FEW_ROWS else None

        yield of


@contextmanager
def processes(count: int, ahead: Sequence[str] = (), niceness: int = 0) -> Iterator[Processes]:
    """Start `count` processes besides this one, `niceness` behind it in line; a person's Ctrl-C ends this process, which then
    ends them. `ahead`: parts of `model.warm_up`, shared out among them, to do before any work."""
    before, os.environ[ONE_THREAD] = os.environ.get(ONE_THREAD, ""), "1"  # empty is as good as none
    # a fresh interpreter each: threads and compiled code of this one are not inherited
    pool = ProcessPoolExecutor(count, mp_context=get_context("spawn"), initializer=_begin, initargs=(niceness,))
    try:
        first = [pool.submit(warm_up, tuple(ahead[k::count])) for k in range(count)]
    finally:
        os.environ[ONE_THREAD] = before
    workers = list(pool._processes.values())  # the pool itself cannot end one that hangs
    feeders = ThreadPoolExecutor(count)
    with TemporaryDirectory(prefix="softlab-") as folder:
        try:
            yield Processes(pool, feeders, Path(folder), first)
        finally:
            for worker in workers:
                worker.terminate()
            feeders.shutdown(wait=False, cancel_futures=True)
            with suppress(BrokenProcessPool):
                pool.shutdown(wait=True, cancel_futures=True)


def end_with_parent() -> None:
    """Have this process, started by `multiprocessing`, end when its parent has: one that was killed cannot end it."""
    parent = parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()  # the end of a pipe that only the parent holds
        os._exit(1)

    Thread(target=watch, name="parent", daemon=True).start()


def _begin(niceness: int) -> None:
    """Ctrl-C at a terminal reaches all its processes."""
    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(niceness)
    import diagnosis.diagnose  # noqa: F401 (what takes a second to import is there when it is needed)


_read: dict[str, Any] = {}
"""What this process was sent last."""


def _done(file: str, item: Any) -> Any:
    if file not in _read:
        _read.clear()
        with Path(file).open("rb") as sent:
            _read[file] = pickle.load(sent)
    return _read[file](item)


CONNECT_SECONDS = 20.0


class Cluster:
    """The workers of one scheduler."""

    def __init__(self, client: Any) -> None:
        self._client = client
        self._do: object = None
        self._there: Any = None
        """`do` as it was sent."""

    def in_order(self, do: Callable[[A], B], items: Sequence[A]) -> Iterator[B]:
        """Return `do` for every item in their order; `do` is sent to each worker once, however much it holds: a method's object
        as it is when it is first asked. What is lost with a worker is done here. Raises what `do` raises."""
        if do != self._do:  # two methods are the same where their objects are
            self._do, self._there = do, self._client.scatter(do, broadcast=True, hash=False)
        begun = [self._client.submit(operator.call, self._there, item, pure=False) for item in items]
        for item, future in zip(items, begun, strict=True):
            try:
                result: B = future.result()
            except (CancelledError, OSError):  # with a worker what it had been sent may be lost, or its result
                self._do, result = None, do(item)
            yield result


@contextmanager
def cluster(scheduler: str) -> Iterator[Cluster]:
    """Workers of `scheduler` (tcp://host:port). Raises ConfigError without dask.distributed, or when nobody answers."""
    try:
        import distributed
    except ImportError as e:
        raise ConfigError(
            "--scheduler: dask.distributed is not installed here; install the extra: pip install 'softlab[cluster]'"
        ) from e
    try:
        client = distributed.Client(scheduler, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError) as e:
        raise ConfigError(
            f"--scheduler {scheduler}: no scheduler answers within {CONNECT_SECONDS:g} s ({e}); start `dask scheduler` there"
        ) from e
    with client:
        yield Cluster(client)
