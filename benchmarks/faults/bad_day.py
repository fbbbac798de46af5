"""`python -m benchmarks.faults.bad_day`: `lab safe` when everything around the rig is broken; is it vented and stopped in time?

Each day (rig.yaml broken or gone, folder full or read-only, log deleted, called through a link, by another user) is crossed
with a run that holds pressure, an arm that pushes, and what a crash of program and guard has left behind. Prints host seconds
from the start of the command to the safe state, and to its end.

Then each actuator's or gauge's serial line drops out for a moment while a run ramps, reads a state or lands, and while `lab
safe` connects to what a crash has left behind. Prints host seconds from the line's return to the safe state, below 0 where that
was before. Exits 0 when each is safe within its limit.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import yaml

from lab.guard.last_used import forget, recall
from lab.verbs.fakes import write_rig
from sim_fakes.rig import FakeRig

from .kills import BENDING, SPEED, STIFFNESS, Witness, _begun, started

LIMIT, LINE_LIMIT = 1.0, 2.0
"""Host seconds from the start of `lab safe` until chambers are below 5 kPa, the valve is off and the arm stands; and from the
return of a line until the first two are so."""
OUT = 0.7
"""Host seconds for which a line is out."""
WITHIN = 60.0
INFLATED = 40e3
"""Pa."""
ANOTHER = """
import os, sys
from lab import cli
from lab.files.rig_file import found_drivers
import encodings.idna, shlex
import lab.console, lab.failures, lab.guard.latch, lab.guard.new_guard, lab.rig.interrupts, lab.rig.real_time, lab.verbs.safe
import concurrent.futures.thread, getpass, multiprocessing.connection, rich.text, serial
found_drivers()
os.setgroups([])
os.setuid(65534)
sys.exit(cli.main(["safe", "--rig", sys.argv[1]]))
"""
"""As a user who may read nothing of root's, the interpreter included."""


def _typo(rig: Path) -> Path:
    rig.write_text(rig.read_text().replace("instruments:", "instruments: ["))
    return rig


def _empty(rig: Path) -> Path:
    rig.write_text("")
    return rig


def _gone(rig: Path) -> Path:
    rig.unlink()
    return rig


def _log_deleted(rig: Path) -> Path:
    rig.with_suffix(".guard.log").unlink(missing_ok=True)
    return rig


def _link(rig: Path) -> Path:
    link = rig.parent.with_name("link.yaml")
    link.symlink_to(rig)
    return link


def _full(rig: Path) -> Path:
    with open(rig.with_name("filler"), "wb", buffering=0) as filler, contextlib.suppress(OSError):
        while True:
            filler.write(bytes(4096))
    return rig


def _read_only(rig: Path) -> Path:
    subprocess.run(["mount", "-o", "remount,ro", str(rig.parent)], check=True)
    return rig


def _as_it_is(rig: Path) -> Path:
    return rig


DAYS: dict[str, Callable[[Path], Path]] = {
    "as usual": _as_it_is,
    "rig.yaml: typo": _typo,
    "rig.yaml: empty": _empty,
    "rig.yaml: gone": _gone,
    "log deleted": _log_deleted,
    "by a link": _link,
    "folder full": _full,
    "folder read-only": _read_only,
    "another user": _as_it_is,
}
MOUNTED = ("folder full", "folder read-only")
"""On a file system of its own, which only root may mount; so may only root become another user."""
SCENES = {"inflated": BENDING, "pushing": STIFFNESS, "after a crash": BENDING}
RIGS: dict[str, tuple[dict[str, str], tuple[str, ...]]] = {
    "alicat, dynamixel, numato, pfeiffer": ({}, ("pressure", "spine", "valve", "gauge")),
    "smc_itv, tmcl": ({"regulators": "smc_itv", "spine": "tmcl"}, ("pressure", "pressure2", "spine")),
}
PHASES = ("ramping", "reading", "landing", "connecting")
READING = 99e3
"""Pa at which the run has reached the first level and reads it."""


@dataclass(frozen=True)
class Misfortune:
    """One bad day in a scene, or one line lost and back in a phase."""

    what: str
    when: str
    safe_s: float
    """From the start of `lab safe`, or from the line's return, to the safe state; nan: never."""
    limit_s: float
    ended_s: float = 0.0
    """From the start of `lab safe` to its end."""
    code: int = 0


