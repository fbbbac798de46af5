"""`lab safe`: vent, stop and un-jam whatever can be reached, confirmed by reading back; `--clear` unlocks the rig then."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from .actuators import Actuators
from .clock import RigClock
from .console import err, out
from .instruments import ACTUATORS
from .interrupts import Shielded
from .latch import Entry, Latch
from .real_time import at_real_speed
from .rescue import land_anew
from .rig_file import load_rig

REACH_WITHIN = 5.0
"""Host seconds for an instrument that an earlier program has just let go of."""


def safe(rig_path: Path, as_json: bool, clear: bool = False) -> int:
    """0 only when every actuator was read back safe, and the rig is not locked afterwards."""
    file, told = at_real_speed(load_rig(rig_path))
    if told:
        err.print(told, markup=False)
    names = [n for n in ACTUATORS if getattr(file.instruments, n) is not None]
    latch = Latch(rig_path)
    with Shielded():
        actuators = Actuators(file, RigClock(file.clock.speed), lambda name, sample: None, despite_latch=True)
        try:
            report = land_anew(actuators, names, REACH_WITHIN)
            if clear and report.confirmed:
                actuators.unlock()
        finally:
            actuators.close()
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
            out.print(f"  {step.instrument}: {'safe' if step.confirmed else '[red]NOT CONFIRMED[/red]'} ({step.text})")
        out.print(_verdict(report.confirmed, locked, rig_path))
    return 0 if report.confirmed and locked is None else 1


def _verdict(confirmed: bool, locked: Entry | None, rig_path: Path) -> str:
    if not confirmed:
        return "[red]Not confirmed safe: use the vent valve and the emergency stop.[/red]"
    if locked is None:
        return "Safe."
    return (
        f"Safe now. The rig stays locked: {locked}. When you have looked at it and nobody is in its way: "
        f"lab safe --clear --rig {rig_path}"
    )
