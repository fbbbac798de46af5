"""Many cases on several processes, here or on a Dask cluster, with progress and the time that is left."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import TypeVar

from rich.progress import track

from lab.processes import cluster, end_with_parent

A = TypeVar("A")
B = TypeVar("B")


def spread(do: Callable[[A], B], items: Sequence[A], workers: int | str, title: str) -> Iterator[B]:
    """`do` for every item, results as they come; with one worker in this process. Raises what `do` raises."""
    yield from track(_results(do, items, workers), title, len(items), disable=not sys.stdout.isatty())


def _results(do: Callable[[A], B], items: Sequence[A], workers: int | str) -> Iterator[B]:
    if isinstance(workers, str):
        with cluster(workers) as there:
            yield from there.in_order(do, items)
    elif workers <= 1:
        yield from map(do, items)
    else:  # a fresh interpreter each: threads and compiled code of this one are not inherited
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=end_with_parent) as pool:
            for future in as_completed([pool.submit(do, item) for item in items]):
                yield future.result()
