"""`lab safe`: vent, stop and release whatever can be reached, confirmed by reading back; `--clear` then unlocks the rig.

A run in progress is ended: its guard lands the rig at once and reports here what it read back.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from ..console import err, out, styled
from ..files.clock import RigClock
from ..files.rig_file import RigFile, load_rig_to_make_safe
from ..guard.instruments import ACTUATORS
from ..guard.landing import SafeReport, SafeStep
from ..guard.latch import Entry, Latch
from ..guard.new_guard import make_safe_with_new_guard
from ..guard.takeover import Requests
from ..rig.interrupts import Shielded
from ..rig.real_time import at_real_speed

ANSWER_WITHIN = 30.0
"""Host seconds for a landing by the guard of a run: longer than any landing takes."""


def safe(rig_path: Path, as_json: bool, clear: bool = False) -> int:
    """0 only when every actuator was read back safe, and the rig is not locked afterwards."""
    rig, missing = load_rig_to_make_safe(rig_path)
    file, told = at_real_speed(rig)
    if told:
        err.print(told)
    latch = Latch(rig_path)
    beyond = tuple(
        SafeStep(name, False, f"{why}; make it safe by hand") for name, why in missing.items() if name in ACTUATORS
    )
    with Shielded():
        report = _make_safe(file, latch, clear and not beyond)
    if beyond:
        report = SafeReport((*report.steps, *beyond))
        latch.write(f"safe state not confirmed after: lab safe. {report}")
    locked = latch.read()
    if as_json:
        steps = [asdict(s) for s in report.steps]
        print(
            json.dumps(
                {"confirmed": report.confirmed, "locked": str(locked) if locked else "", "steps": steps}, indent=1
            )
        )
    else:
        for step in report.steps:
            found = "safe" if step.confirmed else styled("NOT CONFIRMED", "red")
            out.print(f"  {step.instrument}:", found, f"({step.text})")
        said, style = _verdict(report.confirmed, locked, rig_path)
        out.print(said, style=style)
    return 0 if report.confirmed and locked is None else 1


def _make_safe(file: RigFile, latch: Latch, clear: bool) -> SafeReport:
    """By the guard of the run that is going; by this process where there is none, or where it does not answer."""
    names = [n for n in ACTUATORS if getattr(file.instruments, n) is not None]
    if latch.owned() and file.path is not None:
        report = Requests(file.path).ask(ANSWER_WITHIN)
        if report is not None:
            return report
    return make_safe_with_new_guard(file, RigClock(file.clock.speed), names, "lab safe", unlock=clear)


def _verdict(confirmed: bool, locked: Entry | None, rig_path: Path) -> tuple[str, str]:
    """What to say in the end, and in which style."""
    if not confirmed:
        return "Not confirmed safe: use the vent valve and the emergency stop.", "red"
    if locked is None:
        return "Safe.", ""
    return (
        f"Safe now. The rig stays locked: {locked}. Once you have inspected it and nobody is within reach: lab safe "
        f"--clear --rig {rig_path}",
        "",
    )
