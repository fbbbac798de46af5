"""How much of the machine, or of others, a diagnosis may take, and who is told how far it is."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

A = TypeVar("A")
B = TypeVar("B")

Spread = Callable[[Callable[[Any], Any], Sequence[Any]], Iterator[Any]]


def _nobody(share: float) -> None:
    """Told to nobody."""


@dataclass(frozen=True)
class Effort:
    """Threads (the rod's kernels release the interpreter lock), and what is told the share of the work that is done.

    On another machine it is one thread, silent.
    """

    threads: int = 1
    told: Callable[[float], None] = _nobody
    elsewhere: Spread | None = None
    """Does the work on other machines, results in order; None: here."""

    def __reduce__(self) -> tuple[type[Effort], tuple[()]]:
        return Effort, ()

    def each(self, do: Callable[[A], B], items: Sequence[A], begin: float, end: float) -> list[B]:
        """`do` for every item, in order; `begin`, `end`: shares of the work before and after. Raises what `do` raises."""
        done = []
        with self._mapped(do, items) as results:
            for result in results:
                done.append(result)
                self.told(begin + (end - begin) * len(done) / len(items))
        return done

    @contextmanager
    def _mapped(self, do: Callable[[A], B], items: Sequence[A]) -> Iterator[Iterator[B]]:
        if self.elsewhere is not None:
            yield self.elsewhere(do, items)
            return
        if self.threads == 1:
            yield map(do, items)
            return
        pool = ThreadPoolExecutor(self.threads)
        try:
            yield pool.map(do, items)
        finally:
            # After a Ctrl-C what has not begun is not begun any more.
            pool.shutdown(cancel_futures=True)


ALONE = Effort()
"""One thread, silent."""
