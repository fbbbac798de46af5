"""Runs the fits of a diagnosis here or in other processes, and reports progress."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

A = TypeVar("A")
B = TypeVar("B")
RemoteMap = Callable[[Callable[[Any], Any], Sequence[Any]], Iterator[Any]]


@contextmanager
def one_thread() -> Iterator[None]:
    """One thread of linear algebra within. Matrices are small here: several threads wait for each other longer than they work,
    and take four times the processor time where they share a core."""
    with threadpool_limits(1, user_api="blas"):
        yield


Progress = Callable[[str, float], None]
"""Receives the current step, such as "step 2 of 5: hypotheses", and its completed share, 0..1."""


def no_progress(step: str, share: float) -> None:
    """Report nothing."""


class DiagnosisStep(IntEnum):
    """The steps of a whole diagnosis, in order."""

    FIRST_LOOK = 1
    HYPOTHESES = 2
    HELD_OUT_STATES = 3
    EXPERIMENTS = 4
    GAP_STEP_BY_STEP = 5

    def __str__(self) -> str:
        return f"step {self.value} of {len(DiagnosisStep)}: {self.name.lower().replace('_', ' ')}"


@dataclass(frozen=True)
class Executor:
    """Runs fits here or in other processes, and reports progress. A pickled copy runs them without reporting."""

    progress: Progress = no_progress
    remote_map: RemoteMap | None = None
    """Maps a function over items in other processes or on other machines, results in order; None: here."""

    def __reduce__(self) -> tuple[type[Executor], tuple[()]]:
        return Executor, ()

    def map(self, do: Callable[[A], B], items: Sequence[A], step: DiagnosisStep | None = None) -> list[B]:
        """`do` for every item, in order, reported as (part of) a step, if one is given. Raises what `do` raises."""
        here = self if len(items) > 1 else replace(self, remote_map=None)
        return here.ahead(do, items, step)()

    def ahead(self, do: Callable[[A], B], items: Sequence[A], step: DiagnosisStep | None = None) -> Callable[[], list[B]]:
        """Start `map` in other processes; the returned function, called once, waits for the results or computes them here."""
        computed = map(do, items) if self.remote_map is None else self.remote_map(do, items)

        def results() -> list[B]:
            finished = []
            for result in computed:
                finished.append(result)
                if step is not None:
                    self.progress(str(step), len(finished) / len(items))
            return finished

        return results


SINGLE_THREAD = Executor()
"""Here, no progress."""
