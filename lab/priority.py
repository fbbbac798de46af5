"""Places in line on a busy computer. Imports next to nothing, so that `lab safe` can come first at once."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import timing


class Priority(NamedTuple):
    """A process' place in line."""

    session: int
    """Niceness of its session among the others: Linux schedules by session (sched(7), autogroup), whatever the nice of what runs
    in it."""
    process: int
    """Niceness of the process among those of its session."""


FIRST = Priority(-20, -10)
"""Of what holds instruments."""
BEHIND = Priority(5, 5)
"""Of what shows a run: the run comes first, but on a busy computer the page still comes."""


def put_in_place(pid: int, place: Priority) -> None:
    """Set the place of a session's leading process; nothing changes without CAP_SYS_NICE or RLIMIT_NICE for a better one."""
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, pid, place.process)
    if sys.platform == "linux":
        with contextlib.suppress(OSError):
            Path(f"/proc/{pid}/autogroup").write_text(str(place.session), encoding="ascii")


@contextlib.contextmanager
def coming_first() -> Iterator[None]:
    """Put this thread, and those that it starts, before the others of its session while this is entered."""
    before = os.getpriority(os.PRIO_PROCESS, 0)
    if not timing.together():
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, 0, min(before, FIRST.process))
    try:
        yield
    finally:
        if not timing.together():
            os.setpriority(os.PRIO_PROCESS, 0, before)
