"""`python -m benchmarks.faults.busy`: starts of `lab run` next to busy loops; is a guard lost, and how long does a start take?

Prints a line for each start, exits 0 when each run began and none lost its guard.
"""

from __future__ import annotations

import argparse
import contextlib
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from lab.verbs.fakes import PATIENT, PATIENT_SETTLE, write_rig
from sim_fakes.rig import FakeRig

from .kills import BENDING

GIVE_UP = 300.0
"""Host seconds for one start: far more than one takes."""


@contextlib.contextmanager
def busy(loops: int) -> Iterator[None]:
    """So many processes that compute without end, each in a session of its own, as other people's programs are."""
    command = [sys.executable, "-c", "while True: pass"]
    running = [subprocess.Popen(command, start_new_session=True) for _ in range(loops)]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


def start(fakes: FakeRig, rig: Path, folder: Path) -> tuple[float, str]:
    """Start a run and end it once it has inflated a chamber: host seconds until then, and the end of what it said where it never
    came to that or its guard was lost (else empty)."""
    protocol, *settings = BENDING
    command = [sys.executable, "-m", "lab.cli", "run", protocol, "--rig", str(rig), "--out", str(folder)]
    command += [word for s in (*settings, *PATIENT_SETTLE) for word in ("--set", s)]
    began = time.monotonic()
    with tempfile.TemporaryFile() as said:
        program = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=said, stderr=said)
        until = began + GIVE_UP
        while (inflated := float(fakes.plant.regulator.max()) > 5e3) is False and program.poll() is None:
            if time.monotonic() > until:
                break
            time.sleep(0.02)
        took = time.monotonic() - began
        while program.poll() is None:
            program.send_signal(signal.SIGTERM)
            time.sleep(0.5)
        said.seek(0)
        text = said.read().decode(errors="replace").strip()
    lost = not inflated or "was lost" in text
    return took, text[-400:] or "nothing was said" if lost else ""


def main() -> int:
    """See the module's text."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.faults.busy", description=__doc__)
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--loops", type=int, default=20)
    a = parser.parse_args()
    lost = 0
    with tempfile.TemporaryDirectory(prefix="busy-") as place, FakeRig(speed=2.0) as fakes, busy(a.loops):
        folder = Path(place)
        for i in range(a.count):
            write_rig(fakes, folder / "rig.yaml", PATIENT)
            took, trouble = start(fakes, folder / "rig.yaml", folder)
            lost += bool(trouble)
            print(f"{i + 1:3d} {took:5.1f} s {'LOST: ' + trouble if trouble else 'began'}", flush=True)
            (folder / "rig.latch").unlink(missing_ok=True)
    print(f"{lost} of {a.count} starts lost next to {a.loops} busy loops")
    return 1 if lost else 0


if __name__ == "__main__":
    sys.exit(main())
