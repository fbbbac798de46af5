"""`lab safe`: vent, stop and un-jam whatever can be reached, confirmed by reading back; `--clear` unlocks the rig then."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from .actuators import Actuators
from .clock import RigClock
from .console import out, styled
from .instruments import ACTUATORS
from .interrupts import Shielded
from .latch import Entry, Latch
from .rescue import land_anew
from .rig_file import load_rig

REACH_WITHIN = 5.0
"""Host seconds for an instrument that an earlier program has just let go of."""


def safe(rig_path: Path, as_json: bool, clear: bool = False) -> int:
    """0 only when every actuator was read back safe, and the rig is not locked afterwards."""
    file = load_rig(rig_path)
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
            found = "safe" if step.confirmed else styled("NOT CONFIRMED", "red")
            out.print(f"  {step.instrument}:", found, f"({step.text})")
        said, style = _verdict(report.confirmed, locked, rig_path)
        out.print(said, style=style)
    return 0 if report.confirmed and locked is None else 1


def _verdict(confirmed: bool, locked: Entry | None, rig_path: Path) -> tuple[str, str]:
    """What to say in the end, and in which style."""
    if not confirmed:
        return "Not confirmed safe: use the vent valve and the emergency stop.", "red"
    if locked is None:
        return "Safe.", ""
    return (
        f"Safe now. The rig stays locked: {locked}. When you have looked at it and nobody is in its way: "
        f"lab safe --clear --rig {rig_path}",
        "",
    )
