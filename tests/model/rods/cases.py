"""The robot of the reference values, as arrays of rods: bends in the x-z plane, hangs along z."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from model.condition import States
from model.robot import Robot
from model.rods import FINE, Form, Method, Rods, Solution, rods, solve
from model.section import rods_of

Array = NDArray[np.float64]

LENGTH, OUTER, INNER, BODY, GRAVITY = 0.40, 0.05, 0.029, 0.507147e6, 9.81
AREA = math.pi * (OUTER**2 - INNER**2)
SECOND = math.pi / 4 * (OUTER**4 - INNER**4)
SPINE_AREA = math.pi * INNER**2
CHAMBER, PATH = 1.5 * math.pi * 0.005**2, 0.04
WEIGHT, TIP_WEIGHT = 1300.0 * AREA * GRAVITY, 0.053 * GRAVITY

PRESSURES = np.array([50.0, 100.0, 150.0, 200.0, 250.0]) * 1e3
REFERENCE = {
    0.00: [
        (-23.265687, 403.896067), (-59.174490, 402.057387), (-108.384877, 392.375035),
        (-169.873106, 368.680966), (-239.509465, 322.875895),
    ],
    0.10: [
        (-20.627443, 403.591562), (-51.821151, 402.484340), (-94.187001, 395.386688),
        (-147.155722, 377.809735), (-208.079651, 343.984436),
    ],
    0.20: [
        (-13.519996, 402.698634), (-32.954293, 403.015653), (-58.705616, 400.997735),
        (-90.861718, 395.098990), (-128.995021, 383.356816),
    ],
    0.30: [
        (-7.948362, 401.803812), (-18.746965, 402.537608), (-32.568804, 402.598711),
        (-49.539904, 401.597467), (-69.713213, 399.040631),
    ],
}  # fmt: skip
"""Spine length (m) -> tip (x, z) in mm at each of PRESSURES, converged by collocation and by shooting."""


def combined_modulus(spine: Array) -> Array:
    """E (Pa) of the part with spine: mixed by volume, the spine's own linear between 5 and 30 cm."""
    own = (0.318 + (4.389 - 0.318) * (spine - 0.05) / 0.25) * 1e6
    return np.where(spine > 0, (AREA * BODY + SPINE_AREA * own) / (AREA + SPINE_AREA), BODY)


def robots(
    n: int,
    pressure: ArrayLike,
    spine: ArrayLike,
    *,
    body: ArrayLike = 1.0,
    stiffer_spine: ArrayLike = 1.0,
    roll: ArrayLike = 0.0,
    tip_weight: ArrayLike = 1.0,
    weight: ArrayLike = 1.0,
    side: ArrayLike = 0.0,
    form: Form | None = None,
) -> Rods:
    """n robots with chambers at -40, 0, 40 degrees pressurised; factors on moduli and weights, side forces (n, 3) N."""
    pressure, spine, roll = (np.broadcast_to(np.asarray(x, float), n) for x in (pressure, spine, roll))
    azimuth = np.deg2rad([-40.0, 0.0, 40.0]) + roll[:, None]
    push = pressure[:, None] * CHAMBER * np.ones(3)
    force, moment = np.zeros((n, 3)), np.zeros((n, 3))
    force[:, 2] = push.sum(1)
    moment[:, 0], moment[:, 1] = PATH * (np.sin(azimuth) * push).sum(1), -PATH * (np.cos(azimuth) * push).sum(1)
    modulus = np.stack([combined_modulus(spine) * stiffer_spine, BODY * np.ones(n) * body], 1)[:, :, None]
    dead, load = np.zeros((n, 3)), np.zeros((n, 2, 3))
    dead[:, 2] = TIP_WEIGHT * np.ones(n) * tip_weight
    load[:, :, 2] = (WEIGHT * np.ones(n) * weight)[:, None]
    return rods(
        form or Form(elements=2),
        n,
        length=np.stack([spine, LENGTH - spine], 1),
        bend_stiffness=modulus * np.array([SECOND, SECOND, 2 * SECOND]),
        stretch_stiffness=modulus * np.array([AREA / 3, AREA / 3, AREA]),
        tip_force=force,
        tip_moment=moment,
        dead_force=dead + side,
        load=load,
    )


def reference_robots() -> tuple[Rods, Array]:
    """The rods of REFERENCE and their tips (20, 3) in m."""
    found = robots(20, np.tile(PRESSURES, 4), np.repeat(list(REFERENCE), 5))
    tips = np.array([(x, 0.0, z) for row in REFERENCE.values() for x, z in row]) * 1e-3
    return found, tips


def wild_robots(n: int, seed: int) -> Rods:
    """Random robots far beyond the paper's: E +-30 %, to 450 kPa, any spine length, tip forces to 5 N sideways."""
    r = np.random.default_rng(seed)
    angle, size = r.uniform(0, 2 * np.pi, n), r.uniform(0, 5, n)
    side = np.stack([size * np.cos(angle), size * np.sin(angle), np.zeros(n)], 1)
    return robots(
        n,
        r.uniform(0, 450e3, n),
        r.uniform(0, 0.395, n) * (r.random(n) < 0.85),
        body=r.uniform(0.7, 1.3, n),
        stiffer_spine=r.uniform(0.7, 1.3, n),
        roll=r.uniform(0, 2 * np.pi, n),
        tip_weight=r.uniform(0, 3, n),
        weight=r.uniform(0.8, 1.2, n),
        side=side,
    )


def solved(robot: Robot, states: States, arc_lengths: ArrayLike | None = None, method: Method = FINE) -> Solution:
    """The states of a robot, finely unless told otherwise."""
    return solve(rods_of(robot, states), method, arc_lengths=arc_lengths)
