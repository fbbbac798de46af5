"""The verb `lab blind`: make, run, score."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from ..console import out
from ..files.config import ConfigError
from ..options import JSON, SCHEDULER, Step, Verb, option
from .make import make
from .run import Further, attribute_folder, diagnose_folder, propose_folder, run
from .score import score, write
from .sheet import draw, sheet
from .truth import KINDS, Recipe, drawable
from .workers import Crew


def main(a: argparse.Namespace) -> int:
    """One step; 0, or 1 when a score misses a target."""
    return {"make": _make, "run": _run, "score": _score}[a.step](a)


def _crew(a: argparse.Namespace) -> Crew:
    return Crew(a.workers, a.scheduler)


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
    recipe = Recipe(
        a.world, a.n, a.seed, tuple(a.kind or ()), a.clutter, (low, high), a.settled, a.held_out, tuple(a.cause or ())
    )
    # a simulator predicts the base sweep alone
    menu = a.simulator is None
    digest = make(a.out, recipe, a.design, menu=menu, simulator=a.simulator, crew=_crew(a))
    out.print(f"{a.n} cases of world {a.world} in {a.out}; sha256 of the sealed truth {digest}")
    return 0


def _run(a: argparse.Namespace) -> int:
    quick = propose_folder if a.chosen else attribute_folder
    done = run(a.out, quick if a.quick else diagnose_folder, Further(a.chosen), _crew(a))
    out.print(f"{done} cases diagnosed")
    return 0


def _score(a: argparse.Namespace) -> int:
    result = score(a.out, a.answers)
    path = write(result, a.out, a.answers)
    picture = draw(result, path.with_suffix(".png"))
    if a.json:
        print(json.dumps(result.as_dict(), indent=1))
    else:
        out.print(sheet(result))
        out.print(f"{path}, {picture}")
    return 1 if result.shortfalls else 0


CREW = (option("--workers", type=int, default=1, help="processes of this machine (default 1)"), SCHEDULER)

MAKE = (
    option("out", type=Path, help="an empty folder"),
    option("--n", type=int, default=200, help="cases (default 200)"),
    option("--seed", type=int, required=True, help="seed, one that was not used before"),
    option("--design", default="full", help="tip, full (orientation and unload), full+markers, full+extras"),
    option(
        "--clutter",
        type=float,
        help="of cluttered kinds: every other effect at this share of its scale (default: the world's own)",
    ),
    option(
        "--world",
        default="bench",
        metavar="W",
        help="physics of the robots: bench (default), workshop, cellar, attic, shared, field, quiet, or drawn:SEED",
    ),
    option(
        "--kind",
        action="append",
        choices=tuple(KINDS),
        help="only cases of this kind (repeatable; default: a mixture)",
    ),
    option("--held-out", action="store_true", help="held-out outside causes, for a final score"),
    option("--sizes", type=float, nargs=2, default=(0.5, 1.5), metavar=("LOW", "HIGH"), help="effects, in plausible scales"),
    option("--settled", action="store_true", help="stop and read, instead of reading while ramping slowly"),
    option(
        "--simulator",
        metavar="NAME|FILE.py",
        help="its predictions are the baseline, in the rod's place; no further experiments",
    ),
    option("--cause", action="append", metavar="ID", help="draw causes from these effects (repeatable)"),
    *CREW,
)

RUN = (
    option("out", type=Path),
    option("--chosen", type=int, default=0, help="experiments that the diagnosis may request (0 to 3)"),
    *CREW,
    option("--quick", action="store_true", help="no held-out errors, and without --chosen no next experiments"),
)

SCORE = (
    option("out", type=Path),
    option(
        "--answers",
        type=Path,
        metavar="FOLDER",
        help="score those of another method in place of the diagnosis: CASE.json in the form of diagnosis.json",
    ),
    JSON,
)

VERBS = (
    Verb(
        "blind",
        main,
        options=(),
        examples=("lab blind make --help", "lab blind score --help"),
        page="docs/howto/blind.md",
        steps=(
            Step("make", "draw the truth, measure the cases, seal the truth", MAKE),
            Step("run", "diagnose every case; the seal stays closed", RUN),
            Step("score", "open the seal and score", SCORE),
        ),
    ),
)
