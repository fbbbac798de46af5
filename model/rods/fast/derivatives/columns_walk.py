"""The columns of `tangent` for a group of rods: started at the tip, stepped with the rod, and what a direction in parameter
space makes of them by reciprocity.

Arrays are flat, LANES numbers for each quantity, and loops run over all lanes: those without a rod hold a copy.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from model.rods.columns import LENGTH, LOAD
from model.rods.fast.algebra import Vector, add, along, cross, scaled, turned, turned_back, unit
from model.rods.fast.derivatives.column_layout import (
    BY_FORCE,
    BY_MOMENT,
    BY_TURN,
    DM,
    SHIFT,
    THETA,
    TIP_COLUMNS,
    WORK_BY,
)
from model.rods.fast.instructions import number_at, put_number
from model.rods.fast.jit import inline, routine
from model.rods.fast.lanes import ELEMENT, F_LOAD, LANES, TIP, Group, M, put, quaternion_of, vector_of
from model.rods.fast.passes import unit_quaternion

Array = NDArray[np.float64]

SECTION = 9
"""Quantities of the change of a section: turn, shift and moment, mount frame."""


class Columns(NamedTuple):
    """The columns of a group, and what was seen of them at its stations."""

    x: Array
    """(elements, columns, COLUMN LANES), see `tangent`."""
    moment: Array
    """(3 LANES) M at the tip, N m, mount frame."""
    passed: Array
    """(stations, elements, columns, COLUMN LANES): x where a station was passed."""
    walked: Array
    """(stations + 1, elements, LANES): share of each element that lies behind a station, behind the base last."""
    sections: Array
    """(stations + 1, TIP_COLUMNS, SECTION LANES): change of the section there by each column, at the base last."""
    slopes: Array
    """(stations, 6 LANES): what position and orientation do along the arc there, mount frame."""
    saved: Array
    """(1 + columns, COLUMN LANES): state and columns while a station is visited."""


class Direction(NamedTuple):
    """A direction in parameter space for every lane."""

    d: Array
    """(width, LANES), in the order of `columns`."""
    some: NDArray[np.bool_]
    """(width,): which of its numbers are not zero everywhere."""
    most: Array
    """(k, width): see `scan_directions`."""
    work: Array
    """(columns + 3, LANES): T of every column, and the change of N."""


@routine
def start_columns(work: Array, columns: Columns) -> None:
    """Columns at the tip: a unit turn, moment and force about each axis of the mount frame; forced ones are empty."""
    x, moment = columns.x, columns.moment
    x[0, :, : WORK_BY * LANES] = 0.0
    for l in range(LANES):
        put(moment, 0, l, turned(quaternion_of(work, TIP, l), vector_of(work, M, l)))
    for k in range(3):
        turn, twist = x[0, BY_TURN + k], x[0, BY_MOMENT + k]
        for l in range(LANES):
            axis = turned_back(quaternion_of(work, TIP, l), unit(k))
            put(turn, THETA, l, axis)
            put(turn, DM, l, cross(vector_of(work, M, l), axis))
            put(twist, DM, l, axis)


@inline
def section_change(work: Array, column: Array, section: Array, l: int) -> None:
    """Turn, shift and moment (mount frame) of a column where lane l stands."""
    q, m = unit_quaternion(work, l), vector_of(work, M, l)
    theta, dm = vector_of(column, THETA, l), vector_of(column, DM, l)
    put(section, 0, l, turned(q, theta))
    put(section, 3, l, vector_of(column, SHIFT, l))
    put(section, 6, l, turned(q, add(dm, cross(theta, m))))


@routine
def section_changes(work: Array, x: Array, section: Array) -> None:
    """`section_change` for the free columns of all lanes; `section` is (TIP_COLUMNS, SECTION LANES)."""
    for j in range(TIP_COLUMNS):
        column, into = x[j], section[j]
        for l in range(LANES):
            section_change(work, column, into, l)


@routine
def scan_directions(directions: Array, rods: int, first: int, most: Array) -> None:
    """The largest of every number of every direction over the lanes, without sign, into `most` (k, width): most are zero, and
    what is read in the order of memory comes several times as fast."""
    most[:] = 0.0
    count, width = most.shape
    for l in range(LANES if directions.shape[0] > 1 else 1):
        for k in range(count):
            row, of_row = directions[lane_row(directions, rods, first, l), k], most[k]
            for c in range(width):
                put_number(of_row, c, max(number_at(of_row, c), abs(number_at(row, c))))


@routine
def load_direction(directions: Array, rods: int, first: int, k: int, to: Direction) -> None:
    """Direction k of every lane into `to`."""
    for c in range(directions.shape[2]):
        changes = to.most[k, c] > 0.0
        if changes:
            for l in range(LANES):
                to.d[c, l] = directions[lane_row(directions, rods, first, l), k, c]
        elif to.some[c]:
            for l in range(LANES):
                to.d[c, l] = 0.0
        to.some[c] = changes


@inline
def lane_row(directions: Array, rods: int, first: int, l: int) -> int:
    """The row of lane l; lanes without a rod have the last one's."""
    return min(first + l, rods - 1) if directions.shape[0] > 1 else 0


