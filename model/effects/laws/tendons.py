"""Effects of tendons on their way from the motor to where they are fastened."""

from __future__ import annotations

import numpy as np

from model.actuators import PULL_AREA
from model.arrays import Array
from model.effects.history import OF_PART, History
from model.effects.laws.actuation import DEADBAND_SOFTNESS, slack
from model.effects.layout import INNER, OUTER
from model.effects.quantities import Quantities
from model.effects.shows import by_tendons
from model.effects.spec import EffectSpec, Law, Parameter, Values

PLACES = 6
"""Along each part, where tensions are followed: the middles of equal pieces."""


def _tendon_friction(h: History, v: Values) -> None:
    """Belt friction of Euler and Eytelwein with sticking: a tension stays what it is as long as friction can hold it there.

    A weightless body that tendons bend without stretch has a' = k T / T0 and T = T0 exp(-mu a), so that T = T0 / (1 + mu a0), a0
    the bend up to there without friction: the lower limit, T0 / (1 - mu a0) the upper one. Tendons alone bend the part beyond the
    spine evenly; weights add to that (`_by_weight`). What bends a part is the straight line nearest to the tensions at PLACES
    along it, so that the tip's place and turn are as with these.
    """
    q = h.quantities
    if q.robot.tendons is None:
        return
    spine = np.clip(q.spine_length, 0.0, q.length)
    lengths = np.stack(np.broadcast_arrays(spine, q.length - spine), axis=-1)[..., None]
    pulls = np.maximum(q.pressure * q.area_factor, 0.0)
    at_tip = np.stack(_moment(q, pulls), axis=-1) / h.bend_stiffness[..., OUTER, None]  # 1/m, of tendons alone
    inner, outer = (h.drive[..., None, k : k + 2] for k in (0, OF_PART))  # 1/m, mean curvature of the parts
    along = (np.arange(PLACES) + 0.5) / PLACES
    outer = at_tip[..., None, :] + _by_weight(h, at_tip, outer[..., 0, :], lengths[..., OUTER, 0], along)
    bends = np.stack(np.broadcast_arrays(*(np.linalg.norm(k, axis=-1) for k in (inner, outer))), axis=-2) * lengths / PLACES
    angle = np.cumsum(bends, axis=-1) - bends / 2  # rad, up to the middle of each piece
    angle[..., OUTER, :] += bends[..., INNER, :].sum(axis=-1, keepdims=True)
    mean_tension, rise = h.path.held(pulls, v["coefficient"][..., None, None] * angle)
    change = mean_tension - pulls[..., None, :]
    changes: list[Array] = []
    rises: list[Array] = []
    for part in (INNER, OUTER):
        of_part = change[..., part, :]
        bend, axial = h.bend_stiffness[..., part], h.axial_stiffness[..., part]
        changes += [m / bend for m in _moment(q, of_part)]
        changes += [np.zeros((1, 1)), of_part @ q.body.mean(q.body.chamber_area) / axial]
        rises += [m / bend for m in _moment(q, rise[..., part, :])]
    h.add(np.stack(np.broadcast_arrays(*changes), axis=-1))
    along_parts = np.stack(np.broadcast_arrays(*rises), axis=-1)
    h.rise = h.rise + along_parts.reshape(*along_parts.shape[:-1], 2, 2)


def _by_weight(h: History, at_tip: Array, mean: Array, length: Array, along: Array) -> Array:
    """(v, n, places, 2) 1/m by which weights bend the part beyond the spine at shares `along` of its `length`: its `mean` is
    (v, n, 2) there and `at_tip` what tendons make.

    With mass m of the part and M at the tip, x from 0 to 1, weight across the axis bends it in proportion to m (1 - x)^2 / 2 + M
    (1 - x), weight along the axis, as far as the part is bent evenly, to m (1 - x)^2 (1 + 2 x) / 6 + M (1 - x^2) / 2. The first
    is what straight bodies show; the rest is shared as gravity's components are.
    """
    q = h.quantities
    body, tip = q.density * q.body.mean(q.body.weight_area) * length, q.design.tip_mass + q.payload + 1e-9
    x, y, z = q.robot.gravity
    # share of gravity along the axis; shapes below are divided by their means over the part
    hanging = abs(z) / (abs(z) + np.hypot(x, y) + 1e-12)
    per_moment = (length / h.bend_stiffness[..., OUTER])[..., None] * np.array([-y, x])
    across = body[..., None] * (1 - along) ** 2 / 2 + tip[..., None] * (1 - along)
    rest = mean - at_tip - per_moment * (body / 6 + tip / 2)[..., None]
    shape = body[..., None] * (1 - along) ** 2 * (1 + 2 * along) / 6 + tip[..., None] * (1 - along**2) / 2
    shape = hanging * shape / (body / 12 + tip / 3)[..., None] + (1 - hanging) * across / (body / 6 + tip / 2)[..., None]
    return np.asarray(per_moment[..., None, :] * across[..., None] + rest[..., None, :] * shape[..., None])


def _moment(q: Quantities, pulls: Array) -> tuple[Array, Array]:
    """(v, n) N m each about x and y, of pulls (v, n, tendons) Pa."""
    aside = pulls * q.lever[..., None] * q.body.levers * q.body.mean(q.body.path_radius[:, None] * q.body.chamber_area)
    return (np.sin(q.azimuth) * aside).sum(-1), -(np.cos(q.azimuth) * aside).sum(-1)


def _tendon_slack(q: Quantities, v: Values) -> None:
    """What it takes to straighten tendon and guides is lost, rounded as a dead band is."""
    lost = (v["tension"] / PULL_AREA)[..., None]
    if q.robot.tendons is not None and lost.any():
        q.pressure = np.where((q.pressure > 0) & (lost != 0), slack(q.pressure, lost, DEADBAND_SOFTNESS * lost), q.pressure)


SPECS = (
    EffectSpec(
        id="tendon_slack",
        label="slack of the tendons",
        says="the tendons are slack up to {}",
        stage="actuation",
        equation="T_eff = f(T - T0) - f(-T0), f(x) = (x + sqrt(x^2 + (0.2 T0)^2)) / 2",
        parameters=(Parameter("tension", "N", 1.0, 0.0, 10.0, sign="positive", proportional_to="Pa"),),
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
        equation="T(s) stays as it is between T0 / (1 + mu a(s)) and T0 / (1 - mu a(s)), a the frictionless bend up to s",
        parameters=(Parameter("coefficient", "1", 0.3, 0.0, 2.0, sign="positive"),),
        law=Law(path=_tendon_friction),
        citation="Euler and Eytelwein's belt; Jung et al., ICRA 2011, on tendons of continuum robots",
        shown=by_tendons,
        seen_best_in="unload branch: a loop that no rate changes, wider the farther the robot is bent",
    ),
)
