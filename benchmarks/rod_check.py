"""The fast rod solver against the slow converged one on random robots: `python -m benchmarks.rod_check`.

Robots are far beyond the paper's: E +-30 %, to 450 kPa, out of plane, the spine anywhere, tip loads to 5 N sideways.
All are solved by the fast solver at its default setting, a random sample also by `tests/model/rods/reference.py`. A
silent error is a tip that the fast solver calls trusted and that is farther than 0.01 mm from the converged one, or
whose rod the converged solver finds on another branch. Exits with 1 when there is any.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from benchmarks.rod_cases import wild_rods
from model.rods import FINE, Solution, Status, solve
from tests.model.rods.reference import REFERENCE

Array = NDArray[np.float64]

FARTHEST = 1e-5
"""m, what a trusted tip may be off."""
AT_ONCE = 100


def compare(fast: Solution, rows: Array, tips: Array, status: NDArray[np.int8]) -> tuple[Array, NDArray[np.bool_]]:
    """Distances (m) of the sampled tips that both solvers trust, and which samples are silent errors."""
    ok = fast.converged[rows]
    both = ok & (status <= Status.SOLVED_IN_STEPS)
    distance = np.full(len(rows), np.nan)
    distance[both] = np.linalg.norm(fast.tip[rows][both] - tips[both], axis=1)
    wrong = (distance > FARTHEST) | (ok & (status == Status.OTHER_BRANCH))
    return distance, np.asarray(wrong)


def main() -> int:
    """Solve, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=100_000)
    parser.add_argument("--sample", type=int, default=2_000, help="how many are checked by the slow solver")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    console = Console()
    rods = wild_rods(options.robots, options.seed)
    start = time.thread_time()
    fast = solve(rods)
    seconds = time.thread_time() - start
    counts = {state.name: int((fast.status == state).sum()) for state in Status}
    console.print(f"{options.robots} robots in {seconds:.2f} s of processor time: {counts}")
    fine = solve(rods, FINE)
    both = fast.converged & fine.converged
    apart = np.linalg.norm(fast.tip - fine.tip, axis=1)[both]
    console.print(f"default against fine setting: worst {1e3 * apart.max():.5f} mm of {int(both.sum())}")
    rows = np.sort(np.random.default_rng(options.seed).choice(options.robots, options.sample, replace=False))
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


if __name__ == "__main__":
    raise SystemExit(main())
