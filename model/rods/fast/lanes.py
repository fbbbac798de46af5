"""Rods side by side: a group of rods advances together so that the compiler turns the loops over them into vectors.

Everything a group needs lives in flat arrays, LANES numbers for each quantity: entry `k * LANES + l` is quantity k of
rod l. Loops run over the first `active` lanes; a group of one is a plain scalar solve. Symbols are those of `equations`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from model.rods.columns import (
    BASE_COMPLIANCE,
    BASE_RELIEF,
    BASE_STIFFENING,
    BASE_TURN,
    BEND,
    HEAD,
    LENGTH,
    LOAD,
    REST_CURVATURE,
    SERIES,
    SPRING,
    TIP_FORCE,
)
from model.rods.description import MOST_SPRINGS
from model.rods.fast.algebra import Quaternion, Vector, dot
from model.rods.fast.instructions import number_at, put_number
from model.rods.fast.jit import allocating, inline, routine

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Full = int | None
"""1 for rods in full form; None, pruned at compile time where it is an argument, for all others."""

LANES = 16
"""Two AVX-512 or four AVX2 vectors; with fewer the compiler unrolls the loops instead of vectorising them."""

# Quantities of one element in `elements`, tip first; its length (m) comes first.
INV_BEND, INV_STRETCH = 1, 4
"""1 / K_bt and 1 / K_se, three each."""
U_REST, V_REST, F_LOAD = 7, 10, 13
"""u* (1/m), v* (1) and the load f (N/m), three each."""
U_REST_NORM, PARTS = 16, 17
"""|u*|, and the parts that this rod wants the element to be cut into."""
TERMS, RISES = 18, 21
"""Hyperelastic a, b, c (3), and the coefficients of z, z^2, z^3 of u* (9): of rods in full form, else unused."""
ELEMENT = 30

# The quantities in `work`, one array for all so that nothing has to be counted or checked for overlap on the way.
Q, M, R, N, PEAK_M2 = 0, 4, 7, 10, 13
"""State: orientation q (4), m, r, N (3 each), and the largest m^2 (N^2 m^2) met at the ends of steps."""
STATE = PEAK_M2 + 1
"""Quantities of the state, the first of `work`, saved while a station inside a step is visited."""
TIP, ANCHOR = 14, 18
"""Unknowns: orientation of the tip (4), and the spring anchor: where the springs take the tip to be (3, m, mount frame)."""
RESIDUAL, PLACE = 21, 27
"""By how much the base misses its pose: rotation (3, rad) and, with springs, position over length (3); the tip P as
seen from the base (3, m, mount frame)."""
RESIDUAL_BEFORE, TURN = 30, 36
"""The residual before the last change of the unknowns (6), and that change (6: rad, lengths)."""
JACOBIAN, PLACE_BY_TURN = 42, 78
"""d RESIDUAL / d TURN, 6 by 6 (3 by 3 of it without springs), and d PLACE / d TURN, 3 by 6."""
SAVED = 96
"""TIP, ANCHOR and PLACE while unknowns are nudged (10)."""
SAVED_PLACE = SAVED + 7
WRENCH, BASE, COMPLIANCE, LOAD_SHARE, ROD_LENGTH = 106, 118, 122, 125, 126
"""Follower force and moment, dead force and moment (12), base quaternion (4), compliance (3), share of all loads, L (m)."""
LARGEST_MOMENT, THRUST = 127, 128
"""Largest moment of the coarse solution, N m, and about the largest force, N."""
RELIEF = 129
"""Share of the follower loads' moment that the base's compliance does not feel."""
STIFFENING = 130
"""1 / rad^2, see `columns.BASE_STIFFENING`."""
SPRINGS = 131
WORK = SPRINGS + MOST_SPRINGS * SPRING


class RowLayout(NamedTuple):
    """Where things are in a row of `Rods.values`, see `columns`."""

    head: int
    """Columns before the first element."""
    block: int
    """Columns of an element."""
    springs: int


class Group(NamedTuple):
    """Rods side by side, and how they are cut."""

    work: Array
    """(WORK LANES) state, unknowns, residual, Jacobian, loads and supports."""
    elements: Array
    """(count ELEMENT LANES) sections and loads, tip first."""
    full: Full
    parts: Counts
    """(count,) steps of each element."""
    springs: int
    active: int
    """Lanes in use."""


@inline
def copy_numbers(source: Array, into: Array, count: int) -> None:
    """The first `count` numbers. (Numba compiles half a dozen text functions into an assignment of slices, for its error.)"""
    for i in range(count):
        into[i] = source[i]


@inline
def element_at(e: int) -> int:
    """The first quantity of element e, counted from the tip."""
    return e * ELEMENT


@allocating
def new_numbers(count: int) -> Array:
    """Zeros that begin where a vector of 64 bytes does: one that lies across two such places takes twice as long to fetch."""
    room = np.zeros(count + 7)
    begin = -(room.ctypes.data // 8) % 8
    return room[begin : begin + count]


@allocating
def new_work() -> Array:
    """Zeros for one group."""
    return new_numbers(WORK * LANES)


@inline
def number_of(array: Array, k: int, l: int) -> float:
    """Quantity k of lane l."""
    return number_at(array, k * LANES + l)


@inline
def vector_of(array: Array, k: int, l: int) -> Vector:
    """Quantities k, k + 1, k + 2 of lane l."""
    o = k * LANES + l
    return (number_at(array, o), number_at(array, o + LANES), number_at(array, o + 2 * LANES))


@inline
def quaternion_of(array: Array, k: int, l: int) -> Quaternion:
    """Quantities k .. k + 3 of lane l."""
    return (number_of(array, k, l), *vector_of(array, k + 1, l))


@inline
def put_quaternion(into: Array, k: int, l: int, q: Quaternion) -> None:
    """Four numbers of lane l from quantity k on."""
    put_number(into, k * LANES + l, q[0])
    put(into, k + 1, l, (q[1], q[2], q[3]))


@inline
def put(into: Array, k: int, l: int, a: Vector) -> None:
    """Three numbers of lane l from quantity k on (written out: tuples indexed in a loop would go through memory)."""
    o = k * LANES + l
    put_number(into, o, a[0])
    put_number(into, o + LANES, a[1])
    put_number(into, o + 2 * LANES, a[2])


@allocating
def new_elements(count: int) -> Array:
    """Room for so many elements."""
    return new_numbers(count * ELEMENT * LANES)


@inline
def elements_of(rods: Array, at: RowLayout) -> int:
    """Elements of a row."""
    return (rods.shape[1] - at.head) // at.block


@inline
def whole_length(rods: Array, row: int, at: RowLayout) -> float:
    """Length of a rod, m."""
    length = 0.0
    for o in range(at.head, rods.shape[1], at.block):
        length += rods[row, o + LENGTH]
    return length


@routine
def gather_rod(rods: Array, row: int, at: RowLayout, group: Group, l: int) -> None:
    """Copy rod `row` into lane l: its ends, and its elements tip first."""
    gather_ends(rods, row, at, group.work, l)
    gather_elements(rods, row, at, group, l)


@inline
def gather_ends(rods: Array, row: int, at: RowLayout, work: Array, l: int) -> None:
    """Copy what belongs to the ends of rod `row` into lane l."""
    for k in range(12):
        work[(WRENCH + k) * LANES + l] = rods[row, TIP_FORCE + k]
    x, y, z = rods[row, BASE_TURN], rods[row, BASE_TURN + 1], rods[row, BASE_TURN + 2]
    angle = math.sqrt(x * x + y * y + z * z)
    w, half = 1.0, 0.5
    if angle > 0.0:
        w, half = math.cos(0.5 * angle), math.sin(0.5 * angle) / angle
    put_quaternion(work, BASE, l, (w, half * x, half * y, half * z))
    for k in range(3):
        work[(COMPLIANCE + k) * LANES + l] = rods[row, BASE_COMPLIANCE + k]
    work[RELIEF * LANES + l] = rods[row, BASE_RELIEF]
    work[STIFFENING * LANES + l] = rods[row, BASE_STIFFENING]
    work[LOAD_SHARE * LANES + l] = 1.0
    whole = whole_length(rods, row, at)
    work[ROD_LENGTH * LANES + l] = whole
    force, moment = vector_of(work, WRENCH, l), vector_of(work, WRENCH + 3, l)
    dead = vector_of(work, WRENCH + 6, l)
    # A rough idea of the largest moment sizes the coarse steps: the thrust at the tip has an arm once the rod bends.
    thrust = math.sqrt(dot(force, force))
    work[LARGEST_MOMENT * LANES + l] = max(math.sqrt(dot(moment, moment)), 0.125 * whole * thrust)
    thrust += math.sqrt(dot(dead, dead))
    for o in range(at.head, rods.shape[1], at.block):
        x, y, z = rods[row, o + LOAD], rods[row, o + LOAD + 1], rods[row, o + LOAD + 2]
        thrust += 0.5 * rods[row, o + LENGTH] * math.sqrt(x * x + y * y + z * z)
    work[THRUST * LANES + l] = thrust
    for k in range(at.head - HEAD):
        work[(SPRINGS + k) * LANES + l] = rods[row, HEAD + k]


@inline
def gather_elements(rods: Array, row: int, at: RowLayout, group: Group, l: int) -> None:
    """Copy the elements of rod `row` into lane l, tip first."""
    elements = group.elements
    for e in range(elements_of(rods, at)):
        o = rods.shape[1] - (e + 1) * at.block
        p = e * ELEMENT
        elements[p * LANES + l] = rods[row, o + LENGTH]
        for k in range(6):
            elements[(p + INV_BEND + k) * LANES + l] = 1.0 / rods[row, o + BEND + k]
        for k in range(9):
            elements[(p + U_REST + k) * LANES + l] = rods[row, o + REST_CURVATURE + k]
        set_rest_norm(elements, p, l)
        copy_terms(group.full, rods, row, o + SERIES, elements, p + TERMS, l)


@inline
def set_rest_norm(elements: Array, p: int, l: int) -> None:
    """|u*| of the element at p."""
    rest = vector_of(elements, p + U_REST, l)
    elements[(p + U_REST_NORM) * LANES + l] = math.sqrt(dot(rest, rest))


@inline
def copy_terms(full: Full, rods: Array, row: int, o: int, elements: Array, p: int, l: int) -> None:
    """The hyperelastic and graded terms from column o on, where rods have them."""
    if full is not None:
        for k in range(ELEMENT - TERMS):
            elements[(p + k) * LANES + l] = rods[row, o + k]


@inline
def terms_in(full: Full, elements: Array) -> Array | None:
    """`elements` as the place of the terms where rods have them: an array of their own would have to be checked for overlap."""
    if full is None:
        return None
    return elements


@routine
def fixed_cut(group: Group, steps: Counts, first: int) -> None:
    """Cut as `steps` (n, elements base to tip) says, where it has rows: the most that any rod of the group is to have."""
    if steps.shape[0] == 0:
        return
    parts = group.parts
    for e in range(parts.size):
        most = 1
        for l in range(group.active):
            most = max(most, steps[min(first + l, steps.shape[0] - 1), parts.size - 1 - e])
        parts[e] = most


FINEST = 5.0
"""By how much steps are refined at most."""


@routine
def cut(group: Group, divisions: float) -> int:
    """Into how many steps each element (tip first) of the group is cut, into `parts`; returns their sum.

    No step is longer than the rod's length over `divisions`. Where the largest moment bends an element by b radian over
    the rod's length, and the thrust t = |N| L^2 / EI is more than 8, steps shrink as found by experiment to keep the
    error of the tip level. The lanes share the cuts: elements that are empty in one rod are walked with steps of no
    length.
    """
    work, elements, parts = group.work, group.elements, group.parts
    total = 0
    for e in range(parts.size):
        p = e * ELEMENT
        for l in range(group.active):
            whole = work[ROD_LENGTH * LANES + l]
            flexible = max(elements[(p + INV_BEND) * LANES + l], elements[(p + INV_BEND + 1) * LANES + l])
            b = whole * (work[LARGEST_MOMENT * LANES + l] * flexible + elements[(p + U_REST_NORM) * LANES + l])
            t = work[THRUST * LANES + l] * whole * whole * flexible
            finer = 0.3 + 0.5 * b * max(1.0, t / 8.0)
            # A pass that went astray may have met any moment, or none that is a number.
            finer = max(1.0, finer) if finer < FINEST else FINEST
            elements[(p + PARTS) * LANES + l] = elements[p * LANES + l] / whole * divisions * finer
        most = 0.0
        for l in range(group.active):
            most = max(most, elements[(p + PARTS) * LANES + l])
        parts[e] = int(math.ceil(most - 1e-9))
        total += parts[e]
    return total
