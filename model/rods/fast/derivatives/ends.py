"""What changes at the two ends of a rod: the wrench at the tip by unknowns and parameters, the residual at the base by both.

Unknowns are the turn of the tip and, with springs, its shift (rad, m; mount frame). With f, g the follower loads in the
mount frame, P the tip seen from the base and M the moment there,
    dN = phi x f + R dF + dF_dead - d(springs),   dM = phi x g + R dM_tip + dM_dead      at the tip,
    chi(base turned back by base_turn) = v / (1 + h |v|^2)^(1/3), v = K (M - relief (g + P x f))    at the base,
chi being four times the tangent of a quarter of the angle, along its axis. A direction in parameter space is (width,
LANES) numbers.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from model.rods.columns import (
    BASE_COMPLIANCE,
    BASE_RELIEF,
    BASE_STIFFENING,
    BASE_TURN,
    DEAD_FORCE,
    DEAD_MOMENT,
    HEAD,
    SPRING,
    SPRING_ARM,
    SPRING_DIRECTION,
    SPRING_ORIGIN,
    SPRING_SOFTNESS,
    SPRING_STIFFNESS,
    TIP_FORCE,
    TIP_MOMENT,
)
from model.rods.fast.algebra import Quaternion, Vector, add, along, cross, dot, product, scaled, times, turned, unit
from model.rods.fast.jit import inline, routine
from model.rods.fast.lanes import (
    ANCHOR,
    BASE,
    COMPLIANCE,
    LANES,
    PLACE,
    RELIEF,
    SPRINGS,
    STIFFENING,
    TIP,
    WRENCH,
    M,
    put,
    quaternion_of,
    vector_of,
)
from model.rods.fast.passes import unit_quaternion

Array = NDArray[np.float64]

FOLLOWER_FORCE, FOLLOWER_MOMENT, CHI_BY_TURN, TURN_BY_BASE_TURN, FELT_MOMENT = 0, 3, 6, 15, 24
"""f, g, d chi / d turn of the base (3 by 3, by rows), d turn / d base_turn (3 by 3, by columns), M - relief (g + P x f)."""
ENDS = 27


@inline
def spring_tangent(stretch: float, stiffness: float, softness: float) -> Vector:
    """Pull of a spring over its stiffness, and d pull / d stretch and / d softness of it."""
    if softness > 0.0:
        root = math.sqrt(stretch * stretch + softness * softness)
        return (0.5 * (stretch + root), 0.5 * stiffness * (1.0 + stretch / root), 0.5 * stiffness * softness / root)
    return (stretch, stiffness, 0.0)


@routine
def linearise_ends(work: Array, ends: Array, rods: Array, row: int, l: int) -> None:
    """Fill `ends` of a lane that was walked to the base, and its PLACE."""
    q = quaternion_of(work, TIP, l)
    force, moment = turned(q, vector_of(work, WRENCH, l)), turned(q, vector_of(work, WRENCH + 3, l))
    put(ends, FOLLOWER_FORCE, l, force)
    put(ends, FOLLOWER_MOMENT, l, moment)
    base = unit_quaternion(work, l)
    b = quaternion_of(work, BASE, l)
    e = product(base, (b[0], -b[1], -b[2], -b[3]))
    if e[0] < 0.0:
        e = (-e[0], -e[1], -e[2], -e[3])
    scale = 4.0 / (1.0 + e[0])
    axis = (e[1], e[2], e[3])
    for k in range(3):
        one = unit(k)
        # de = (0, one) e / 2
        moved = scaled(0.5 * scale, along(cross(one, axis), e[0], one))
        moved = along(moved, 0.125 * scale * scale * dot(one, axis), axis)
        for r in range(3):
            ends[(CHI_BY_TURN + 3 * r + k) * LANES + l] = moved[r]
        put(
            ends,
            TURN_BY_BASE_TURN + 3 * k,
            l,
            turned(e, turn_rate((rods[row, BASE_TURN], rods[row, BASE_TURN + 1], rods[row, BASE_TURN + 2]), one)),
        )
    place = vector_of(work, PLACE, l)
    felt = turned(base, vector_of(work, M, l))
    carried = add(moment, cross(place, force))
    put(ends, FELT_MOMENT, l, along(felt, -work[RELIEF * LANES + l], carried))


@inline
def turn_rate(x: Vector, change: Vector) -> Vector:
    """By which turn (rad, from the left) the rotation of the vector x changes with x."""
    angle = math.sqrt(dot(x, x))
    if angle < 1e-4:
        return along(change, 0.5, cross(x, change))
    a = scaled(1.0 / angle, x)
    sine = math.sin(angle) / angle
    found = along(scaled(sine, change), (1.0 - sine) * dot(a, change), a)
    return along(found, (1.0 - math.cos(angle)) / angle, cross(a, change))


@inline
def springs_by_motion(work: Array, springs: int, turn: Vector, shift: Vector, l: int) -> tuple[Vector, Vector]:
    """Change of the springs' force and moment at the tip when it turns and shifts."""
    force, moment = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for j in range(springs):
        o = SPRINGS + j * SPRING
        e, arm, found = spring_state(work, o, l)
        swung = cross(turn, arm)
        pulled = scaled(found[1] * (dot(e, swung) - dot(e, shift)), e)
        force = add(force, pulled)
        held = scaled(-work[(o + SPRING_STIFFNESS) * LANES + l] * found[0], e)
        moment = along(moment, -1.0, add(cross(swung, held), cross(arm, pulled)))
    return force, moment


