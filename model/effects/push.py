"""The force of stiffness trials: a cantilever that is pushed at its end.

The bare spine is weightless and has its apparent modulus (eq. 9 of the paper). The body bends and shears like the rod
model's, with spine or without, and its own weight holds it: hanging, it looks about 20 % stiffer than eq. 8 says. The
weight's share is Rayleigh's, with the shape that the push alone gives: 1/c + integral N (w'/w(L))^2 ds, N the pull along
the axis.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from model.effects.quantities import Quantities
from model.effects.spine import ShearSpine, moduli
from model.rods.beam import bending_compliance, shear_compliance
from model.section import annulus_second_moment, body_area, body_second_moment

Array = NDArray[np.float64]

POINTS, WEIGHTS = (0.5 * (a + b) for a, b in zip(np.polynomial.legendre.leggauss(5), (1.0, 0.0), strict=True))
"""Of a quadrature over 0..1, exact for the shapes of both parts."""


NOTHING = 1e9
"""m/N of a specimen that is not there."""


def cantilever_force(q: Quantities, shear: ShearSpine) -> Array:
    """Force (v, n) N at the end for the deflection that was read; 0 where the row is no stiffness row."""
    design = q.design
    bare = np.full((1, 1), NOTHING)
    if q.robot.spine is not None:
        second = annulus_second_moment(q.robot.spine.radius)
        bare = np.maximum(q.spine_length, 1e-3) ** 3 / (3 * np.maximum(moduli(q, shear)[2], 1.0) * second)
    given = np.where(design.body, _body_compliance(q, shear), bare) if design.body.any() else bare
    given = given + q.arm_compliance
    reached = design.deflection - q.contact_offset
    pressed = np.maximum(reached, np.minimum(design.deflection, 0.0)) / given
    # Softer than what comes behind it, the layer counts until it is squeezed flat.
    squeezed = np.maximum(design.deflection, 0.0) * q.contact_layer / (1 + q.contact_layer * given)
    return np.where(design.stiffness, np.maximum(pressed, squeezed), 0.0)


def _body_compliance(q: Quantities, shear: ShearSpine) -> Array:
    """(v, n) m/N of the body, its root's give included."""
    robot = q.robot
    long, inner = q.length, np.clip(q.spine_length, 0.0, q.length)
    area, second = body_area(robot), body_second_moment(robot)
    ratio = robot.shear_modulus / robot.youngs_modulus
    plain, plain_side = q.body_modulus * second, ratio * q.body_modulus * area
    stiff, side = plain, plain_side
    if robot.spine is not None:
        within, across, _ = moduli(q, shear)
        core, core_second = math.pi * robot.spine.radius**2, annulus_second_moment(robot.spine.radius)
        share = area / (area + core)
        mixed = (share * q.body_modulus + (1 - share) * within) * second
        mixed_side = (share * ratio * q.body_modulus + (1 - share) * across) * area
        stiff = mixed + q.area_moments * (plain + within * core_second - mixed)
        side = mixed_side + q.area_moments * (plain_side + across * core - mixed_side)
    edges = (0.0, inner, long)
    bending = bending_compliance(edges, (stiff, plain))
    held = _pull(q, inner, stiff, plain) / bending**2
    sheared = shear_compliance(edges, (side, plain_side))
    out: Array = 1 / (1 / (bending + sheared + q.clamp_root * long**2) + held)
    return out


def _pull(q: Quantities, inner: Array, stiff: Array, plain: Array) -> Array:
    """(v, n) integral of N slope^2 ds for the slope that 1 N at the end gives; N grows from the tip's mass to the base."""
    down, long = q.robot.gravity[2], q.length
    line = q.density * body_area(q.robot) * down
    at_joint = (long * inner - inner**2 / 2) / stiff
    total: Array = np.zeros((1, 1))
    for x, weight in zip(POINTS, WEIGHTS, strict=True):
        low, high = x * inner, inner + x * (long - inner)
        slope_low = (long * low - low**2 / 2) / stiff
        slope_high = at_joint + (long * (high - inner) - (high**2 - inner**2) / 2) / plain
        pull_low, pull_high = (line * (long - s) + q.design.tip_mass * down for s in (low, high))
        total = total + weight * (inner * pull_low * slope_low**2 + (long - inner) * pull_high * slope_high**2)
    return total
