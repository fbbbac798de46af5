"""The effects a virtual robot can have beyond the paper's assumptions: one number each, zero means absent.

A set of effects is a `Laws` object: a field per effect, named by its id. The physics reads the field; a zero leaves
its equation as the paper has it, to the last bit. The laws themselves are where the physics is (material.py, spine.py,
pneumatics.py, tendons.py, body.py, seen.py, stand.py), as their docstrings and docs/explanations/virtual-robot.md state.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np

from .catalogue import list_effects

_BY_ID = {info.id: info for info in list_effects()}


@dataclass(frozen=True)
class Effect:
    """An effect switched on: its id and its size in the unit of `list_effects`."""

    id: str
    size: float


@dataclass(frozen=True)
class Laws:
    """Size of each effect in its unit; all zero is the robot of the paper."""

    spine_slip: float = 0.0
    area_moment: float = 0.0
    spine_shear: float = 0.0
    vacuum_leak: float = 0.0
    spine_length_offset: float = 0.0
    body_modulus: float = 0.0
    hyperelastic: float = 0.0
    viscoelastic: float = 0.0
    chamber_ballooning: float = 0.0
    pressure_deadband: float = 0.0
    pressure_offset: float = 0.0
    chamber_azimuth: float = 0.0
    chamber_twist: float = 0.0
    self_weight: float = 0.0
    tether_load: float = 0.0
    contact: float = 0.0
    base_tilt: float = 0.0
    base_compliance: float = 0.0
    precurvature: float = 0.0
    frame_misalignment: float = 0.0
    marker_offset: float = 0.0
    time_offset: float = 0.0
    force_bias: float = 0.0
    arm_compliance: float = 0.0
    contact_offset: float = 0.0
    tendon_friction: float = 0.0
    chamber_gain: float = 0.0
    chamber_order: float = 0.0
    tip_payload: float = 0.0
    rest_shape: float = 0.0
    weak_chamber: float = 0.0
    graded_modulus: float = 0.0
    eccentric_spine: float = 0.0
    pressure_jamming: float = 0.0
    drift: float = 0.0
    temperature_step: float = 0.0
    chamber_leak: float = 0.0
    jam_shape_memory: float = 0.0
    bad_trial: float = 0.0

    @property
    def history(self) -> bool:
        """True when the shape depends on the way it was reached, so that ramps must be walked in small steps."""
        return bool(self.spine_slip or self.viscoelastic or self.tendon_friction or self.tip_payload or self.rest_shape)


def laws(effects: Mapping[str, float] | Iterable[Effect]) -> Laws:
    """Collect effects into laws. Raises ValueError for an unknown id, a repeated id or a size that is not finite."""
    pairs = list(effects.items()) if isinstance(effects, Mapping) else [(e.id, e.size) for e in effects]
    sizes: dict[str, float] = {}
    for name, size in pairs:
        if name not in _BY_ID:
            raise ValueError(f"virtual robot: unknown effect {name!r}; known: {', '.join(_BY_ID)}")
        if name in sizes:
            raise ValueError(f"virtual robot: effect {name!r} is given twice; give it once")
        if not np.isfinite(size):
            raise ValueError(
                f"virtual robot: effect {name!r} has size {size} {_BY_ID[name].unit}; give a finite number"
            )
        sizes[name] = float(size)
    return Laws(**sizes)


def draw_effect(rng: np.random.Generator, ids: Sequence[str] = ()) -> tuple[str, float]:
    """Draw one effect and its size: 0.5 to 1.5 of the scale, random sign where both make sense; blends 0.6 to 1.

    `ids` limits the choice; without it, all effects of the catalogue.
    """
    names = tuple(ids) or tuple(info.id for info in _BY_ID.values() if info.catalogue and not info.on_request)
    info = _BY_ID[names[int(rng.integers(len(names)))]]
    if info.sign == "blend":
        return info.id, float(rng.uniform(0.6, 1.0)) * info.scale
    size = float(rng.uniform(0.5, 1.5)) * info.scale
    return info.id, -size if info.sign == "both" and rng.random() < 0.5 else size


if {f.name for f in fields(Laws)} != set(_BY_ID):
    raise RuntimeError("effects and laws name different effects")
