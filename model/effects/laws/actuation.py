"""Effects between the regulator and the moment on the body."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from model.arrays import Ints
from model.condition import USED
from model.effects.quantities import Quantities
from model.effects.shows import by_chambers, chambers_apart, directions_apart, set_points
from model.effects.spec import EffectSpec, Law, Parameter, Values, adding
from model.robot import Robot

DEADBAND_SOFTNESS = 0.2
"""Width of the smooth corner of a dead band, in dead bands."""
SINGLE = 3.0
"""Logarithm of the ratio of what one chamber differs by to what its neighbour does, where it differs alone."""
ORDERS = ((1, -1), (-1, -1), (-1, 0), (-1, 1), (1, 1))
"""Ways to connect hoses wrongly, as sense and start of counting: turned back, three mirror images, turned on."""


def slack(p: np.ndarray, band: np.ndarray, soft: np.ndarray) -> np.ndarray:
    """p without its first `band`, the corner rounded over `soft`: f(p - band) - f(-band), f(x) = (x + sqrt(x^2 + soft^2)) / 2."""
    return np.asarray(0.5 * (p + np.sqrt((p - band) ** 2 + soft**2) - np.sqrt(band**2 + soft**2)))


def _time_offset(q: Quantities, v: Values) -> None:
    """Pressure and tip are read apart, which matters while the pressure moves."""
    pressed = q.design.pressure.max(axis=1) > USED * q.scales.pressure
    moving = (q.design.hold <= 0) & ~q.design.stiffness & pressed
    resting = (q.design.hold <= 0) & ~q.design.stiffness & ~moving
    sign = np.where(q.design.unload, -1.0, 1.0)
    slope = sign * q.design.rate * (moving + v["rest"] * resting)
    shifted = q.pressure + (v["delay"] * slope)[..., None] * q.design.used
    q.pressure = np.where(resting[:, None], np.maximum(shifted, np.minimum(q.pressure, 0.0)), shifted)


def _pressure_lag(q: Quantities, v: Values) -> None:
    """Subtract what a first-order low-pass still lacks of its set-points at the reading, of this ramp and of earlier ones."""
    tau, p = v["constant"][..., None], q.pressure
    lagging = tau > 0
    tau = np.where(lagging, tau, 1.0)
    begins_trial = np.ones(len(q.design), bool)
    begins_trial[1:] = np.diff(q.design.trial) != 0
    step = p - np.where(begins_trial[:, None], 0.0, np.roll(p, 1, axis=-2))
    ramp = np.abs(step).max(axis=-1, keepdims=True) / np.maximum(q.design.rate, 1.0)[:, None]
    after_hold = np.exp(-q.design.hold[:, None] / tau)
    slope = step / np.where(ramp > 0, ramp, 1.0)
    of_ramp = slope * tau * -np.expm1(-ramp / tau) * after_hold
    remaining = np.where(begins_trial[:, None], 0.0, after_hold * np.exp(-ramp / tau))
    lag = of_ramp
    for _ in range(3):  # a reading may still show the lag of three states before it
        lag = of_ramp + remaining * np.roll(lag, 1, axis=-2)
    q.pressure = np.where(lagging & ~q.design.stiffness[:, None], p - lag, p)


def _pressure_offset(q: Quantities, v: Values) -> None:
    share = np.where(q.design.used, 1.0, v["idle"][..., None])
    shifted = q.pressure + v["offset"][..., None] * share * ~q.design.stiffness[:, None]
    # A regulator without a pump for vacuum cannot go below ambient.
    q.pressure = np.where(v["offset"][..., None] < 0, np.maximum(shifted, np.minimum(q.pressure, 0.0)), shifted)


def _pressure_deadband(q: Quantities, v: Values) -> None:
    """Slack on the way up; on the way down a share of it is play: the push follows late, and then all the way."""
    band = v["band"][..., None]
    soft = DEADBAND_SOFTNESS * band
    p = q.pressure
    taken = slack(p, band, soft)
    late = p - slack(p, np.maximum(q.design.highest_of_trial - band, 0.0), soft)
    share = np.where(q.design.unload[:, None], v["play"][..., None], 0.0)
    q.pressure = np.where((p > 0) & (band != 0), taken + share * (late - taken), p)


def _chamber_ballooning(q: Quantities, v: Values) -> None:
    power, onset = (x[..., None] for x in (1.25 + v["power"], v["onset"]))
    beyond, most = (slack(p, onset, 0.5 * onset) for p in (np.maximum(q.pressure, 0.0), np.full_like(onset, q.scales.pressure)))
    grown = np.maximum(beyond, 0.0) / most  # rounding may leave it below zero
    q.area_factor = q.area_factor * (1 + v["growth"][..., None] * grown**power)


def orders(azimuths_deg: Sequence[float]) -> Ints:
    """(5, chambers) the chamber whose pressure each gets, of `ORDERS`; a step on the ring is a third of the chambers."""
    ring = np.argsort(np.mod(azimuths_deg, 360.0), kind="stable")
    n = len(ring)
    step, place = max(1, round(n / 3)), np.arange(n)
    out = np.empty((len(ORDERS), n), np.int64)
    for order, (sense, shift) in zip(out, ORDERS, strict=True):
        order[ring] = ring[(sense * place + shift * step) % n]
    return out


def _chamber_order(q: Quantities, v: Values) -> None:
    """Between two orders pressures mix; what is searched begins and ends at one of them."""
    which = v["which"][..., None]
    mixed = np.zeros_like(q.pressure)
    for k, order in enumerate(orders(q.robot.actuators.azimuths_deg)):
        share = np.maximum(1 - np.abs(which - (k - len(ORDERS) // 2)), 0.0)
        mixed = mixed + share * q.pressure[..., order]
    q.pressure = q.pressure + v["blend"][..., None] * (mixed - q.pressure)


def _areas(robot: Robot, v: Values) -> np.ndarray:
    """From one side to the other (single 0), or one chamber that differs from the others (strong at 1, weak at -1)."""
    azimuths = np.deg2rad(robot.actuators.azimuths_deg)
    x, y, single = (v[name][..., None] for name in ("x", "y", "single"))
    along = np.cos(azimuths - np.arctan2(y, x))
    sharp = np.where(single == 0, 1.0, single * SINGLE / (1 - np.cos(2 * np.pi / max(len(azimuths), 2))))
    shape = np.where(single == 0, along, np.expm1(sharp * along) / np.sinh(sharp))
    return np.asarray(1 + np.hypot(x, y) * (shape - shape.mean(axis=-1, keepdims=True)))


def _chamber_gain(q: Quantities, v: Values) -> None:
    q.area_factor = q.area_factor * _areas(q.robot, v)


def _chamber_twist(q: Quantities, v: Values) -> None:
    q.twist = q.twist + v["winding"] * (1 - v["growth"])  # at the base
    q.azimuth = q.azimuth - (v["winding"] * v["aligned"] * q.robot.length)[..., None]
    q.twist_growth = q.twist_growth + v["growth"] / (1 - v["growth"])


SPECS = (
    EffectSpec(
        id="time_offset",
        label="delay between {pressure} and tip",
        says="{pressures} and tips are read {} apart",
        stage="measurement",
        equation="P = P_read + (dP/dt) d in states read while ramping; dP/dt < 0 on the unload branch; share r of it, not below "
        "ambient, where a ramp begins and ends",
        parameters=(Parameter("delay", "s", 0.4, -3.0, 3.0), Parameter("rest", "1", 0.5, 0.0, 1.0, role="shape")),
        law=Law(before=_time_offset),
        citation="kinematics of two clocks",
        seen_best_in="states read while ramping: the sign flips on the unload branch; grows with the ramp rate",
    ),
    EffectSpec(
        id="pressure_lag",
        label="{regulators} that lag behind their set-points",
        says="the {pressures} follow their set-points with a time constant of {}",
        stage="actuation",
        equation="dP/dt = (P_set - P) / tau, where the table holds set-points: after a ramp of slope r and duration T, held for "
        "h, P_set - P = r tau (1 - exp(-T / tau)) exp(-h / tau), and what the states before have left of theirs",
        parameters=(Parameter("constant", "s", 1.0, 0.0, 20.0, sign="positive", starts=(0.5, 3.0)),),
        law=Law(before=_pressure_lag),
        citation="first-order regulator and hose, as of data sheets of proportional valves",
        tolerated=False,
        shown=set_points,
        seen_best_in="states read soon after a ramp, on the way up and down; longer holds make it vanish",
    ),
    EffectSpec(
        id="pressure_offset",
        label="offset of the {pressures}",
        says="the {actuators} hold {} [more|less] than their {regulators} read",
        stage="actuation",
        equation="P = P_read + p0, not below ambient, in chambers that the trial uses, at rest too, share i p0 in vented ones",
        parameters=(
            Parameter("offset", "Pa", 5e3, -40e3, 40e3),
            Parameter("idle", "1", 1.0, 0.0, 1.0, role="shape", starts=(0.0, 1.0)),
        ),
        law=Law(before=_pressure_offset),
        citation="zero error of a gauge",
        seen_best_in="zero-pressure state, low pressures",
        family="pressure_zero",
    ),
    EffectSpec(
        id="pressure_deadband",
        label="dead band of the {actuators}",
        says="the {actuators} act only above {}",
        stage="actuation",
        equation="P_eff = f(P - P0) - f(-P0), f(x) = (x + sqrt(x^2 + (0.2 P0)^2)) / 2; on the way down (1 - h) of that and "
        "h min(P, P_highest - P0), rounded as f",
        parameters=(
            Parameter("band", "Pa", 10e3, 0.0, 60e3, sign="positive"),
            Parameter("play", "1", 0.5, 0.0, 1.0, role="shape"),
        ),
        law=Law(before=_pressure_deadband),
        citation="slack of the winding: a chamber must swell to its winding before it pushes; h = 1: backlash, as of a valve",
        shown=by_chambers,
        seen_best_in="low pressures",
        family="pressure_zero",
    ),
    EffectSpec(
        id="chamber_order",
        label="order of the {actuators}",
        says="the {actuators} hang on other {regulators} than robot.yaml states",
        stage="actuation",
        equation="P_i = (1 - w) P_i,read + w P_k,read, k = pi(i): the ring of chambers turned a third (-2, 2) or mirrored",
        parameters=(
            Parameter("blend", "1", 1.0, 0.0, 1.0, sign="blend", starts=(1.0,)),
            Parameter("which", "1", 2.0, -2.0, 2.0, role="shape", starts=(-2.0, -1.0, 0.0, 1.0, 2.0)),
        ),
        law=Law(before=_chamber_order),
        citation="geometry: hoses or channels exchanged",
        exact=True,
        tolerated=False,
        shown=directions_apart,
        seen_best_in="chambers of different sides inflated one after another",
    ),
    EffectSpec(
        id="chamber_ballooning",
        label="ballooning of the {actuators}",
        says="the {actuator_area} [grows|shrinks] by {} at {quoted}",
        stage="actuation",
        equation="A_eff = A (1 + b (f(P) / f(P_max))^(1.25 + g)), f(P) what P is above an onset P0, its corner rounded over "
        "P0 / 2, P_max the largest pressure",
        parameters=(
            Parameter("growth", "1", 0.15, -0.5, 1.0, least=0.0),
            Parameter("power", "1", 0.25, -0.5, 1.0, role="shape"),
            Parameter("onset", "Pa", 50e3, 0.0, 150e3, role="shape", starts=(0.0, 80e3)),
        ),
        law=Law(before=_chamber_ballooning),
        citation="Polygerinos et al., IEEE T-RO 31 (2015), on fibre-reinforced bending actuators",
        shown=by_chambers,
        seen_best_in="pressure curve without spine",
    ),
    EffectSpec(
        id="chamber_gain",
        label="difference between the {actuator_areas}",
        says="the {actuator_areas} differ by {}",
        stage="actuation",
        equation="A_i = A (1 + |g| (f_i - mean f)), f_i = (exp(k cos(az_i - az_g)) - 1) / sinh k, g = (x, y) towards az_g, "
        "k = 3 s / (1 - cos(2 pi / n)) of n actuators; s = 1 or -1: one differs alone",
        parameters=(
            Parameter("x", "1", 0.1 / math.sqrt(2), -0.4, 0.4),
            Parameter("y", "1", 0.1 / math.sqrt(2), -0.4, 0.4),
            Parameter("single", "1", 0.5, -1.5, 1.5, role="shape"),
        ),
        law=Law(before=_chamber_gain),
        each=_areas,
        citation="moulded rubber, ISO 3302-1 class M3: 0.3 mm on 10 mm, 6 % of the area; as much again for walls (estimate)",
        shown=chambers_apart,
        seen_best_in="chambers of different sides inflated one after another; all chambers at once",
    ),
    EffectSpec(
        id="chamber_azimuth",
        label="angle of the {actuators} about the axis",
        says="the {actuators} are turned by {} about the axis",
        stage="actuation",
        equation="azimuth_i = azimuth_i,drawn + d",
        parameters=(Parameter("angle", "rad", math.radians(6), -0.6, 0.6),),
        law=Law(before=adding(azimuth="angle")),
        citation="geometry",
        exact=True,
        seen_best_in="tip out of the bending plane",
    ),
    EffectSpec(
        id="chamber_twist",
        label="twist of the {actuators}",
        says="the {actuators} wind about the axis by {}",
        stage="actuation",
        equation="azimuth_i(s) = azimuth_i + phi(s), phi = c (s (1 + g (s / L - 1)) - a L), c its mean: "
        "m_act(s) = Rz(phi) m_act(0); a L: where they were aligned when mounted",
        parameters=(
            Parameter("winding", "rad/m", 0.35, -3.0, 3.0),
            Parameter("growth", "1", 0.3, -0.9, 0.9, role="shape"),
            Parameter("aligned", "1", 0.5, 0.0, 1.0, role="shape"),
        ),
        law=Law(before=_chamber_twist),
        citation="Rucker & Webster, IEEE T-RO 27 (2011), loads of routed actuators; here for pressure",
        seen_best_in="tip out of the plane and tip orientation, over pressure",
    ),
)
