"""What a piece of the robot answers to a strain: silicone fibres, spine, friction between them, a little viscosity.

Generalised strain of a segment, in its own frame: (shear x, shear y, stretch - 1, curvature x, curvature y, twist).
Generalised stress: (force x, y, z in N, moment x, y, z in N m). A fibre at (x, y) is stretched by
`e = stretch - 1 + curvature_x * y - curvature_y * x`; its stress (first Piola-Kirchhoff) follows a uniaxial law and
adds `(1, y, -x) * weight` to axial force and bending moments.

Silicone     sigma(e) = E [(1 - h) e + h/3 (a - a^-2) (1 + c1 I + c2 I^2)],  a = 1 + e,  I = a^2 + 2/a - 3
             (Yeoh; h = 0: linear)
Creep        strain = elastic + sum_k creep_k,   tau_k d(creep_k)/dt = a_k * elastic - creep_k
             (two Kelvin elements)
Spine        linear, about its own rest strain
Friction     sliders: moment K_j (u - x_j), |u - x_j| <= yield curvature of level j; the same for the axial strain
Tendons      a fibre at the tendon's place that carries its tension, whatever the strain
Viscosity    stress += c * K_linear * (strain - strain before), c = 1 / (exp(dt / settling time) - 1)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .kernels import kernel

Array = NDArray[np.float64]

YEOH = (-0.8, 3.0)
"""c1, c2 of the silicone's law at effect size 1."""
CREEP_TIMES = (4.0, 30.0)
CREEP_SHARES = (0.4, 0.6)
"""Relaxation times (s) of the two Kelvin elements and how they share the effect's size."""
SLIP_CURVATURES = (0.03, 0.12, 0.35, 0.9)
SLIP_SHARES = (0.3, 0.3, 0.25, 0.15)
"""Yield curvatures (1/m) of the friction levels and their share of the friction moment."""
SLIP_STRAINS = (5e-4, 3e-3)
"""Yield strains of the axial friction levels; they share the friction force equally."""


class Sections(NamedTuple):
    """Material of all segments (first axis) during one step."""

    silicone: Array
    """(n) Modulus of the silicone times its share of the annulus, Pa."""
    annulus: Array
    """(n, 4) Area, shear area * shear ratio (m^2), second moment, torsion constant (m^4)."""
    fibres: Array
    """(f, 3) x, y (m) and weight (m^2) of the silicone fibres at the base."""
    scale: Array
    """(n) Radii over those at the base."""
    tendons: Array
    """(n, 6) Stress that tendons bring in."""
    law: Array
    """(3) Yeoh share h, c1, c2."""
    rest: Array
    """(n, 6) Strain without load."""
    spine: Array
    """(n, 9) Stiffness of the spine: shear, shear, then the symmetric axial-bending block 00 01 02 11 12 22,
    torsion."""
    spine_rest: Array
    """(n, 6) Strain at which the spine is free of stress."""
    slips: bool
    """False: the sliders need not be looked at."""
    slip_moment: Array
    """(n, 4) Friction moment of each level, N m."""
    slip_force: Array
    """(n, 2) Friction force of each level, N."""
    creep: Array
    """(2, 2) exp(-dt / tau_k) and amplitude a_k."""
    viscosity: float
    """c of the equation above."""


class History(NamedTuple):
    """What the segments remember between steps."""

    strain: Array
    creep: Array
    slider: Array
    axial_slider: Array


def annulus_fibres(outer: float, inner: float, rings: int = 3, sectors: int = 16) -> Array:
    """Fibres (x, y, weight) of an annulus: Gauss points in radius squared, equal sectors; area and second moments are
    exact."""
    node, weight = np.polynomial.legendre.leggauss(rings)
    squared = inner**2 + (outer**2 - inner**2) * (node + 1) / 2
    angle = 2 * np.pi * (np.arange(sectors) + 0.5) / sectors
    radius, around = np.meshgrid(np.sqrt(squared), angle, indexing="ij")
    share = np.repeat(weight[:, None] / 2, sectors, axis=1) / sectors
    area = np.pi * (outer**2 - inner**2)
    columns = (radius * np.cos(around), radius * np.sin(around), share * area)
    return np.ascontiguousarray(np.stack([c.ravel() for c in columns], axis=1))


