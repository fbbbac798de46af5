"""The effects a virtual robot can have beyond the paper's assumptions: one number each, zero means absent.

A set of effects is a `Laws` object: a field per effect, named by its id. The physics reads the field; a zero leaves
its equation as the paper has it, to the last bit. The laws themselves are where the physics is (body.py, spine.py,
pneumatics.py, stand.py); docs/explanations/virtual-robot.md gives an overview.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Literal

import numpy as np

from .truth import RobotTruth


@dataclass(frozen=True)
class EffectInfo:
    """One effect: `scale` is its plausible size in `unit`; a `blend` lies between 0 (paper) and 1."""

    id: str
    physics: str
    scale: float
    unit: str
    sign: Literal["both", "+", "blend"] = "both"


def _effect(*info: Any) -> float:
    """The field of an effect, from what `EffectInfo` says of it after its id."""
    return field(default=0.0, metadata={"info": info})


@dataclass(frozen=True)
class Laws:
    """Size of each effect in its unit; all zero is the robot of the paper."""

    spine_slip: float = _effect("Coulomb friction of the jammed spine against the wall, distributed sliders", 0.15, "N m", "+")
    area_moment: float = _effect("spine stiffens as a composite section instead of by volume share", 1.0, "1", "blend")
    spine_shear: float = _effect("spine has one modulus (6.6 MPa) and little shear stiffness (0.09 MPa)", 1.0, "1", "blend")
    vacuum_leak: float = _effect("share of the vacuum lost on the way into the spine, more in a long one", 0.3, "1", "+")
    chamber_ballooning: float = _effect("growth of the effective area at 250 kPa, as P^1.5", 0.15, "1")
    chamber_azimuth: float = _effect("the chamber pattern is turned about the axis", np.radians(6.0), "rad")
    chamber_twist: float = _effect("the chambers wind along the body", 0.35, "rad/m")
    tether_load: float = _effect("side force at the tip, fixed in the world, slackening as the tip yields", 0.35, "N")
    base_tilt: float = _effect("the base is turned about a horizontal axis", np.radians(1.5), "rad")
    force_bias: float = _effect("the force sensor's zero moves when it is loaded", 0.1, "N")
    arm_compliance: float = _effect("arm and probe give under the contact force", 5e-5, "m/N", "+")
    contact_offset: float = _effect("a soft layer is squeezed before the probe meets the specimen", 0.001, "m", "+")


_BY_ID = {f.name: EffectInfo(f.name, *f.metadata["info"]) for f in fields(Laws)}


def list_effects() -> tuple[EffectInfo, ...]:
    """All effects with unit and plausible scale."""
    return tuple(_BY_ID.values())


def laws(effects: Mapping[str, float]) -> Laws:
    """Collect sizes by id into laws. Raises ValueError for an unknown id or a size that is not finite."""
    for name, size in effects.items():
        if name not in _BY_ID:
            raise ValueError(f"virtual robot: unknown effect {name!r}; known: {', '.join(_BY_ID)}")
        if not np.isfinite(size):
            raise ValueError(f"virtual robot: effect {name!r} has size {size} {_BY_ID[name].unit}; give a finite number")
    return Laws(**{name: float(size) for name, size in effects.items()})


def draw_effect(rng: np.random.Generator, ids: Sequence[str]) -> tuple[str, float]:
    """Draw one of the effects and its size: 0.5 to 1.5 of the scale, random sign where both make sense; blends 0.6 to 1."""
    info = _BY_ID[ids[int(rng.integers(len(ids)))]]
    if info.sign == "blend":
        return info.id, float(rng.uniform(0.6, 1.0)) * info.scale
    size = float(rng.uniform(0.5, 1.5)) * info.scale
    return info.id, -size if info.sign == "both" and rng.random() < 0.5 else size


@dataclass(frozen=True)
class Directions:
    """What an effect's size leaves open: angles about the robot's axis, rad."""

    tether: float = 0.0
    tilt: float = 0.0


def draw_directions(truth: RobotTruth, seed: int) -> Directions:
    """Draw the directions of a seed; all along x when `truth.canonical_directions`."""
    if truth.canonical_directions:
        return Directions()
    tether, tilt = np.random.default_rng([seed, 1]).uniform(-np.pi, np.pi, 2)
    return Directions(float(tether), float(tilt))
