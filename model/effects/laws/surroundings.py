"""Effects of loads and of the boundary."""

from __future__ import annotations

import math

import numpy as np

from model.effects.quantities import Quantities
from model.effects.shows import by_chambers
from model.effects.spec import EffectSpec, Law, Parameter, Values, adding, growing, vector
from model.rotation import rolled

OBSTACLE = 0.175
"""Robot lengths from the axis at which an obstacle is looked for first."""
base_tilt = adding(base_turn=("x", "y"))


def _tip_payload(q: Quantities, v: Values) -> None:
    """What is fixed to the tip turns with it, and with a robot that is mounted rolled."""
    q.payload = q.payload + v["mass"]
    x, y = rolled(q.design.roll, v["x"], v["y"])
    q.payload_place = q.payload_place + vector(x, y, v["z"])


_chamber_thrust = adding(thrust_on_walls="share", thrust_borne="borne", thrust_growth="growth")
"""The `share` of the chambers' thrust P A that the side walls take. How it gets into them differs from body to body:
`borne` b and `growth` g are 0 for thrust that is in the walls from the cap on.

- Stretch: walls stretch by all of P A where they are free to. Traction of a liner that sticks all along leaves half of it,
  fibres or a bonded spine none, and a lever shorter than drawn, which a larger area makes up for, more than P A: b = 0,
  1/2, 1 and below 0, a scale of 1/2.
- Moment: it enters the section as the force does, over a length l from the cap (Saint-Venant's decay; shear lag), or it is
  missing over l at the base. Of 1 - exp(-(L - s) / l), what a tip shows besides the mean is the first moment along the arc,
  g = -2 (l / L) (1 - 2 l / L) / (1 - l / L): -0.2 and -0.35 for l of a radius and of a diameter of a body four diameters
  long, above 0 at the base, -2/3 for traction all along. A scale of 1/3; more of it lies near the cap.

A share that changes with the pressure needs no shape: it is what the error of a law may be, a smooth factor on what it does.
Nor does one of normal pressure that changes along the arc, which acts as a constant one does.
"""


def _contact(q: Quantities, v: Values) -> None:
    q.plane_stiffness = q.plane_stiffness + v["stiffness"]
    # m from the axis to the obstacle
    q.plane_distance = OBSTACLE * q.robot.length + v["distance"]
    q.plane_direction = np.array(rolled(v["turn"], *q.plane_direction))
    q.plane_lever = q.plane_lever + v["lever"]


def _base_compliance(q: Quantities, v: Values) -> None:
    q.base_compliance = q.base_compliance + v["give"]
    q.base_relief = q.base_relief + v["relief"]
    # at a turn of 0.1 rad, stiffening of 7 has halved the compliance of a mount
    q.base_stiffening = q.base_stiffening + v["stiffening"] / 0.1**2
    q.clamp_root = q.clamp_root + v["give"]


def _precurvature(q: Quantities, v: Values) -> None:
    """The body's own curvature turns with the body."""
    q.rest_curvature = q.rest_curvature + vector(*rolled(q.design.roll, v["x"], v["y"]), np.zeros((1, 1)))
    q.rest_growth = q.rest_growth + v["growth"]