def fresh_history(segments: int) -> History:
    """Memory of a body that has never been loaded."""
    return History(
        np.zeros((segments, 6)),
        np.zeros((segments, 2, 6)),
        np.zeros((segments, len(SLIP_CURVATURES), 2)),
        np.zeros((segments, len(SLIP_STRAINS))),
    )


@kernel
def yeoh(e: float, modulus: float, h: float, c1: float, c2: float) -> tuple[float, float]:
    """Stress and tangent of one fibre; squeezed below 40 % it goes on straight."""
    a = max(1.0 + e, 0.4)
    b = 1.0 / (a * a)
    i = a * a + 2.0 / a - 3.0
    neo = (a - b) / 3.0
    g = 1.0 + c1 * i + c2 * i * i
    tangent = (1.0 + 2.0 * b / a) / 3.0 * g + 2.0 * neo * (c1 + 2.0 * c2 * i) * (a - b)
    stress = neo * g + tangent * (1.0 + e - a)
    return modulus * ((1.0 - h) * e + h * stress), modulus * (1.0 - h + h * tangent)


@kernel
def _silicone(s: Sections, k: int, e: Array, stress: Array, t: Array) -> None:
    """Stress and tangent of the silicone at elastic strain `e`."""
    m = s.silicone[k]
    t[0] = t[1] = m * s.annulus[k, 1]
    t[8] = m * s.annulus[k, 3]
    stress[0] = t[0] * e[0]
    stress[1] = t[1] * e[1]
    stress[5] = t[8] * e[5]
    for i in range(2, 8):
        t[i] = 0.0
    if s.law[0] == 0.0:
        t[2] = m * s.annulus[k, 0]
        t[5] = t[7] = m * s.annulus[k, 2]
        stress[2] = t[2] * e[2]
        stress[3] = t[5] * e[3]
        stress[4] = t[7] * e[4]
        return
    stress[2] = stress[3] = stress[4] = 0.0
    for f in range(s.fibres.shape[0]):
        x = s.fibres[f, 0] * s.scale[k]
        y = s.fibres[f, 1] * s.scale[k]
        sigma, slope = yeoh(e[2] + e[3] * y - e[4] * x, m, s.law[0], s.law[1], s.law[2])
        sigma *= s.fibres[f, 2] * s.scale[k] ** 2
        slope *= s.fibres[f, 2] * s.scale[k] ** 2
        stress[2] += sigma
        stress[3] += sigma * y
        stress[4] -= sigma * x
        t[2] += slope
        t[3] += slope * y
        t[4] -= slope * x
        t[5] += slope * y * y
        t[6] -= slope * x * y
        t[7] += slope * x * x


@kernel
def _friction(s: Sections, hist: History, k: int, strain: Array, stress: Array, t: Array, commit: bool) -> None:
    """Add the sliders' stress and consistent tangent; with `commit` their positions are kept.

    Without friction force (spine not jammed, or none here) a slider follows the strain.
    """
    for j in range(len(SLIP_CURVATURES)):
        moment = s.slip_moment[k, j]
        limit = SLIP_CURVATURES[j]
        if moment > 0.0:
            stiff = moment / limit
            ex = strain[3] - hist.slider[k, j, 0]
            ey = strain[4] - hist.slider[k, j, 1]
            size = np.sqrt(ex * ex + ey * ey)
            if size <= limit:
                t[5] += stiff
                t[7] += stiff
            else:
                ratio = limit / size
                ux = ex / size
                uy = ey / size
                ex *= ratio
                ey *= ratio
                t[5] += stiff * ratio * uy * uy
                t[6] -= stiff * ratio * ux * uy
                t[7] += stiff * ratio * ux * ux
            stress[3] += stiff * ex
            stress[4] += stiff * ey
            if commit:
                hist.slider[k, j, 0] = strain[3] - ex
                hist.slider[k, j, 1] = strain[4] - ey
        elif commit:
            hist.slider[k, j, 0] = strain[3]
            hist.slider[k, j, 1] = strain[4]
    for j in range(len(SLIP_STRAINS)):
        force = s.slip_force[k, j]
        if force > 0.0:
            limit = SLIP_STRAINS[j]
            e = strain[2] - hist.axial_slider[k, j]
            if abs(e) <= limit:
                t[2] += force / limit
            else:
                e = limit if e > 0.0 else -limit
            stress[2] += force / limit * e
            if commit:
                hist.axial_slider[k, j] = strain[2] - e
        elif commit:
            hist.axial_slider[k, j] = strain[2]


