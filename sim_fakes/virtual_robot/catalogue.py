"""The effects a virtual robot can have beyond the paper's assumptions: what each is, how large, in which unit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class EffectInfo:
    """One effect: `scale` is its plausible size in `unit`; `sign` "both" or "+" or "blend" (0 = paper, 1 = full)."""

    id: str
    physics: str
    scale: float
    unit: str
    sign: str = "both"
    catalogue: bool = True
    """False: a cause that the diagnosis has no name for."""
    on_request: bool = False
    """Drawn only where it is asked for: a plain sweep cannot show it, or sets made before it keep their cases."""


_INFO = (
    EffectInfo(
        "spine_slip", "Coulomb friction of the jammed spine against the wall, distributed sliders", 0.15, "N m", "+"
    ),
    EffectInfo("area_moment", "spine stiffens as a composite section instead of by volume share", 1.0, "1", "blend"),
    EffectInfo(
        "spine_shear", "spine has one modulus (6.6 MPa) and little shear stiffness (0.09 MPa)", 1.0, "1", "blend"
    ),
    EffectInfo("vacuum_leak", "share of the vacuum lost on the way into the spine, more in a long one", 0.3, "1", "+"),
    EffectInfo("spine_length_offset", "true spine length minus the length read", 0.012, "m"),
    EffectInfo("body_modulus", "relative error of the silicone's modulus", 0.12, "1"),
    EffectInfo(
        "hyperelastic", "share of a Yeoh law in each silicone fibre (softening, then stiffening)", 1.0, "1", "+"
    ),
    EffectInfo(
        "viscoelastic", "creep of two Kelvin elements (4 s, 30 s), total relative to the elastic strain", 0.05, "1", "+"
    ),
    EffectInfo("chamber_ballooning", "growth of the effective area at 250 kPa, as P^1.5", 0.15, "1"),
    EffectInfo("pressure_deadband", "pressure needed before a chamber acts, smooth", 10e3, "Pa", "+"),
    EffectInfo(
        "pressure_offset",
        "pressure in every chamber beyond what its sensor reads (never below ambient)",
        5e3,
        "Pa",
        "+",
    ),
    EffectInfo("chamber_azimuth", "the chamber pattern is turned about the axis", np.radians(6.0), "rad"),
    EffectInfo("chamber_twist", "the chambers wind along the body", 0.35, "rad/m"),
    EffectInfo("self_weight", "extra weight relative to the body's, more of it near the base", 0.12, "1"),
    EffectInfo("tether_load", "side force at the tip, fixed in the world, slackening as the tip yields", 0.35, "N"),
    EffectInfo(
        "contact", "stiffness of an obstacle met at 85 % of the body, 40-100 mm from the axis", 300.0, "N/m", "+"
    ),
    EffectInfo("base_tilt", "the base is turned about a horizontal axis", np.radians(1.5), "rad"),
    EffectInfo("base_compliance", "the base turns with its moment, stiffening", 0.025, "rad/(N m)", "+"),
    EffectInfo("precurvature", "the body is bent without load, more near the tip", 0.12, "1/m"),
    EffectInfo("frame_misalignment", "the cameras' frame is turned about the base", np.radians(1.5), "rad"),
    EffectInfo("marker_offset", "the tracked point sits off the tip's centre", 0.006, "m"),
    EffectInfo("time_offset", "the tip is reported later than the pressure (negative: earlier)", 0.4, "s"),
    EffectInfo("force_bias", "the force sensor's zero moves when it is loaded", 0.1, "N"),
    EffectInfo("arm_compliance", "arm and probe give under the contact force", 5e-5, "m/N", "+"),
    EffectInfo("contact_offset", "a soft layer is squeezed before the probe meets the specimen", 0.001, "m", "+"),
    EffectInfo(
        "tendon_friction", "tendons slide along their guides with this coefficient", 0.5, "1", "+", on_request=True
    ),
    EffectInfo(
        "chamber_gain", "cores of the mould stand off to one side, and not all alike", 0.1, "1", "+", on_request=True
    ),
    EffectInfo("chamber_order", "hoses of regulators are exchanged, from half on", 1.0, "1", "blend", on_request=True),
    EffectInfo(
        "tip_payload", "mass on a bracket beside the tip, and its cable along the body", 0.1, "kg", "+", on_request=True
    ),
    EffectInfo(
        "rest_shape",
        "fibres keep a share of their largest stretch, part of it for good",
        0.05,
        "1",
        "+",
        on_request=True,
    ),
    EffectInfo("weak_chamber", "one chamber acts less than the others", 0.2, "1", "+", False),
    EffectInfo(
        "graded_modulus", "modulus rises along the body, base to tip, around its mean", 0.25, "1", "both", False
    ),
    EffectInfo("eccentric_spine", "the spine lies off the axis", 0.006, "m", "+", False),
    EffectInfo(
        "pressure_jamming",
        "inflated chambers squeeze the spine stiffer (at 250 kPa in three chambers)",
        0.4,
        "1",
        "+",
        False,
    ),
    EffectInfo("drift", "silicone softens over the campaign, per hour", 0.15, "1/h", "both", False),
    EffectInfo("temperature_step", "silicone softens at some moment of the campaign", 0.06, "1", "both", False),
    EffectInfo("chamber_leak", "one chamber's pressure falls short of its regulator's", 0.15, "1", "+", False),
    EffectInfo(
        "jam_shape_memory",
        "the spine is free of stress in the shape it was jammed in, not straight",
        1.0,
        "1",
        "blend",
        False,
    ),
    EffectInfo("bad_trial", "the spine is too soft in one trial of the campaign", 0.3, "1", "+", False),
)


def list_effects() -> tuple[EffectInfo, ...]:
    """All effects with unit and plausible scale."""
    return _INFO
