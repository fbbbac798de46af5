"""`python -m benchmarks.faults.kills`: the program is killed at random moments; how fast is the rig safe, is the file whole?

Also with --signal TERM, or INT: how long from the signal (the second Ctrl-C) to the first stop on the wire. With --loops N the
same next to N busy loops: is a guard lost, and how long does a start take? Prints the figures, exits 0 when every run began
and ended safe.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from lab.verbs.fakes import PATIENT, PATIENT_SETTLE, write_rig
from recordings.file.recover import recover
from sim_fakes.rig import FakeRig

SPEED = 20.0
BENDING = ("bending", "spine_lengths=[0.05]", "pressures=[100 kPa, 200 kPa]", "rate=20 kPa/s", *PATIENT_SETTLE)
STIFFNESS = ("stiffness", "spine_lengths=[0.1]", "steps=3", "min_samples=30")
LIMIT, BUSY_LIMIT, BUSY_SPEED = 30.0, 300.0, 2.0
"""Host seconds for a start, far more than one takes, alone and next to busy loops; speed of the fakes next to these."""
LOG = "run.log"
AGAIN = 0.03
"""Host seconds between two Ctrl-C: two at once are one to the kernel."""


@dataclass(frozen=True)
class Kill:
    """One run that was cut off."""

    protocol: str
    start_s: float
    """Host seconds from the command to the first motion."""
    after: float
    """Host seconds from the first motion to the signal."""
    stop_ms: float
    """From the signal to the first stop at a fake: regulators told zero, or the arm told to stop."""
    vented_s: float
    """From the signal until all chambers were below 5 kPa, host time."""
    arm_ms: float
    """From the signal until the arm stood; nan when it did not move."""
    safe: bool
    recovered: bool
    begun: bool = True
    """Whether it moved; a run that refuses to, as the computer is too busy to read in time, says why and ends by itself."""


class Witness(threading.Thread):
    """Looks at the fakes each millisecond."""

    def __init__(self, fakes: FakeRig) -> None:
        super().__init__(daemon=True)
        self._fakes = fakes
        self._ended = threading.Event()
        self.stop_at = self.vented_at = self.still_at = float("nan")
        self.moving = self._moves()
        self._asked = float(fakes.plant.regulator.max()) > 1.0

    def _moves(self) -> bool:
        before = self._fakes.plant.probe_position.copy()
        time.sleep(0.012)
        return bool(np.abs(self._fakes.plant.probe_position - before).max() > 1e-5)

    def run(self) -> None:
        """Until everything was seen, or `end`."""
        plant, last, last_at = self._fakes.plant, self._fakes.plant.probe_position.copy(), time.monotonic()
        while not self._ended.is_set():
            now = time.monotonic()
            if np.isnan(self.stop_at) and self._asked and float(plant.regulator.max()) <= 1.0:
                self.stop_at = now
            if np.isnan(self.vented_at) and float(plant.chamber_pressure.max()) < 5e3:
                self.vented_at = now
            here = plant.probe_position.copy()
            if float(np.abs(here - last).max()) > 1e-6:
                last, last_at = here, now
            self.still_at = last_at
            time.sleep(0.001)

    def end(self) -> None:
        """No longer."""
        self._ended.set()
        self.join()


@contextlib.contextmanager
def busy(loops: int) -> Iterator[None]:
    """Processes that compute without end, each in a session of its own, as other people's programs are."""
    running = [subprocess.Popen([sys.executable, "-c", "while True: pass"], start_new_session=True) for _ in range(loops)]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


def started(rig: Path, folder: Path, what: Sequence[str]) -> subprocess.Popen[bytes]:
    """`lab run` of a protocol and its settings; what it says stands in run.log.

    In a session of its own, as that of a terminal: Linux shares processors between sessions, and the fakes work in this one.
    """
    protocol, *settings = what
    command = [sys.executable, "-m", "lab.cli", "run", protocol, "--rig", str(rig), "--out", str(folder)]
    command += [word for s in settings for word in ("--set", s)]
    folder.mkdir(exist_ok=True)
    with (folder / LOG).open("wb") as log:
        return subprocess.Popen(command, stdout=log, stderr=log, stdin=subprocess.DEVNULL, start_new_session=True)


