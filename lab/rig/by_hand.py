"""A rig that is moved without a protocol, by `lab check --move` or `lab jog`: limits and guard as ever, no recording is kept."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from protocols.bench import Bench

from ..console import Screen
from ..guard.messages import SafeReport
from .assembly import Rig
from .interrupts import Interrupts


@contextlib.contextmanager
def by_hand(
    rig: Rig, screen: Screen, landed: Callable[[SafeReport], None], watched: Sequence[str], at_once: bool = False
) -> Iterator[Bench]:
    """The bench of an opened rig; at the end the rig is landed and `landed` gets the report.

    `watched`: instruments whose readings are demanded meanwhile. Ctrl-C raises KeyboardInterrupt where the bench waits, when it
    is pressed twice or, with `at_once`, once."""
    with tempfile.TemporaryDirectory() as folder, Interrupts(screen.say, rig.actuators.pulse, at_once) as interrupts:
        recorder = rig.recorder(Path(folder) / "moves.mcap")
        rig.stop_now = lambda: interrupts.now
        rig.record_to(recorder)
        try:
            yield rig.bench(recorder, screen, interrupts.stopping, watched)
        finally:
            report = rig.make_safe()
            rig.record_to(None)
            recorder.close("completed", "")
    landed(report)
