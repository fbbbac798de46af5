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

import numpy as np
from numpy.typing import NDArray

from model.statics.algebra import Quaternion, State, Vector, add, along, cross, product, times, turned_back
from model.statics.jit import inline
from model.statics.lanes import vector_of
from model.statics.record import keep, keep_softness

Array = NDArray[np.float64]

Section = tuple[Vector, Vector, Vector, Vector]
"""1 / K_bt, 1 / K_se, u*, v*."""

Places = tuple[int, int]
"""Where in `series` and `rises` the terms of the element are."""

SERIES_ROUNDS = 5
"""Newton rounds on D and e; from the linear values they reach rounding where the section law has a solution nearby."""


@inline
def slope(
    y: State,
    force: Vector,
    section: Section,
    z: float,
    rises: Array | None,
    series: Array | None,
    at: Places,
    l: int,
    stages: Array | None,
    i: int,
) -> State:
    """dy/dt of the state (q, m, r) under the internal force N (mount frame), at the share z of an element of lane l.

    Where `stages` is given, what goes on here is written down as its stage i.
    """
    q = (y[0], y[1], y[2], y[3])
    m = (y[4], y[5], y[6])
    r = (y[7], y[8], y[9])
    n = turned_back(q, force)
    u, v = strains(m, n, section, z, rises, series, at, l, stages, i)
    if stages is not None:
        keep(stages, i, q, m, n, u, v, l)
    dq = turning(q, u)
    dm = add(cross(u, m), cross(v, n))
    dr = add(cross(u, r), v)
    return (dq[0], dq[1], dq[2], dq[3], dm[0], dm[1], dm[2], dr[0], dr[1], dr[2])


@inline
def turning(q: Quaternion, u: Vector) -> Quaternion:
    """dq/dt of a section that turns with curvature u (section frame) while walking towards the base."""
    return product(q, (0.0, -0.5 * u[0], -0.5 * u[1], -0.5 * u[2]))


@inline
def strains(
    m: Vector,
    n: Vector,
    section: Section,
    z: float,
    rises: Array | None,
    series: Array | None,
    at: Places,
    l: int,
    stages: Array | None,
    i: int,
) -> tuple[Vector, Vector]:
    """u and v of a section that carries m and n (section frame).

    `series` holds a, b, c of each element from at[0] on; `rises`, from at[1] on, the coefficients of z, z^2, z^3 of u*, z = 0 at
    its base end .. 1 at its tip end. None means that no rod has such terms and costs nothing.
    """
    flex, give, rest, straight = section
    u, v = times(flex, m), times(give, n)
    if series is not None:
        stiffer, strain = softened(u, m, v[2], flex, give, vector_of(series, at[0], l))
        if stages is not None:
            keep_softness(stages, i, m, n, stiffer, strain, flex, give, vector_of(series, at[0], l), l)
        u = (u[0] / stiffer, u[1] / stiffer, u[2])
        v = (v[0], v[1], strain)
    if rises is not None:
        rest = along(rest, z, vector_of(rises, at[1], l))
        rest = along(rest, z * z, vector_of(rises, at[1] + 3, l))
        rest = along(rest, z * z * z, vector_of(rises, at[1] + 6, l))
    return add(u, rest), add(v, straight)


@inline
def softened(u: Vector, m: Vector, strain: float, flex: Vector, give: Vector, series: Vector) -> tuple[float, float]:
    """D and e of a hyperelastic section from its linear curvatures u and axial strain."""
    a, b, c = series
    energy = m[0] * u[0] + m[1] * u[1]
    bending = a * energy * math.sqrt(flex[0] * flex[1])
    coupled = 0.5 * energy * give[2]
    d, e = 1.0, strain
    for _ in range(SERIES_ROUNDS):
        # Newton on D - 1 - g(a Q / B) - h(b e) = 0 and k(e) + b h'(b e) Q / (2 EA) - n3 / EA = 0, Q = (m . u) / D^2.
        w = 1.0 / (d * d)
        x = bending * w
        level = 1.0 / (1.0 - 2.0 * min(x, 0.0))
        loss, relief = 1.0 / (1.0 - min(b * e, 0.0)), 1.0 / (1.0 - min(c * e, 0.0))
        rise, curl = loss * loss, 2.0 * loss * loss * loss if b * e < 0.0 else 0.0
        first = d - 1.0 - x * level - b * e * loss
        second = e * (relief + max(c * e, 0.0)) + b * rise * coupled * w - strain
        first_d, first_e = 1.0 + 2.0 * x * level * level / d, -b * rise
        second_d = -2.0 * b * rise * coupled * w / d
        second_e = relief * relief + 2.0 * max(c * e, 0.0) + b * b * curl * coupled * w
        scale = 1.0 / (first_d * second_e - first_e * second_d)
        d -= scale * (second_e * first - first_e * second)
        e -= scale * (first_d * second - second_d * first)
    return d, e
