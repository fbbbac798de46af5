"""Landing without the guard that owned the rig: a process becomes its guard, opens every actuator and lands it.

Used when the guard was lost, and by `lab safe`. The drivers are loaded already, so no time is lost in starting a process. An arm
that cannot be opened, because its own safety system holds it or it has no power, counts as at rest if its controller shows so.
If another guard owns the rig by now, that one is asked to land it.

Instruments not confirmed after a guard was lost are landed by a process of its own, `python -m lab.guard.new_guard`, which
outlives the program that started it and reads as JSON what to land.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from recordings.json_text import read_json
from timing import RigClock

from ..files.rig_file import RigFile
from . import door
from .child import Child, begin_child, start_child
from .guard import LIVES_ON, REACH_WITHIN, Guard
from .instruments import owned_names
from .latch import RigLocked
from .messages import SafeReport, SafeStep


def make_safe_with_new_guard(file: RigFile, clock: RigClock, names: Sequence[str], why: str, unlock: bool) -> SafeReport:
    """Own the rig, open these actuators and make them safe; what cannot be reached is reported as not confirmed.

    `unlock` the rig when everything is confirmed. If its owner does not land it, the rig is landed all the same."""
    guard = Guard(file, clock, despite_latch=True, about=why)
    held = ""  # owners that do not land the rig
    try:
        guard.take_over()
    except door.CannotBeAsked as e:
        held = str(e)
    except RigLocked as e:
        landed = door.land(owned_names(file), file.path)
        if landed.answered:
            return landed.report
        held = str(e)
    try:
        report = guard.make_safe(why, file.safe.keep_vacuum, names, REACH_WITHIN)
        if unlock and report.confirmed:
            with contextlib.suppress(RigLocked):  # the latch stays for the next reader
                guard.unlock()
    finally:
        guard.close()
    return SafeReport((*report.steps, SafeStep("guard", False, held))) if held else report


def make_safe_after_loss(file: RigFile, clock: RigClock, names: Sequence[str]) -> SafeReport:
    """Land a rig whose guard was lost; unlock it when all is confirmed, else another process continues to land it."""
    why = "the guard was lost"
    report = make_safe_with_new_guard(file, clock, names, why, unlock=True)
    if left := [s.instrument for s in report.steps if not s.confirmed and s.instrument in names]:
        nowhere = subprocess.DEVNULL  # a process opens and lands them for `LIVES_ON` host seconds at most, and unlocks the rig
        process = start_child("lab.guard.new_guard", stdin=subprocess.PIPE, stdout=nowhere, stderr=nowhere)
        RESCUING.append(process)
        assert process.stdin is not None
        with process.stdin as asked:
            asked.write(json.dumps([file.model_dump_json(), str(file.path or ""), left, why]).encode())
    return report


RESCUING: list[Child] = []
"""Processes that this program has started for it."""


def main() -> int:
    """Land one rig, and unlock it unless it was locked anew; the exit code: 1 where another guard owns the rig by now."""
    text, path, names, why = read_json(sys.stdin.buffer.read())
    rig = RigFile.model_validate_json(text).read_from(Path(path) if path else None)
    guard = Guard(rig, RigClock(rig.clock.speed), despite_latch=True, about=why)
    locked = guard.latch.read() if guard.latch is not None else None
    guard.ending = True  # as `owners` report it: it commands nothing, and is gone when it has landed the rig
    try:
        guard.take_over()
    except RigLocked:
        return 1  # that guard lands it
    report = guard.make_safe(why, rig.safe.keep_vacuum, names, LIVES_ON)
    if report.confirmed and guard.latch is not None and guard.latch.read() == locked:
        guard.unlock()
    guard.close()
    return 0


if __name__ == "__main__":
    begin_child()
    os._exit(main())  # threads may be stuck in a driver that does not return
