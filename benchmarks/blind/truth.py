"""The truth of a case: which effects are on and how large, in plausible scales, and what they do in mm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np

from .worlds.campaign import WorldRobot, tails
from .worlds.forms import EFFECTS, ON_REQUEST
from .worlds.outside import OUTSIDE, Cause
from .worlds.robot import LENGTH, draw_places
from .worlds.table import World, world

Stratum = Literal[
    "clean", "none", "cluttered", "cluttered_none", "pairs", "cluttered_pairs", "outside", "cluttered_outside", "walls"
]

THRUST = "chamber_thrust"
"""Never clutter and never a single cause: where the gas acts is a robot's design, the stratum `walls` asks for it."""
KINDS: dict[Stratum, str] = {
    "clean": "single", "none": "none", "cluttered": "single", "cluttered_none": "none", "pairs": "pair",
    "cluttered_pairs": "pair", "outside": "outside", "cluttered_outside": "outside", "walls": "single",
}  # fmt: skip
"""What the score takes each stratum for."""
MIXED: dict[Stratum, float] = {
    "clean": 0.2, "none": 0.05, "cluttered": 0.3, "cluttered_none": 0.1, "pairs": 0.05, "cluttered_pairs": 0.1,
    "outside": 0.05, "cluttered_outside": 0.1, "walls": 0.05,
}  # fmt: skip
"""Shares of a set that asks for no stratum."""
LESS_CLUTTER = {"contact": 0.15, "base_compliance": 0.3}
"""These two at their plain share would carry more than what is drawn."""
TOLERANCES = {"body_modulus": 0.02 / 0.12, "self_weight": 0.01 / 0.12, "base_tilt": 0.1 / 1.5, "frame_misalignment": 0.1 / 1.5}
"""Of every robot: E 2 %, density 1 %, base and camera frame 0.1 deg, in plausible scales."""
SMALL = 0.5e-3
"""m: length of the body, origin of the camera frame."""
LEAST_BLEND = 0.6


@dataclass(frozen=True)
class Truth:
    """One sealed case. Sizes in plausible scales."""

    case: str
    stratum: Stratum
    robot: WorldRobot
    effects: Mapping[str, float]
    """The drawn causes; one outside the catalogue is among them."""
    moves_mm: Mapping[str, float] = field(default_factory=dict)
    calibrated_mm: Mapping[str, float] = field(default_factory=dict)
    nearest: Mapping[str, Any] | None = None
    """Of an outside cause: the catalogue's effect that comes closest, and the mm it leaves."""
    floor_mm: float = 0.0
    """Scatter of repeats, rms of a reading's distance from its mean."""

    def as_dict(self) -> dict[str, Any]:
        """For the sealed file."""
        robot = self.robot
        kind = KINDS[self.stratum]
        if kind == "none" and self.effects:
            kind = "single"  # walls that balance the thrust are a cause, in a world that has no other robots
        clutter = {e: s for e, s in robot.sizes.items() if e not in self.effects}
        return {
            "case": self.case, "kind": kind, "stratum": self.stratum, "effects": dict(self.effects),
            "clutter": clutter, "world": robot.world.name, "forms": dict(robot.world.forms), "route": "direct",
            "area_factor": robot.area_factor, "length": robot.length, "offset": robot.offset, "drift": robot.drift,
            "places": asdict(robot.places), "floor_mm": round(self.floor_mm, 3),
            "moves_mm": dict(self.moves_mm), "calibrated_mm": dict(self.calibrated_mm), "nearest": self.nearest,
            "stage": next((robot.causes[e].stage for e in robot.outside), None),
        }  # fmt: skip


@dataclass(frozen=True)
class Recipe:
    """How a set is drawn."""

    world: str
    n: int
    seed: int
    strata: tuple[Stratum, ...] = ()
    clutter: float | None = None
    """Standard deviation of clutter in plausible scales; the world's own without."""
    sizes: tuple[float, float] = (0.5, 1.5)
    held_out: bool = False
    """Outside causes are those that nothing is developed on."""
    causes: tuple[str, ...] = ()
    """Effects that causes are drawn from; without, all but those that are drawn on request."""


def causes(held_out: bool) -> Mapping[str, Cause]:
    """Causes outside the catalogue that may be drawn."""
    if held_out:
        from .worlds.outside_held_out import HELD_OUT

        return HELD_OUT
    return OUTSIDE


