"""The verb `lab blind`: make, run, score."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence

from ..console import out
from ..files.config import ConfigError
from .make import make
from .options import KINDS, OWN_WORLD, WIRED
from .run import Further, run
from .score import score, write
from .sheet import draw, sheet
from .truth import Recipe, drawable
from .workers import Crew


def main(a: argparse.Namespace) -> int:
    """One step; 0, or 1 when a score misses a target."""
    return {"make": _make, "run": _run, "score": _score}[a.step](a)


def _crew(a: argparse.Namespace) -> Crew:
    return Crew(a.workers, a.scheduler)


def _menu(a: argparse.Namespace) -> bool:
    """Whether experiments are offered: a simulator predicts the base sweep alone, and the menu is for nine chambers."""
    return not a.no_menu and a.simulator is None and a.geometry == "paper"


def _make(a: argparse.Namespace) -> int:
    low, high = a.sizes
    clutter, wire = a.clutter or 0.0, a.wire
    if wire is None:
        wire = WIRED if a.geometry == "paper" else 0
    if not 0 < low <= high <= 5 or not 0 <= clutter <= 1:
        raise ConfigError(
            f"--sizes {low:g} {high:g} must increase within 0..5, and --clutter {clutter:g} must be within 0..1"
        )
    if a.n < 1 or wire < 0:
        raise ConfigError(f"--n {a.n} must be 1 or more, and --wire {wire} not below 0")
    if a.geometry != "paper" and (wire or a.world != OWN_WORLD):
        raise ConfigError(f"--geometry {a.geometry}: the virtual robot driven directly; give --wire 0 and no --world")
    if a.world != OWN_WORLD:
        return _make_world(a)
    if a.kind or a.held_out:
        raise ConfigError(
            f"--kind and --held-out are for other worlds: give --world, or use --only {' | '.join(KINDS)}"
        )
    only, causes = tuple(a.only or KINDS), _causes(a, drawable())
    recipe = Recipe(a.n, a.seed, clutter, (low, high), a.settled, min(wire, a.n), only, a.geometry, causes)
    digest = make(a.out, recipe, a.design, menu=_menu(a), per_length=a.per_length, simulator=a.simulator, crew=_crew(a))
    out.print(f"{a.n} cases in {a.out}; sha256 of the sealed truth {digest}")
    return 0


def _causes(a: argparse.Namespace, known: Sequence[str]) -> tuple[str, ...]:
    """Effects to draw from; raises ConfigError for one that the robots do not have, or a sweep does not show."""
    for cause in a.cause or ():
        if cause not in known:
            raise ConfigError(f"--cause {cause}: must be one of {', '.join(known)}")
    return tuple(a.cause or ())


def _make_world(a: argparse.Namespace) -> int:
    from .worlds.make import make as make_world
    from .worlds.truth import WorldRecipe
    from .worlds.truth import drawable as drawable_in_world

    if a.wire or a.only:
        raise ConfigError("--wire and --only are for the virtual robot: with --world leave them out, and use --kind")
    low, high = a.sizes
    causes = _causes(a, drawable_in_world())
    recipe = WorldRecipe(
        a.world, a.n, a.seed, tuple(a.kind or ()), a.clutter, (low, high), a.settled, a.held_out, causes
    )
    digest = make_world(
        a.out, recipe, a.design, menu=_menu(a), per_length=a.per_length, simulator=a.simulator, crew=_crew(a)
    )
    out.print(f"{a.n} cases of world {a.world} in {a.out}; sha256 of the sealed truth {digest}")
    return 0


def _run(a: argparse.Namespace) -> int:
    from .diagnose import attribute_folder, diagnose_folder, propose_folder

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