@kernel
def respond(
    s: Sections, hist: History, k: int, strain: Array, stress: Array, t: Array, elastic: Array, commit: bool
) -> None:
    """Stress (6) and tangent (9, laid out as `Sections.spine`) of segment k; `elastic` is scratch space.

    With `commit` the history moves on to this strain: call it once, after equilibrium is found.
    """
    give = 1.0
    for c in range(2):
        give += (1.0 - s.creep[c, 0]) * s.creep[c, 1]
    for i in range(6):
        e = strain[i] - s.rest[k, i]
        for c in range(2):
            e -= s.creep[c, 0] * hist.creep[k, c, i]
        elastic[i] = e / give
    _silicone(s, k, elastic, stress, t)
    for i in range(9):
        t[i] = t[i] / give + s.spine[k, i]
    if commit:
        for c in range(2):
            for i in range(6):
                grown = (1.0 - s.creep[c, 0]) * s.creep[c, 1] * elastic[i]
                hist.creep[k, c, i] = s.creep[c, 0] * hist.creep[k, c, i] + grown

    g = s.spine[k]
    for i in range(6):
        elastic[i] = strain[i] - s.spine_rest[k, i]
    add_linear(g, elastic, 1.0, stress)
    if s.viscosity > 0.0:
        # the linear stiffness of silicone and spine, also under a curved law: this is only a brake
        brake = s.viscosity
        m = s.silicone[k]
        for i in range(6):
            elastic[i] = strain[i] - hist.strain[k, i]
        add_linear(g, elastic, brake, stress)
        for i in range(9):
            t[i] += brake * g[i]
        drag = (
            m * s.annulus[k, 1],
            m * s.annulus[k, 1],
            m * s.annulus[k, 0],
            m * s.annulus[k, 2],
            m * s.annulus[k, 2],
            m * s.annulus[k, 3],
        )
        for i in range(6):
            stress[i] += brake * drag[i] * elastic[i]
        t[0] += brake * drag[0]
        t[1] += brake * drag[1]
        t[2] += brake * drag[2]
        t[5] += brake * drag[3]
        t[7] += brake * drag[4]
        t[8] += brake * drag[5]
    if s.slips:
        _friction(s, hist, k, strain, stress, t, commit)
    for i in range(6):
        stress[i] += s.tendons[k, i]
    if commit:
        for i in range(6):
            hist.strain[k, i] = strain[i]


@kernel
def add_linear(g: Array, e: Array, factor: float, stress: Array) -> None:
    """stress += factor * stiffness(g) * e."""
    stress[0] += factor * g[0] * e[0]
    stress[1] += factor * g[1] * e[1]
    stress[2] += factor * (g[2] * e[2] + g[3] * e[3] + g[4] * e[4])
    stress[3] += factor * (g[3] * e[2] + g[5] * e[3] + g[6] * e[4])
    stress[4] += factor * (g[4] * e[2] + g[6] * e[3] + g[7] * e[4])
    stress[5] += factor * g[8] * e[5]
