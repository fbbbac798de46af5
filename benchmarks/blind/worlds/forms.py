"""The forms of every effect: which there are, and how large one plausible scale of each is.

A form's scale is set so that it moves the tip by about as many mm as the catalogue's effect does at its plausible size: rms over
the base sweep of the paper's robot (seven spine lengths, 0 to 250 kPa and back) with an area factor of 1.6, taken from
`lab effects` once. Blends keep 0 to 1, and no scale was moved by more than 2.5 from what the lab would call plausible.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from . import actuation, loads, seen, silicone, spine
from .body import ORDER as BODY
from .forms_held_out import FORMS_HELD_OUT
from .gas import ORDER as CHAMBERS
from .outside import Cause

Array = NDArray[np.float64]
Change = Callable[[Any, Array], None]
Sign = Literal["both", "+", "blend"]


@dataclass(frozen=True)
class Effect:
    """How an effect is drawn."""

    id: str
    sign: Sign
    moves: float
    """mm at the tip at one scale."""


EFFECTS = {
    e.id: e
    for e in (
        Effect("spine_slip", "+", 0.71),
        Effect("area_moment", "blend", 16.7),
        Effect("spine_shear", "blend", 22.2),
        Effect("vacuum_leak", "+", 4.7),
        Effect("spine_length_offset", "both", 4.5),
        Effect("body_modulus", "both", 13.4),
        Effect("hyperelastic", "+", 21.4),
        Effect("viscoelastic", "+", 2.64),
        Effect("chamber_ballooning", "both", 22.5),
        Effect("pressure_deadband", "+", 8.52),
        Effect("pressure_offset", "+", 4.44),
        Effect("chamber_azimuth", "both", 9.76),
        Effect("chamber_twist", "both", 8.22),
        Effect("self_weight", "both", 2.42),
        Effect("tether_load", "both", 3.51),
        Effect("contact", "+", 47.4),
        Effect("chamber_thrust", "blend", 59),
        Effect("base_tilt", "both", 8.86),
        Effect("base_compliance", "+", 44),
        Effect("precurvature", "both", 13.4),
        Effect("frame_misalignment", "both", 9.26),
        Effect("marker_offset", "both", 6),
        Effect("time_offset", "both", 1.74),
    )
}
"""By id."""

FORMS: dict[str, dict[str, tuple[Change, float]]] = {
    "spine_slip": {"dahl": (spine.slip_dahl, 0.099), "bouc_wen": (spine.slip_bouc_wen, 0.11),
                   "prandtl": (spine.slip_prandtl, 0.11), "lugre": (spine.slip_lugre, 0.12)},
    "area_moment": {"compliance": (spine.composite_compliance, 1.0), "sliding": (spine.composite_sliding, 1.0),
                    "loose": (spine.composite_loose, 1.0), "from_the_base": (spine.composite_from_the_base, 1.0)},
    "spine_shear": {"soft": (spine.shear_soft, 1.0), "lag": (spine.shear_lag, 1.0),
                    "by_length": (spine.shear_by_length, 1.0)},
    "vacuum_leak": {"seams": (spine.leak_seams, 0.2), "along": (spine.leak_along, 0.41),
                    "by_length": (spine.leak_by_length, 0.17), "threshold": (spine.leak_to_the_threshold, 0.12)},
    "spine_length_offset": {"reel": (spine.eccentric_reel, 0.026), "encoder": (spine.encoder_scale, 0.016),
                            "slack": (spine.slack_first, 0.015), "wrinkles": (spine.wrinkled_tail, 0.026)},
    "body_modulus": {"layers": (silicone.modulus_of_layers, 0.12), "skin": (silicone.modulus_of_the_skin, 0.11),
                     "mix": (silicone.modulus_of_the_mix, 0.12)},
    "hyperelastic": {"mooney_rivlin": (silicone.mooney_rivlin, 0.74), "gent": (silicone.gent, 0.75),
                     "payne": (silicone.payne, 0.4), "fung": (silicone.fung, 0.75)},
    "viscoelastic": {"power_law": (silicone.power_law, 0.088), "stretched": (silicone.stretched, 0.053),
                     "logarithmic": (silicone.logarithmic, 0.06), "slow": (silicone.one_slow_branch, 0.02)},
    "precurvature": {"half_sine": (silicone.curved_half_sine, 0.13), "helix": (silicone.curved_helix, 0.12),
                     "at_the_base": (silicone.curved_at_the_base, 0.12)},
    "chamber_ballooning": {"saturating": (actuation.balloon_saturating, 0.14),
                           "threshold": (actuation.balloon_threshold, 0.17), "tube": (actuation.balloon_tube, 0.17)},
    "pressure_deadband": {"seating": (actuation.seating_band, 14000), "slow": (actuation.slow_band, 11000),
                          "rational": (actuation.rational_band, 11000), "play": (actuation.play_band, 17000)},
    "pressure_offset": {"regulator": (actuation.regulator_leak, 5800), "falling": (actuation.falling_offset, 6400),
                        "warming": (actuation.warming_offset, 4300)},
    "chamber_azimuth": {"uneven": (actuation.uneven_azimuth, 0.079),
                        "off_centre": (actuation.turned_off_centre, 0.079),
                        "cap": (actuation.cap_azimuth, 0.14)},
    "chamber_twist": {"late": (actuation.twist_late, 0.49), "middle": (actuation.twist_middle, 0.35),
                      "early": (actuation.twist_early, 0.28)},
    "chamber_thrust": {"to_the_tip": (actuation.walls_to_the_tip, 1.0), "but_the_cap": (actuation.walls_but_the_cap, 1.0),
                       "from_the_base": (actuation.walls_from_the_base, 1.0)},
    "self_weight": {"hose": (loads.hose_on_the_base, 0.3), "spine": (loads.weight_of_the_spine, 0.15),
                    "fittings": (loads.weight_of_fittings, 0.11), "to_the_tip": (loads.weight_to_the_tip, 0.093)},
    "tether_load": {"point": (loads.tether_to_a_point, 0.52), "spread": (loads.tether_spread, 0.58),
                    "stiffening": (loads.tether_stiffening, 0.3)},
    "contact": {"hertz": (loads.contact_hertz, 350), "slanted": (loads.contact_slanted, 630),
                "foam": (loads.contact_foam, 650)},
    "base_tilt": {"lever": (loads.tilt_about_a_lever, 0.022),
                  "corner": (loads.tilt_about_a_corner, 0.026),
                  "below": (loads.tilt_below, 0.029)},
    "base_compliance": {"with_shift": (loads.give_with_shift, 0.025), "hinge": (loads.give_hinge, 0.027),
                        "play": (loads.give_with_play, 0.041)},
    "frame_misalignment": {"middle": (seen.turned_about_the_middle, 0.034),
                           "ceiling": (seen.turned_about_the_ceiling, 0.022),
                           "stretched": (seen.turned_and_stretched, 0.025)},
    "marker_offset": {"off_centre": (seen.off_centre, 0.006), "hidden_pin": (seen.one_pin_hidden, 0.0056),
                      "cap": (seen.cap_off_centre, 0.0058)},
    "time_offset": {"late": (seen.late, 0.43), "frames": (seen.late_by_frames, 0.41), "filter": (seen.late_filter, 0.41)},
}  # fmt: skip
"""Law and plausible size (in its own unit) by effect and name of the form."""


ON_REQUEST = {
    c.id: c
    for c in (
        Cause("chamber_gain", "actuation", 0.1, actuation.chambers_by_side, "chambers", one_way=False),
        Cause("chamber_order", "actuation", 1.0, actuation.hoses_exchanged, "chambers"),
        Cause("tip_payload", "load", 0.1, loads.payload_on_a_rod, "body"),
    )
}
"""Effects of the catalogue, one form each, that are drawn where they are asked for only."""


@dataclass(frozen=True)
class Physics:
    """The laws of one world, sorted by what they act on; sizes come in plausible scales."""

    body: Mapping[str, Change]
    chambers: Mapping[str, Change]
    seen: Mapping[str, Change]


def physics(choice: Mapping[str, str], outside: Mapping[str, Cause] | None = None) -> Physics:
    """One form of each effect, and causes outside the catalogue. Raises ValueError for a form that does not exist."""
    made: dict[str, dict[str, Change]] = {"body": {}, "chambers": {}, "seen": {}}
    for effect, name in choice.items():
        forms = {**FORMS.get(effect, {}), **FORMS_HELD_OUT.get(effect, {})}
        if name not in forms:
            raise ValueError(f"world: effect {effect!r} has no form {name!r}; it has {', '.join(FORMS.get(effect, {}))}")
        law, scale = forms[name]
        place = "body" if effect in BODY else "chambers" if effect in CHAMBERS else "seen"
        made[place][effect] = _scaled(law, scale)
    for cause in (outside or {}).values():
        made[cause.on][cause.id] = _scaled(cause.change, cause.scale)
    return Physics(made["body"], made["chambers"], made["seen"])


def _scaled(law: Change, scale: float) -> Change:
    return lambda what, size: law(what, scale * size)
