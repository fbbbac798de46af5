"""`python -m benchmarks.faults.lines`: a serial line drops out and returns; how soon after its return is the rig vented?

Each actuator's or gauge's line is unplugged for a moment while a run ramps, reads a state or lands, and while `lab safe`
connects to what a crash has left behind. Prints host seconds from the line's return until all chambers are below 5 kPa and the
vacuum is off, below 0 where that was before; exits 0 when each is within the limit.
"""

from __future__ import annotations

import argparse
import json
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

from lab.guard.last_used import forget, recall
from lab.verbs.fakes import write_rig
from sim_fakes.rig import FakeRig

from .bad_day import WITHIN, crash, running
from .kills import SPEED

LIMIT = 2.0
"""Host seconds from the line's return until chambers are below 5 kPa and the valve is off."""
OUT = 0.7
"""Host seconds for which a line is out."""
RIGS: dict[str, tuple[dict[str, str], tuple[str, ...]]] = {
    "alicat, dynamixel, numato, pfeiffer": ({}, ("pressure", "spine", "valve", "gauge")),
    "smc_itv, tmcl": ({"regulators": "smc_itv", "spine": "tmcl"}, ("pressure", "pressure2", "spine")),
}
PHASES = ("ramping", "reading", "landing", "connecting")
READING = 99e3
"""Pa at which the run has reached the first level and reads it."""


@dataclass(frozen=True)
class Cell:
    """One line lost and back."""

    rig: str
    line: str
    phase: str
    safe_s: float
    """Host seconds from the line's return to the safe state; nan: not within `WITHIN`."""


def one(fakes: FakeRig, kind: str, line: str, phase: str) -> Cell:
    """One cell on these fakes."""
    with tempfile.TemporaryDirectory() as place:
        rig = Path(place) / "rig" / "rig.yaml"
        rig.parent.mkdir()
        write_rig(fakes, rig)
        program = running(fakes, rig, Path(place), "inflated")
        if phase == "reading":
            _await(lambda: float(fakes.plant.regulator.max()) >= READING)
        if phase == "connecting":
            crash(program)
        fakes.switch.drop_out(line, OUT)
        back = time.monotonic() + OUT
        if phase == "landing":
            program.send_signal(signal.SIGTERM)
        command = [sys.executable, "-m", "lab.cli", "safe", "--rig", str(rig)]
        asked = subprocess.Popen(command, stdout=subprocess.DEVNULL) if phase == "connecting" else None
        safe = _await(lambda: float(fakes.plant.chamber_pressure.max()) < 5e3 and not fakes.plant.valve_on)
        for process in (program, asked):
            if process is not None:
                process.wait(WITHIN)
        fakes.switch.end()
        if (left := recall(rig)) is not None:
            forget(left)
        return Cell(kind, line, phase, safe - back)


def _await(condition: Callable[[], bool]) -> float:
    """Host time at which a condition holds; nan when it does not within `WITHIN`."""
    give_up = time.monotonic() + WITHIN
    while time.monotonic() < give_up:
        if condition():
            return time.monotonic()
        time.sleep(0.002)
    return float("nan")


def main() -> int:
    """Entry."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--phase", action="append", choices=PHASES, help="these only (repeatable)")
    parser.add_argument("--json", type=Path)
    a = parser.parse_args()
    phases = a.phase or PHASES
    cells = []
    for kind, (parts, lines) in RIGS.items():
        print(f"{kind:40}" + "".join(f"{phase:>12}" for phase in phases))
        with FakeRig(speed=SPEED, seed=1, **parts) as fakes:  # type: ignore[arg-type]
            for line in lines:
                cells += (row := [one(fakes, kind, line, phase) for phase in phases])
                print(f"  {line:38}" + "".join(f"{c.safe_s:10.2f} s" for c in row), flush=True)
    if a.json:
        a.json.write_text(json.dumps([asdict(c) for c in cells], indent=1))
    late = [c for c in cells if not c.safe_s <= LIMIT]
    slowest = max(c.safe_s for c in cells)
    print(f"{len(cells) - len(late)} of {len(cells)} safe within {LIMIT:g} s of the line's return, slowest {slowest:.2f} s")
    return 1 if late else 0


if __name__ == "__main__":
    sys.exit(main())
