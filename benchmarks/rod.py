"""The figures of the rod solver: `python -m benchmarks.rod [--quick] [--json FILE]`, and `--check ROBOTS` of its answers.

Times are processor time of one thread (so that a busy machine counts less), medians and minima of rounds; the row with
two threads and the single calls are wall time. Ratios are between rows of one run. Accuracy stands beside: the worst
distance (mm) of a tip from the same rods solved finely.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.figures import write
from benchmarks.rod_cases import directions, paper_rods, split, tips_of, wild_rods
from model.arrays import Array, Mask
from model.rods import FAST, FINE, Fast, Rods, Solution, Status, sensitivities, solve
from model.rods.fast import direct
from model.rods.fast.method import steps_of
from model.rods.solution import RESULT


def measure(call: Callable[[], object], rounds: int, clock: Callable[[], float] = time.thread_time) -> tuple[float, float]:
    """Median and least seconds of a call."""
    call()
    times = []
    for _ in range(rounds):
        start = clock()
        call()
        times.append(clock() - start)
    return float(np.median(times)), min(times)


def row(name: str, seconds: tuple[float, float], solves: int, target: str = "", error: float = float("nan")) -> dict[str, object]:
    """One line: microseconds a solve (median, least), solves per second, worst error in mm."""
    median, least = (1e6 * s / solves for s in seconds)
    return {"name": name, "us": median, "us_least": least, "per_s": 1e6 / median, "error_mm": error, "target": target}


def error_of(rods: Rods) -> float:
    """Worst distance between the default and the fine tips, mm."""
    return float(1e3 * np.linalg.norm(tips_of(solve(rods, FAST)) - tips_of(solve(rods, FINE)), axis=1).max())


def kernel_seconds(rods: Rods, rounds: int) -> tuple[float, float]:
    """The kernel alone, called for one rod."""
    out, memory = np.empty((len(rods), RESULT)), np.zeros((0, direct.MEMORY))
    settings, steps = (FAST.divisions, FAST.close, False), steps_of(rods, None)

    def call() -> None:
        direct.solve_direct(rods.values, rods.form.springs, settings, steps, memory, out)

    return measure(call, rounds, time.perf_counter)


def figures(quick: bool) -> list[dict[str, object]]:
    """All lines of the table."""
    n, rounds = (4_000, 5) if quick else (35_000, 11)
    rods = paper_rods(n, seed=1)
    plain = measure(lambda: solve(rods), rounds)
    lines = [row("batch, cold, 35 conditions", plain, n, ">= 1.5 M/s, <= 0.01 mm", error_of(rods))]
    warm = solve(rods, Fast(remember=True))
    lines.append(row("batch, warm", measure(lambda: solve(rods, start=warm), rounds), n))
    two = Fast(cores=2)
    lines.append(row("batch, cold, two threads", measure(lambda: solve(rods, two), rounds, time.perf_counter), n))
    one = paper_rods(35, seed=2)[22:23]
    lines.append(row("single, kernel called", kernel_seconds(one, 3000), 1, "<= 6 us"))
    lines.append(row("single, Python call", measure(lambda: solve(one), 3000, time.perf_counter), 1, "<= 15 us", error_of(one)))
    part = rods[: n // 4]
    along, solved = directions(part), solve(part)
    both = measure(lambda: (solve(part), sensitivities(part, solved, along)), rounds)
    lines.append(row("batch with 8 sensitivities", both, len(part), "<= 3x plain"))
    soft = paper_rods(n // 4, seed=1)
    soft.field("series")[:, 1] = (0.02, 0.0, 1.0)
    lines.append(row("hyperelastic section", measure(lambda: solve(soft), rounds), n // 4, "<= 10x plain", error_of(soft)))
    for size in (100, 1_000, 10_000) if quick else (100, 1_000, 10_000, 100_000, 1_000_000):
        many = Rods(rods.form, np.resize(rods.values, (size, rods.form.width)))
        lines.append(row(f"batch of {size}", measure(lambda many=many: solve(many), 3), size))  # type: ignore[misc]
    for elements in (2, 4, 8, 16, 32, 64):
        fine = split(paper_rods(1_600, seed=3), elements // 2)
        lines.append(row(f"{elements} elements", measure(lambda fine=fine: solve(fine), 3), 1_600, "", error_of(fine)))  # type: ignore[misc]
    return lines


FARTHEST = 1e-5
"""m, what a trusted tip may be off."""
AT_ONCE = 100


def compare(fast: Solution, rows: Array, tips: Array, status: NDArray[np.int8]) -> tuple[Array, Mask]:
    """Distances (m) of the sampled tips that both solvers trust, and which samples are silent errors."""
    ok = fast.converged[rows]
    both = ok & (status <= Status.SOLVED_IN_STEPS)
    distance = np.full(len(rows), np.nan)
    distance[both] = np.linalg.norm(fast.tip[rows][both] - tips[both], axis=1)
    wrong = (distance > FARTHEST) | (ok & (status == Status.OTHER_BRANCH))
    return distance, np.asarray(wrong)


def check(robots: int, sample: int, seed: int = 1) -> int:
    """Solve random robots far beyond the paper's: E +-30 %, to 450 kPa, out of plane, tip loads to 5 N sideways.

    All are solved by the fast solver at its default setting, a random sample also by `tests/model/rods/reference.py`. A silent
    error is a tip that the fast solver calls trusted and that is farther than `FARTHEST` from the converged one, or whose rod
    the converged solver finds on another branch. Returns 1 when there is any.
    """
    from tests.model.rods.reference import REFERENCE

    console = Console()
    rods = wild_rods(robots, seed)
    start = time.thread_time()
    fast = solve(rods)
    seconds = time.thread_time() - start
    counts = {state.name: int((fast.status == state).sum()) for state in Status}
    console.print(f"{robots} robots in {seconds:.2f} s of processor time: {counts}")
    fine = solve(rods, FINE)
    both = fast.converged & fine.converged
    apart = np.linalg.norm(fast.tip - fine.tip, axis=1)[both]
    console.print(f"default against fine setting: worst {1e3 * apart.max():.5f} mm of {int(both.sum())}")
    rows = np.sort(np.random.default_rng(seed).choice(robots, sample, replace=False))
    tips, status = np.empty((len(rows), 3)), np.empty(len(rows), np.int8)
    for at in track(range(0, len(rows), AT_ONCE), "slow solver", console=console, disable=not console.is_terminal):
        part = slice(at, at + AT_ONCE)
        slow = solve(rods[rows[part]], REFERENCE)
        tips[part], status[part] = slow.tip, slow.status
    distance, wrong = compare(fast, rows, tips, status)
    slow_ok = status <= Status.SOLVED_IN_STEPS
    console.print(
        f"sample of {len(rows)}: both trust {int(np.isfinite(distance).sum())}, worst {1e3 * np.nanmax(distance):.5f} mm, "
        f"fast alone {int((fast.converged[rows] & ~slow_ok).sum())}, slow alone {int((~fast.converged[rows] & slow_ok).sum())}, "
        f"neither {int((~fast.converged[rows] & ~slow_ok).sum())}"
    )
    for i in np.flatnonzero(wrong | (fast.converged[rows] & ~slow_ok)):
        console.print(f"  robot {rows[i]}: {1e3 * distance[i]:.4f} mm, slow solver says {Status(status[i]).name}")
    console.print(f"silent errors: {int(wrong.sum())}")
    return 1 if wrong.any() else 0


def main() -> int:
    """Print the table, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer rods and rounds")
    parser.add_argument("--json", type=Path, default=Path("out/rod.json"), help="where the numbers go")
    parser.add_argument("--check", type=int, metavar="ROBOTS", help="compare random robots with the converged solver")
    parser.add_argument("--sample", type=int, default=2_000, help="of these, how many are solved by the slow solver")
    options = parser.parse_args()
    if options.check:
        return check(options.check, min(options.sample, options.check))
    start = time.perf_counter()
    solve(paper_rods(1, seed=0))
    first = time.perf_counter() - start
    lines = figures(options.quick)
    table = Table(title=f"Rod solver (first solve {first:.1f} s, load {os.getloadavg()[0]:.1f})", title_justify="left")
    for column in ("case", "us/solve", "least", "solves/s", "x plain", "worst mm", "target"):
        table.add_column(column)
    plain = float(str(lines[0]["us"]))
    for line in lines:
        us, least, error = (float(str(line[key])) for key in ("us", "us_least", "error_mm"))
        line["ratio"] = us / plain
        shown = "" if np.isnan(error) else f"{error:.4f}"
        table.add_row(
            str(line["name"]), f"{us:.3f}", f"{least:.3f}", f"{1e6 / us:,.0f}", f"{us / plain:.2f}", shown, str(line["target"])
        )
    Console(width=150).print(table)
    write(options.json, "figures", lines, first_solve_s=first)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
