"""Work on a Dask cluster: a scheduler somewhere, workers that have this project installed.

A worker that is lost loses nothing: the scheduler gives what it had to another one, and an error that says so is given one
more chance here. Needs the optional extra `cluster` (dask.distributed). Folders must be where all workers see them.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from typing import Any, TypeVar

from .files.config import ConfigError

A = TypeVar("A")
B = TypeVar("B")

CONNECT_SECONDS = 20.0


class Cluster:
    """The workers of one scheduler."""

    def __init__(self, distributed: Any, client: Any) -> None:
        self._distributed, self._client = distributed, client
        self._do: object = None
        self._there: list[Any] = []
        """`do` as it was sent, each time."""

    def in_order(self, do: Callable[[A], B], items: Sequence[A]) -> Iterator[B]:
        """Return `do` for every item in their order; `do` is sent to each worker once, however much it holds: a method's object
        as it is when it is first asked. Raises what `do` raises."""
        if do != self._do:  # two methods are the same where their objects are
            self._do, self._there = do, []
        sent: dict[Any, tuple[int, int, int]] = {}
        """Place of the item, chance and copy of `do` by what was submitted."""

        def send(i: int, chance: int, lost: int | None = None) -> Any:
            # With a worker what it had may be lost; what others still work with is kept.
            if not self._there or lost == len(self._there):
                self._there.append(self._client.scatter(do, broadcast=True, hash=False))
            future = self._client.submit(operator.call, self._there[-1], items[i], pure=False)
            sent[future] = (i, chance, len(self._there))
            return future

        waiting: dict[int, B] = {}
        turn = 0
        running = self._distributed.as_completed([send(i, 1) for i in range(len(items))], loop=self._client.loop)
        for future in running:
            i, chance, copy = sent.pop(future)
            try:
                # A result that is there may be lost with its worker before it comes here.
                waiting[i] = future.result()
            except (CancelledError, self._distributed.KilledWorker, OSError):
                if chance == 3:
                    raise
                running.add(send(i, chance + 1, copy))
            while turn in waiting:
                yield waiting.pop(turn)
                turn += 1


@contextmanager
def cluster(scheduler: str) -> Iterator[Cluster]:
    """The workers of `scheduler` (tcp://host:port).

    Raises ConfigError when dask.distributed is missing or nobody answers at the address.
    """
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
        yield Cluster(distributed, client)
