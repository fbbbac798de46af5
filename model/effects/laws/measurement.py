"""Effects of the instruments."""

from __future__ import annotations

import math

import numpy as np

from model.effects.readings import Readings
from model.effects.shows import pushes
from model.effects.spec import EffectSpec, Law, Parameter, Values, adding, vector
from model.rotation import rolled, to_base

TURN = math.radians(1.5) / math.sqrt(3)


def frame_misalignment(r: Readings, v: Values) -> None:
    r.turn(vector(v["x"], v["y"], v["z"]))


def marker_offset(r: Readings, v: Values) -> None:
    """The marker is rolled with the robot it sits on."""
    x, y = rolled(r.design.roll, v["x"], v["y"])
    r.tip = r.tip + to_base(r.orientation, vector(x, y, v["z"]))


def force_bias(r: Readings, v: Values) -> None:
    (bias,) = v.values()
    r.force = r.force + np.where(r.design.stiffness, bias, 0.0)


SPECS = (
    EffectSpec(
        id="marker_offset",
        label="position of the tip's marker",
        says="the tip's marker sits {} off its place",
        stage="measurement",
        equation="p_read = p + R_tip d",
        parameters=tuple(Parameter(axis, "m", 6e-3 / math.sqrt(3), -0.2, 0.2) for axis in "xyz"),
        law=Law(after=marker_offset),
        citation="geometry",
        exact=True,
        seen_best_in="turns with the tip's orientation",
    ),
    EffectSpec(
        id="frame_misalignment",
        label="turn of the cameras' frame",
        says="the cameras' frame is turned by {}",
        stage="measurement",
        equation="p_read = exp(theta^) p, orientation likewise",
        parameters=tuple(Parameter(axis, "rad", TURN, -0.3, 0.3) for axis in "xyz"),
        law=Law(after=frame_misalignment),
        citation="geometry",
        exact=True,
        seen_best_in="grows with displacement, equally in all states",
    ),
    EffectSpec(
        id="force_bias",
        label="offset of the force sensor",
        says="the force sensor reads {} too [high|low]",
        stage="measurement",
        equation="F_read = F + b",
        parameters=(Parameter("bias", "N", 0.1, -2.0, 2.0),),
        law=Law(after=force_bias),
        citation="zero error of the sensor",
        shown=pushes,
        seen_best_in="stiffness trials: the intercept",
    ),
    EffectSpec(
        id="arm_compliance",
        label="compliance of the arm",
        says="the arm gives way by {}",
        stage="measurement",
        equation="1/k = 1/k_specimen + c",
        parameters=(Parameter("give", "m/N", 5e-5, 0.0, 2e-3, sign="positive"),),
        law=Law(before=adding(arm_compliance="give")),
        citation="springs in series",
        shown=pushes,
        seen_best_in="stiffness trials: the modulus falls with the specimen's stiffness",
    ),
    EffectSpec(
        id="contact_offset",
        label="offset of the contact",
        says="contact begins {} [later|earlier] than read",
        stage="measurement",
        equation="F = max(k <y - d>, k c y / (k + c)): a gap, or a layer of stiffness c, is taken up over d",
        parameters=(
            Parameter("offset", "m", 1e-3, -5e-3, 5e-3, starts=(0.0, 5e-4, 1e-3, -1e-3)),
            Parameter("layer", "N/m", 200.0, 0.0, 2e3, role="shape", starts=(0.0, 100.0)),
        ),
        law=Law(before=adding(contact_offset="offset", contact_layer="layer")),
        citation="delayed contact; springs in series",
        shown=pushes,
        seen_best_in="stiffness trials: the first points",
    ),
)
