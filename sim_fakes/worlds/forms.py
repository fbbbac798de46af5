"""The forms of every effect: which there are, and how large one plausible scale of each is.

A form's scale is set so that it moves the tip by about as many mm as the catalogue's effect does at its plausible size: rms over
the base sweep of the paper's robot (seven spine lengths, 0 to 250 kPa and back) with an area factor of 1.6, taken from
`lab.signatures` once. Blends keep 0 to 1, and no scale was moved by more than 2.5 from what the lab would call plausible.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from . import actuation, boundary, loads, seen, silicone, spine
from .body import ORDER as BODY
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
    "spine_slip": {"dahl": (spine.slip_dahl, 0.15), "bouc_wen": (spine.slip_bouc_wen, 0.15),
                   "prandtl": (spine.slip_prandtl, 0.15), "lugre": (spine.slip_lugre, 0.15)},
    "area_moment": {"compliance": (spine.composite_compliance, 1.0), "bending": (spine.composite_in_bending, 1.0),
                    "loose": (spine.composite_loose, 1.0), "geometric": (spine.composite_geometric, 1.0)},
    "spine_shear": {"soft": (spine.shear_soft, 1.0), "lag": (spine.shear_lag, 1.0),
                    "by_length": (spine.shear_by_length, 1.0)},
    "vacuum_leak": {"all": (spine.leak_all, 0.3), "along": (spine.leak_along, 0.3),
                    "by_length": (spine.leak_by_length, 0.3), "threshold": (spine.leak_to_the_threshold, 0.3)},
    "spine_length_offset": {"same_modulus": (spine.offset_same_modulus, 0.012), "encoder": (spine.encoder_scale, 0.012),
                            "slack": (spine.slack_first, 0.012), "wrinkles": (spine.wrinkled_tail, 0.012)},
    "body_modulus": {"not_shear": (silicone.modulus_not_shear, 0.12), "skin": (silicone.modulus_of_the_skin, 0.12),
                     "mix": (silicone.modulus_of_the_mix, 0.12)},
    "hyperelastic": {"mooney_rivlin": (silicone.mooney_rivlin, 1.0), "gent": (silicone.gent, 1.0),
                     "payne": (silicone.payne, 1.0), "fung": (silicone.fung, 1.0)},
    "viscoelastic": {"power_law": (silicone.power_law, 0.05), "stretched": (silicone.stretched, 0.05),
                     "logarithmic": (silicone.logarithmic, 0.05), "slow": (silicone.one_slow_branch, 0.05)},
    "precurvature": {"half_sine": (silicone.curved_half_sine, 0.12), "helix": (silicone.curved_helix, 0.12),
                     "at_the_base": (silicone.curved_at_the_base, 0.12)},
    "chamber_ballooning": {"saturating": (actuation.balloon_saturating, 0.15),
                           "threshold": (actuation.balloon_threshold, 0.15), "tube": (actuation.balloon_tube, 0.15)},
    "pressure_deadband": {"hard": (actuation.hard_band, 10e3), "saturating": (actuation.saturating_band, 10e3),
                          "rational": (actuation.rational_band, 10e3), "play": (actuation.play_band, 10e3)},
    "pressure_offset": {"regulator": (actuation.regulator_leak, 5e3), "falling": (actuation.falling_offset, 5e3),
                        "warming": (actuation.warming_offset, 5e3)},
    "chamber_azimuth": {"uneven": (actuation.uneven_azimuth, np.radians(6)),
                        "off_centre": (actuation.turned_off_centre, np.radians(6)),
                        "cap": (actuation.cap_azimuth, np.radians(6))},
    "chamber_twist": {"late": (actuation.twist_late, 0.35), "middle": (actuation.twist_middle, 0.35),
                      "early": (actuation.twist_early, 0.35)},
    "chamber_thrust": {"evenly": (actuation.walls_evenly, 1.0), "but_the_cap": (actuation.walls_but_the_cap, 1.0),
                       "from_the_base": (actuation.walls_from_the_base, 1.0)},
    "self_weight": {"hose": (loads.hose_on_the_base, 0.12), "spine": (loads.weight_of_the_spine, 0.12),
                    "fittings": (loads.weight_of_fittings, 0.12), "to_the_tip": (loads.weight_to_the_tip, 0.12)},
    "tether_load": {"point": (loads.tether_to_a_point, 0.35), "spread": (loads.tether_spread, 0.35),
                    "stiffening": (loads.tether_stiffening, 0.35)},
    "contact": {"hertz": (loads.contact_hertz, 300.0), "slanted": (loads.contact_slanted, 300.0),
                "foam": (loads.contact_foam, 300.0)},
    "base_tilt": {"lever": (boundary.tilt_about_a_lever, np.radians(1.5)),
                  "corner": (boundary.tilt_about_a_corner, np.radians(1.5)),
                  "below": (boundary.tilt_below, np.radians(1.5))},
    "base_compliance": {"with_shift": (boundary.give_with_shift, 0.025), "hinge": (boundary.give_hinge, 0.025),
                        "play": (boundary.give_with_play, 0.025)},
    "frame_misalignment": {"floor": (seen.turned_about_the_floor, np.radians(1.5)),
                           "ceiling": (seen.turned_about_the_ceiling, np.radians(1.5)),
                           "stretched": (seen.turned_and_stretched, np.radians(1.5))},
    "marker_offset": {"off_centre": (seen.off_centre, 0.006), "hidden_pin": (seen.one_pin_hidden, 0.006),
                      "cap": (seen.cap_off_centre, 0.006)},
    "time_offset": {"late": (seen.late, 0.4), "frames": (seen.late_by_frames, 0.4), "filter": (seen.late_filter, 0.4)},
}  # fmt: skip
"""Law and plausible size (in its own unit) by effect and name of the form."""


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
        if name not in FORMS.get(effect, {}):
            raise ValueError(
                f"world: effect {effect!r} has no form {name!r}; it has {', '.join(FORMS.get(effect, {}))}"
            )
        law, scale = FORMS[effect][name]
        place = "body" if effect in BODY else "chambers" if effect in CHAMBERS else "seen"
        made[place][effect] = _scaled(law, scale)
    for cause in (outside or {}).values():
        made[cause.on][cause.id] = _scaled(cause.change, cause.scale)
    return Physics(made["body"], made["chambers"], made["seen"])


def _scaled(law: Change, scale: float) -> Change:
    return lambda what, size: law(what, scale * size)
