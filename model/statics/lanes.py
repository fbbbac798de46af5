"""Rods side by side: a group of rods advances together so that the compiler turns the loops over them into vectors.

Everything a group needs lives in flat arrays, LANES numbers for each quantity: entry `k * LANES + l` is quantity k of
rod l. Loops run over the first `active` lanes; a group of one is a plain scalar solve.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from model.statics.algebra import Quaternion, Vector, dot
from model.statics.jit import inline, routine
from model.statics.layout import (
    BASE_COMPLIANCE,
    BASE_RELIEF,
    BASE_STIFFENING,
    BASE_TURN,
    BEND,
    HEAD,
    LENGTH,
    LOAD,
    REST_CURVATURE,
    RISE,
    SERIES,
    SPRING,
    TIP_FORCE,
)

Array = NDArray[np.float64]
Counts = NDArray[np.int64]

LANES = 16
"""Two AVX-512 or four AVX2 vectors; with fewer the compiler unrolls the loops instead of vectorising them."""

ELEMENT = 18
"""Quantities of one element in `elements`: length, 1/K_bt (3), 1/K_se (3), u* (3), v* (3), load (3), |u*|, and the
parts it wants to be cut into."""
REST, PARTS = 16, 17
MOST_SPRINGS = 3

# The quantities in `work`, one array for all so that nothing has to be counted or checked for overlap on the way.
Q, M, R, N, PEAK = 0, 4, 7, 10, 13
"""State: orientation (4), m, r, N (3 each), and the largest m^2 (N^2 m^2) met at the ends of steps."""
TIP, HELD = 14, 18
"""Unknowns: orientation of the tip (4), and where the springs believe the tip to be (3, m, mount frame)."""
MISS, PLACE = 21, 27
"""By how much the base misses its pose: rotation (3, rad) and, with springs, position over length (3); the tip as
seen from the base (3, m, mount frame)."""
BEFORE, TURN = 30, 36
"""The miss before the last change of the unknowns (6), and that change (6: rad, lengths)."""
JACOBIAN, CARRY = 42, 78
"""d MISS / d TURN, 6 by 6 (3 by 3 of it without springs), and d PLACE / d TURN, 3 by 6."""
KEPT = 96
"""TIP, HELD and PLACE while unknowns are nudged (10)."""
WRENCH, BASE, COMPLIANCE, SHARE, WHOLE = 106, 118, 122, 125, 126
"""Follower force and moment, dead force and moment (12), base quaternion (4), compliance (3), share of load, length."""
LARGEST, THRUST = 127, 128
"""Largest moment of the coarse solution, N m, and about the largest force, N."""
RELIEF = 129
"""Share of the follower loads' moment that the base's compliance does not feel."""
STIFFENING = 130
"""1 / rad^2, see `layout.BASE_STIFFENING`."""
SPRINGS = 131
WORK = SPRINGS + MOST_SPRINGS * SPRING


@inline
def new_work() -> Array:
    """Zeros for one group."""
    return np.zeros(WORK * LANES)


@inline
def vector_of(array: Array, k: int, l: int) -> Vector:
    """Quantities k, k + 1, k + 2 of lane l."""
    return (array[k * LANES + l], array[(k + 1) * LANES + l], array[(k + 2) * LANES + l])


@inline
def quaternion_of(array: Array, k: int, l: int) -> Quaternion:
    """Quantities k .. k + 3 of lane l."""
    return (array[k * LANES + l], array[(k + 1) * LANES + l], array[(k + 2) * LANES + l], array[(k + 3) * LANES + l])


@inline
def put_quaternion(into: Array, k: int, l: int, q: Quaternion) -> None:
    """Four numbers of lane l from quantity k on."""
    into[k * LANES + l] = q[0]
    into[(k + 1) * LANES + l] = q[1]
    into[(k + 2) * LANES + l] = q[2]
    into[(k + 3) * LANES + l] = q[3]


@inline
def put(into: Array, k: int, l: int, a: Vector) -> None:
    """Three numbers of lane l from quantity k on (written out: tuples indexed in a loop would go through memory)."""
    into[k * LANES + l] = a[0]
    into[(k + 1) * LANES + l] = a[1]
    into[(k + 2) * LANES + l] = a[2]


@inline
def whole_length(rods: Array, row: int, head: int, block: int) -> float:
    """Length of a rod, m."""
    length = 0.0
    for o in range(head, rods.shape[1], block):
        length += rods[row, o + LENGTH]
    return length


@routine
def gather_ends(rods: Array, row: int, head: int, block: int, work: Array, lane: int) -> None:
    """Copy what belongs to the ends of rod `row` into a lane."""
    for k in range(12):
        work[(WRENCH + k) * LANES + lane] = rods[row, TIP_FORCE + k]
    x, y, z = rods[row, BASE_TURN], rods[row, BASE_TURN + 1], rods[row, BASE_TURN + 2]
    angle = math.sqrt(x * x + y * y + z * z)
    w, half = 1.0, 0.5
    if angle > 0.0:
        w, half = math.cos(0.5 * angle), math.sin(0.5 * angle) / angle
    put_quaternion(work, BASE, lane, (w, half * x, half * y, half * z))
    for k in range(3):
        work[(COMPLIANCE + k) * LANES + lane] = rods[row, BASE_COMPLIANCE + k]
    work[RELIEF * LANES + lane] = rods[row, BASE_RELIEF]
    work[STIFFENING * LANES + lane] = rods[row, BASE_STIFFENING]
    work[SHARE * LANES + lane] = 1.0
    whole = whole_length(rods, row, head, block)
    work[WHOLE * LANES + lane] = whole
    force, moment = vector_of(work, WRENCH, lane), vector_of(work, WRENCH + 3, lane)
    dead = vector_of(work, WRENCH + 6, lane)
    # A rough idea of the largest moment sizes the coarse steps: the thrust at the tip has an arm once the rod bends.
    thrust = math.sqrt(dot(force, force))
    work[LARGEST * LANES + lane] = max(math.sqrt(dot(moment, moment)), 0.125 * whole * thrust)
    thrust += math.sqrt(dot(dead, dead))
    for o in range(head, rods.shape[1], block):
        x, y, z = rods[row, o + LOAD], rods[row, o + LOAD + 1], rods[row, o + LOAD + 2]
        thrust += 0.5 * rods[row, o + LENGTH] * math.sqrt(x * x + y * y + z * z)
    work[THRUST * LANES + lane] = thrust
    for k in range(head - HEAD):
        work[(SPRINGS + k) * LANES + lane] = rods[row, HEAD + k]


@routine
def gather_elements(
    rods: Array, row: int, head: int, block: int, elements: Array, rises: Array | None, series: Array | None, lane: int
) -> None:
    """Copy the elements of rod `row` into a lane, tip first."""
    for e in range((rods.shape[1] - head) // block):
        o = rods.shape[1] - (e + 1) * block
        p = e * ELEMENT
        elements[p * LANES + lane] = rods[row, o + LENGTH]
        for k in range(6):
            elements[(p + 1 + k) * LANES + lane] = 1.0 / rods[row, o + BEND + k]
        for k in range(9):
            elements[(p + 7 + k) * LANES + lane] = rods[row, o + REST_CURVATURE + k]
        rest = vector_of(elements, p + 7, lane)
        elements[(p + REST) * LANES + lane] = math.sqrt(dot(rest, rest))
        copy_terms(rods, row, o + SERIES, series, 3 * e, 3, lane)
        copy_terms(rods, row, o + RISE, rises, 9 * e, 9, lane)


@inline
def copy_terms(rods: Array, row: int, o: int, terms: Array | None, k: int, count: int, lane: int) -> None:
    """Numbers from column o on, where there are such terms (None is pruned at compile time where it is an argument)."""
    if terms is not None:
        for j in range(count):
            terms[(k + j) * LANES + lane] = rods[row, o + j]


@routine
def fixed_cut(steps: Counts, first: int, parts: Counts, active: int) -> None:
    """`parts` (tip first) from `steps` (n, elements base to tip): the most that any rod of the group is to have."""
    for e in range(parts.size):
        most = 1
        for l in range(active):
            most = max(most, steps[first + l, parts.size - 1 - e])
        parts[e] = most


FINEST = 5.0
"""By how much steps are refined at most."""


@routine
def cut(work: Array, elements: Array, parts: Counts, divisions: float, active: int) -> int:
    """Into how many steps each element (tip first) of the group is cut, into `parts`; returns their sum.

    No step is longer than the rod's length over `divisions`. Where the largest moment bends an element by b radian over
    the rod's length, and the thrust t = |N| L^2 / EI is more than 8, steps shrink as found by experiment to keep the
    error of the tip level. The lanes share the cuts: elements that are empty in one rod are walked with steps of no
    length.
    """
    total = 0
    for e in range(parts.size):
        p = e * ELEMENT
        for l in range(active):
            whole = work[WHOLE * LANES + l]
            flexible = max(elements[(p + 1) * LANES + l], elements[(p + 2) * LANES + l])
            b = whole * (work[LARGEST * LANES + l] * flexible + elements[(p + REST) * LANES + l])
            t = work[THRUST * LANES + l] * whole * whole * flexible
            finer = 0.3 + 0.5 * b * max(1.0, t / 8.0)
            # A pass that went astray may have met any moment, or none that is a number.
            finer = max(1.0, finer) if finer < FINEST else FINEST
            elements[(p + PARTS) * LANES + l] = elements[p * LANES + l] / whole * divisions * finer
        most = 0.0
        for l in range(active):
            most = max(most, elements[(p + PARTS) * LANES + l])
        parts[e] = int(math.ceil(most - 1e-9))
        total += parts[e]
    return total
