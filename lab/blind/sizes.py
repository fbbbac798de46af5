"""How large an effect was said to be, in the unit of the sealed size; where the two laws share a meaning.

The virtual robot's laws have other forms than the model's, so not every size can be compared: a friction moment spread
over sliders, a share of another silicone law or an obstacle's stiffness have no counterpart of the same meaning.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal

Size = tuple[tuple[str, ...], Literal["value", "opposite", "norm", "sum"]]
SIZES: dict[str, Size] = {
    "area_moment": (("blend",), "value"),
    "spine_shear": (("blend",), "value"),
    "vacuum_leak": (("lost",), "value"),
    "spine_length_offset": (("offset",), "value"),
    "body_modulus": (("excess",), "value"),
    "viscoelastic": (("fast", "slow"), "sum"),
    "chamber_ballooning": (("growth",), "value"),
    "pressure_deadband": (("band",), "value"),
    "pressure_offset": (("offset",), "value"),
    "chamber_azimuth": (("angle",), "value"),
    "chamber_twist": (("winding",), "value"),
    "self_weight": (("excess",), "value"),
    "tether_load": (("x", "y"), "norm"),
    "base_tilt": (("x", "y"), "norm"),
    "base_compliance": (("give",), "value"),
    "precurvature": (("x", "y"), "norm"),
    "frame_misalignment": (("x", "y", "z"), "norm"),
    "marker_offset": (("x", "y", "z"), "norm"),
    "tip_payload": (("mass",), "value"),
    "time_offset": (("delay",), "opposite"),
}
"""Effects whose sealed size and named size mean the same, at least to first order: the model's parameters that make it.

The virtual robot counts by how much the tip is later than the pressure, the model by how much the pressure is."""
Z90 = 1.6449
"""Half width of a 90 % interval, in standard deviations."""


def true_size(effect: str, parameters: Mapping[str, tuple[float, float]]) -> tuple[float, float] | None:
    """Size and its sd from an effect's parameters (value, sd); None where it cannot be compared."""
    names, how = SIZES.get(effect, ((), "value"))
    values = [parameters[n] for n in names if n in parameters]
    if not values or len(values) < len(names) or not all(math.isfinite(x) for pair in values for x in pair):
        return None
    if how == "value":
        return values[0]
    if how == "opposite":
        return -values[0][0], values[0][1]
    if how == "sum":
        return sum(v for v, _ in values), math.hypot(*(sd for _, sd in values))
    norm = math.hypot(*(v for v, _ in values))
    return (norm, math.hypot(*(v * sd for v, sd in values)) / norm) if norm > 0 else None


def within_90(effect: str, truth: float, value: float, sd: float) -> bool:
    """Whether the 90 % interval covers the truth; the length of a direction has no sign."""
    known = abs(truth) if SIZES[effect][1] == "norm" else truth
    return abs(known - value) <= Z90 * sd
