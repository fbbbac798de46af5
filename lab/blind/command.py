"""The verb `lab blind`: make, run, score."""

from __future__ import annotations

import argparse
import json

from ..console import out
from ..files.config import ConfigError
from .make import make
from .run import Further, attribute_folder, diagnose_folder, propose_folder, run
from .score import score, write
from .sheet import draw, sheet
from .truth import Recipe, drawable
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
    menu = not a.no_menu and a.simulator is None
    digest = make(
        a.out, recipe, a.design, menu=menu, per_length=a.per_length, simulator=a.simulator, crew=_crew(a)
    )  # fmt: skip
    out.print(f"{a.n} cases of world {a.world} in {a.out}; sha256 of the sealed truth {digest}")
    return 0


def _run(a: argparse.Namespace) -> int:
    quick = propose_folder if a.chosen else attribute_folder
    done = run(a.out, quick if a.quick else diagnose_folder, Further(a.chosen, a.choose), _crew(a))
    out.print(f"{done} cases diagnosed")
    return 0


def _score(a: argparse.Namespace) -> int:
    result = score(a.out, a.after)
    path = write(result, a.out)
    picture = draw(result, a.out / "score.png")
    if a.json:
        print(json.dumps(result.as_dict(), indent=1))
    else:
        out.print(sheet(result))
        out.print(f"{path}, {picture}")
    return 1 if result.shortfalls else 0
