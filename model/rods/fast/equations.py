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
    m_i + mu_i = EI_i k_i D,   D = 1 + g(a Q / B) + h(b e),   n3 + nu = EA k(e) + b Q h'(b e) / 2
with mu and nu of the actuators within the section, given by what they would make of a linear one (mu_i / EI_i and nu / EA:
`active`, which u* and v* hold already: u_i = k_i + u*_i - mu_i / EI_i), where g(x) = x, h(x) = x and k(e) = e + c e^2, G and K
their integrals. A section that softens has g(x) = x / (1 - 2 x), h(x) = x / (1 - x) and k(e) = e / (1 - c e) below 0, so that it
never carries less the more it is bent or stretched; for neo-Hookean silicone (b = -2, c = -1, R. S. Rivlin, Phil. Trans. R. Soc.
A 240 (1948)) h is then right to second order in the strain, and k to second.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from model.rods.fast.algebra import Quaternion, Vector, add, along, cross, dot, plus_cross, scaled, times
from model.rods.fast.compiler import fused, inline
from model.rods.fast.lanes import LaneRecord, record


@record
class Terms(LaneRecord):
    """What makes a section hyperelastic or its rest curvature graded, in the order of `columns`."""

    law: Vector
    """a (m^2), b, c."""
    rise1: Vector
    rise2: Vector
    rise3: Vector
    """u*(z) = u* + z rise1 + z^2 rise2 + z^3 rise3, z = 0 at the element's base end .. 1 at its tip end, 1/m."""
    active: Vector
    active1: Vector
    active2: Vector
    active3: Vector
    """mu_x / EI_x, mu_y / EI_y (1/m) and nu / EA, over z as u*."""


@record
class RodSection(LaneRecord):
    """An element and its section."""

    length: float
    """m."""
    inv_bend: Vector
    """1 / K_bt, 1 / (N m^2)."""
    inv_stretch: Vector
    """1 / K_se, 1 / N."""
    u_rest: Vector
    """u*, 1/m."""
    v_rest: Vector
    """v*, 1."""
    load: Vector
    """f, N/m."""
    terms: Terms
    u_rest_norm: float
    """|u*|, 1/m."""
    parts: float
    """Into how many steps this rod wants the element to be cut."""


class RodState(NamedTuple):
    """The unknown functions."""

    q: Quaternion
    m: Vector
    r: Vector


class Soft(NamedTuple):
    """D and e of a hyperelastic section."""

    d: float
    e: float


class Strains(NamedTuple):
    """What a section does that carries m and n."""

    u: Vector
    v: Vector
    soft: Soft
    free: Vector
    """k1, k2 (1/m) and e of a section that were linear."""


@inline
def state_along(y: RodState, h: float, k: RodState) -> RodState:
    """y + h k."""
    w, x = fused(h, k.q[0], y.q[0]), fused(h, k.q[1], y.q[1])
    return RodState((w, x, fused(h, k.q[2], y.q[2]), fused(h, k.q[3], y.q[3])), along(y.m, h, k.m), along(y.r, h, k.r))


@inline
def slope(y: RodState, n: Vector, s: Strains) -> RodState:
    """dy/dt of a section that carries n."""
    return RodState(turning(y.q, s.u), plus_cross(cross(s.u, y.m), s.v, n), plus_cross(s.v, s.u, y.r))


@inline
def turning(q: Quaternion, u: Vector) -> Quaternion:
    """dq/dt of a section that turns with curvature u (section frame) while walking towards the base."""
    w, r, half = q[0], (q[1], q[2], q[3]), scaled(-0.5, u)
    x, y, z = plus_cross(scaled(w, half), r, half)
    return (-dot(r, half), x, y, z)


@inline
def strains(m: Vector, n: Vector, section: RodSection, z: float, near: Soft | None, linear: bool) -> Strains:
    """u, v and softness of a section that carries m and n, at the share z of its element; `near` is how soft it is close by.
    `linear`: no section of the group is hyperelastic, which saves two thirds of the time."""
    u, v, terms = times(section.inv_bend, m), times(section.inv_stretch, n), section.terms
    rest = add(u, along(along(along(section.u_rest, z, terms.rise1), z * z, terms.rise2), z * z * z, terms.rise3))
    own = along(along(along(terms.active, z, terms.active1), z * z, terms.active2), z * z * z, terms.active3)
    free = (u[0] + own[0], u[1] + own[1], v[2] + own[2])
    if linear:
        return Strains(rest, add(v, section.v_rest), Soft(1.0, free[2]), free)
    soft = softened(law_of(free, section), near)
    less = 1.0 - 1.0 / soft.d
    bent = (rest[0] - less * free[0], rest[1] - less * free[1], rest[2])
    return Strains(bent, add((v[0], v[1], soft.e - own[2]), section.v_rest), soft, free)


