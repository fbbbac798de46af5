"""Many cases on several processes, with progress and the time that is left."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from typing import TypeVar

from ..cluster import cluster
from ..console import Screen
from ..processes import end_with_parent

A = TypeVar("A")
B = TypeVar("B")


@dataclass(frozen=True)
class Crew:
    """Who does the work: processes of this machine, or the workers of a Dask scheduler (tcp://host:port)."""

    workers: int = 1
    scheduler: str | None = None
    quiet: bool = False


def spread(do: Callable[[A], B], items: Sequence[A], crew: Crew, title: str) -> Iterator[B]:
    """`do` for every item, results as they come; with one worker in this process. Raises what `do` raises."""
    began = time.monotonic()
    with Screen(title, quiet=crew.quiet) as screen:
        results = _results(do, items, crew.workers) if crew.scheduler is None else _on_cluster(do, items, crew.scheduler)
        for done, result in enumerate(results, 1):
            yield result
            spent = time.monotonic() - began
            screen.progress(spent, spent * len(items) / done)


def _on_cluster(do: Callable[[A], B], items: Sequence[A], scheduler: str) -> Iterator[B]:
    with cluster(scheduler) as workers:
        yield from workers.as_they_come(do, items)


def _results(do: Callable[[A], B], items: Sequence[A], workers: int) -> Iterator[B]:
    if workers <= 1:
        yield from map(do, items)
        return
    # a fresh interpreter each: threads and compiled code of this one are not inherited
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=end_with_parent) as pool:
        for future in as_completed([pool.submit(do, item) for item in items]):
            yield future.result()
