"""What the instruments read of solved rods, and the force of stiffness trials."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.effects import layout as at
from model.effects.design import Design
from model.effects.quantities import Quantities
from model.effects.spine import ShearSpine, moduli
from model.rotation import from_vector, multiply, to_base
from model.section import annulus_second_moment, body_area, body_second_moment

Array = NDArray[np.float64]


@dataclass
class Readings:
    """Arrays (v, n, ...) in the base frame; laws replace them, never change them in place."""

    design: Design
    tip: Array
    """(v, n, 3) m."""
    orientation: Array
    """(v, n, 4) quaternion."""
    markers: Array
    """(v, n, k, 3) m."""
    force: Array
    """(v, n) N, stiffness rows; 0 elsewhere."""

    def turn(self, vector: Array) -> None:
        """Turn the frame that is read by a rotation vector (v, n or 1, 3) in rad: all positions and orientations."""
        q = from_vector(vector)
        self.tip = to_base(q, self.tip)
        self.orientation = multiply(
            np.broadcast_to(q, np.broadcast_shapes(q.shape, self.orientation.shape)), self.orientation
        )
        if self.markers.shape[2]:
            self.markers = to_base(q[..., None, :], self.markers)


def readings(q: Quantities, shear: ShearSpine, solved: Array) -> Readings:
    """Readings of perfect instruments from results (v, n, columns) of the solver."""
    v, n, wide = solved.shape
    markers = solved[..., at.MARKERS :].reshape(v, n, (wide - at.MARKERS) // 3, 3)
    force = np.zeros((v, n))
    if q.design.stiffness.any():
        force[...] = cantilever_force(q, shear)
    return Readings(
        q.design, solved[..., :3].copy(), solved[..., at.ORIENTATION : at.ORIENTATION + 4].copy(), markers.copy(), force
    )


def cantilever_force(q: Quantities, shear: ShearSpine) -> Array:
    """Force (v, n) N at the tip for the deflection that was read, eq. 8 and 9; 0 where the row is no stiffness row.

    The bare spine has its apparent modulus; the body's compliance is integrated over the part with spine and the rest.
    """
    robot, design = q.robot, q.design
    long, inner = q.length, np.clip(q.spine_length, 0.0, q.length)
    area, second = body_area(robot), body_second_moment(robot)
    plain = q.body_modulus * second
    stiff, compliance = plain, np.full((1, 1), np.inf)
    if robot.spine is not None:
        within, _, bare = moduli(q, shear)
        core, core_second = np.pi * robot.spine.radius**2, annulus_second_moment(robot.spine.radius)
        mixed = (area * q.body_modulus + core * within) / (area + core) * second
        stiff = mixed + q.area_moments * (plain + within * core_second - mixed)
        compliance = np.maximum(q.spine_length, 1e-3) ** 3 / (3 * np.maximum(bare, 1.0) * core_second)
    rest = (long - inner) ** 3
    of_body = (long**3 - rest) / (3 * stiff) + rest / (3 * plain) + q.clamp_root * long**2
    given = np.where(design.body, of_body, compliance) + q.arm_compliance
    reached = design.deflection - q.contact_offset
    pressed = np.maximum(reached, np.minimum(design.deflection, 0.0))
    return np.where(design.stiffness, pressed / given, 0.0)
