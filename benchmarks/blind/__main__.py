"""Sealed cases: `python -m benchmarks.blind make|run|score`. Exit code 0 done, 1 failed or a target missed, 2 wrong usage."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from lab.console import complain, out
from lab.failures import explained
from lab.files.config import ConfigError

from .make import make
from .run import attribute_folder, diagnose_folder, propose_folder, run
from .score import score, write
from .sheet import sheet
from .truth import KINDS, Recipe, drawable


def _make(a: argparse.Namespace) -> int:
    low, high = a.sizes
    if not 0 < low <= high <= 5:
        raise ConfigError(f"--sizes {low:g} {high:g}: must increase within 0..5")
    if a.clutter is not None and not 0 <= a.clutter <= 1:
        raise ConfigError(f"--clutter {a.clutter:g}: must be within 0..1")
    if a.n < 1:
        raise ConfigError(f"--n {a.n}: must be 1 or more")
    for cause in a.cause or ():
        if cause not in drawable():
            raise ConfigError(f"--cause {cause}: must be one of {', '.join(drawable())}")
    recipe = Recipe(a.world, a.n, a.seed, tuple(a.kind or ()), a.clutter, (low, high), a.held_out, tuple(a.cause or ()))
    # a simulator predicts the base sweep alone
    menu = a.simulator is None
    digest = make(a.out, recipe, a.design, menu=menu, simulator=a.simulator, workers=a.workers)
    out.print(f"{a.n} cases of world {a.world} in {a.out}; sha256 of the sealed truth {digest}")
    return 0


def _run(a: argparse.Namespace) -> int:
    quick = propose_folder if a.chosen else attribute_folder
    done = run(a.out, quick if a.quick else diagnose_folder, a.chosen, a.workers)
    out.print(f"{done} cases diagnosed")
    return 0


def _score(a: argparse.Namespace) -> int:
    result = score(a.out, a.answers)
    path = write(result, a.out, a.answers)
    if a.json:
        print(json.dumps(result.as_dict(), indent=1))
    else:
        out.print(sheet(result))
        out.print(str(path))
    return 1 if result.shortfalls else 0


def parser() -> argparse.ArgumentParser:
    """Return the parser of the three steps."""
    top = argparse.ArgumentParser(prog="python -m benchmarks.blind", epilog="page: docs/howto/blind.md", allow_abbrev=False)
    steps = top.add_subparsers(required=True, metavar="STEP")
    making = steps.add_parser("make", help="draw the truth, measure the cases, seal the truth", allow_abbrev=False)
    running = steps.add_parser("run", help="diagnose every case; the seal stays closed", allow_abbrev=False)
    scoring = steps.add_parser("score", help="open the seal and score", allow_abbrev=False)
    for step, call in ((making, _make), (running, _run), (scoring, _score)):
        step.set_defaults(call=call)
        step.add_argument("out", type=Path, help="folder of the set")
    for step in (making, running):
        step.add_argument("--workers", type=lambda text: text if "://" in text else int(text), default=1, help="processes "
                          "(default 1), or tcp://HOST:PORT of a Dask scheduler")  # fmt: skip
    making.add_argument("--n", type=int, default=200, help="cases (default 200)")
    making.add_argument("--seed", type=int, required=True, help="seed, one that was not used before")
    making.add_argument("--design", default="full", help="tip, full (orientation and unload), full+markers, full+extras")
    making.add_argument("--clutter", type=float, help="of cluttered kinds: every other effect at this share of its scale "
                        "(default: the world's own)")  # fmt: skip
    making.add_argument("--world", default="bench", metavar="W", help="physics of the robots: bench (default), drawn:SEED, or "
                        "new:SEED of forms that nothing is developed on")  # fmt: skip
    making.add_argument("--kind", action="append", choices=tuple(KINDS), help="only cases of this kind (repeatable; default: a "
                        "mixture)")  # fmt: skip
    making.add_argument("--held-out", action="store_true", help="held-out outside causes, for a final score")
    making.add_argument("--sizes", type=float, nargs=2, default=(0.5, 1.5), metavar=("LOW", "HIGH"), help="effects, in plausible "
                        "scales")  # fmt: skip
    making.add_argument("--simulator", metavar="NAME|FILE.py", help="its predictions are the baseline, in the rod's place; no "
                        "further experiments")  # fmt: skip
    making.add_argument("--cause", action="append", metavar="ID", help="draw causes from these effects (repeatable)")
    running.add_argument("--chosen", type=int, default=0, help="experiments that the diagnosis may request (0 to 3)")
    running.add_argument("--quick", action="store_true", help="no held-out errors, and without --chosen no next experiments")
    scoring.add_argument("--answers", type=Path, metavar="FOLDER", help="score those of another method in place of the "
                         "diagnosis: CASE.json in the form of diagnosis.json")  # fmt: skip
    scoring.add_argument("--json", action="store_true", help="print the result as JSON")
    return top


def main(words: Sequence[str] | None = None) -> int:
    """Do one step; a failure that a person can do something about is one message."""
    a = parser().parse_args(words)
    try:
        return int(a.call(a))
    except Exception as e:
        known = explained(e)
        if known is None:
            raise
        complain(known[0])
        return known[1]


if __name__ == "__main__":
    sys.exit(main())
