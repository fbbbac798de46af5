"""How long a person waits: whole commands, first with nothing compiled and again, and how fit and diagnosis grow with rows.

    python -m benchmarks.commands --out out/commands       # hours: twice the rows, twice the time

Each figure is a fresh process: seconds on the clock, seconds of processors, and the most memory that any of its processes held.
Robots are drawn from the world `bench` (seed 7), one alone and one in clutter; of the first also with more repeats.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.blind.make import drawn, robot_yaml, table_of, walk_of, write_case
from benchmarks.blind.sweeps import BASE, design
from benchmarks.blind.truth import Recipe, Stratum, draw
from benchmarks.blind.worlds.campaign import WorldRobot, read, respond
from benchmarks.figures import write

CACHE = "NUMBA_CACHE_DIR"
SEED = 7
REPEATS = (12, 66, 261)
"""Of the sweep of 77 states, besides the usual three: 924, 5,082 and 20,097 rows."""
RECORDING = Path("tests/recordings/data/bending-schema-1.mcap").resolve()


@dataclass(frozen=True)
class Wait:
    """One command, once."""

    what: str
    seconds: float
    processor_s: float
    memory_mib: float
    code: int
    rows: int | None = None
    """Of a fit or diagnosis that shows how it grows with rows."""


def waited(what: str, words: Sequence[str] | str, cache: Path, rows: int | None = None) -> Wait:
    """Run `lab` with words, or a line of Python, in a process of its own, its compiled code kept in `cache`."""
    began, environment = time.monotonic(), {**os.environ, CACHE: str(cache)}
    command = [sys.executable, *(["-c", words] if isinstance(words, str) else ["-m", "lab.cli", *words])]
    with subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as child:
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
    return Wait(what, time.monotonic() - began, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024.0, child.returncode, rows)


def case_of(robot: WorldRobot, repeats: int, folder: Path) -> Path:
    """Write the case folder of a robot that was swept this often."""
    sweep = replace(BASE, repeats=repeats)
    walked = walk_of(sweep)
    readings = read(robot, walked, respond(robot, walked), np.random.default_rng([SEED, repeats]))
    tables = {BASE.name: table_of(sweep, readings)}
    write_case(folder, tables, design("full"), robot_yaml(markers=False), menu=False)
    return folder


def robot(stratum: Stratum) -> WorldRobot:
    """Draw a robot with one cause that a sweep shows well, alone or among many small effects."""
    recipe = Recipe("bench", 1, SEED, (stratum,), causes=("chamber_azimuth",))
    ((_, causes),) = draw(recipe)
    return drawn(recipe, 0, stratum, causes, 0).robot


def draw_growth(waits: Sequence[Wait], path: Path) -> None:
    """Draw processor time and memory over rows, with lines of slope one."""
    figure, axes = plt.subplots(1, 2, figsize=(7.0, 3.0), layout="constrained")
    for axis, name, label in zip(axes, ("processor_s", "memory_mib"), ("processor time (s)", "memory (MiB)"), strict=True):
        for verb in ("fit", "diagnose"):
            own = [w for w in waits if w.rows is not None and w.what.startswith(f"lab {verb}")]
            rows, cost = np.array([w.rows for w in own]), np.array([getattr(w, name) for w in own])
            axis.loglog(rows, cost, "o-", label=f"lab {verb}")
            axis.loglog(rows, cost[0] * rows / rows[0], color="grey", linewidth=0.5)
        axis.set(xlabel="states", ylabel=label)
        axis.set_xticks(rows, [f"{n:,}" for n in rows])
        axis.tick_params(axis="x", which="minor", bottom=False, labelbottom=False)
    axes[0].legend()
    figure.savefig(path)


def main() -> int:
    """Measure, print, write JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="a folder for commands.json")
    parser.add_argument("--repeats", type=int, nargs="+", default=REPEATS, help="of the sweep, for the growth with rows")
    a = parser.parse_args()
    a.out.mkdir(parents=True, exist_ok=True)
    waits: list[Wait] = []

    def do(what: str, words: Sequence[str] | str, cache: Path, rows: int | None = None) -> None:
        waits.append(w := waited(what, words, cache, rows))
        figures = f"{w.seconds:.1f} s, {w.processor_s:.1f} s of processors, {w.memory_mib:.0f} MiB"
        print(f"{what}: {figures}, exit code {w.code}", flush=True)

    with tempfile.TemporaryDirectory(prefix="commands-") as place:
        here, alone = Path(place), robot("clean")
        first, second = (str(case_of(robot(kind), BASE.repeats, here / kind)) for kind in ("clean", "cluttered"))
        warm, cold = here / "warm", here / "cold"
        do("import lab", "import lab", warm)
        do("guard, until it can take a rig over", "import lab.guard.process", warm)
        do("lab --help", ["--help"], warm)
        do("lab info FILE", ["info", str(RECORDING)], warm)
        do("lab compare, first after installation", ["compare", first, "--out", str(here / "c1")], cold)
        do("lab compare", ["compare", first, "--out", str(here / "c2")], cold)
        do("lab fit, first after installation", ["fit", first, "--out", str(here / "f1")], here / "cold fit")
        do("lab diagnose, 231 rows, first after installation", ["diagnose", first], warm)
        do("lab diagnose, 231 rows, cluttered", ["diagnose", second], warm)
        for repeats in (BASE.repeats, *a.repeats):
            case = case_of(alone, repeats, here / f"repeats {repeats}")
            do(f"lab fit, {77 * repeats} rows", ["fit", str(case), "--out", str(here / f"fit {repeats}")], warm, 77 * repeats)
            do(f"lab diagnose, {77 * repeats} rows", ["diagnose", str(case)], warm, 77 * repeats)
    shown = Table("command", "s", "s of processors", "MiB", title="What a person waits for", title_justify="left")
    for w in waits:
        shown.add_row(w.what, f"{w.seconds:.1f}", f"{w.processor_s:.1f}", f"{w.memory_mib:.0f}")
    Console(highlight=False).print(shown)
    write(a.out / "commands.json", "commands", waits)
    draw_growth(waits, a.out / "growth.svg")
    return int(any(w.code for w in waits))


if __name__ == "__main__":
    raise SystemExit(main())
