"""How large an effect was said to be, in the unit of the sealed size; where the two laws share a meaning.

The virtual robot's laws have other forms than the model's, so not every size can be compared: a friction moment spread
over sliders, a share of another silicone law or an obstacle's stiffness have no counterpart of the same meaning.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

COMPARABLE = frozenset({
    "area_moment", "spine_shear", "vacuum_leak", "spine_length_offset", "body_modulus", "chamber_ballooning",
    "pressure_deadband", "pressure_offset", "chamber_azimuth", "chamber_twist", "self_weight", "tether_load", "base_tilt",
    "base_compliance", "precurvature", "frame_misalignment", "marker_offset", "time_offset", "viscoelastic",
})  # fmt: skip
"""Effects whose sealed size and named size mean the same, at least to first order."""
Z90 = 1.6449
"""Half width of a 90 % interval, in standard deviations."""


def true_size(effect: str, parameters: Mapping[str, tuple[float, float]]) -> tuple[float, float] | None:
    """Size and its sd from an effect's parameters (value, sd): of one, itself; of a direction's components, their norm.

    None where it cannot be compared.
    """
    if effect not in COMPARABLE or not parameters:
        return None
    values = list(parameters.values())
    if any(not math.isfinite(v) or not math.isfinite(sd) for v, sd in values):
        return None
    if len(values) == 1:
        return values[0]
    norm = math.sqrt(sum(v * v for v, _ in values))
    if norm == 0:
        return None
    return norm, math.sqrt(sum((v * sd) ** 2 for v, sd in values)) / norm


def within_90(truth: float, value: float, sd: float) -> bool:
    """Whether the 90 % interval covers the truth; the size of a direction has no sign."""
    known = abs(truth) if value >= 0 else truth
    return abs(known - value) <= Z90 * sd