@inline
def springs_by_parameters(work: Array, springs: int, d: Array, l: int) -> tuple[Vector, Vector]:
    """Change of force and moment at the tip with the springs themselves, along the direction d."""
    force, moment = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for j in range(springs):
        o, c = SPRINGS + j * SPRING, HEAD + j * SPRING
        e, arm, found = spring_state(work, o, l)
        point = along(vector_of(work, ANCHOR, l), -1.0, arm)
        stiffness = work[(o + SPRING_STIFFNESS) * LANES + l]
        de, longer = (
            vector_in(d, c + SPRING_DIRECTION, l),
            turned(quaternion_of(work, TIP, l), vector_in(d, c + SPRING_ARM, l)),
        )
        grown = d[c + SPRING_STIFFNESS, l] * found[0] + d[c + SPRING_SOFTNESS, l] * found[2]
        grown += found[1] * (dot(de, point) - dot(e, longer) - d[c + SPRING_ORIGIN, l])
        pulled = along(scaled(-grown, e), -stiffness * found[0], de)
        force = add(force, pulled)
        moment = along(moment, -1.0, add(cross(longer, scaled(-stiffness * found[0], e)), cross(arm, pulled)))
    return force, moment


@inline
def spring_state(work: Array, o: int, l: int) -> tuple[Vector, Vector, Vector]:
    """Direction of the spring at o, its arm in the mount frame, and what `spring_tangent` says of it."""
    e = vector_of(work, o + SPRING_DIRECTION, l)
    arm = turned(quaternion_of(work, TIP, l), vector_of(work, o + SPRING_ARM, l))
    stretch = dot(e, vector_of(work, ANCHOR, l)) - dot(e, arm) - work[(o + SPRING_ORIGIN) * LANES + l]
    found = spring_tangent(stretch, work[(o + SPRING_STIFFNESS) * LANES + l], work[(o + SPRING_SOFTNESS) * LANES + l])
    return e, arm, found


@inline
def vector_in(d: Array, c: int, l: int) -> Vector:
    """Three numbers of a direction."""
    return (d[c, l], d[c + 1, l], d[c + 2, l])


@inline
def tip_wrench_change(work: Array, springs: int, d: Array, l: int) -> tuple[Vector, Vector]:
    """dN and dM at the tip along the direction d, the tip held still."""
    q: Quaternion = quaternion_of(work, TIP, l)
    force = add(turned(q, vector_in(d, TIP_FORCE, l)), vector_in(d, DEAD_FORCE, l))
    moment = add(turned(q, vector_in(d, TIP_MOMENT, l)), vector_in(d, DEAD_MOMENT, l))
    if springs > 0:
        pulled = springs_by_parameters(work, springs, d, l)
        force, moment = add(force, pulled[0]), add(moment, pulled[1])
    return force, moment


@inline
def compliant_turn(work: Array, ends: Array, change: Vector, stiffer: float, l: int) -> Vector:
    """By how much the base turns more when v changes, and h by `stiffer`."""
    h = work[STIFFENING * LANES + l]
    if h == 0.0 and stiffer == 0.0:
        return change
    v = times(vector_of(work, COMPLIANCE, l), vector_of(ends, FELT_MOMENT, l))
    size = dot(v, v)
    whole = 1.0 + h * size
    factor = whole ** (-1.0 / 3.0)
    return along(scaled(factor, change), -factor / (3.0 * whole) * (2.0 * h * dot(v, change) + stiffer * size), v)


@inline
def base_residual_change(work: Array, ends: Array, change: Array, force: Vector, twist: Vector, l: int) -> Vector:
    """Change of the base's residual when the section there changes by `change` (turn, shift, moment), and f and g change."""
    turn, moment = vector_of(change, 0, l), vector_of(change, 6, l)
    shift = scaled(-1.0, vector_of(change, 3, l))
    relief = work[RELIEF * LANES + l]
    follower = add(cross(shift, vector_of(ends, FOLLOWER_FORCE, l)), cross(vector_of(work, PLACE, l), force))
    moment = along(moment, -relief, add(twist, follower))
    v = compliant_turn(work, ends, times(vector_of(work, COMPLIANCE, l), moment), 0.0, l)
    return (
        dot(vector_of(ends, CHI_BY_TURN, l), turn) - v[0],
        dot(vector_of(ends, CHI_BY_TURN + 3, l), turn) - v[1],
        dot(vector_of(ends, CHI_BY_TURN + 6, l), turn) - v[2],
    )


@inline
def base_parameter_change(work: Array, ends: Array, d: Array, l: int) -> Vector:
    """Change of the base's residual along the direction d with the base's own parameters."""
    x, y, z = vector_in(d, BASE_TURN, l)
    by_tilt = scaled(-x, vector_of(ends, TURN_BY_BASE_TURN, l))
    by_tilt = along(
        along(by_tilt, -y, vector_of(ends, TURN_BY_BASE_TURN + 3, l)), -z, vector_of(ends, TURN_BY_BASE_TURN + 6, l)
    )
    moment = vector_of(ends, FELT_MOMENT, l)
    follower = add(
        vector_of(ends, FOLLOWER_MOMENT, l), cross(vector_of(work, PLACE, l), vector_of(ends, FOLLOWER_FORCE, l))
    )
    v = times(vector_in(d, BASE_COMPLIANCE, l), moment)
    v = along(v, -d[BASE_RELIEF, l], times(vector_of(work, COMPLIANCE, l), follower))
    v = compliant_turn(work, ends, v, d[BASE_STIFFENING, l], l)
    return (
        dot(vector_of(ends, CHI_BY_TURN, l), by_tilt) - v[0],
        dot(vector_of(ends, CHI_BY_TURN + 3, l), by_tilt) - v[1],
        dot(vector_of(ends, CHI_BY_TURN + 6, l), by_tilt) - v[2],
    )