def draw(recipe: Recipe) -> list[tuple[Stratum, tuple[str, ...]]]:
    """Stratum and causes of each case, in an order that tells nothing; a pair gets its partner with its sizes."""
    rng = np.random.default_rng([recipe.seed, 5])
    known = {False: _around(rng, list(recipe.causes) or _names(recipe)), True: _around(rng, sorted(causes(recipe.held_out)))}
    chosen: list[tuple[Stratum, tuple[str, ...]]] = []
    for stratum in _strata(recipe):
        kind = KINDS[stratum]
        if stratum == "walls":
            chosen.append((stratum, (THRUST,)))
        else:
            chosen.append((stratum, () if kind == "none" else (next(known[kind == "outside"]),)))
    return [chosen[i] for i in rng.permutation(len(chosen))]


def another_cause(recipe: Recipe, place: int, stratum: Stratum, attempt: int) -> tuple[str, ...]:
    """A cause of the catalogue for a case whose own leaves no robot with an equilibrium; empty where its kind has none, or where
    the causes were asked for."""
    if stratum == "walls" or KINDS[stratum] in ("none", "outside") or recipe.causes:
        return ()
    rng = np.random.default_rng([recipe.seed, 9, place, attempt])
    return (str(rng.choice(_names(recipe))),)


def _strata(recipe: Recipe) -> list[Stratum]:
    wanted = recipe.strata or tuple(MIXED)
    total = sum(MIXED[s] for s in wanted)
    share = {s: recipe.n * MIXED[s] / total for s in wanted}
    counts = {s: int(v) for s, v in share.items()}
    for s in sorted(share, key=lambda s: counts[s] - share[s])[: recipe.n - sum(counts.values())]:
        counts[s] += 1
    return [s for s in wanted for _ in range(counts[s])]


def _names(recipe: Recipe) -> list[str]:
    return [e for e in EFFECTS if e != THRUST]


def drawable() -> list[str]:
    """Effects that a cause may be asked for from."""
    return [*(e for e in EFFECTS if e != THRUST), *ON_REQUEST]


def _around(rng: np.random.Generator, names: Sequence[str]) -> Any:
    while True:
        yield from (str(x) for x in rng.permutation(list(names)))


def draw_robot(
    recipe: Recipe, place: int, stratum: Stratum, ids: Sequence[str], attempt: int = 0
) -> tuple[WorldRobot, dict[str, float]]:
    """A robot and the sizes of its causes; another `attempt` draws sizes, clutter and tolerances anew."""
    rng = np.random.default_rng([recipe.seed, 6, place, attempt])
    where = world(recipe.world)
    known = {**causes(recipe.held_out), **ON_REQUEST}
    names = list(ids)
    if KINDS[stratum] == "pair":
        names.append(str(rng.choice([e for e in _names(recipe) if e not in names])))
    drawn = {e: _size(rng, recipe, where, e, known) for e in names}
    sizes: dict[str, float] = dict.fromkeys(EFFECTS, 0.0)
    if stratum.startswith("cluttered"):
        level = where.clutter if recipe.clutter is None else recipe.clutter
        for e in EFFECTS:
            if e != THRUST and e not in drawn:
                value = level * LESS_CLUTTER.get(e, 1.0) * float(tails(rng, where.heavy, ()))
                sizes[e] = abs(value) if EFFECTS[e].sign != "both" else value
    for e, sd in TOLERANCES.items():
        sizes[e] += where.tolerance * sd * float(tails(rng, where.heavy, ()))
    if stratum != "walls" and where.thrust:
        drawn[THRUST] = where.thrust
    outside = {e: s for e, s in drawn.items() if e in known}
    for e, s in drawn.items():
        if e in EFFECTS:
            sizes[e] += s
    a, b, c = (float(x) for x in where.tolerance * SMALL * tails(rng, where.heavy, (3,)))
    robot = WorldRobot(
        where, {e: s for e, s in sizes.items() if s}, outside, {e: known[e] for e in outside}, draw_places(rng),
        float(rng.uniform(1.4, 1.8)), LENGTH + where.tolerance * SMALL * float(tails(rng, where.heavy, ())), (a, b, c),
        where.drift * float(rng.uniform(0.4, 1.0)) * (1 if rng.random() < 0.7 else -1),
    )  # fmt: skip
    return robot, drawn


def _size(rng: np.random.Generator, recipe: Recipe, where: World, effect: str, known: Mapping[str, Cause]) -> float:
    low, high = recipe.sizes
    if effect == THRUST:
        return where.thrust or float(rng.uniform(LEAST_BLEND, 1.0))
    if effect in known:
        return float(rng.uniform(low, high)) * (1 if known[effect].one_way or rng.random() < 0.5 else -1)
    sign = EFFECTS[effect].sign
    if sign == "blend":
        return float(rng.uniform(min(LEAST_BLEND, low), 1.0))
    return float(rng.uniform(low, high)) * (-1 if sign == "both" and rng.random() < 0.5 else 1)
