"""The robot of the reference values, as arrays of rods: bends in the x-z plane, hangs along z."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from benchmarks.rod_cases import AREA, BODY, CHAMBER, GRAVITY, SPINE_AREA, rods_like_it
from model.condition import States
from model.robot import Robot
from model.rods import FINE, Form, Method, Rods, Solution, solve
from model.section import rods_of

Bending = Callable[..., States]
"""The fixture `bending`."""
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


def robots(n: int, pressure: ArrayLike, spine: ArrayLike, roll: ArrayLike = 0.0, form: Form | None = None) -> Rods:
    """n robots with chambers at -40, 0, 40 degrees pressurised."""
    pressure, spine, roll, one = (np.broadcast_to(np.asarray(x, float), n) for x in (pressure, spine, roll, 1.0))
    own = (0.318 + (4.389 - 0.318) * (spine - 0.05) / 0.25) * 1e6
    mixed = np.where(spine > 0, (AREA * BODY + SPINE_AREA * own) / (AREA + SPINE_AREA), BODY)
    dead = (0 * one, 0 * one, 0.053 * GRAVITY * one)
    return rods_like_it(spine, (mixed, BODY * one), pressure * CHAMBER, roll, dead, 1300.0 * AREA * GRAVITY * one, form)


def solved(robot: Robot, states: States, arc_lengths: ArrayLike | None = None, method: Method = FINE) -> Solution:
    """The states of a robot, finely unless told otherwise."""
    return solve(rods_of(robot, states), method, arc_lengths=arc_lengths)
