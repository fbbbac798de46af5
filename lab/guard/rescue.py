"""The landing of a rig whose guard was lost, in a process of its own: it goes on after the program that asked for it has ended.

Run by `python -m lab.guard.rescue`; what to land comes as JSON at its input.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from recordings.json_text import read_json
from timing import RigClock

from ..files.rig_file import RigFile
from .child import begin_child, start_child
from .guard import LIVES_ON, Guard
from .latch import RigLocked

RESCUING: list[subprocess.Popen[bytes]] = []
"""Processes that this program has started for it."""


def go_on_landing(rig: RigFile, names: Sequence[str], why: str) -> None:
    """Start a process that opens these instruments again and again, and lands them, for `LIVES_ON` host seconds at most.

    It unlocks the rig when everything is confirmed, unless it was locked anew meanwhile.
    """
    nowhere = subprocess.DEVNULL
    process = start_child("lab.guard.rescue", stdin=subprocess.PIPE, stdout=nowhere, stderr=nowhere)
    RESCUING.append(process)
    assert process.stdin is not None
    with process.stdin as asked:
        asked.write(json.dumps([rig.model_dump_json(), str(rig.path or ""), list(names), why]).encode())


def main() -> int:
    """Land one rig; unlock it when everything is confirmed, unless it was locked anew meanwhile. Returns the exit code: 1 where
    another guard owns the rig by now."""
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
    os._exit(main())  # threads may be stuck in a driver that does not come back
