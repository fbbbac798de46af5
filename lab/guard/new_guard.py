"""Landing without the guard that owned the rig: this process becomes its guard, opens every actuator and lands it.

Used when the guard was lost, and by `lab safe`. There is no time to start a process: the drivers are here already. An arm that
does not let itself be opened, because its own safety system holds it or it is without power, is at rest by what its controller
shows. Where another guard owns the rig by now, that one is asked to land it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

from timing import RigClock

from ..files.rig_file import RigFile
from . import door
from .guard import REACH_WITHIN, Guard
from .instruments import owned_names
from .latch import RigLocked
from .report import SafeReport, SafeStep
from .rescue import go_on_landing


def make_safe_with_new_guard(file: RigFile, clock: RigClock, names: Sequence[str], why: str, unlock: bool) -> SafeReport:
    """Own the rig, open these actuators and make them safe; what cannot be reached is reported as not confirmed.

    `unlock` the rig when everything is confirmed. A rig that somebody keeps who does not land it is landed all the same.
    """
    guard = Guard(file, clock, despite_latch=True, about=why)
    held = ""
    try:
        guard.take_over()
    except door.CannotBeAsked as e:
        held = str(e)
    except RigLocked as e:
        found = door.land(owned_names(file), file.path)
        if found.names:
            return found.report
        held = str(e)
    try:
        report = guard.make_safe(why, file.safe.keep_vacuum, names, REACH_WITHIN)
        if unlock and report.confirmed:
            with contextlib.suppress(RigLocked):  # the latch stays, and is found by who reads it
                guard.unlock()
    finally:
        guard.close()
    return SafeReport((*report.steps, SafeStep("guard", False, held))) if held else report


def make_safe_after_loss(file: RigFile, clock: RigClock, names: Sequence[str]) -> SafeReport:
    """Land a rig whose guard was lost; unlock it when everything is confirmed. Another process lands the rest as soon as its line
    comes back."""
    why = "the guard was lost"
    report = make_safe_with_new_guard(file, clock, names, why, unlock=True)
    if left := [s.instrument for s in report.steps if not s.confirmed and s.instrument in names]:
        go_on_landing(file, left, why)
    return report
