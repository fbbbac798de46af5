"""What changed since a reference? `python -m benchmarks.changes [--pairs N] [--seed S] [--cores N] [--json FILE]`

Pairs of campaigns on one robot of another physics (`sim_fakes.worlds`), each pair on a robot and in a world of its own, with
clutter: a reference, and the same robot on another day, mounted and seen by the cameras anew, with other trials and another
drift. In every other pair nothing else has changed; in the others one effect has, by one plausible scale. Reported, with
Clopper-Pearson 95 % intervals: how often a change is told where there is none, and how often the changed effect is named.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console

from diagnosis.compare_campaigns import compare_campaigns
from diagnosis.inference.executor import Executor
from lab.blind.intervals import clopper_pearson
from lab.blind.make import described
from lab.blind.sweeps import BASE
from lab.blind.worlds.make import scatter, table_of, walk_of
from lab.blind.worlds.truth import SMALL, THRUST, TOLERANCES, WorldRecipe, draw_robot
from lab.files.inputs import Case
from sim_fakes.worlds.campaign import Robot as Built
from sim_fakes.worlds.campaign import Sweep, read, respond, tails
from sim_fakes.worlds.carried import carried
from sim_fakes.worlds.equilibrium import NoEquilibrium
from sim_fakes.worlds.forms import EFFECTS

SET_UP = ("base_tilt", "frame_misalignment")
"""Tolerances that each day has for itself: the robot was mounted and the cameras were calibrated anew."""
TWO_FLOORS = 2.0
ATTEMPTS = 8


@dataclass(frozen=True)
class Pair:
    """One pair and what was said of it."""

    world: str
    changed: str
    """Effect, or empty."""
    floors: float
    """What the change moves the tip by after calibration, in noise floors."""
    named: tuple[str, ...]
    probability: float
    seconds: float

    @property
    def right(self) -> bool:
        """Whether just that is named."""
        return self.named == ((self.changed,) if self.changed else ())


def campaigns(seed: int, changed: bool) -> tuple[str, str, float, Case, Case]:
    """World, changed effect, its floors, reference and later campaign. Raises NoEquilibrium after some attempts."""
    world = f"drawn:{seed}"
    recipe = WorldRecipe(world, 1, seed, ("cluttered_none",))
    walked = walk_of(BASE)
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([seed, 1, attempt])
        before, _ = draw_robot(recipe, 0, "cluttered_none", (), attempt)
        after, effect = another_day(before, rng), ""
        if changed:
            effect = str(rng.choice([e for e in EFFECTS if e != THRUST]))
            way = -1.0 if EFFECTS[effect].sign == "both" and rng.random() < 0.5 else 1.0
            after = replace(after, sizes={**after.sizes, effect: after.sizes.get(effect, 0.0) + way})
        try:
            (reference, floor, _), (later, _, moved) = (measured(r, walked, rng) for r in (before, after))
        except NoEquilibrium:
            continue
        return world, effect, moved.get(effect, 0.0) / floor, reference, later
    raise NoEquilibrium


def another_day(robot: Built, rng: np.random.Generator) -> Built:
    """The same robot, mounted and seen anew, on a day whose drift may go the other way."""
    where = robot.world
    sizes = dict(robot.sizes)
    for effect in SET_UP:
        sizes[effect] = sizes.get(effect, 0.0) + where.tolerance * TOLERANCES[effect] * float(
            tails(rng, where.heavy, ())
        )
    a, b, c = (float(x) for x in np.array(robot.offset) + where.tolerance * SMALL * tails(rng, where.heavy, (3,)))
    drift = abs(robot.drift) * (1 if rng.random() < 0.7 else -1)
    return replace(robot, sizes=sizes, offset=(a, b, c), drift=drift)


def measured(robot: Built, walked: Sweep, rng: np.random.Generator) -> tuple[Case, float, Mapping[str, float]]:
    """A campaign, the scatter of its repeats, and what each effect moves the tip by after calibration, mm."""
    response = respond(robot, walked, tuple(robot.present))
    readings = read(robot, walked, response, rng)
    moved = carried(robot, walked, response).calibrated
    return Case(described(), table_of(BASE, readings)), scatter(walked, readings), moved


def said(seed: int, changed: bool, cores: int) -> Pair:
    """One pair compared."""
    world, effect, floors, reference, later = campaigns(seed, changed)
    begun = time.monotonic()
    found = compare_campaigns(later, reference, executor=Executor(cores))
    named, probability = found.ranking[0]
    return Pair(world, effect, round(floors, 2), tuple(named), round(probability, 3), time.monotonic() - begun)


def summary(pairs: Sequence[Pair]) -> dict[str, object]:
    """Shares with their intervals."""
    still = [p for p in pairs if not p.changed]
    moved = [p for p in pairs if p.changed]
    seen = [p for p in moved if p.floors >= TWO_FLOORS]
    rows = {
        "unchanged, told as changed": [bool(p.named) for p in still],
        "changed: just the effect named": [p.right for p in moved],
        "changed by two floors or more: just the effect named": [p.right for p in seen],
        "changed by two floors or more: the effect among the named": [p.changed in p.named for p in seen],
        "told with p > 0.9: right": [p.right for p in pairs if p.probability > 0.9],
    }
    return {
        name: {
            "share": float(np.mean(own)) if own else None,
            "n": len(own),
            "interval": clopper_pearson(sum(own), len(own)),
        }
        for name, own in rows.items()
    }


def main() -> int:
    """Print a line a pair and the figures, and write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=80)
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--json", type=Path, default=Path("out/changes.json"))
    a = parser.parse_args()
    console = Console(width=150)
    pairs = []
    for k in range(a.pairs):
        try:
            pairs.append(said(a.seed + k, bool(k % 2), a.cores))
        except NoEquilibrium:
            console.print(f"drawn:{a.seed + k}: the robot has no equilibrium, left out")
            continue
        p = pairs[-1]
        console.print(
            f"{p.world}: {p.changed or 'nothing'} changed ({p.floors:.1f} floors), told: {' and '.join(p.named) or 'nothing'} "
            f"(p = {p.probability:.2f}), {p.seconds:.0f} s", markup=False,
        )  # fmt: skip
    figures = summary(pairs)
    for name, figure in figures.items():
        console.print(f"{name}: {figure}", markup=False)
    a.json.parent.mkdir(parents=True, exist_ok=True)
    a.json.write_text(json.dumps({"figures": figures, "pairs": [asdict(p) for p in pairs]}, indent=1), encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
