"""Going on after a pause: a piece of work that the rig suspended is begun again, and nothing is read twice."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from drivers.errors import InstrumentError

from .bench import Bench
from .errors import Suspended

T = TypeVar("T")
TRIES = 3
"""Pauses that one piece of work may need; what fails more often is not mended."""


def through_pauses(bench: Bench, work: Callable[[], T], back: Callable[[], None] | None = None) -> T:
    """Do a piece of work; after a pause come `back` to where it begins, with the chambers vented, and do it again.

    Raises the InstrumentError behind the pause when it cannot be mended, or comes back too often.
    """
    paused = 0
    while True:
        try:
            if paused and back is not None:
                back()
            return work()
        except (Suspended, InstrumentError) as e:
            cause = e.cause if isinstance(e, Suspended) else e
            paused += 1
            if paused > TRIES or not (isinstance(e, Suspended) or bench.recoverable(cause)):
                raise cause from e
            bench.recover(cause)
