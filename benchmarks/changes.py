"""What changed since a reference? `python -m benchmarks.changes [--pairs N] [--seed S] [--cores N] [--json FILE]`

Pairs of campaigns on one robot of another physics (`benchmarks.blind.worlds`), each pair on a robot and in a world of its own,
with clutter: a reference, and the same robot on another day, mounted and seen by the cameras anew, with other trials and another
drift. In every other pair nothing else has changed; in the others one effect has, by one plausible scale. Reported, with
Clopper-Pearson 95 % intervals: how often a change is reported where there is none, and how often the changed effect is named.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.blind.make import described, scatter, table_of, walk_of
from benchmarks.blind.metrics import counted
from benchmarks.blind.sweeps import BASE
from benchmarks.blind.truth import SMALL, THRUST, TOLERANCES, Recipe, draw_robot
from benchmarks.blind.worlds.campaign import WorldRobot, read, respond, tails
from benchmarks.blind.worlds.carried import rms, rows
from benchmarks.blind.worlds.equilibrium import NoWorldEquilibrium
from benchmarks.blind.worlds.forms import EFFECTS
from benchmarks.figures import write
from diagnosis.compare_campaigns import compare_campaigns
from diagnosis.inference.executor import Executor
from lab.files.inputs import Case
from lab.processes import processes

SET_UP = ("base_tilt", "frame_misalignment")
"""Tolerances that each day has for itself: the robot was mounted and the cameras were calibrated anew."""
TWO_FLOORS = 2.0
ATTEMPTS = 8


@dataclass(frozen=True)
class Pair:
    """One pair of campaigns and the answer to it."""

    world: str
    changed: str
    """Effect, or empty."""
    floors: float
    """What the change moves the tip by, in noise floors."""
    named: tuple[str, ...]
    probability: float


def another_day(robot: WorldRobot, rng: np.random.Generator) -> WorldRobot:
    """The same robot, mounted and seen anew, on a day whose drift may go the other way."""
    where = robot.world
    sizes = dict(robot.sizes)
    for effect in SET_UP:
        sizes[effect] = sizes.get(effect, 0.0) + where.tolerance * TOLERANCES[effect] * float(tails(rng, where.heavy, ()))
    a, b, c = (float(x) for x in np.array(robot.offset) + where.tolerance * SMALL * tails(rng, where.heavy, (3,)))
    drift = abs(robot.drift) * (1 if rng.random() < 0.7 else -1)
    return replace(robot, sizes=sizes, offset=(a, b, c), drift=drift)


def campaigns(seed: int, changed: bool) -> tuple[str, float, Case, Case]:
    """The changed effect or nothing, by how many floors it moves the tip, the reference and the later campaign. Raises
    NoWorldEquilibrium after some attempts."""
    recipe, walked = Recipe(f"drawn:{seed}", 1, seed, ("cluttered_none",)), walk_of(BASE)
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([seed, 1, attempt])
        before, _ = draw_robot(recipe, 0, "cluttered_none", (), attempt)
        after, effect = another_day(before, rng), ""
        if changed:
            effect = str(rng.choice([e for e in EFFECTS if e != THRUST]))
            way = -1.0 if EFFECTS[effect].sign == "both" and rng.random() < 0.5 else 1.0
            after = replace(after, sizes={**after.sizes, effect: after.sizes.get(effect, 0.0) + way})
        difference = {effect: after.sizes[effect] - before.sizes.get(effect, 0.0)} if effect else {}
        try:
            response = respond(before, walked, (), difference)
            readings = read(before, walked, response, rng), read(after, walked, respond(after, walked), rng)
        except NoWorldEquilibrium:
            continue
        floors = rms(rows(before, walked, response, effect)) / scatter(walked, readings[0]) if effect else 0.0
        reference, later = (Case(described(), table_of(BASE, r)) for r in readings)
        return effect, round(floors, 2), reference, later
    raise NoWorldEquilibrium


def compared(seed: int, changed: bool, executor: Executor) -> Pair:
    """One pair compared."""
    effect, floors, reference, later = campaigns(seed, changed)
    found = compare_campaigns(later, reference, executor=executor)
    return Pair(f"drawn:{seed}", effect, floors, found.effects, round(dict(found.ranking).get(found.effects, 0.0), 3))


def summary(pairs: Sequence[Pair]) -> dict[str, str]:
    """How many of how many, with the interval."""
    large = [p for p in pairs if p.changed and p.floors >= TWO_FLOORS]
    return {
        "unchanged, reported as changed": counted([bool(p.named) for p in pairs if not p.changed]),
        "changed by two floors or more: just the effect named": counted([p.named == (p.changed,) for p in large]),
    }


def main() -> int:
    """Print a line a pair and the figures, and write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=80)
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--json", type=Path, default=Path("out/changes.json"))
    a = parser.parse_args()
    pairs = []
    with processes(max(a.cores - 1, 1)) as workers:
        for k in range(a.pairs):
            try:
                pairs.append(compared(a.seed + k, bool(k % 2), Executor(remote_map=workers.in_order)))
                print(pairs[-1], flush=True)
            except NoWorldEquilibrium:
                print(f"drawn:{a.seed + k}: the robot has no equilibrium, left out")
    for name, figure in summary(pairs).items():
        print(f"{name}: {figure}")
    write(a.json, "pairs", pairs, figures=summary(pairs))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
