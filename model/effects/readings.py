"""What the instruments read of solved rods, and the force of stiffness trials."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from model.arrays import Array
from model.body import annulus_second_moment
from model.condition import States
from model.effects import layout as at
from model.effects.compose import with_spine
from model.effects.quantities import Quantities
from model.effects.spine import ShearSpine, SpineModuli, moduli
from model.rods.beam import bending_compliance, shear_compliance
from model.rotation import from_vector, multiply, to_base


@dataclass(slots=True)
class Readings:
    """Arrays (v or 1, n, ...) in the base frame; replace them, never write into them."""

    design: States
    length: float
    """m, of the robot."""
    tip: Array
    """(v, n, 3) m."""
    orientation: Array
    """(v, n, 4) quaternion."""
    markers: Array
    """(v, n, k, 3) m."""
    force: Array
    """(v, n) N, stiffness rows; 0 elsewhere."""

    def first(self, n: int) -> Readings:
        """The readings of the first n states."""
        return replace(self, **{name: getattr(self, name)[:, :n] for name in ("tip", "orientation", "markers", "force")})

    def turn(self, vector: Array) -> None:
        """Turn the frame of all readings by a rotation vector (v, n or 1, 3) rad."""
        q = from_vector(vector)
        self.tip = to_base(q, self.tip)
        self.orientation = multiply(np.broadcast_to(q, np.broadcast_shapes(q.shape, self.orientation.shape)), self.orientation)
        self.markers = to_base(q[..., None, :], self.markers)


def readings(q: Quantities, shear: ShearSpine, solved: Array) -> Readings:
    """Readings of perfect instruments from results (v, n, columns) of the solver."""
    v, n, wide = solved.shape
    markers = solved[..., at.MARKERS :].reshape(v, n, (wide - at.MARKERS) // 3, 3)
    force = np.zeros((v, n))
    if q.design.stiffness.any():
        force = force + cantilever_force(q, shear)
    tip, turn = solved[..., :3].copy(), solved[..., at.ORIENTATION : at.ORIENTATION + 4].copy()
    return Readings(q.design, q.robot.length, tip, turn, markers.copy(), force)


NO_SPECIMEN, SHORTEST, SOFTEST = 1e9, 1e-3, 1.0
"""m/N of a spine that is not there; m and Pa at least of one that is, so that none is without stiffness."""
POINTS, WEIGHTS = (0.5 * (a + b) for a, b in zip(np.polynomial.legendre.leggauss(5), (1.0, 0.0), strict=True))
"""Of a quadrature over 0..1, exact for the shapes of both parts."""


def cantilever_force(q: Quantities, shear: ShearSpine) -> Array:
    """Force (v, n) N at the end of a cantilever, of v variants of n states, for the deflections that were read; 0 for other rows
    than those of stiffness trials.

    The bare spine is weightless and has its apparent modulus (eq. 9 of the paper). The body bends and shears like the rod
    model's, with spine or without, and its own weight holds it: hanging, it looks about 20 % stiffer than eq. 8 says. The
    weight's share is Rayleigh's, with the shape that the push alone gives: 1/c + integral N (w'/w(L))^2 ds, N the pull along
    the axis.

    With the compliance c of specimen and arm, F = (d - d0) / c behind the offset d0 of the contact; a deflection below zero
    pulls, and meets no offset. A soft layer of stiffness k in between gives F = k d / (1 + k c), which is more until it is
    squeezed flat.
    """
    design, of_spine = q.design, moduli(q, shear)
    bare_spine = np.full((1, 1), NO_SPECIMEN)
    if q.robot.spine is not None:
        second = annulus_second_moment(q.robot.spine.radius)
        bare_spine = np.maximum(q.spine_length, SHORTEST) ** 3 / (3 * np.maximum(of_spine.bare, SOFTEST) * second)
    specimen = np.where(design.body, _body_compliance(q, of_spine), bare_spine) if design.body.any() else bare_spine
    compliance = specimen + q.arm_compliance
    travel = design.deflection - q.contact_offset
    contact_force = np.maximum(travel, np.minimum(design.deflection, 0.0)) / compliance
    layer_force = np.maximum(design.deflection, 0.0) * q.contact_layer / (1 + q.contact_layer * compliance)
    return np.where(design.stiffness, np.maximum(contact_force, layer_force), 0.0)


def _body_compliance(q: Quantities, of_spine: SpineModuli) -> Array:
    """(v, n) m/N of the body, its root's give included."""
    length, spine_end = q.length, np.clip(q.spine_length, 0.0, q.length)
    relative_edges = q.body.edges / q.robot.length
    ratio = q.robot.shear_modulus / q.robot.youngs_modulus
    edges: list[Array] = [np.zeros((1, 1))]
    bend_stiffness, lateral_stiffness = [], []
    # each piece of the body: the part with spine, then the part without
    for k, (area, second) in enumerate(zip(q.body.area, q.body.second, strict=True)):
        bend, _, lateral = with_spine(q, of_spine, area, second)
        edges += [np.clip(spine_end, edges[-1], relative_edges[k + 1] * length), relative_edges[k + 1] * length]
        bend_stiffness += [bend, q.body_modulus * second]
        lateral_stiffness += [lateral, ratio * q.body_modulus * area]
    bending = bending_compliance(edges, bend_stiffness)
    weight_stiffness = _weight_work(q, edges, bend_stiffness) / bending**2
    sheared = shear_compliance(edges, lateral_stiffness)
    return np.asarray(1 / (1 / (bending + sheared + q.clamp_root * length**2) + weight_stiffness))


def _weight_work(q: Quantities, edges: list[Array], bend_stiffness: list[Array]) -> Array:
    """(v, n) m/N: integral of N (dw/ds)^2 ds, w the deflection (m/N) by 1 N at the end, N (N) the weight beyond s."""
    down, length = q.robot.gravity[2], q.length
    weight_per_length = [q.density * down * area for area in np.repeat(q.body.weight_area, 2)]
    parts = list(zip(edges[:-1], edges[1:], bend_stiffness, weight_per_length, strict=True))
    pull: Array = sum((w * (b - a) for a, b, _, w in parts), np.zeros((1, 1))) + q.design.tip_mass * down
    total, slope = np.zeros((1, 1)), np.zeros((1, 1))
    for low, high, bending, weight in parts:
        for x, share in zip(POINTS, WEIGHTS, strict=True):
            s = low + x * (high - low)
            slope_at_s = slope + (length * (s - low) - (s**2 - low**2) / 2) / bending
            total = total + share * (high - low) * (pull - weight * (s - low)) * slope_at_s**2
        slope = slope + (length * (high - low) - (high**2 - low**2) / 2) / bending
        pull = pull - weight * (high - low)
    return np.asarray(total)
