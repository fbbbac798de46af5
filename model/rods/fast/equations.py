"""The static Cosserat rod, written from the tip to the base in the frame of the cross-section.

Unknown functions of the distance t = L - s from the tip (s is the arc length from the base):
    q   orientation of the section in the mount frame (quaternion),
    m   internal moment in the section frame, N m,
    r   vector from here to the tip in the section frame, m,
and the internal force N in the mount frame, which needs no integration: it is the force at the tip plus the load
passed on the way.

Equilibrium and kinematics (eq. 1 and 2 of the paper: p' = R v, R' = R u^, n' = -f, m' = -p' x n) become
    n = R(q)^T N
    v = n / K_se + v*,   u = m / K_bt + u*
    dq/dt = -q (0, u) / 2
    dm/dt = u x m + v x n
    dr/dt = u x r + v

A hyperelastic section has the stored energy, per length, of elastic bending curvatures k1, k2 and axial strain e
    W = Q (1 + G(a Q / B) B / (a Q) + h(b e)) / 2 + EA K(e),   Q = EIxx k1^2 + EIyy k2^2,  B^2 = EIxx EIyy
(for EIxx = EIyy simply Q / B = curvature squared), so that its moment and axial force are
    m_i = EI_i k_i D,   D = 1 + g(a Q / B) + h(b e),   n3 = EA k(e) + b Q h'(b e) / 2
where g(x) = x, h(x) = x and k(e) = e + c e^2, G and K their integrals. A section that softens has g(x) = x / (1 - 2 x),
h(x) = x / (1 - x) and k(e) = e / (1 - c e) below 0, so that it never carries less the more it is bent or stretched; for
neo-Hookean silicone (b = -2, c = -1, R. S. Rivlin, Phil. Trans. R. Soc. A 240 (1948)) h is then right to second order
in the strain, and k to second.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from model.rods.fast.algebra import (
    Quaternion,
    State,
    Vector,
    add,
    along,
    cross,
    dot,
    plus_cross,
    scaled,
    times,
    turned_back,
)
from model.rods.fast.jit import inline
from model.rods.fast.lanes import INV_BEND, INV_STRETCH, RISES, TERMS, U_REST, V_REST, Full, terms_in, vector_of
from model.rods.fast.stage_buffer import save_softness, save_stage

Array = NDArray[np.float64]


class Section(NamedTuple):
    """The section of one lane within an element, and where the terms are that not all rods have."""

    inv_bend: Vector
    """1 / K_bt, 1 / (N m^2)."""
    inv_stretch: Vector
    """1 / K_se, 1 / N."""
    u_rest: Vector
    """u*, 1/m."""
    v_rest: Vector
    """v*, 1."""
    terms: Array | None
    """Holds the hyperelastic and graded terms of the element; None costs nothing."""
    at: int
    """The element's first quantity there."""


@inline
def section_of(elements: Array, full: Full, at: int, l: int) -> Section:
    """The section of lane l in the element that begins at quantity `at`."""
    return Section(
        vector_of(elements, at + INV_BEND, l),
        vector_of(elements, at + INV_STRETCH, l),
        vector_of(elements, at + U_REST, l),
        vector_of(elements, at + V_REST, l),
        terms_in(full, elements),
        at,
    )


Soft = tuple[float, float]
"""D and e of a hyperelastic section."""


@inline
def slope(
    y: State, force: Vector, section: Section, z: float, l: int, stages: Array | None, i: int, near: Soft | None
) -> tuple[State, Soft]:
    """dy/dt of the state (q, m, r) under the internal force N (mount frame), at the share z of an element of lane l, and how soft
    the section is there; `near` is how soft it was at a stage close by.

    Where `stages` is given, what goes on here is saved as its stage i.
    """
    q = (y[0], y[1], y[2], y[3])
    m = (y[4], y[5], y[6])
    r = (y[7], y[8], y[9])
    n = turned_back(q, force)
    u, v, soft = strains(m, n, section, z, l, stages, i, near)
    if stages is not None:
        save_stage(stages, i, l, q, (m, n), (u, v))
    dq = turning(q, u)
    dm = plus_cross(cross(u, m), v, n)
    dr = plus_cross(v, u, r)
    return (dq[0], dq[1], dq[2], dq[3], dm[0], dm[1], dm[2], dr[0], dr[1], dr[2]), soft


@inline
def turning(q: Quaternion, u: Vector) -> Quaternion:
    """dq/dt of a section that turns with curvature u (section frame) while walking towards the base."""
    w, r, half = q[0], (q[1], q[2], q[3]), scaled(-0.5, u)
    x, y, z = plus_cross(scaled(w, half), r, half)
    return (-dot(r, half), x, y, z)


