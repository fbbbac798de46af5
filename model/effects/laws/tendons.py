"""Effects of tendons on their way from the motor to where they are fastened."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from model.actuators import PULL_AREA
from model.effects.history import OF_PART, History
from model.effects.laws.actuation import slack
from model.effects.quantities import Quantities
from model.effects.shows import by_tendons
from model.effects.spec import EffectSpec, Law, Parameter, Values

Array = NDArray[np.float64]

STICK = 0.15
"""1/m, change of curvature within which a tendon sticks to half of its guides, before its shape parameter."""
SPREAD = np.array([1 / 4, 1.0, 4.0])
"""Of the guides about it: those near the motor slide first."""


def _tendon_friction(h: History, v: Values) -> None:
    """Euler and Eytelwein to first order, on the mean of each part; which way the tendons slide is that of sliding elements."""
    q = h.quantities
    if q.robot.tendons is None:
        return
    spine = np.clip(q.spine_length, 0.0, q.length)
    curved = [h.drive[..., k : k + 2] for k in (0, OF_PART)]
    inner, outer = (
        np.linalg.norm(k, axis=-1) * long for k, long in zip(curved, (spine, q.length - spine), strict=True)
    )
    pulls = q.pressure * q.area_factor
    aside = pulls * q.body.mean_arm
    mx, my = (np.sin(q.azimuth) * aside).sum(-1), -(np.cos(q.azimuth) * aside).sum(-1)
    pull = (pulls * q.body.mean_chamber_area).sum(-1)
    yields = STICK * np.exp(v["stroke"][:, :1]) * SPREAD
    parts: list[Array] = []
    for part, bent in enumerate((inner / 2, inner + outer / 2)):
        size = np.maximum(np.linalg.norm(curved[part], axis=-1), 1e-9)
        sliding = (h.sliding(curved[part], yields) * curved[part]).sum(-1) / size
        lost = v["coefficient"] * bent * sliding
        bend, axial = h.bend_stiffness[..., part], h.axial_stiffness[..., part]
        parts += [-lost * mx / bend, -lost * my / bend, np.zeros((1, 1)), -lost * pull / axial]
    h.add(np.stack(np.broadcast_arrays(*parts), axis=-1))


def _tendon_slack(q: Quantities, v: Values) -> None:
    """What it takes to straighten tendon and guides is lost, rounded as a dead band is."""
    lost = (v["tension"] / PULL_AREA)[..., None]
    if q.robot.tendons is not None and lost.any():
        q.pressure = np.where((q.pressure > 0) & (lost != 0), slack(q.pressure, lost), q.pressure)


SPECS = (
    EffectSpec(
        id="tendon_slack",
        label="slack of the tendons",
        says="the tendons are slack up to {}",
        stage="actuation",
        equation="T_eff = f(T - T0) - f(-T0), f(x) = (x + sqrt(x^2 + (0.2 T0)^2)) / 2",
        parameters=(Parameter("tension", "N", 1.0, 0.0, 10.0, sign="positive"),),
        law=Law(before=_tendon_slack),
        citation="slack of the cable before it pulls",
        shown=by_tendons,
        seen_best_in="low tensions",
    ),
    EffectSpec(
        id="tendon_friction",
        label="friction of the tendons",
        says="friction takes {} of the tendons' tension per radian of bend",
        stage="actuation",
        equation="T(s) = T0 (1 - mu a(s) d), a the angle of the bend between the base and s, d from -1 to 1: which way the "
        "tendon slides, by sliding elements in series",
        parameters=(
            Parameter("coefficient", "1", 0.3, 0.0, 2.0, sign="positive"),
            Parameter("stroke", "1", 0.7, -3.0, 3.0, role="shape"),
        ),
        law=Law(path=_tendon_friction),
        citation="Euler and Eytelwein's belt, to first order; Jung et al., ICRA 2011, on tendons of continuum robots",
        shown=by_tendons,
        seen_best_in="unload branch: a loop that no rate changes, wider the farther the robot is bent",
    ),
)
