"""Implicit differentiation at a solution, a group of rods at a time: one pass, whatever the number of parameters.

With the columns Y of `tangent` the change of a section's state behind parameters d is, in the mount frame,
    X = Y (x + G d)        x: what changes at the tip, G: what comes from within, by reciprocity
    G_turn = - T_moment,  G_moment = T_turn + M x T_moment,  G_force = integral df dt,  G_shift = - T_force
where T_moment is what the columns that start with a unit moment collected, and so on, and M the moment at the tip: the
turn of a section is conjugate to the change of its moment halfway between both frames. Of x the turn of the tip (and,
with springs, its shift) is unknown; the base must not miss its pose (`ends`), which is a 3 by 3 (6 by 6) system.

Arrays are flat, LANES numbers for each quantity, and loops run over all lanes: those without a rod hold a copy.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from model.statics.algebra import Vector, add, along, cross, scaled, turned, turned_back, unit
from model.statics.ends import ENDS, FOLLOWED, TWISTED, base_change, base_miss, by_motion, look, three, tip_change
from model.statics.equations import strains
from model.statics.group import AT_LARGEST, AT_ORIENTATION, AT_TIP, new_elements
from model.statics.jit import inline, kernel, routine
from model.statics.lanes import (
    ELEMENT,
    HELD,
    JACOBIAN,
    LANES,
    LARGEST,
    MISS,
    TIP,
    TURN,
    Counts,
    M,
    N,
    cut,
    fixed_cut,
    gather_elements,
    gather_ends,
    put,
    quaternion_of,
    vector_of,
)
from model.statics.layout import LENGTH, LOAD, TIP_FORCE, TIP_MOMENT
from model.statics.newton import by_cofactors, eliminate, jacobian_of
from model.statics.passes import advance, pull, read_base, set_tip, unit_quaternion
from model.statics.record import ON_DESK, RISES_ON_DESK, SERIES_ON_DESK, STEP_ON_DESK, if_any, lay_out
from model.statics.tangent import (
    BY_FORCE,
    BY_MOMENT,
    BY_TURN,
    CELL,
    DESK,
    DM,
    FREE,
    SHIFT,
    STRETCHED,
    THETA,
    WORKS,
    columns_step,
)

Array = NDArray[np.float64]

BY_TIP, BY_ROTATION, BY_BASE_FORCE, BY_BASE_MOMENT, BY_BASE_TURN, OUTPUTS = 0, 3, 6, 9, 12, 15
"""d tip (m), d rotation of the tip (rad, mount frame), d base force (N), d base moment (N m), d rotation of the base
(rad); then the mean strain of each element (1) where asked, then d position (m) and d rotation (rad) of each station."""
STATION = 6
SEEN = 9
"""Of a column at a section: turn, shift and moment, mount frame."""
STATE = 14


@inline
def copy_numbers(source: Array, into: Array, count: int) -> None:
    """The first `count` numbers. (Numba compiles half a dozen text functions into an assignment of slices, for its error.)"""
    for i in range(count):
        into[i] = source[i]


@routine
def start_columns(work: Array, x: Array, moment: Array) -> None:
    """Columns at the tip: a unit turn, moment and force about each axis of the mount frame; forced ones are empty.

    `moment` becomes M there.
    """
    x[:] = 0.0
    for l in range(LANES):
        put(moment, 0, l, turned(quaternion_of(work, TIP, l), vector_of(work, M, l)))
    for k in range(3):
        turn, twist = x[0, BY_TURN + k], x[0, BY_MOMENT + k]
        for l in range(LANES):
            axis = turned_back(quaternion_of(work, TIP, l), unit(k))
            put(turn, THETA, l, axis)
            put(turn, DM, l, cross(vector_of(work, M, l), axis))
            put(twist, DM, l, axis)


@routine
def step_all(desk: Array, x: Array, rises: Array | None, series: Array | None, e: int, z: float, dz: float) -> None:
    """A step of all lanes, of each the share that the desk says, and of all columns `x` with them."""
    for l in range(LANES):
        advance(
            desk, desk, if_any(rises, desk), if_any(series, desk), ON_DESK, (SERIES_ON_DESK, RISES_ON_DESK), z,
            dz * desk[STEP_ON_DESK * LANES + l], l, 1.0, desk,
        )  # fmt: skip
    columns_step(desk, x, rises, series, e, z, dz)


@inline
def see(work: Array, column: Array, seen: Array, l: int) -> None:
    """Turn, shift and moment (mount frame) of a column where lane l stands."""
    q, m = unit_quaternion(work, l), vector_of(work, M, l)
    theta, dm = vector_of(column, THETA, l), vector_of(column, DM, l)
    put(seen, 0, l, turned(q, theta))
    put(seen, 3, l, vector_of(column, SHIFT, l))
    put(seen, 6, l, turned(q, add(dm, cross(theta, m))))


@routine
def see_all(work: Array, x: Array, seen: Array) -> None:
    """`see` for the free columns of all lanes; `seen` is (FREE, SEEN LANES)."""
    for j in range(FREE):
        column, into = x[j], seen[j]
        for l in range(LANES):
            see(work, column, into, l)


@routine
def spell(directions: Array, rods: int, first: int, k: int, d: Array, some: NDArray[np.bool_]) -> None:
    """Direction k of every lane into d; `some` says which of its numbers are not zero everywhere."""
    for c in range(directions.shape[2]):
        any_of = False
        for l in range(LANES):
            row = min(first + l, rods - 1) if directions.shape[0] > 1 else 0
            value = directions[row, k, c]
            d[c, l] = value
            any_of = any_of or value != 0.0
        some[c] = any_of


@routine
def contract(
    x: Array, walked: Array, elements: Array, moment: Array, d: Array, some: NDArray[np.bool_], block: int, gamma: Array
) -> None:
    """gamma: T of every column along a direction, that of the first with M x T_moment, and behind them the change of N.

    `walked` is the share of each element that lies behind.
    """
    gamma[:] = 0.0
    count = x.shape[1]
    for e in range(len(x)):
        o = some.size - (e + 1) * block
        for c in range(block):
            if not some[o + c]:
                continue
            row = d[o + c]
            collected = x[e, :, (WORKS + c) * LANES : (WORKS + c + 1) * LANES]
            for l in range(LANES):
                # Written out: the compiler would unroll short loops over lanes and make no vectors of them.
                gamma[0, l] += collected[0, l] * row[l]
                gamma[1, l] += collected[1, l] * row[l]
                gamma[2, l] += collected[2, l] * row[l]
                gamma[3, l] += collected[3, l] * row[l]
                gamma[4, l] += collected[4, l] * row[l]
                gamma[5, l] += collected[5, l] * row[l]
                gamma[6, l] += collected[6, l] * row[l]
                gamma[7, l] += collected[7, l] * row[l]
                gamma[8, l] += collected[8, l] * row[l]
            for j in range(FREE, count):
                for l in range(LANES):
                    gamma[j, l] += collected[j, l] * row[l]
            if c == LENGTH:
                for i in range(3):
                    for l in range(LANES):
                        gamma[count + i, l] += walked[e, l] * elements[(e * ELEMENT + 13 + i) * LANES + l] * row[l]
            if LOAD <= c < LOAD + 3:
                for l in range(LANES):
                    gamma[count + c - LOAD, l] += walked[e, l] * elements[e * ELEMENT * LANES + l] * row[l]
    for l in range(LANES):
        a, b, c2 = moment[l], moment[LANES + l], moment[2 * LANES + l]
        gamma[0, l] += b * gamma[5, l] - c2 * gamma[4, l]
        gamma[1, l] += c2 * gamma[3, l] - a * gamma[5, l]
        gamma[2, l] += a * gamma[4, l] - b * gamma[3, l]


@inline
def mixed(seen: Array, q: int, factors: Array, l: int) -> Vector:
    """Quantities q, q + 1, q + 2 of the free columns, `seen` (FREE, SEEN LANES), by their factors."""
    total = scaled(factors[l], vector_of(seen[0], q, l))
    total = along(total, factors[LANES + l], vector_of(seen[1], q, l))
    total = along(total, factors[2 * LANES + l], vector_of(seen[2], q, l))
    total = along(total, factors[3 * LANES + l], vector_of(seen[3], q, l))
    total = along(total, factors[4 * LANES + l], vector_of(seen[4], q, l))
    total = along(total, factors[5 * LANES + l], vector_of(seen[5], q, l))
    total = along(total, factors[6 * LANES + l], vector_of(seen[6], q, l))
    total = along(total, factors[7 * LANES + l], vector_of(seen[7], q, l))
    return along(total, factors[8 * LANES + l], vector_of(seen[8], q, l))


@routine
def spread(seen: Array, factors: Array, change: Array) -> None:
    """`change` (SEEN) of a section by the factors of the free columns."""
    for l in range(LANES):
        put(change, 0, l, mixed(seen, 0, factors, l))
    for l in range(LANES):
        put(change, 3, l, mixed(seen, 3, factors, l))
    for l in range(LANES):
        put(change, 6, l, mixed(seen, 6, factors, l))


@routine
def from_within(start: Array, gamma: Array, factors: Array) -> None:
    """Factors of the free columns: what changes at the tip and what comes from within."""
    force = gamma[len(gamma) - 3 :]
    for k in range(3):
        for l in range(LANES):
            factors[k * LANES + l] = start[k * LANES + l] - gamma[BY_MOMENT + k, l]
            factors[(BY_MOMENT + k) * LANES + l] = start[(BY_MOMENT + k) * LANES + l] + gamma[k, l]
            factors[(BY_FORCE + k) * LANES + l] = start[(BY_FORCE + k) * LANES + l] + force[k, l]


@routine
def by_unknowns(work: Array, ends: Array, springs: int, seen: Array, starts: Array, answers: Array) -> None:
    """Fill JACOBIAN; `starts` and `answers` (unknowns, ..) are the state at the tip and the change at the base that
    belong to a unit of each unknown."""
    none = (0.0, 0.0, 0.0)
    for c in range(len(starts)):
        start, change = starts[c], answers[c]
        for l in range(LANES):
            axis = unit(c % 3)
            turn = axis if c < 3 else none
            put(start, BY_TURN, l, turn)
            pulled = by_motion(work, springs, turn, axis if c >= 3 else none, l)
            put(start, BY_MOMENT, l, add(cross(turn, vector_of(ends, TWISTED, l)), pulled[1]))
            put(start, BY_FORCE, l, add(cross(turn, vector_of(ends, FOLLOWED, l)), pulled[0]))
        spread(seen, start, change)
        for l in range(LANES):
            turn = vector_of(start, BY_TURN, l)
            force, twist = cross(turn, vector_of(ends, FOLLOWED, l)), cross(turn, vector_of(ends, TWISTED, l))
            shift = scaled(-1.0, vector_of(change, 3, l))
            miss = base_miss(work, ends, vector_of(change, 0, l), shift, vector_of(change, 6, l), force, twist, l)
            work[(JACOBIAN + c) * LANES + l] = miss[0]
            work[(JACOBIAN + 6 + c) * LANES + l] = miss[1]
            work[(JACOBIAN + 12 + c) * LANES + l] = miss[2]
            for r in range(3 if springs > 0 else 0):
                fixed = 1.0 if c == 3 + r else 0.0
                work[(JACOBIAN + 6 * (3 + r) + c) * LANES + l] = change[(3 + r) * LANES + l] + fixed


@routine
def by_direction(
    work: Array, ends: Array, springs: int, seen: Array, gamma: Array, d: Array, starts: Array,
    answers: Array, start: Array, factors: Array, change: Array,
) -> None:  # fmt: skip
    """State at the tip `start`, factors and change at the base `change` along a direction, the base kept in its place."""
    for l in range(LANES):
        force, moment = tip_change(work, springs, d, l)
        put(start, BY_TURN, l, (0.0, 0.0, 0.0))
        put(start, BY_MOMENT, l, moment)
        put(start, BY_FORCE, l, force)
    from_within(start, gamma, factors)
    spread(seen, factors, change)
    for l in range(LANES):
        within = (gamma[BY_FORCE, l], gamma[BY_FORCE + 1, l], gamma[BY_FORCE + 2, l])
        put(change, 3, l, along(vector_of(change, 3, l), -1.0, within))
        q = quaternion_of(work, TIP, l)
        force, twist = turned(q, three(d, TIP_FORCE, l)), turned(q, three(d, TIP_MOMENT, l))
        shift = scaled(-1.0, vector_of(change, 3, l))
        miss = base_miss(work, ends, vector_of(change, 0, l), shift, vector_of(change, 6, l), force, twist, l)
        put(work, MISS, l, add(miss, base_change(work, ends, d, l)))
    if springs > 0:
        for l in range(LANES):
            put(work, MISS + 3, l, vector_of(change, 3, l))
            eliminate(work, l)
    else:
        for l in range(LANES):
            put(work, TURN, l, by_cofactors(jacobian_of(work, l), vector_of(work, MISS, l)))
    for c in range(len(starts)):
        at_tip, at_base = starts[c], answers[c]
        for l in range(LANES):
            by = work[(TURN + c) * LANES + l]
            for k in (0, 3, 6):
                put(start, k, l, along(vector_of(start, k, l), by, vector_of(at_tip, k, l)))
                put(factors, k, l, along(vector_of(factors, k, l), by, vector_of(at_tip, k, l)))
                put(change, k, l, along(vector_of(change, k, l), by, vector_of(at_base, k, l)))


@kernel
def differentiate(
    rods: Array,
    head: int,
    block: int,
    rises: Array | None,
    series: Array | None,
    springs: int,
    divisions: float,
    steps: Counts,
    strained: bool,
    arcs: Array,
    attached: int,
    directions: Array,
    solved: Array,
    out: Array,
) -> None:
    """d outputs / d parameter (n, k, outputs) for directions (n or 1, k, width) of rows, at the solutions `solved`. `steps` as in
    `solve_direct`.

    `arcs` (n, s) are stations, m from the base; the first `attached` of them go with their share of an element when
    lengths change, the others stay where they are.
    """
    n, width = rods.shape
    stations, size = arcs.shape[1], (width - head) // block
    work, elements, parts = np.zeros(DESK * LANES), new_elements(size), np.empty(size, np.int64)
    count = FREE + (size if strained else 0)
    x, ends, moment = np.zeros((size, count, CELL * LANES)), np.zeros(ENDS * LANES), np.zeros(3 * LANES)
    passed, walked = np.zeros((stations, *x.shape)), np.zeros((stations + 1, size, LANES))
    seen = np.zeros((stations + 1, FREE, SEEN * LANES))
    unknowns = 6 if springs > 0 else 3
    starts, answers = np.zeros((unknowns, FREE * LANES)), np.zeros((unknowns, SEEN * LANES))
    start, factors, change, aside = (
        np.zeros(FREE * LANES),
        np.zeros(FREE * LANES),
        np.zeros(SEEN * LANES),
        np.zeros(SEEN * LANES),
    )
    d, some, gamma = np.zeros((width, LANES)), np.zeros(width, np.bool_), np.zeros((count + 3, LANES))
    kept, slopes = np.zeros((count + 1, CELL * LANES)), np.zeros((stations, 6 * LANES))
    walked[stations] = 1.0
    for first in range(0, n, LANES):
        active = min(LANES, n - first)
        for l in range(LANES):
            row = min(first + l, n - 1)
            gather_ends(rods, row, head, block, work, l)
            gather_elements(rods, row, head, block, elements, rises, series, l)
            work[LARGEST * LANES + l] = solved[row, AT_LARGEST]
            for k in range(4):
                work[(TIP + k) * LANES + l] = solved[row, AT_ORIENTATION + k]
            for k in range(3):
                work[(HELD + k) * LANES + l] = solved[row, AT_TIP + k]
        cut(work, elements, parts, divisions, active)
        if steps.shape[0] > 0:
            fixed_cut(steps, first, parts, active)
        set_tip(work, 1.0, LANES)
        pull(work, springs, LANES)
        start_columns(work, x, moment)
        for e in range(size):
            # An element that no rod of the group has still tells what its length would do.
            pieces = max(parts[e], 1)
            lay_out(work, elements, rises, series, e)
            if e > 0:
                # Columns go on from where they left the element before, and collect anew.
                for c in range(count):
                    copy_numbers(x[e - 1, c], x[e, c], STRETCHED * LANES)
            for j in range(pieces):
                for s in range(stations):
                    visit(work, elements, rises, series, e, j, pieces, x, arcs, first, active, s, seen[s], passed[s],
                          walked[s], slopes[s], kept)  # fmt: skip
                for l in range(LANES):
                    work[STEP_ON_DESK * LANES + l] = 1.0
                step_all(work, x[e], rises, series, e, 1.0 - j / pieces, -1.0 / pieces)
        read_base(work, LANES)
        for l in range(LANES):
            look(work, ends, rods, min(first + l, n - 1), l)
        see_all(work, x[size - 1], seen[stations])
        by_unknowns(work, ends, springs, seen[stations], starts, answers)
        for k in range(directions.shape[1]):
            spell(directions, n, first, k, d, some)
            if not some.any():
                out[first : first + active, k] = 0.0
                continue
            contract(x, walked[stations], elements, moment, d, some, block, gamma)
            by_direction(work, ends, springs, seen[stations], gamma, d, starts, answers, start, factors, change)
            write(start, factors, change, out, first, k, active)
            at = OUTPUTS
            if strained:
                write_strains(x, gamma, factors, out, first, k, active)
                at += size
            for s in range(stations):
                contract(passed[s], walked[s], elements, moment, d, some, block, gamma)
                from_within(start, gamma, factors)
                spread(seen[s], factors, aside)
                for l in range(active):
                    # What was followed is a share of an element; the station stays at its arc length.
                    slid = 0.0
                    for e in range(size):
                        slid += (1.0 - walked[s, e, l]) * d[width - (e + 1) * block + LENGTH, l]
                    if s < attached:
                        slid = 0.0
                    for q in range(3):
                        shift = aside[(3 + q) * LANES + l] - gamma[BY_FORCE + q, l]
                        shift -= change[(3 + q) * LANES + l]
                        out[first + l, k, at + STATION * s + q] = shift - slid * slopes[s, q * LANES + l]
                        out[first + l, k, at + STATION * s + 3 + q] = (
                            aside[q * LANES + l] - slid * slopes[s, (3 + q) * LANES + l]
                        )


@routine
def write(start: Array, factors: Array, change: Array, out: Array, row: int, k: int, active: int) -> None:
    """What comes out at the ends."""
    for l in range(active):
        for q in range(3):
            out[row + l, k, BY_TIP + q] = -change[(3 + q) * LANES + l]
            out[row + l, k, BY_ROTATION + q] = start[(BY_TURN + q) * LANES + l]
            out[row + l, k, BY_BASE_FORCE + q] = factors[(BY_FORCE + q) * LANES + l]
            out[row + l, k, BY_BASE_MOMENT + q] = change[(6 + q) * LANES + l]
            out[row + l, k, BY_BASE_TURN + q] = change[q * LANES + l]


@routine
def write_strains(x: Array, gamma: Array, factors: Array, out: Array, row: int, k: int, active: int) -> None:
    """The mean strain of each element; those of the outputs run from the base, those of the pass from the tip."""
    size = len(x)
    for e in range(size):
        for l in range(active):
            total = gamma[FREE + e, l]
            for j in range(FREE):
                total += x[e, j, STRETCHED * LANES + l] * factors[j * LANES + l]
            out[row + l, k, OUTPUTS + size - 1 - e] = total


@routine
def visit(
    work: Array, elements: Array, rises: Array | None, series: Array | None, e: int, j: int, pieces: int, x: Array,
    arcs: Array, first: int, active: int, s: int, seen: Array, passed: Array, walked: Array, slopes: Array,
    kept: Array,
) -> None:  # fmt: skip
    """Look at station s from the lanes where step j of the element's `pieces` passes it, then bring them back."""
    z = 1.0 - j / pieces
    inside = np.zeros(LANES, np.bool_)
    for l in range(active):
        share = passes_by(elements, e, j, pieces, len(x), arcs[first + l, s], l)
        inside[l] = share >= 0.0
        work[STEP_ON_DESK * LANES + l] = max(share, 0.0)
    if not inside.any():
        return
    own = x[e]
    copy_numbers(work, kept[0], STATE * LANES)
    for c in range(len(own)):
        copy_numbers(own[c], kept[1 + c], CELL * LANES)
    step_all(work, own, rises, series, e, z, -1.0 / pieces)
    for l in range(active):
        if not inside[l]:
            continue
        # What position and orientation do along the arc, in the mount frame.
        q, n, m = unit_quaternion(work, l), vector_of(work, N, l), vector_of(work, M, l)
        section = (
            vector_of(work, ON_DESK + 1, l), vector_of(work, ON_DESK + 4, l),
            vector_of(work, ON_DESK + 7, l), vector_of(work, ON_DESK + 10, l),
        )  # fmt: skip
        u, v = strains(
            m,
            turned_back(q, n),
            section,
            z - work[STEP_ON_DESK * LANES + l] / pieces,
            rises,
            series,
            (3 * e, 9 * e),
            l,
            None,
            0,
        )
        put(slopes, 0, l, turned(q, v))
        put(slopes, 3, l, turned(q, u))
        for c in range(FREE):
            see(work, own[c], seen[c], l)
        for i in range(len(x)):
            walked[i, l] = 1.0 if i < e else 1.0 - z + work[STEP_ON_DESK * LANES + l] / pieces if i == e else 0.0
            for c in range(len(own)):
                for k in range(CELL):
                    passed[i, c, k * LANES + l] = x[i, c, k * LANES + l] if i <= e else 0.0
    copy_numbers(kept[0], work, STATE * LANES)
    for c in range(len(own)):
        copy_numbers(kept[1 + c], own[c], CELL * LANES)


@routine
def passes_by(elements: Array, e: int, j: int, pieces: int, size: int, arc: float, l: int) -> float:
    """Share of step j of element e at which lane l passes the arc length (m from the base); negative if it does not."""
    below = 0.0
    for i in range(e + 1, size):
        below += elements[i * ELEMENT * LANES + l]
    length = elements[e * ELEMENT * LANES + l]
    above = arc - below
    # Exactly nothing at the end: compilers may divide by multiplying.
    start, end = (1.0 - j / pieces) * length, (1.0 - (j + 1) / pieces) * length if j + 1 < pieces else 0.0
    outermost, innermost = e == 0 and j == 0, j + 1 == pieces and below == 0.0
    inside = (end < above or (innermost and end <= above)) and (above <= start or outermost)
    # Of the elements that touch the station, one without a length sees only half of what is to come.
    if not inside or (length == 0.0 and not innermost):
        return -1.0
    return min(1.0, max(0.0, (start - above) / (start - end))) if start > end else 0.0