@inline
def strains(
    m: Vector, n: Vector, section: Section, z: float, l: int, stages: Array | None, i: int, near: Soft | None
) -> tuple[Vector, Vector, Soft]:
    """u and v of a section that carries m and n (section frame), and how soft it is."""
    u, v, soft = elastic_strains(section.terms, section, m, n, l, stages, i, near)
    return add(u, rest_curvature(section.terms, section, z, l)), add(v, section.v_rest), soft


@inline
def elastic_strains(
    terms: Array | None,
    section: Section,
    m: Vector,
    n: Vector,
    l: int,
    stages: Array | None,
    i: int,
    near: Soft | None,
) -> tuple[Vector, Vector, Soft]:
    """u - u* and v - v*. (`terms` is an argument of its own so that the compiler sees a None.)"""
    u, v = times(section.inv_bend, m), times(section.inv_stretch, n)
    soft = (1.0, v[2])
    if terms is not None:
        soft = softened(u, m, v[2], section, vector_of(terms, section.at + TERMS, l), near)
        d, strain = soft
        if stages is not None:
            save_softness(stages, i, l, m, n, (d, strain), (section.inv_bend, section.inv_stretch),
                          vector_of(terms, section.at + TERMS, l))  # fmt: skip
        u = (u[0] / d, u[1] / d, u[2])
        v = (v[0], v[1], strain)
    return u, v, soft


@inline
def rest_curvature(terms: Array | None, section: Section, z: float, l: int) -> Vector:
    """u*(z) = u* + z rise1 + z^2 rise2 + z^3 rise3, z = 0 at the element's base end .. 1 at its tip end."""
    rest = section.u_rest
    if terms is not None:
        rest = along(rest, z, vector_of(terms, section.at + RISES, l))
        rest = along(rest, z * z, vector_of(terms, section.at + RISES + 3, l))
        rest = along(rest, z * z * z, vector_of(terms, section.at + RISES + 6, l))
    return rest


@inline
def softened(u: Vector, m: Vector, strain: float, section: Section, law: Vector, near: Soft | None) -> Soft:
    """D and e of a hyperelastic section from its linear curvatures u and axial strain. `near` is what they are at a stage close
    by: three rounds from there come as near as five from an unstrained section."""
    inv_bend, inv_stretch = section.inv_bend, section.inv_stretch
    a, b, c = law
    energy = m[0] * u[0] + m[1] * u[1]
    bending = a * energy * math.sqrt(inv_bend[0] * inv_bend[1])
    coupled = 0.5 * energy * inv_stretch[2]
    bent = Bent(bending, coupled, strain, b, c)
    return rounds_from(near, bent)


@inline
def rounds_from(near: Soft | None, bent: Bent) -> Soft:
    """Rounds from a stage close by, or from an unstrained section; written out, since loops within keep the compiler from making
    vectors of the lanes."""
    if near is not None:
        return series_round(bent, series_round(bent, series_round(bent, near)))
    y = series_round(bent, (1.0, bent.strain))
    y = series_round(bent, y)
    y = series_round(bent, y)
    y = series_round(bent, y)
    return series_round(bent, y)


class Bent(NamedTuple):
    """What `softened` solves for: a Q / B and Q / (2 EA) for D = 1, n3 / EA, and b, c."""

    bending: float
    coupled: float
    strain: float
    b: float
    c: float


@inline
def series_round(s: Bent, y: tuple[float, float]) -> tuple[float, float]:
    """A Newton round on D - 1 - g(a Q / B) - h(b e) = 0 and k(e) + b h'(b e) Q / (2 EA) - n3 / EA = 0, Q = (m . u) / D^2."""
    d, e = y
    be, ce = s.b * e, s.c * e
    inverse = 1.0 / d
    w = inverse * inverse
    x, coupled = s.bending * w, s.b * s.coupled * w
    level = 1.0 / (1.0 - 2.0 * min(x, 0.0))
    loss, relief = 1.0 / (1.0 - min(be, 0.0)), 1.0 / (1.0 - min(ce, 0.0))
    rise = loss * loss
    curl = 2.0 * rise * (loss if be < 0.0 else 0.0)
    further = max(ce, 0.0)
    first = d - 1.0 - x * level - be * loss
    second = e * (relief + further) + rise * coupled - s.strain
    first_d, first_e = 1.0 + 2.0 * x * level * level * inverse, -s.b * rise
    second_d = -2.0 * rise * coupled * inverse
    second_e = relief * relief + 2.0 * further + s.b * curl * coupled
    scale = 1.0 / (first_d * second_e - first_e * second_d)
    return d - scale * (second_e * first - first_e * second), e - scale * (first_d * second - second_d * first)
