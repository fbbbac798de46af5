"""From the robot and its conditions to the rod: areas, stiffness, actuation.

Equation numbers are those of the paper. Choices where it leaves room (see docs/explanations/model.md): area and second moments
are those of the annulus unless robot.yaml gives the stiffness, chambers not subtracted, with and without spine; the weight is the
body's alone; the shear modulus of the part with spine keeps the ratio to Young's modulus that the body has.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from model.body import annulus_second_moment, body_of
from model.condition import States
from model.robot import Robot

if TYPE_CHECKING:
    from model.rods import Rods

Array = NDArray[np.float64]

__all__ = [
    "actuation_wrench", "annulus_second_moment", "body_area", "body_mass", "body_second_moment", "combined_modulus", "rods_of",
    "stiffness",
]  # fmt: skip

INNER, OUTER = 0, 1
"""Elements of a uniform robot's rod: from the base to the spine's end, and from there to the tip."""


def body_area(robot: Robot) -> float:
    """EA / E of the body, m^2: of the annulus as drawn; of sections, that of a uniform body which a pull stretches as much."""
    return body_of(robot).mean_area


def body_second_moment(robot: Robot) -> float:
    """EI / E of the body, m^4: of the annulus as drawn; of sections, that of a uniform body which a moment turns as much."""
    return body_of(robot).mean_second


def body_mass(robot: Robot) -> float:
    """Mass of the body, kg: no spine, no tip."""
    return robot.density * body_of(robot).mean_weight_area * robot.length


def combined_modulus(robot: Robot, spine_length: ArrayLike) -> Array:
    """E_eq (Pa) of the part that holds the spine, eq. 10, at spine length (m).

    Volumes are taken over that part: V_c the annulus, V_s the spine, V_total their sum. At length 0 it is the
    body's own.
    """
    return _combined(robot, np.asarray(spine_length, float), body_area(robot))


def _combined(robot: Robot, length: Array, body: float) -> Array:
    if robot.spine is None:
        return np.full(length.shape, robot.youngs_modulus)
    spine = math.pi * robot.spine.radius**2
    mixed = (body * robot.youngs_modulus + spine * robot.spine.modulus_at(length)) / (body + spine)
    return np.where(length > 0, mixed, robot.youngs_modulus)


def stiffness(robot: Robot, youngs_modulus: ArrayLike, area: float, second: float, polar: float) -> tuple[Array, Array]:
    """Diagonals of K_se (..., 3) in N and K_bt (..., 3) in N m^2, eq. 3, for Young's modulus (Pa) of any shape.

    `area` (m^2), `second` and `polar` (m^4) are those of `Body`; a polar moment of Ixx + Iyy carries E, as printed in eq. 3
    (most texts put G there).
    """
    e = np.asarray(youngs_modulus, float)
    g = e * (robot.shear_modulus / robot.youngs_modulus)
    stretch = np.stack([g * area, g * area, e * area], axis=-1)
    bend = np.stack([e * second, e * second, e * polar], axis=-1)
    return stretch, bend


def actuation_wrench(robot: Robot, condition: States) -> tuple[Array, Array]:
    """Force (n, 3) in N and moment (n, 3) in N m of the pressurised chambers in the tip frame, eq. 4.

    n_P = sum P A_eff e3, m_P = sum path_i x P A_eff e3: the robot bends away from an inflated chamber.
    """
    body = body_of(robot)
    return _wrench(robot, condition, body.tip_area, float(body.path_radius[-1]))


def _wrench(robot: Robot, condition: States, area: Array, path_radius: float) -> tuple[Array, Array]:
    """Force (n, 3) N and moment (n, 3) N m of chambers of these areas (actuators,), m^2, in the section's frame."""
    azimuth = np.deg2rad(robot.actuators.azimuths_deg)[None, :] + condition.roll[:, None]
    push = condition.pressure * robot.area_factor_at(condition.spine_length)[:, None] * area
    zero = np.zeros(len(condition))
    force = np.stack([zero, zero, push.sum(axis=1)], axis=1)
    aside = np.stack([(np.sin(azimuth) * push).sum(1), -(np.cos(azimuth) * push).sum(1), zero], axis=1)
    return force, path_radius * aside


def rods_of(robot: Robot, condition: States, full: bool = False) -> Rods:
    """The rods of all states, after checking that the conditions fit the robot; raises `BadCondition`. `full`: in the form whose
    kernels a diagnosis compiles in any case.

    Each piece of the body is an element to the spine's end and one beyond it. Where chambers are wider or farther off the axis
    than at the tip, or end, the difference in force and moment from those at the tip is one of rest; so is all of tendons'.
    """
    from model.rods import Form, blank  # the compiler comes with it; who asks for a section alone waits for neither

    condition.check(robot)
    n, body, gravity = len(condition), body_of(robot), np.array(robot.gravity)
    made = blank(Form(elements=2 * len(body), full=full), n)
    length, load = made.field("length"), made.field("load")
    stretch, bend = made.field("stretch_stiffness"), made.field("bend_stiffness")
    force, moment = actuation_wrench(robot, condition)
    for k in range(len(body)):
        low, high = body.edges[k : k + 2]
        end = np.clip(condition.spine_length, low, high)
        section = (float(body.area[k]), float(body.second[k]), float(body.polar[k]))
        modulus = _combined(robot, condition.spine_length, section[0])
        own_force, own_moment = _wrench(robot, condition, body.chamber_area[k], float(body.path_radius[k]))
        for e, long, material in ((2 * k, end - low, modulus), (2 * k + 1, high - end, robot.youngs_modulus)):
            length[:, e] = long
            stretch[:, e], bend[:, e] = stiffness(robot, material, *section)
            load[:, e] = robot.density * body.weight_area[k] * gravity
            made.field("rest_strain")[:, e] += (own_force - force) / stretch[:, e]
            made.field("rest_curvature")[:, e] = (own_moment - moment) / bend[:, e]
    made.field("tip_force")[:], made.field("tip_moment")[:] = force, moment
    made.field("dead_force")[:] = condition.tip_mass[:, None] * gravity + condition.force
    return made.check()
