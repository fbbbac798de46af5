"""From the robot and its conditions to the rod: areas, stiffness, actuation.

Equation numbers are those of the paper. Choices where it leaves room (see docs/explanations/model.md): area and second moments
are those of the annulus, chambers not subtracted, with and without spine; the weight is the body's alone; the shear
modulus of the part with spine keeps the ratio to Young's modulus that the body has.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from model.condition import Condition
from model.robot import Robot

if TYPE_CHECKING:
    from model.rods import Rods

Array = NDArray[np.float64]

INNER, OUTER = 0, 1
"""Elements of a robot's rod: from the base to the spine's end, and from there to the tip."""


def body_area(robot: Robot) -> float:
    """Cross-section of the silicone annulus, m^2."""
    return math.pi * (robot.outer_radius**2 - robot.inner_radius**2)


def body_second_moment(robot: Robot) -> float:
    """Ixx = Iyy of the annulus, m^4."""
    return annulus_second_moment(robot.outer_radius, robot.inner_radius)


def annulus_second_moment(outer_radius: float, inner_radius: float = 0.0) -> float:
    """I = pi (ro^4 - ri^4) / 4 about a diameter (m^4), radii in m; a solid round bar with inner_radius 0."""
    return math.pi / 4 * (outer_radius**4 - inner_radius**4)


def combined_modulus(robot: Robot, spine_length: ArrayLike) -> Array:
    """E_eq (Pa) of the part that holds the spine, eq. 10, at spine length (m).

    Volumes are taken over that part: V_c the annulus, V_s the spine, V_total their sum. At length 0 it is the
    body's own.
    """
    length = np.asarray(spine_length, float)
    if robot.spine is None:
        return np.full(length.shape, robot.youngs_modulus)
    body, spine = body_area(robot), math.pi * robot.spine.radius**2
    mixed = (body * robot.youngs_modulus + spine * robot.spine.modulus_at(length)) / (body + spine)
    return np.where(length > 0, mixed, robot.youngs_modulus)


def stiffness(robot: Robot, youngs_modulus: ArrayLike) -> tuple[Array, Array]:
    """Diagonals of K_se (..., 3) in N and K_bt (..., 3) in N m^2, eq. 3, for Young's modulus (Pa) of any shape."""
    e = np.asarray(youngs_modulus, float)
    g = e * (robot.shear_modulus / robot.youngs_modulus)
    area, second = body_area(robot), body_second_moment(robot)
    # Izz = Ixx + Iyy carries E, as printed in eq. 3 (most texts put G there).
    stretch = np.stack([g * area, g * area, e * area], axis=-1)
    bend = np.stack([e * second, e * second, e * 2 * second], axis=-1)
    return stretch, bend


def actuation_wrench(robot: Robot, condition: Condition) -> tuple[Array, Array]:
    """Force (n, 3) in N and moment (n, 3) in N m of the pressurised chambers in the tip frame, eq. 4.

    n_P = sum P A_eff e3, m_P = sum path_i x P A_eff e3: the robot bends away from an inflated chamber.
    """
    azimuth = np.deg2rad(robot.chambers.azimuths_deg)[None, :] + condition.roll[:, None]
    area = robot.area_factor_at(condition.spine_length) * robot.chambers.area
    push = condition.pressure * area[:, None]
    arm = robot.chambers.path_radius
    zero = np.zeros(len(condition))
    force = np.stack([zero, zero, push.sum(axis=1)], axis=1)
    moment = np.stack([arm * (np.sin(azimuth) * push).sum(1), -arm * (np.cos(azimuth) * push).sum(1), zero], axis=1)
    return force, moment


def rods_of(robot: Robot, condition: Condition) -> Rods:
    """The rods of all states, after checking that the conditions fit the robot; raises `BadCondition`."""
    from model.rods import Form, blank  # the compiler comes with it; who asks for a section alone waits for neither

    condition.check(robot)
    n = len(condition)
    modulus = np.empty((n, 2))
    modulus[:, INNER] = combined_modulus(robot, condition.spine_length)
    modulus[:, OUTER] = robot.youngs_modulus
    gravity = np.array(robot.gravity)
    made = blank(Form(elements=2), n)
    inner = np.minimum(condition.spine_length, robot.length)
    made.field("length")[:] = np.stack([inner, robot.length - inner], axis=1)
    made.field("stretch_stiffness")[:], made.field("bend_stiffness")[:] = stiffness(robot, modulus)
    made.field("tip_force")[:], made.field("tip_moment")[:] = actuation_wrench(robot, condition)
    made.field("dead_force")[:] = condition.tip_mass[:, None] * gravity + condition.force
    made.field("load")[:] = robot.density * body_area(robot) * gravity
    return made.check()