class SectionLaw(NamedTuple):
    """What D and e follow from: b, c, and what a load makes of the section if it were linear."""

    bending: float
    """a Q / B for D = 1."""
    coupled: float
    """Q / (2 EA) for D = 1."""
    strain: float
    """n3 / EA."""
    b: float
    c: float


@inline
def law_of(free: Vector, section: RodSection) -> SectionLaw:
    """The law of a section of which its moments and axial force would make `free`."""
    a, b, c = section.terms.law
    ix, iy, _ = section.inv_bend
    energy = free[0] * free[0] / ix + free[1] * free[1] / iy
    return SectionLaw(a * energy * math.sqrt(ix * iy), 0.5 * energy * section.inv_stretch[2], free[2], b, c)


@inline
def softened(law: SectionLaw, near: Soft | None) -> Soft:
    """D and e by Newton: three rounds from a stage close by come as near as five from an unstrained section. (Written out, since
    loops within keep the compiler from making vectors of the lanes.)"""
    if near is not None:
        return newton_round(law, newton_round(law, newton_round(law, near)))
    y = newton_round(law, Soft(1.0, law.strain))
    return newton_round(law, newton_round(law, newton_round(law, newton_round(law, y))))


@inline
def newton_round(law: SectionLaw, y: Soft) -> Soft:
    """Nearer to F1 = F2 = 0."""
    f = balance(law, y)
    scale = 1.0 / (f.f1_by_d * f.f2_by_e - f.f1_by_e * f.f2_by_d)
    d = y.d - scale * (f.f2_by_e * f.f1 - f.f1_by_e * f.f2)
    return Soft(d, y.e - scale * (f.f1_by_d * f.f2 - f.f2_by_d * f.f1))


class Balance(NamedTuple):
    """F1 = D - 1 - g(x) - h(b e) and F2 = k(e) + b h'(b e) Q / (2 EA) - n3 / EA, x = a Q / B, Q = (Q for D = 1) / D^2;
    their derivatives, and pieces of these."""

    f1: float
    f2: float
    f1_by_d: float
    f1_by_e: float
    f2_by_d: float
    f2_by_e: float
    x: float
    steep: float
    """g'(x)."""
    coupled: float
    """b Q / (2 EA)."""
    h: float
    rise: float
    """h'(b e)."""
    curl: float
    """h''(b e)."""
    relief: float
    """1 / (1 - c e) below 0, else 1."""


@inline
def balance(law: SectionLaw, y: Soft) -> Balance:
    """F1, F2 and their derivatives at y = (D, e); see the top of the file for g, h and k."""
    be, ce = law.b * y.e, law.c * y.e
    inverse = 1.0 / y.d
    inverse_squared = inverse * inverse
    x, coupled = law.bending * inverse_squared, law.b * law.coupled * inverse_squared
    # 1 / (1 - 2 x), 1 / (1 - b e) and 1 / (1 - c e) where the section softens, else 1
    level = 1.0 / (1.0 - 2.0 * min(x, 0.0))
    loss, relief = 1.0 / (1.0 - min(be, 0.0)), 1.0 / (1.0 - min(ce, 0.0))
    rise, steep = loss * loss, level * level
    curl = 2.0 * rise * (loss if be < 0.0 else 0.0)
    stiffening = max(ce, 0.0)
    return Balance(
        y.d - 1.0 - x * level - be * loss,
        y.e * (relief + stiffening) + rise * coupled - law.strain,
        1.0 + 2.0 * x * level * level * inverse,
        -law.b * rise,
        -2.0 * rise * coupled * inverse,
        relief * relief + 2.0 * stiffening + law.b * curl * coupled,
        x, steep, coupled, be * loss, rise, curl, relief,
    )  # fmt: skip
