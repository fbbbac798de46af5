"""How the time of a diagnosis grows: with rows, with the effects that are considered, with worker processes.

    python -m benchmarks.diagnosis_growth --json out/diagnosis_growth.json [--quick] [--commands out/commands/commands.json]

Each figure is a fresh process whose kernels are compiled. The robot is the one alone of `benchmarks.commands`, of which the
times by rows are taken where `--commands` has them. Effects are the cause that the robot has and further ones of the
catalogue in an order drawn once, each set within the next.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.commands import Wait, case_of, robots, waited
from benchmarks.written import write
from diagnosis.diagnose import Options, diagnose
from diagnosis.inference.executor import Executor
from lab.files.inputs import read_case
from lab.files.own_effects import catalogue
from lab.processes import for_case

STATES = 77
"""Of the sweep that is repeated."""
REPEATS = (1, 3, 7, 13)
USUAL = 3
"""Repeats of the case whose effects and workers are varied."""
EFFECTS = (5, 10, 20)
"""And all."""


@dataclass(frozen=True)
class Grown:
    """One diagnosis."""

    by: str
    """rows, effects or workers."""
    count: int
    seconds: float
    processor_s: float
    memory_mib: float
    """Most that one of its processes held."""


def grown(by: str, count: int, wait: Wait) -> Grown:
    """Raises RuntimeError for a command that failed."""
    if wait.code:
        raise RuntimeError(f"{wait.what}: exit code {wait.code}")
    return Grown(by, count, wait.seconds, wait.processor_s, wait.memory_mib)


def by_rows(commands: Path) -> list[Grown]:
    """What `benchmarks.commands` measured; nothing where it has not run."""
    if not commands.is_file():
        return []
    waits = [Wait(**each) for each in json.loads(commands.read_text(encoding="utf-8"))]
    return [grown("rows", wait.rows, wait) for wait in waits if wait.rows is not None]


def considered(cause: Sequence[str], known: Sequence[str], count: int) -> list[str]:
    """So many of the effects known, the cause among them."""
    others = [effect for effect in known if effect not in cause]
    drawn = [others[i] for i in np.random.default_rng(1).permutation(len(others))]
    return [*cause, *drawn][:count]


def once(folder: Path, effects: Sequence[str]) -> None:
    """Diagnose a case folder with these effects, as the command does on two processors."""
    case = read_case([folder], None)
    weighed = {name: spec for name, spec in catalogue(case.robot)[0].items() if name in effects}
    with for_case(len(case.table), 2) as others:
        executor = Executor(remote_map=None if others is None else others.in_order)
        diagnose(case, Options(catalogue=weighed, executor=executor))


def measure(commands: Path, quick: bool) -> list[Grown]:
    """All figures."""
    found = by_rows(commands)
    with tempfile.TemporaryDirectory(prefix="diagnosis-") as place:
        here, (alone, _, _) = Path(place), robots()
        cache = here / "cache"

        def run(by: str, count: int, words: Sequence[str], module: str = "lab.cli") -> None:
            found.append(grown(by, count, waited(f"{count} {by}", words, cache, module)))
            print(f"{count} {by}: {found[-1].seconds:.1f} s, {found[-1].memory_mib:.0f} MiB", flush=True)

        folders = {repeats: case_of(alone, repeats, here / f"{repeats}") for repeats in REPEATS}
        usual = folders[USUAL]
        waited("compiling", ["diagnose", str(usual)], cache)
        if not found:
            for repeats in REPEATS[: 2 if quick else None]:
                run("rows", STATES * repeats, ["diagnose", str(folders[repeats])])
        case = read_case([usual], None)
        known = list(catalogue(case.robot)[0])
        for count in (*EFFECTS[: 1 if quick else None], len(known)):
            names = considered(list(alone.effects), known, count)
            run("effects", count, [str(usual), "--effects", *names], "benchmarks.diagnosis_growth")
        for workers in (1, 2):
            run("workers", workers, ["diagnose", str(usual), "--workers", str(workers)])
    return found


def main() -> int:
    """Measure, print, write JSON; or diagnose one case."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("case", type=Path, nargs="?", help="diagnose this case folder once, and nothing else")
    parser.add_argument("--effects", nargs="+", default=[], help="with these effects")
    parser.add_argument("--quick", action="store_true", help="fewer rows and sets of effects")
    parser.add_argument("--commands", type=Path, default=Path("out/commands/commands.json"), help="times by rows")
    parser.add_argument("--json", type=Path, default=Path("out/diagnosis_growth.json"), help="where the numbers go")
    a = parser.parse_args()
    if a.case is not None:
        once(a.case, a.effects)
        return 0
    found = measure(a.commands, a.quick)
    table = Table(title="Diagnosis", title_justify="left")
    for column in ("by", "how many", "s", "s of processors", "MiB"):
        table.add_column(column)
    for g in found:
        table.add_row(g.by, str(g.count), f"{g.seconds:.1f}", f"{g.processor_s:.1f}", f"{g.memory_mib:.0f}")
    Console().print(table)
    write(a.json, "diagnoses", found)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
