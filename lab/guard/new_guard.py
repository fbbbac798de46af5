"""Landing without the guard that owned the rig: this process becomes its guard, opens every actuator and lands it.

Used when the guard was lost, and by `lab safe`. There is no time to start a process: the drivers are here already. An arm that
does not let itself be opened, because its own safety system holds it or it is without power, is at rest by what its controller
shows.
"""

from __future__ import annotations

from collections.abc import Sequence

from ..files.clock import RigClock
from ..files.rig_file import RigFile
from .guard import Guard
from .landing import SafeReport, SafeStep
from .latch import RigLocked

REACH_WITHIN = 8.0
"""Host seconds in which an actuator must let itself be opened; an earlier connection to the arm takes some to end."""


def make_safe_with_new_guard(
    file: RigFile, clock: RigClock, names: Sequence[str], why: str, unlock: bool
) -> SafeReport:
    """Own the rig, open these actuators and make them safe; what cannot be reached is reported as not confirmed.

    `unlock` the rig when everything is confirmed. Raises RigLocked when another guard owns the rig.
    """
    guard = Guard(file, clock, despite_latch=True)
    guard.take_over()
    try:
        report = guard.make_safe(why, file.safe.keep_vacuum, names, REACH_WITHIN)
        if unlock and report.confirmed:
            guard.unlock()
        return report
    finally:
        guard.close()


def make_safe_after_loss(file: RigFile, clock: RigClock, names: Sequence[str]) -> SafeReport:
    """Land a rig whose guard was lost; unlocks it when everything is confirmed."""
    try:
        return make_safe_with_new_guard(file, clock, names, "the guard was lost", unlock=True)
    except RigLocked as e:
        return SafeReport((SafeStep("guard", False, str(e)),))
