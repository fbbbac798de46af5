"""`python -m benchmarks.faults.soak`: sweeps for half an hour with random faults: no leaks, trials complete or marked.

One process opens and closes the rig again and again, as a long day would; after each run its threads, open files, memory
and child processes are counted.
"""

from __future__ import annotations

import argparse
import logging
import os
import random
import sys
import tempfile
import threading
import time
from pathlib import Path

from lab.console import Screen, err, out
from lab.files.config import ConfigError
from lab.files.rig_file import load_rig
from lab.guard.latch import Latch
from lab.rig.assembly import Rig
from lab.verbs.fakes import write_rig
from lab.verbs.run import execute, job
from lab.verbs.safe import safe
from recordings.errors import RecordingError
from recordings.file.reader import Recording
from sim_fakes.faults import ACCIDENTS, FAULTS
from sim_fakes.rig import FakeRig

TRIALS = 2
SETTINGS = ["spine_lengths=[0.0, 0.05]", "pressures=[50 kPa, 100 kPa]"]
INSTRUMENTS = ("pressure", "spine", "valve", "gauge", "mocap")
MEMORY_GROWTH, COUNT_GROWTH = 60.0, 3
"""MB, and threads, files or processes, by which the second half of the runs may be above the first runs."""


def counts() -> dict[str, float]:
    """What must not grow."""
    with open("/proc/self/statm") as file:
        memory = int(file.read().split()[1]) * os.sysconf("SC_PAGESIZE") / 1e6
    children = sum(len(Path(p).read_text().split()) for p in Path("/proc/self/task").glob("*/children"))
    return {"threads": threading.active_count(), "files": len(os.listdir("/proc/self/fd")), "children": children, "MB": memory}


def trouble(fakes: FakeRig, rng: random.Random, ended: threading.Event) -> str:
    """One fault or accident at a random moment, gone again after a while; or none."""
    if rng.random() < 0.4:
        return "none"
    what = rng.choice([*(f"{i} {f}" for i in INSTRUMENTS for f in FAULTS), *ACCIDENTS])
    after, lasts = rng.uniform(0.5, 12.0), rng.uniform(0.05, 4.0)

    def happen() -> None:
        if ended.wait(after):
            return
        if " " in what:
            fakes.switch.begin(*what.split())
        else:
            fakes.accidents.begin(what)
        ended.wait(lasts)
        if "disconnect" not in what:
            fakes.switch.end()

    threading.Thread(target=happen, daemon=True).start()
    return what


def incomplete(file: Path, outcome: str, states: int) -> str:
    """What is wrong with a recording: a finished file is expected, each state once, all of them after a whole run."""
    try:
        recording = Recording.open(file)
    except RecordingError as e:
        return f"the recording is not finished: {e}"
    steps = [(t.row.trial, t.row.step) for t in recording.trials]
    if len(set(steps)) != len(steps):
        return "a state was read twice"
    if outcome == "completed" and len(steps) != states:
        return f"{len(steps)} states of {states} in a run that counts as completed"
    return ""


def once(fakes: FakeRig, rig: Path, folder: Path, rng: random.Random) -> tuple[str, str, str]:
    """One run; returns the trouble, how it ended, and what is wrong with its recording."""
    ended = threading.Event()
    what = trouble(fakes, rng, ended)
    outcome, wrong = "not connected", ""
    try:
        planned = job("bending", rig, SETTINGS)
        with Rig(load_rig(rig)) as opened:
            if not opened.open_all(str, opened.needed(planned.experiment.needs)):
                done = execute(opened, planned, folder, Screen("soak", planned.rig.clock.speed, quiet=True))
                outcome = done.outcome
                wrong = incomplete(done.file, outcome, len(planned.plan.steps) - TRIALS)
    finally:
        ended.set()
        time.sleep(0.1)
        fakes.switch.end()
        write_rig(fakes, rig)
        for file in folder.glob("*.mcap"):
            file.unlink()
    return what, outcome, wrong


def main() -> int:
    """See the module's text."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.faults.soak", description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--speed", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=0)
    a = parser.parse_args()
    logging.disable(logging.CRITICAL)
    out.quiet = err.quiet = True
    rng, folder = random.Random(a.seed), Path(tempfile.mkdtemp(prefix="soak-"))
    rig = folder / "rig.yaml"
    seen: list[dict[str, float]] = []
    bad: list[str] = []
    ends: dict[str, int] = {}
    with FakeRig(speed=a.speed, seed=a.seed) as fakes:
        write_rig(fakes, rig)
        over = time.monotonic() + 60 * a.minutes
        while time.monotonic() < over:
            try:
                what, outcome, wrong = once(fakes, rig, folder, rng)
            except ConfigError:
                raise
            except Exception as e:  # noqa: BLE001 - what a soak is for
                what, outcome, wrong = "?", "crashed", f"{type(e).__name__}: {e}"
            ends[outcome] = ends.get(outcome, 0) + 1
            if Latch(rig).read() is not None and safe(rig, clear=True).code != 0:
                wrong = wrong or "still locked after the fault was over"
            if wrong:
                bad.append(f"run {len(seen) + 1} ({what}): {wrong}")
            seen.append(counts())
            figures = ", ".join(f"{k} {v:.0f}" for k, v in seen[-1].items())
            print(f"{len(seen):3d} {what:22s} {outcome:13s} {figures} {wrong}", flush=True)
    first, last = seen[min(2, len(seen) - 1)], seen[-1]
    grown = [k for k in first if last[k] - first[k] > (MEMORY_GROWTH if k == "MB" else COUNT_GROWTH)]
    print("\n".join(bad))
    grew = ", ".join(grown) or "nothing"
    print(f"{len(seen)} runs in {a.minutes:g} min at {a.speed:g}x: {ends}; grown: {grew}; wrong: {len(bad)}")
    return 0 if not grown and not bad else 1


if __name__ == "__main__":
    sys.exit(main())