@routine
def collect_work(x: Array, walked: Array, group: Group, moment: Array, to: Direction, block: int) -> None:
    """T of every column along a direction, that of the first with M x T_moment, and behind them the change of N.

    `x` are the columns and `walked` (elements, LANES) the share of each element that lies behind; `moment` is M at the tip.
    """
    work_done, elements = to.work, group.elements
    work_done[:] = 0.0
    count = x.shape[1]
    for e in range(len(x)):
        o = to.some.size - (e + 1) * block
        for c in range(block):
            if not to.some[o + c]:
                continue
            row = to.d[o + c]
            collected = x[e, :, (WORK_BY + c) * LANES : (WORK_BY + c + 1) * LANES]
            for l in range(LANES):
                # Written out: the compiler would unroll short loops over lanes and make no vectors of them.
                work_done[0, l] += collected[0, l] * row[l]
                work_done[1, l] += collected[1, l] * row[l]
                work_done[2, l] += collected[2, l] * row[l]
                work_done[3, l] += collected[3, l] * row[l]
                work_done[4, l] += collected[4, l] * row[l]
                work_done[5, l] += collected[5, l] * row[l]
                work_done[6, l] += collected[6, l] * row[l]
                work_done[7, l] += collected[7, l] * row[l]
                work_done[8, l] += collected[8, l] * row[l]
            for j in range(TIP_COLUMNS, count):
                for l in range(LANES):
                    work_done[j, l] += collected[j, l] * row[l]
            if c == LENGTH:
                for i in range(3):
                    for l in range(LANES):
                        work_done[count + i, l] += (
                            walked[e, l] * elements[(e * ELEMENT + F_LOAD + i) * LANES + l] * row[l]
                        )
            if LOAD <= c < LOAD + 3:
                for l in range(LANES):
                    work_done[count + c - LOAD, l] += walked[e, l] * elements[e * ELEMENT * LANES + l] * row[l]
    for l in range(LANES):
        a, b, c2 = moment[l], moment[LANES + l], moment[2 * LANES + l]
        work_done[0, l] += b * work_done[5, l] - c2 * work_done[4, l]
        work_done[1, l] += c2 * work_done[3, l] - a * work_done[5, l]
        work_done[2, l] += a * work_done[4, l] - b * work_done[3, l]


@inline
def combined(sections: Array, q: int, factors: Array, l: int) -> Vector:
    """Quantities q, q + 1, q + 2 of the free columns, `sections` (TIP_COLUMNS, SECTION LANES), by their factors."""
    total = scaled(factors[l], vector_of(sections[0], q, l))
    total = along(total, factors[LANES + l], vector_of(sections[1], q, l))
    total = along(total, factors[2 * LANES + l], vector_of(sections[2], q, l))
    total = along(total, factors[3 * LANES + l], vector_of(sections[3], q, l))
    total = along(total, factors[4 * LANES + l], vector_of(sections[4], q, l))
    total = along(total, factors[5 * LANES + l], vector_of(sections[5], q, l))
    total = along(total, factors[6 * LANES + l], vector_of(sections[6], q, l))
    total = along(total, factors[7 * LANES + l], vector_of(sections[7], q, l))
    return along(total, factors[8 * LANES + l], vector_of(sections[8], q, l))


@routine
def combine(sections: Array, factors: Array, change: Array) -> None:
    """`change` (SECTION) of a section by the factors of the free columns."""
    for l in range(LANES):
        put(change, 0, l, combined(sections, 0, factors, l))
    for l in range(LANES):
        put(change, 3, l, combined(sections, 3, factors, l))
    for l in range(LANES):
        put(change, 6, l, combined(sections, 6, factors, l))


@routine
def tip_factors(start: Array, work_done: Array, factors: Array) -> None:
    """Factors of the free columns: what changes at the tip and what comes from within."""
    force = work_done[len(work_done) - 3 :]
    for k in range(3):
        for l in range(LANES):
            factors[k * LANES + l] = start[k * LANES + l] - work_done[BY_MOMENT + k, l]
            factors[(BY_MOMENT + k) * LANES + l] = start[(BY_MOMENT + k) * LANES + l] + work_done[k, l]
            factors[(BY_FORCE + k) * LANES + l] = start[(BY_FORCE + k) * LANES + l] + force[k, l]
