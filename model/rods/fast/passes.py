"""One pass of a group of rods from the tip to the base."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from model.rods.columns import (
    SPRING,
    SPRING_ARM,
    SPRING_DIRECTION,
    SPRING_ORIGIN,
    SPRING_SOFTNESS,
    SPRING_STIFFNESS,
)
from model.rods.fast.algebra import Quaternion, add, along, cross, dot, product, scaled, times, turned, turned_back
from model.rods.fast.equations import section_of
from model.rods.fast.jit import inline, routine
from model.rods.fast.lanes import (
    ANCHOR,
    BASE,
    COMPLIANCE,
    F_LOAD,
    LANES,
    LOAD_SHARE,
    PEAK_M2,
    PLACE,
    RELIEF,
    RESIDUAL,
    ROD_LENGTH,
    SPRINGS,
    STIFFENING,
    TIP,
    TURN,
    WRENCH,
    Group,
    M,
    N,
    Q,
    R,
    element_at,
    number_of,
    put,
    put_quaternion,
    quaternion_of,
    vector_of,
)
from model.rods.fast.runge_kutta import Step, step

Array = NDArray[np.float64]


@routine
def evaluate(group: Group, springs: int, dead: float) -> None:
    """Shoot from the present unknowns and read what comes out at the base; dead loads count `dead` times, and so many
    springs pull."""
    start_at_tip(group, springs, dead)
    parts = group.parts
    for e in range(parts.size):
        for j in range(parts[e]):
            dz = -1.0 / parts[e]
            advance_group(group, e, 1.0 + j * dz, dz, dead)
    read_base(group.work, group.active)
    if springs > 0:
        read_gap(group.work, group.active)


@inline
def start_at_tip(group: Group, springs: int, dead: float) -> None:
    """The state at the tip under the wrench there, springs included."""
    set_tip(group.work, dead, group.active)
    add_springs(group.work, springs, group.active)


@inline
def advance_group(group: Group, e: int, z: float, dz: float, dead: float) -> None:
    """One step of all lanes within element e."""
    if group.active == LANES:
        for l in range(LANES):
            advance(group, element_at(e), z, dz, l, dead, None)
    else:
        for l in range(group.active):
            advance_alone(group, e, z, dz, l, dead)


@routine
def advance_alone(group: Group, e: int, z: float, dz: float, l: int, dead: float) -> None:
    """`advance` compiled once by itself, for where lanes are not side by side."""
    advance(group, element_at(e), z, dz, l, dead, None)


@inline
def set_tip(work: Array, dead: float, active: int) -> None:
    """The state at the tip under the wrench there."""
    for l in range(active):
        q = quaternion_of(work, TIP, l)
        share = work[LOAD_SHARE * LANES + l]
        force = scaled(share, turned(q, vector_of(work, WRENCH, l)))
        force = along(force, share * dead, vector_of(work, WRENCH + 6, l))
        moment = scaled(share, vector_of(work, WRENCH + 3, l))
        moment = along(moment, share * dead, turned_back(q, vector_of(work, WRENCH + 9, l)))
        put_quaternion(work, Q, l, q)
        put(work, M, l, moment)
        put(work, R, l, (0.0, 0.0, 0.0))
        put(work, N, l, force)
        work[PEAK_M2 * LANES + l] = dot(moment, moment)


@inline
def spring_force(stretch: float, stiffness: float, softness: float) -> float:
    """Pull (N) of a spring stretched by `stretch` (m); one that only pushes one way starts over a width `softness`."""
    if softness > 0.0:
        return 0.5 * stiffness * (stretch + math.sqrt(stretch * stretch + softness * softness))
    return stiffness * stretch


@inline
def add_springs(work: Array, springs: int, active: int) -> None:
    """Add the springs to the internal force and moment at the tip: -k (e . (p - R a) - origin) e each, at p - R a."""
    for j in range(springs):
        o = SPRINGS + j * SPRING
        for l in range(active):
            e, q = vector_of(work, o + SPRING_DIRECTION, l), quaternion_of(work, TIP, l)
            arm = turned(q, vector_of(work, o + SPRING_ARM, l))
            stretch = dot(e, vector_of(work, ANCHOR, l)) - dot(e, arm) - work[(o + SPRING_ORIGIN) * LANES + l]
            stiffness, softness = work[(o + SPRING_STIFFNESS) * LANES + l], work[(o + SPRING_SOFTNESS) * LANES + l]
            size = work[LOAD_SHARE * LANES + l] * spring_force(stretch, stiffness, softness)
            put(work, N, l, along(vector_of(work, N, l), -size, e))
            put(work, M, l, along(vector_of(work, M, l), size, turned_back(q, cross(arm, e))))


@inline
def advance(group: Group, at: int, z: float, dz: float, l: int, dead: float, stages: Array | None) -> None:
    """One step of lane l within an element, from the place z by dz (a negative share of the element)."""
    work, elements = group.work, group.elements
    q, m, r = quaternion_of(work, Q, l), vector_of(work, M, l), vector_of(work, R, l)
    y = (q[0], q[1], q[2], q[3], m[0], m[1], m[2], r[0], r[1], r[2])
    force = vector_of(work, N, l)
    h = -dz * number_of(elements, at, l)
    section = section_of(elements, group.full, at, l)
    load = scaled(dead * number_of(work, LOAD_SHARE, l), vector_of(elements, at + F_LOAD, l))
    y = step(y, Step(h, z, dz, force, load), section, l, stages)
    put_quaternion(work, Q, l, (y[0], y[1], y[2], y[3]))
    put(work, M, l, (y[4], y[5], y[6]))
    put(work, R, l, (y[7], y[8], y[9]))
    put(work, N, l, along(force, h, load))
    work[PEAK_M2 * LANES + l] = max(work[PEAK_M2 * LANES + l], y[4] * y[4] + y[5] * y[5] + y[6] * y[6])


@inline
def unit_quaternion(work: Array, l: int) -> Quaternion:
    """The orientation in the state, freed from the drift of its norm."""
    a, b, c, d = quaternion_of(work, Q, l)
    size = 1.0 / math.sqrt(a * a + b * b + c * c + d * d)
    return (size * a, size * b, size * c, size * d)


@inline
def read_base(work: Array, active: int) -> None:
    """By which rotation (rad, mount frame) the base misses its place, and where the tip is seen from it (m)."""
    for l in range(active):
        q = unit_quaternion(work, l)
        b = quaternion_of(work, BASE, l)
        v = times(turned(q, vector_of(work, M, l)), vector_of(work, COMPLIANCE, l))
        e = product(q, (b[0], -b[1], -b[2], -b[3]))
        # Four times the tangent of a quarter of the angle: the rotation vector to third order, regular up to 2 pi.
        scale = math.copysign(4.0 / (1.0 + abs(e[0])), e[0])
        put(work, RESIDUAL, l, (scale * e[1] - v[0], scale * e[2] - v[1], scale * e[3] - v[2]))
        put(work, PLACE, l, turned(q, vector_of(work, R, l)))
    for l in range(active):
        if work[RELIEF * LANES + l] != 0.0 or work[STIFFENING * LANES + l] != 0.0:
            relieve(work, l)


@routine
def relieve(work: Array, l: int) -> None:
    """Take back the share RELIEF of what the compliance made of the moment of the follower loads about the base, and what
    a base that stiffens does not turn."""
    share = work[RELIEF * LANES + l] * work[LOAD_SHARE * LANES + l]
    q = quaternion_of(work, TIP, l)
    force, moment = turned(q, vector_of(work, WRENCH, l)), turned(q, vector_of(work, WRENCH + 3, l))
    follower = add(moment, cross(vector_of(work, PLACE, l), force))
    whole = times(turned(unit_quaternion(work, l), vector_of(work, M, l)), vector_of(work, COMPLIANCE, l))
    left = along(whole, -share, times(follower, vector_of(work, COMPLIANCE, l)))
    yielded = (1.0 + work[STIFFENING * LANES + l] * dot(left, left)) ** (-1.0 / 3.0)
    put(work, RESIDUAL, l, along(add(vector_of(work, RESIDUAL, l), whole), -yielded, left))


@inline
def read_gap(work: Array, active: int) -> None:
    """How far the tip is from the spring anchor, over the rod's length."""
    for l in range(active):
        gap = along(vector_of(work, ANCHOR, l), -1.0, vector_of(work, PLACE, l))
        put(work, RESIDUAL + 3, l, scaled(1.0 / work[ROD_LENGTH * LANES + l], gap))


@inline
def turn_tip(group: Group) -> None:
    """Turn the tips by the first three of TURN (rad, mount frame); with springs move them by the others (lengths)."""
    work = group.work
    for l in range(group.active):
        x, y, z = vector_of(work, TURN, l)
        size = 1.0 / math.sqrt(1.0 + 0.25 * (x * x + y * y + z * z))
        half = 0.5 * size
        put_quaternion(work, TIP, l, product((size, half * x, half * y, half * z), quaternion_of(work, TIP, l)))
    if group.springs > 0:
        for l in range(group.active):
            moved = along(vector_of(work, ANCHOR, l), work[ROD_LENGTH * LANES + l], vector_of(work, TURN + 3, l))
            put(work, ANCHOR, l, moved)
