"""Many cases on a Dask cluster: a scheduler somewhere, workers that have this project installed.

A worker that is lost loses no case: the scheduler gives what it had to another one, and an error that says so is given one
more chance here. Needs the optional extra `cluster` (dask.distributed). Folders must be where all workers see them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from ..config import ConfigError

A = TypeVar("A")
B = TypeVar("B")

CONNECT_SECONDS = 20.0
CHANCES = 3
"""Times a case is sent out before its worker's loss is an error."""


def spread_on_cluster(do: Callable[[A], B], items: Sequence[A], scheduler: str) -> Iterator[B]:
    """`do` for every item on the workers of `scheduler` (tcp://host:port), results as they come.

    Raises ConfigError when dask.distributed is missing or nobody answers at the address, otherwise what `do` raises.
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
        yield from _gathered(distributed, client, do, items)


def _gathered(distributed: Any, client: Any, do: Callable[[A], B], items: Sequence[A]) -> Iterator[B]:
    sent: dict[Any, tuple[A, int]] = {}

    def send(item: A, chance: int) -> Any:
        future = client.submit(do, item, pure=False)
        sent[future] = (item, chance)
        return future

    running = distributed.as_completed([send(item, 1) for item in items], loop=client.loop)
    for future in running:
        item, chance = sent.pop(future)
        lost = future.cancelled() or isinstance(future.exception(), (distributed.KilledWorker, OSError))
        if lost and chance < CHANCES:
            running.add(send(item, chance + 1))
            continue
        yield future.result()
