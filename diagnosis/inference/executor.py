"""Runs the fits of a diagnosis on threads or on other machines, and reports progress."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import wraps
from typing import Any, ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

A = TypeVar("A")
B = TypeVar("B")

RemoteMap = Callable[[Callable[[Any], Any], Sequence[Any]], Iterator[Any]]


P = ParamSpec("P")


def one_thread(do: Callable[P, B]) -> Callable[P, B]:
    """The same with one thread of linear algebra. Matrices are small here: several threads wait for each other longer than they
    work, and take four times the processor time where they share a core."""

    @wraps(do)
    def alone(*args: P.args, **kwargs: P.kwargs) -> B:
        with threadpool_limits(1, user_api="blas"):
            return do(*args, **kwargs)

    return alone


def _no_progress(share: float) -> None:
    """Reports nothing."""


def _no_first_look(leading: tuple[str, ...]) -> None:
    """Tells nobody."""


@dataclass(frozen=True)
class Executor:
    """Threads (the rod's kernels release the interpreter lock), and callbacks: one gets the share of the work done, 0..1, one
    what leads at first sight, before any search.

    Pickled to another process it is one thread without progress.
    """

    threads: int = 1
    progress: Callable[[float], None] = _no_progress
    first_look: Callable[[tuple[str, ...]], None] = _no_first_look
    """Gets the `FIRST_LOOK` effects that alone, in the linear problem at their starting points, make the data most probable."""
    remote_map: RemoteMap | None = None
    """Maps a function over items in other processes or on other machines, results in order; None: here."""

    def __reduce__(self) -> tuple[type[Executor], tuple[()]]:
        return Executor, ()

    def map(self, do: Callable[[A], B], items: Sequence[A], begin: float, end: float) -> list[B]:
        """`do` for every item, in order; `begin`, `end`: shares of the work before and after. Raises what `do` raises."""
        done = []
        with self._mapped(do, items) as results:
            for result in results:
                done.append(result)
                self.progress(begin + (end - begin) * len(done) / len(items))
        return done

    @contextmanager
    def _mapped(self, do: Callable[[A], B], items: Sequence[A]) -> Iterator[Iterator[B]]:
        if self.remote_map is not None:
            yield self.remote_map(do, items)
            return
        if self.threads == 1:
            yield map(do, items)
            return
        pool = ThreadPoolExecutor(self.threads)
        try:
            yield pool.map(do, items)
        finally:
            # After Ctrl-C, items that have not begun are dropped.
            pool.shutdown(cancel_futures=True)


SINGLE_THREAD = Executor()
"""One thread, no progress."""