SPECS = (
    EffectSpec(
        id="self_weight",
        label="weight of the body",
        says="the body is {} [heavier|lighter] than stated",
        stage="load",
        equation="f = rho A g (1 + d)",
        parameters=(Parameter("excess", "1", 0.12, -0.6, 1.5),),
        law=Law(before=growing(density="excess")),
        citation="statics",
        seen_best_in="zero-pressure elongation, horizontal robot",
    ),
    EffectSpec(
        id="tether_load",
        label="pull of a tether",
        says="a tether pulls the tip with {}",
        stage="load",
        equation="F_tip = F0 - k (x, y), fixed in the base frame",
        parameters=(
            Parameter("x", "N", 0.35 / math.sqrt(2), -3.0, 3.0),
            Parameter("y", "N", 0.35 / math.sqrt(2), -3.0, 3.0),
            Parameter("spring", "N/m", 2.0, 0.0, 40.0, sign="positive"),
        ),
        law=Law(before=adding(tip_force=("x", "y"), tether="spring")),
        citation="statics of hoses and cables",
        seen_best_in="roll the robot: its direction stays fixed in the world",
    ),
    EffectSpec(
        id="tip_payload",
        label="load at the tip",
        says="the tip carries {} [more|less] than stated",
        stage="load",
        equation="F_tip = m g, M_tip = R(L) c x m g, c = (x, y, z) from the tip to the payload's centre in the tip's frame",
        parameters=(
            Parameter("mass", "kg", 0.1, -0.3, 3.0),
            Parameter("x", "m", 0.02, -0.15, 0.15, role="shape"),
            Parameter("y", "m", 0.02, -0.15, 0.15, role="shape"),
            Parameter("z", "m", 0.03, -0.1, 0.3, role="shape"),
        ),
        law=Law(before=_tip_payload),
        exact=True,
        citation="statics; a gripper, camera or fitting that robot.yaml's tip_mass leaves out",
        seen_best_in="horizontal robot, another tip mass; its lever turns with the tip",
    ),
    EffectSpec(
        id="chamber_thrust",
        label="thrust on the side walls",
        says="the side walls carry {} of the {actuators}' thrust",
        stage="load",
        equation="F_tip = (1 - w) P A e3(L), v*_3 = w (1 - b) P A / EA, moment times 1 + w g (3 s^2/L^2 - 1); w = 0: paper, "
        "eq. 4; w = 1: the side walls balance the thrust",
        parameters=(
            Parameter("share", "1", 1.0, 0.0, 1.0, sign="blend", starts=(0.5, 1.0), least=0.5),
            Parameter("borne", "1", 0.5, -1.0, 1.0, role="shape"),
            Parameter("growth", "1", 1 / 3, -2.0, 2.0, role="shape"),
        ),
        law=Law(before=_chamber_thrust),
        citation="pressurised curved tubes: Haringx, Philips Res. Rep. 3 (1948); shear lag: Cox, Br. J. Appl. "
        "Phys. 3 (1952); Horgan and Knowles, Adv. Appl. Mech. 23 (1983)",
        shown=by_chambers,
        seen_best_in="pressure curve at all lengths",
        tolerated=False,
    ),
    EffectSpec(
        id="contact",
        label="contact with an obstacle",
        says="the body touches an obstacle of {}, as felt near the tip",
        stage="load",
        equation="F = -k <e . p(L - l) - (0.175 L + d)> e, l from the tip, e turned by t from the obstacle's azimuth, "
        "< > positive part over L / 200",
        parameters=(
            Parameter("stiffness", "N/m", 300.0, 0.0, 5e3, sign="positive", starts=(0.0, 200.0)),
            Parameter("distance", "m", 0.025, -0.08, 0.2, role="shape", starts=(-0.03, 0.03)),
            Parameter("turn", "rad", 0.15, -1.25 * math.pi, 1.25 * math.pi, role="shape"),
            Parameter("lever", "m", 0.05, 0.0, 0.25, role="shape", starts=(0.03,)),
        ),
        law=Law(before=_contact),
        citation="one-sided spring (penalty contact)",
        seen_best_in="kink in the sweep",
    ),
    EffectSpec(
        id="base_tilt",
        label="tilt of the base",
        says="the base is tilted by {}",
        stage="boundary",
        equation="R(0) = exp(theta^), theta fixed in the base frame",
        parameters=(
            Parameter("x", "rad", math.radians(1.5) / math.sqrt(2), -0.2, 0.2),
            Parameter("y", "rad", math.radians(1.5) / math.sqrt(2), -0.2, 0.2),
        ),
        law=Law(before=base_tilt),
        citation="geometry",
        exact=True,
        seen_best_in="zero-pressure pose; does not turn with the robot",
    ),
    EffectSpec(
        id="base_compliance",
        label="compliance of the base",
        says="the base turns under load by {}",
        stage="boundary",
        equation="R(0) = exp((v / (1 + h (v / 0.1 rad)^2)^(1/3))^), v = c (m(0) - l m_ch) about x and y; l = 1: the "
        "chambers' ends pull on the mount too",
        parameters=(
            Parameter("give", "rad/(N m)", 0.025, 0.0, 0.5, sign="positive"),
            Parameter("relief", "1", 0.5, 0.0, 1.0, role="shape", starts=(0.0, 1.0)),
            Parameter("stiffening", "1", 3.0, 0.0, 40.0, role="shape"),
        ),
        law=Law(before=_base_compliance),
        citation="elastic clamp",
        seen_best_in="tip mass, horizontal robot",
    ),
    EffectSpec(
        id="precurvature",
        label="curvature at rest",
        says="the body is curved by {} at rest",
        stage="boundary",
        equation="u*(s) = u0 (1 + g (2 s / L - 1)), turns with roll",
        parameters=(
            Parameter("x", "1/m", 0.12 / math.sqrt(2), -2.0, 2.0),
            Parameter("y", "1/m", 0.12 / math.sqrt(2), -2.0, 2.0),
            Parameter("growth", "1", 0.5, -2.0, 2.0, role="shape"),
        ),
        law=Law(before=_precurvature),
        citation="paper's u*, set to zero there",
        seen_best_in="roll the robot: turns with it, unlike a tilted base",
    ),
)