def bad_day(fakes: FakeRig, day: str, scene: str) -> Misfortune:
    """One day on these fakes."""
    with tempfile.TemporaryDirectory() as place, _folder(Path(place), day in MOUNTED) as folder:
        rig = folder / "rig.yaml"
        write_rig(fakes, rig)
        for table in yaml.safe_load(rig.read_text())["instruments"].values():
            if "port" in table and day == "another user":
                os.chmod(os.path.realpath(table["port"]), 0o666)  # as the group dialout makes them
        program = running(fakes, rig, Path(place), scene)
        if scene == "after a crash":
            crash(program)
        called = DAYS[day](rig)
        words = ["-c", ANOTHER, str(called)] if day == "another user" else ["-m", "lab.cli", "safe", "--rig", str(called)]
        witness = Witness(fakes)
        witness.start()
        began = time.monotonic()
        asked = subprocess.run([sys.executable, *words], capture_output=True, text=True, check=False)
        ended = time.monotonic()
        while np.isnan(witness.vented_at) and time.monotonic() < ended + 2.0:
            time.sleep(0.01)
        program.wait(WITHIN)
        witness.end()
        if "Traceback" in asked.stderr:
            print(asked.stderr, file=sys.stderr)
        _forget(rig)
        safe = witness.vented_at if scene != "pushing" else max(witness.vented_at, witness.still_at)
        return Misfortune(day, scene, safe - began, LIMIT, ended - began, asked.returncode)


def lost_line(fakes: FakeRig, line: str, phase: str) -> Misfortune:
    """One line lost and back on these fakes."""
    with tempfile.TemporaryDirectory() as place:
        rig = Path(place) / "rig" / "rig.yaml"
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
        _forget(rig)
        return Misfortune(line, phase, safe - back, LINE_LIMIT)


def _await(condition: Callable[[], bool]) -> float:
    """Host time at which a condition holds; nan when it does not within `WITHIN`."""
    give_up = time.monotonic() + WITHIN
    while time.monotonic() < give_up:
        if condition():
            return time.monotonic()
        time.sleep(0.002)
    return float("nan")


def _forget(rig: Path) -> None:
    if (last := recall(rig)) is not None:
        forget(last)


@contextlib.contextmanager
def _folder(place: Path, mounted: bool) -> Iterator[Path]:
    folder = place / "rig"
    folder.mkdir()
    with contextlib.ExitStack() as last:
        if mounted:
            subprocess.run(["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", str(folder)], check=True)
            last.callback(subprocess.run, ["umount", "-l", str(folder)], check=True)
        yield folder


def running(fakes: FakeRig, rig: Path, out: Path, scene: str) -> subprocess.Popen[bytes]:
    """A run in a process of its own, once the robot is inflated or the arm moves."""
    start = fakes.plant.probe_position.copy()
    program = started(rig, out / "runs", SCENES[scene])
    protocol = SCENES[scene][0]

    def begun() -> bool:
        inflated = float(fakes.plant.chamber_pressure.max()) > INFLATED
        return inflated if protocol == "bending" else _begun(fakes, protocol, start)

    if np.isnan(_await(begun)):
        raise TimeoutError(f"{protocol} has not begun within {WITHIN:g} s")
    return program


def crash(program: subprocess.Popen[bytes]) -> None:
    """Kill the program and all that it has started, at the same moment."""
    whole = [program.pid]
    for pid in whole:
        children = Path(f"/proc/{pid}/task").glob("*/children")
        whole += [int(child) for found in children for child in found.read_text().split()]
    for pid in whole:
        os.kill(pid, signal.SIGSTOP)
    for pid in whole:
        os.kill(pid, signal.SIGKILL)


def main() -> int:
    """Entry."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--day", action="append", choices=DAYS, help="these only (repeatable)")
    parser.add_argument("--scene", action="append", choices=SCENES, help="these only (repeatable)")
    parser.add_argument("--phase", action="append", choices=PHASES, help="of a lost line, these only (repeatable)")
    parser.add_argument("--json", type=Path)
    a = parser.parse_args()
    root = os.getuid() == 0 and shutil.which("mount") is not None
    days = [d for d in a.day or DAYS if root or d not in (*MOUNTED, "another user")]
    scenes, phases, cells = a.scene or tuple(SCENES), a.phase or PHASES, list[Misfortune]()
    print(f"{'':18}" + "".join(f"{scene:>30}" for scene in scenes))
    with FakeRig(speed=SPEED, seed=1) as fakes:
        for day in days:
            cells += (row := [bad_day(fakes, day, scene) for scene in scenes])
            texts = (f"safe {c.safe_s:.2f} s, over {c.ended_s:.2f} s ({c.code})" for c in row)
            print(f"{day:18}" + "".join(f"{text:>30}" for text in texts), flush=True)
    for kind, (parts, lines) in RIGS.items():
        print(f"{kind:40}" + "".join(f"{phase:>12}" for phase in phases))
        with FakeRig(speed=SPEED, seed=1, **parts) as fakes:  # type: ignore[arg-type]
            for line in lines:
                cells += (row := [lost_line(fakes, line, phase) for phase in phases])
                print(f"  {line:38}" + "".join(f"{c.safe_s:10.2f} s" for c in row), flush=True)
    if a.json:
        a.json.write_text(json.dumps([asdict(c) for c in cells], indent=1))
    late = [c for c in cells if not c.safe_s <= c.limit_s]
    print(f"{len(cells) - len(late)} of {len(cells)} safe in time, slowest {max(c.safe_s for c in cells):.2f} s")
    return 1 if late else 0


if __name__ == "__main__":
    sys.exit(main())
