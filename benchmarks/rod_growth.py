"""How the time of rods grows: `python -m benchmarks.rod_growth [--quick] [--json FILE]`.

The paper's rods with random parameters in batches of 1 to 100,000, cold (from nothing) and warm (from the same rods with 1 % less
of what the chambers do), on one and on two threads; and rods cut into more and more elements. Seconds of a whole
call from Python, the least of several: of one thread processor time, of two the clock, which other work on the machine prolongs.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.rod_cases import eased, paper_rods, split
from benchmarks.written import write
from model.rods import Fast, Rods, solve

SIZES = (1, 10, 100, 1_000, 10_000, 100_000)
ELEMENTS = (2, 4, 8, 16, 32, 64)
AT_LEAST = 1.0
"""s, for which a call is repeated."""
CUT = 1_600
"""Rods of which each has so many elements."""


@dataclass(frozen=True)
class Taken:
    """A batch."""

    rods: int
    elements: int
    start: str
    """cold or warm."""
    threads: int
    seconds: float
    """Of the whole batch."""


def least(call: Callable[[], object], clock: Callable[[], float]) -> float:
    """Least seconds of a call that is repeated, three times at least."""
    call()
    began, taken = time.perf_counter(), list[float]()
    while len(taken) < 3 or time.perf_counter() - began < AT_LEAST:
        start = clock()
        call()
        taken.append(clock() - start)
    return min(taken)


def both(rods: Rods, elements: int, threads: int) -> list[Taken]:
    """Cold and warm."""
    method = Fast(cores=threads)
    near = solve(eased(rods), Fast(remember=True))
    clock = time.thread_time if threads == 1 else time.perf_counter
    calls = {"cold": lambda: solve(rods, method), "warm": lambda: solve(rods, method, start=near)}
    return [Taken(len(rods), elements, start, threads, least(call, clock)) for start, call in calls.items()]


def figures(quick: bool) -> list[Taken]:
    """All batches."""
    found = []
    for n in SIZES[:-1] if quick else SIZES:
        rods = paper_rods(35, seed=1)[22:23] if n == 1 else paper_rods(n, seed=1)
        for threads in (1, 2):
            found += both(rods, 2, threads)
    for elements in ELEMENTS:
        cut = split(paper_rods(CUT // 4 if quick else CUT, seed=3), elements // 2)
        found += both(cut, elements, 1)
    return found


def main() -> int:
    """Print the table, write the JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="no more than 10,000 rods")
    parser.add_argument("--json", type=Path, default=Path("out/rod_growth.json"), help="where the numbers go")
    options = parser.parse_args()
    found = figures(options.quick)
    table = Table(title="Rods", title_justify="left")
    for column in ("rods", "elements", "start", "threads", "ms", "us a rod"):
        table.add_column(column)
    for t in found:
        words = (t.rods, t.elements, t.start, t.threads, f"{1e3 * t.seconds:.3g}", f"{1e6 * t.seconds / t.rods:.3g}")
        table.add_row(*map(str, words))
    Console().print(table)
    write(options.json, "batches", found)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
