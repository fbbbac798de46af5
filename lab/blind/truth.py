"""The truth of a blind set: which effects are on in each case, how large, and the tolerances nobody can avoid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from sim_fakes.virtual_robot import EffectInfo, list_effects

Kind = Literal["single", "pair", "none", "outside"]
SHARES: dict[Kind, float] = {"single": 0.60, "pair": 0.14, "none": 0.10, "outside": 0.16}
"""Share of each kind in a set."""
STAND_ONLY = ("force_bias", "arm_compliance", "contact_offset")
"""Effects that only a stiffness trial shows: left out of sweeps."""
RAMPING_ONLY = ("time_offset",)
"""Effects that a settled reading cannot show."""
CLUTTER_SHARE = {"contact": 0.13, "base_compliance": 0.5}
"""Share of its clutter size that these get: at the plain 15 % of their scale they move the tip by 13 and 9 mm, 27 and 29 % of
what they do at full scale and more than most effects at theirs, so that they and not the drawn effect would dominate."""
SIZES = (0.5, 1.5)
"""Drawn effects, times their plausible scale."""


@dataclass(frozen=True)
class Nuisance:
    """What is never exact, at its tolerance: relative E and density, length (m), small turns (rad) of base and camera
    frame about x, y, z, and that frame's offset (m)."""

    youngs_modulus: float
    density: float
    length: float
    tilt: tuple[float, float, float]
    frame: tuple[float, float, float]
    offset: tuple[float, float, float]


@dataclass(frozen=True)
class Truth:
    """One sealed case. Sizes are in each effect's own unit."""

    case: str
    kind: Kind
    effects: dict[str, float]
    clutter: dict[str, float]
    nuisance: Nuisance
    area_factor: float
    seed: int
    route: Literal["direct", "wire"]
    geometry: str = "paper"
    """Of `geometry.GEOMETRIES`."""

    @property
    def all_effects(self) -> dict[str, float]:
        """What the robot is given."""
        return {**self.clutter, **self.effects}

    def as_dict(self) -> dict[str, Any]:
        """For the sealed file."""
        return asdict(self)


@dataclass(frozen=True)
class Recipe:
    """How a set is drawn."""

    n: int
    seed: int
    clutter: float = 0.0
    """Size of every other catalogue effect, share of its scale."""
    sizes: tuple[float, float] = SIZES
    settled: bool = False
    wire: int = 0
    """How many cases are measured through every wire."""
    only: tuple[Kind, ...] = ("single", "pair", "none", "outside")
    geometry: str = "paper"
    causes: tuple[str, ...] = ()
    """Effects that causes are drawn from; without, all that a plain sweep shows."""


def draw(recipe: Recipe) -> list[Truth]:
    """Every case of a set; ids in an order that tells nothing. Raises ValueError for a set of less than one case."""
    if recipe.n < 1:
        raise ValueError(f"n = {recipe.n}: a set needs at least one case")
    rng = np.random.default_rng([recipe.seed, 0])
    names = list(recipe.causes) or _names(recipe.settled)
    outside = [e.id for e in list_effects() if not e.catalogue]
    kinds = _kinds(recipe)
    turn = {"single": _around(rng, names), "outside": _around(rng, outside)}
    chosen: list[tuple[Kind, tuple[str, ...]]] = []
    for kind in kinds:
        if kind == "pair":
            pick: tuple[str, ...] = tuple(str(x) for x in rng.choice(names, 2, replace=False))
        else:
            pick = () if kind == "none" else (next(turn[kind]),)
        chosen.append((kind, pick))
    order = rng.permutation(len(chosen))
    wired = set(rng.permutation(len(chosen))[: recipe.wire].tolist())
    truths = []
    for place, which in enumerate(order):
        kind, ids = chosen[which]
        truths.append(draw_one(recipe, place, kind, ids, "wire" if place in wired else "direct"))
    return truths


def draw_one(
    recipe: Recipe, place: int, kind: Kind, ids: Sequence[str], route: Literal["direct", "wire"], attempt: int = 0
) -> Truth:
    """Sizes, clutter and tolerances of one case; another `attempt` draws them anew."""
    rng = np.random.default_rng([recipe.seed, 1, place, attempt])
    known = {e.id: e for e in list_effects()}
    effects = {name: _size(rng, known[name], recipe.sizes) for name in ids}
    clutter = {}
    if recipe.clutter > 0:
        others = [known[name] for name in _names(False) if name not in effects]
        share = {e.id: recipe.clutter * CLUTTER_SHARE.get(e.id, 1.0) for e in others}
        clutter = {e.id: float(share[e.id] * e.scale * _sign(rng, e)) for e in others}
    small = np.radians(0.1)
    nuisance = Nuisance(
        youngs_modulus=float(rng.normal(0, 0.02)),
        density=float(rng.normal(0, 0.01)),
        length=float(rng.normal(0, 0.5e-3)),
        tilt=(float(rng.normal(0, small)), float(rng.normal(0, small)), 0.0),
        frame=_three(rng, small),
        offset=_three(rng, 0.5e-3),
    )
    area, seed = float(rng.uniform(1.4, 1.8)), int(rng.integers(2**31))
    return Truth(f"{place + 1:04d}", kind, effects, clutter, nuisance, area, seed, route, recipe.geometry)


def _three(rng: np.random.Generator, sd: float) -> tuple[float, float, float]:
    a, b, c = (float(x) for x in rng.normal(0, sd, 3))
    return (a, b, c)


def drawable() -> list[str]:
    """Effects that a cause may be asked for from: all that a sweep shows."""
    return [e.id for e in list_effects() if e.catalogue and e.id not in STAND_ONLY]


def _names(settled: bool) -> list[str]:
    left_out = STAND_ONLY + (RAMPING_ONLY if settled else ())
    return [e.id for e in list_effects() if e.catalogue and not e.on_request and e.id not in left_out]


def _kinds(recipe: Recipe) -> list[Kind]:
    """Kinds by their shares, the largest remainders first."""
    total = sum(SHARES[k] for k in recipe.only)
    wanted = {k: recipe.n * SHARES[k] / total for k in recipe.only}
    counts = {k: int(w) for k, w in wanted.items()}
    for k in sorted(wanted, key=lambda k: counts[k] - wanted[k])[: recipe.n - sum(counts.values())]:
        counts[k] += 1
    return [k for k in recipe.only for _ in range(counts[k])]


def _around(rng: np.random.Generator, names: Sequence[str]) -> Any:
    """All names in a new random order, again and again."""
    while True:
        yield from (str(x) for x in rng.permutation(list(names)))


def _sign(rng: np.random.Generator, info: EffectInfo) -> int:
    return -1 if info.sign == "both" and rng.random() < 0.5 else 1


def _size(rng: np.random.Generator, info: EffectInfo, sizes: tuple[float, float]) -> float:
    if info.sign == "blend":
        return float(info.scale * rng.uniform(min(0.6, sizes[0]), 1.0))
    return float(info.scale * rng.uniform(*sizes) * _sign(rng, info))
