"""What changed since a reference? `python -m benchmarks.changes [--pairs N] [--seed S] [--cores N] [--json FILE]`

Pairs of campaigns on one robot of another physics (`benchmarks.blind.worlds`), each pair on a robot and in a world of its own,
with clutter: a reference, and the same robot on another day, mounted and seen by the cameras anew, with other trials and another
drift. In every other pair nothing else has changed; in the others one effect has, by one plausible scale. Reported, with
Clopper-Pearson 95 % intervals: how often a change is told where there is none, and how often the changed effect is named.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console

from benchmarks.blind.make import described, scatter, table_of, walk_of
from benchmarks.blind.metrics import clopper_pearson
from benchmarks.blind.sweeps import BASE
from benchmarks.blind.truth import SMALL, THRUST, TOLERANCES, Recipe, draw_robot
from benchmarks.blind.worlds.campaign import Response, Sweep, read, respond, tails
from benchmarks.blind.worlds.campaign import Robot as Built
from benchmarks.blind.worlds.carried import rms, rows
from benchmarks.blind.worlds.equilibrium import NoEquilibrium
from benchmarks.blind.worlds.forms import EFFECTS
from benchmarks.figures import write
from diagnosis.compare_campaigns import compare_campaigns
from diagnosis.inference.executor import Executor
from lab.files.inputs import Case

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
    """What the change moves the tip by, in noise floors."""
    set_up: dict[str, float]
    """What mounting and cameras set up anew move it by."""
    named: tuple[str, ...]
    probability: float
    nothing: float
    """Probability that nothing changed."""
    seconds: float

    @property
    def right(self) -> bool:
        """Whether just that is named."""
        return self.named == ((self.changed,) if self.changed else ())

    @property
    def false_alarm(self) -> bool:
        """Whether something is named that did not move the tip by two floors, set up anew or changed."""
        moved = {**self.set_up, self.changed: self.floors}
        return any(moved.get(e, 0.0) < TWO_FLOORS for e in self.named)


@dataclass(frozen=True)
class Drawn:
    """Two campaigns and what is true of them."""

    changed: str
    floors: float
    set_up: dict[str, float]
    reference: Case
    later: Case


def campaigns(seed: int, changed: bool) -> Drawn:
    """Of one robot of the world that a seed draws. Raises NoEquilibrium after some attempts."""
    recipe = Recipe(f"drawn:{seed}", 1, seed, ("cluttered_none",))
    walked = walk_of(BASE)
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([seed, 1, attempt])
        before, _ = draw_robot(recipe, 0, "cluttered_none", (), attempt)
        after, effect = another_day(before, rng), ""
        anew = {e: after.sizes[e] - before.sizes.get(e, 0.0) for e in SET_UP}
        if changed:
            effect = str(rng.choice([e for e in EFFECTS if e != THRUST]))
            way = -1.0 if EFFECTS[effect].sign == "both" and rng.random() < 0.5 else 1.0
            after = replace(after, sizes={**after.sizes, effect: after.sizes.get(effect, 0.0) + way})
        differences = anew | ({effect: after.sizes[effect] - before.sizes.get(effect, 0.0)} if effect else {})
        try:
            response = respond(before, walked, (), differences)
            reference = read(before, walked, response, rng)
            later = read(after, walked, respond(after, walked), rng)
        except NoEquilibrium:
            continue
        floor = scatter(walked, reference)
        moved = {e: round(moves(before, walked, response, e) / floor, 2) for e in differences}
        cases = (Case(described(), table_of(BASE, readings)) for readings in (reference, later))
        return Drawn(effect, moved.get(effect, 0.0), {e: moved[e] for e in anew}, *cases)
    raise NoEquilibrium


def moves(robot: Built, walked: Sweep, response: Response, effect: str) -> float:
    """mm, root mean square over all readings: an area factor that both campaigns share takes up nothing of it."""
    return rms(rows(robot, walked, response, effect))


def another_day(robot: Built, rng: np.random.Generator) -> Built:
    """The same robot, mounted and seen anew, on a day whose drift may go the other way."""
    where = robot.world
    sizes = dict(robot.sizes)
    for effect in SET_UP:
        sizes[effect] = sizes.get(effect, 0.0) + where.tolerance * TOLERANCES[effect] * float(tails(rng, where.heavy, ()))
    a, b, c = (float(x) for x in np.array(robot.offset) + where.tolerance * SMALL * tails(rng, where.heavy, (3,)))
    drift = abs(robot.drift) * (1 if rng.random() < 0.7 else -1)
    return replace(robot, sizes=sizes, offset=(a, b, c), drift=drift)


def said(seed: int, changed: bool, cores: int) -> Pair:
    """One pair compared."""
    drawn = campaigns(seed, changed)
    begun = time.monotonic()
    found = compare_campaigns(drawn.later, drawn.reference, executor=Executor(cores))
    nothing = dict(found.ranking).get((), 0.0)
    probability = dict(found.ranking)[found.effects] if found.effects else nothing
    return Pair(
        f"drawn:{seed}", drawn.changed, drawn.floors, drawn.set_up, found.effects, round(probability, 3),
        round(nothing, 3), time.monotonic() - begun,
    )  # fmt: skip


def summary(pairs: Sequence[Pair]) -> dict[str, object]:
    """Shares with their intervals."""
    still = [p for p in pairs if not p.changed]
    moved = [p for p in pairs if p.changed]
    seen = [p for p in moved if p.floors >= TWO_FLOORS]
    rows = {
        "unchanged, told as changed": [bool(p.named) for p in still],
        "unchanged, told as changed what moved less than two floors": [p.false_alarm for p in still],
        "changed: just the effect named": [p.right for p in moved],
        "changed by two floors or more: just the effect named": [p.right for p in seen],
        "changed by two floors or more: the effect among the named": [p.changed in p.named for p in seen],
        "told with p > 0.9: right": [p.right for p in pairs if p.probability > 0.9],
    }
    return {
        name: {"share": float(np.mean(own)) if own else None, "n": len(own), "interval": clopper_pearson(sum(own), len(own))}
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
            f"{p.world}: {p.changed or 'nothing'} changed ({p.floors:.1f} floors; set up anew {max(p.set_up.values()):.1f}), "
            f"told: {' and '.join(p.named) or 'nothing'} (p = {p.probability:.2f}, nothing {p.nothing:.2f}), {p.seconds:.0f} s",
            markup=False,
        )  # fmt: skip
    figures = summary(pairs)
    for name, figure in figures.items():
        console.print(f"{name}: {figure}", markup=False)
    write(a.json, "pairs", pairs, figures=figures)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
