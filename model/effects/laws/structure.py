"""Effects of the spine and of how it works together with the body; and of the body's material."""

from __future__ import annotations

import numpy as np

from model.arrays import Array
from model.effects.history import DRIVES, History
from model.effects.quantities import Quantities
from model.effects.shows import returns, with_spine
from model.effects.spec import EffectSpec, Law, Parameter, Values, adding, growing

YIELDS = np.array([1 / 8, 1 / 2, 2.0, 8.0])
"""Spread of the sliding elements about it: a core slides in patches, all over the curvatures that the robot goes through."""
HALF_SPENT = 0.048
"""rad over the robot's length: change of bend at which friction is half spent."""
GRIP = 2.0
"""Outer radii from the spine's end over which friction builds up (shear lag)."""
RELAXATION_TIMES = {"fast": 0.3, "slow": 1.5, "long": 7.5}
"""Paces of the campaign; what lies between is a mixture of neighbours."""


def _spine_slip(h: History, v: Values) -> None:
    """Add the rest curvature and strain of the spine's friction: moment m s, axially m / r s, s (0..1 long) the mean state of
    sliding elements that curvature or strain drives; to the part with spine alone."""
    robot = h.quantities.robot
    if robot.spine is None:
        return
    yields = HALF_SPENT / robot.length * np.exp(v["stroke"][:, :1]) * YIELDS
    length, grip = h.quantities.spine_length, GRIP * robot.outer_radius
    built_up = np.where(length > grip, 1 - grip / (2 * np.maximum(length, grip)), length / (2 * grip))
    bend_state = h.path.sliding(h.drive[..., 0:2], yields)
    pull_state = h.path.sliding(h.drive[..., 3:4], yields * robot.spine.radius)
    moment = v["moment"] * built_up
    curvature = -(moment / h.bend_stiffness[..., 0])[..., None] * bend_state
    strain = -(moment / robot.spine.radius / h.axial_stiffness[..., 0]) * pull_state[..., 0]
    out = np.zeros(np.broadcast_shapes(curvature.shape[:2], strain.shape) + (DRIVES,))
    out[..., 0:2], out[..., 3] = curvature, strain
    h.add(out)


def _viscoelastic(h: History, v: Values) -> None:
    """A Zener solid, to first order in the amplitude: what has not yet relaxed is missing from curvature and strain."""
    share = h.silicone + v["spine"][..., None] * (1 - h.silicone)
    for name, time in RELAXATION_TIMES.items():
        h.add(-v[name][..., None] * share * h.path.lag(h.drive, time * h.quantities.scales.time))


def _rest_shape(h: History, v: Values) -> None:
    """The silicone's own shape is bent towards where it has been; a spine holds against it."""
    h.add(v["kept"][..., None] * h.silicone * h.extremes(v["recovery"]))


def _grown(q: Quantities, length: Array, power: Array) -> Array:
    """(length / half the robot's length)^power; below a fortieth of it as there."""
    return np.asarray((2 * np.maximum(length / q.robot.length, 0.025)) ** power)


def _vacuum_leak(q: Quantities, v: Values) -> None:
    q.vacuum_loss = q.vacuum_loss + v["lost"] * q.design.nominal_vacuum * _grown(q, q.spine_length, v["length"])


def _spine_length_offset(q: Quantities, v: Values) -> None:
    # A retracted spine stands at its stop: there is nothing to misread.
    out = q.design.spine_length
    offset = np.where(out > 0, v["offset"] * _grown(q, out, v["growth"]), 0.0)
    q.spine_length = q.spine_length + offset
    q.tabulated_length = q.tabulated_length + (1 - v["read"]) * offset