def one(
    fakes: FakeRig, rig: Path, folder: Path, how: int, rng: random.Random, what: Sequence[str], limit: float = LIMIT
) -> Kill | None:
    """Start a run, cut it off at a random moment, and state how the rig ended; None when it had ended by itself before.

    A run that has not begun within `limit` s counts as not safe.
    """
    protocol, began = what[0], time.monotonic()
    program = started(rig, folder, what)
    start = fakes.plant.probe_position.copy()
    deadline = began + limit
    while not (begun := _begun(fakes, protocol, start)) and program.poll() is None and time.monotonic() < deadline:
        time.sleep(0.005)
    took = time.monotonic() - began
    if not begun:
        program.terminate()
        program.wait()
        print((folder / LOG).read_text(errors="replace")[-2000:], file=sys.stderr)
        rig.with_suffix(".latch").unlink(missing_ok=True)
        return Kill(protocol, took, 0.0, np.nan, np.nan, np.nan, False, _recovered(folder), begun=False)
    after = rng.uniform(0.0, 1.5)
    time.sleep(after)
    if program.poll() is not None:
        return None
    witness = Witness(fakes)
    while protocol == "stiffness" and not witness.moving and program.poll() is None and time.monotonic() < deadline:
        witness = Witness(fakes)  # an arm that stands anyway proves nothing
    witness.start()
    if how == signal.SIGINT:
        _send(program, how)
        time.sleep(AGAIN)
    at = time.monotonic()
    _send(program, how)
    give_up = at + 10.0
    while np.isnan(witness.vented_at) and time.monotonic() < give_up:
        time.sleep(0.005)
    program.wait()
    latch = rig.with_suffix(".latch")
    while latch.exists() and time.monotonic() < give_up:
        time.sleep(0.02)
    witness.end()
    vented = float(fakes.plant.chamber_pressure.max()) < 5e3 and not fakes.plant.valve_on
    return Kill(
        protocol,
        took,
        after,
        1e3 * (witness.stop_at - at),
        witness.vented_at - at,
        1e3 * (witness.still_at - at) if witness.moving else float("nan"),
        vented and not latch.exists(),
        _recovered(folder),
    )


def _send(program: subprocess.Popen[bytes], how: int) -> None:
    if program.poll() is None:
        os.kill(program.pid, how)


def _begun(fakes: FakeRig, protocol: str, start: np.ndarray) -> bool:
    if protocol == "bending":
        return float(fakes.plant.regulator.max()) > 5e3
    return fakes.plant.valve_on and float(np.abs(fakes.plant.probe_position - start).max()) > 0.01


def _recovered(folder: Path) -> bool:
    """Whether the newest recording can be read, after `recover` where it was cut off; it is deleted then."""
    files = sorted(folder.glob("*.mcap"), key=lambda f: f.stat().st_mtime)
    if not files:
        return False
    try:
        recover(files[-1], folder / "recovered.mcap")
        return (folder / "recovered.mcap").stat().st_size > 1000
    except Exception as e:
        print(f"not recovered: {e}", file=sys.stderr)
        return False
    finally:
        for file in folder.glob("*.mcap"):
            file.unlink()


def main() -> int:
    """See the module's text."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.faults.kills", description=__doc__)
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--signal", choices=("KILL", "TERM", "INT"), default="KILL")
    parser.add_argument("--protocol", choices=("both", "bending", "stiffness"), default="both")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--loops", type=int, default=0, help="busy loops next to the runs")
    parser.add_argument("--report", type=Path)
    a = parser.parse_args()
    how, rng = getattr(signal, f"SIG{a.signal}"), random.Random(a.seed)
    folder = Path(tempfile.mkdtemp(prefix="kills-"))
    kills: list[Kill] = []
    with FakeRig(speed=BUSY_SPEED if a.loops else SPEED, seed=a.seed) as fakes, busy(a.loops):
        write_rig(fakes, folder / "rig.yaml", PATIENT if a.loops else None)
        for i in range(a.count):
            stiffness = a.protocol == "stiffness" or (a.protocol == "both" and i % 3 == 2)
            what, limit, kill = STIFFNESS if stiffness else BENDING, BUSY_LIMIT if a.loops else LIMIT, None
            while kill is None:
                kill = one(fakes, folder / "rig.yaml", folder, how, rng, what, limit)
            kills.append(kill)
            ends = f"{'safe' if kill.safe else 'NOT SAFE'}, {'file recovered' if kill.recovered else 'FILE LOST'}"
            ends = ends if kill.begun else "NOT BEGUN"
            times = f"stop {kill.stop_ms:6.1f} ms, vented {kill.vented_s:5.2f} s, arm {kill.arm_ms:6.1f} ms"
            print(f"{i + 1:3d} {kill.protocol:9s} begun {kill.start_s:5.1f} s, {times}, {ends}", flush=True)
    summary(kills)
    if a.report is not None:
        a.report.write_text(json.dumps([asdict(k) for k in kills]))
    return 0 if all(k.safe and k.recovered for k in kills) else 1


def summary(kills: list[Kill]) -> None:
    """The figures."""
    for name, unit in (
        ("start_s", "s to the first motion"),
        ("stop_ms", "ms to the first stop on the wire"),
        ("vented_s", "s until vented"),
        ("arm_ms", "ms until the arm stood"),
    ):
        values = np.array([getattr(k, name) for k in kills])
        values = values[np.isfinite(values)]
        if len(values):
            figures = f"median {np.median(values):.2f}, p99 {np.percentile(values, 99):.2f}, worst {values.max():.2f}"
            print(f"{unit}: {figures} (n = {len(values)})")
    for name, word in (("begun", "begun"), ("safe", "safe"), ("recovered", "recordings")):
        print(f"{word} {sum(getattr(k, name) for k in kills)}/{len(kills)}")


if __name__ == "__main__":
    sys.exit(main())