SPECS = (
    EffectSpec(
        id="body_modulus",
        label="stiffness of the body",
        says="the body is {} [stiffer|softer] than stated",
        stage="material",
        equation="E_c = E (1 + d), G_c with it",
        parameters=(Parameter("excess", "1", 0.12, -0.6, 1.5),),
        law=Law(before=growing(body_modulus="excess")),
        citation="batch scatter of cast silicone",
        seen_best_in="weight-driven states: horizontal robot, tip mass",
    ),
    EffectSpec(
        id="hyperelastic",
        label="nonlinear elasticity of the body",
        says="the body [stiffens|softens] as it is bent",
        stage="material",
        equation="m = EI k D, D = 1 + g(a (k r)^2) + h(b e), g(x) = x (x / (1 - 2 x) below 0), h(x) = x (x / (1 - x) below 0), "
        "n3 = EA e / (1 - b e / 2) + b EI k^2 h'(b e) / 2; over the body's share and share c of the spine's",
        parameters=(
            Parameter("curvature", "1", 20.0, -80.0, 200.0, starts=(15.0, -15.0)),
            Parameter("strain", "1", 2.0, -6.0, 6.0),
            Parameter("spine", "1", 0.5, 0.0, 1.0, role="shape"),
        ),
        law=Law(before=adding(bend_softening="curvature", strain_softening="strain", spine_softening="spine")),
        citation="series of the section integral of a Yeoh law, Rubber Chem. Technol. 66 (1993); neo-Hookean: b = -2",
        seen_best_in="high pressure without spine; elongation",
    ),
    EffectSpec(
        id="viscoelastic",
        label="creep of the body",
        says="the body creeps by {} under load",
        stage="material",
        equation="k = k_e - s sum_j a_j (k_e - z_j), dz_j/dt = (k_e - z_j) / tau_j, tau = 0.3, 1.5 and 7.5 paces, "
        "s the body's share of EI, and share c of the spine's; axial strain likewise",
        parameters=(
            Parameter("fast", "1", 0.035, 0.0, 0.4, sign="positive"),
            Parameter("slow", "1", 0.035, 0.0, 0.4, sign="positive"),
            Parameter("long", "1", 0.035, 0.0, 0.4, sign="positive"),
            Parameter("spine", "1", 0.5, 0.0, 1.0, role="shape", starts=(0.0, 1.0)),
        ),
        law=Law(path=_viscoelastic),
        citation="standard linear solid (Zener, 1948) with three relaxation times",
        seen_best_in="hold times, ramp rate, unload branch: depends on rate, unlike slip",
    ),
    EffectSpec(
        id="rest_shape",
        label="bend that the body keeps",
        says="the body keeps {} of its largest bend",
        stage="material",
        equation="u* = s c (k_max + k_min), k_max >= 0 and k_min <= 0 the extremes of the curvature at each place of the body in "
        "the campaign so far, which fade by exp(-r t); s the body's share of EI; axial strain likewise",
        parameters=(
            Parameter("kept", "1", 0.03, 0.0, 0.4, sign="positive"),
            Parameter("recovery", "1/s", 1e-3, 0.0, 5e-3, role="shape", starts=(0.0, 1.5e-3)),
        ),
        law=Law(path=_rest_shape),
        citation="Diani et al., Eur. Polym. J. 45 (2009), on residual strain; the size is an estimate",
        shown=returns,
        seen_best_in="the state at zero pressure, before the first trial and after each; a side never bent to",
    ),
    EffectSpec(
        id="spine_length_offset",
        label="error of the spine length",
        says="the spine is {} [longer|shorter] than read",
        stage="structure",
        equation="L_s = L_s,read + e, e = d (2 L_s,read / L)^g for a spine that is out; its moduli those of "
        "L_s,read + (1 - m) e: a table measured with the same error holds by the length read (m = 1)",
        parameters=(
            Parameter("offset", "m", 0.012, -0.05, 0.05),
            Parameter("read", "1", 0.5, 0.0, 1.0, role="shape", starts=(0.0, 1.0)),
            Parameter("growth", "1", 1.0, 0.0, 2.0, role="shape"),
        ),
        shown=with_spine,
        law=Law(before=_spine_length_offset),
        citation="geometry",
        seen_best_in="spine lengths, markers",
    ),
    EffectSpec(
        id="vacuum_leak",
        label="vacuum lost in the spine",
        says="the spine loses {} of its vacuum",
        stage="structure",
        equation="E_s ~ sqrt((v - x v_nominal (2 L_s / L)^g) / v_nominal)",
        parameters=(
            Parameter("lost", "1", 0.3, 0.0, 0.97, sign="positive"),
            Parameter("length", "1", 0.5, 0.0, 1.0, role="shape"),
        ),
        shown=with_spine,
        law=Law(before=_vacuum_leak),
        citation="jamming stiffness over confining pressure, power near 1/2 (Hertzian packings)",
        seen_best_in="vacuum sweep",
    ),
    EffectSpec(
        id="area_moment",
        label="bending by own area moments",
        says="body and spine bend by their own area moments, to {}",
        stage="structure",
        equation="EI = (1 - w) E_eq I + w (E_c I_c + E_s I_s); GA likewise; EA with (1 - b) E_s: b = 1: the spine slides along "
        "its channel and takes no stretch",
        parameters=(
            Parameter("blend", "1", 1.0, 0.0, 1.0, sign="blend"),
            Parameter("sliding", "1", 0.5, 0.0, 1.0, role="shape", starts=(0.0, 0.75)),
        ),
        shown=with_spine,
        law=Law(before=adding(area_moments="blend", spine_sliding="sliding")),
        citation="composite beam theory; the baseline mixes moduli by volume, eq. 10",
        seen_best_in="tip over spine length with one A_eff for all",
    ),
    EffectSpec(
        id="spine_shear",
        label="shear of the spine",
        says="the spine is soft in shear, to {}",
        stage="structure",
        equation="E_s = mean(E_table, E0 (1 - l (1 - eta(L_s)))), G_s to kappa G; bare: 1/E = 1/E0 + 3 I / (kappa G A L^2); "
        "mean: (1 - w, w) of power m - 1, from compliances in series (m = 0) to side by side (2)",
        parameters=(
            Parameter("blend", "1", 1.0, 0.0, 1.0, sign="blend"),
            Parameter("lag", "1", 0.5, 0.0, 1.0, role="shape"),
            Parameter("mix", "1", 1.0, -0.5, 2.5, role="shape", starts=(0.0, 2.0)),
        ),
        shown=with_spine,
        law=Law(before=adding(shear_blend="blend", shear_lag="lag", shear_mix="mix")),
        citation="Timoshenko, Phil. Mag. 41 (1921)",
        seen_best_in="stiffness trials; tip over spine length",
    ),
    EffectSpec(
        id="spine_slip",
        label="friction in the spine",
        says="friction in the spine resists bending by {}",
        stage="structure",
        equation="m_f = -m phi(L_s) mean_j s_j, s_j sliding elements with yield curvatures k_y (1/8, 1/2, 2, 8); axial m_f / r",
        parameters=(
            Parameter("moment", "N m", 0.15, 0.0, 1.5, sign="positive"),
            Parameter("stroke", "ln", 0.7, -2.5, 2.5, role="shape"),
        ),
        shown=with_spine,
        law=Law(path=_spine_slip),
        citation="Jenkins (1962), Iwan, J. Appl. Mech. 33 (1966): friction as parallel elastic-sliding elements",
        seen_best_in="unload branch: hysteresis that does not depend on rate",
    ),
)
