"""The direct solve: groups of rods from a cold or warm start to the result of each, no load steps."""

from __future__ import annotations

import math

from model.arrays import Array, Ints
from model.rods.fast.algebra import Vector, add, dot, scaled, turned
from model.rods.fast.compiler import inline, kernel, routine
from model.rods.fast.group import ROD, Rod, RodGroup, Six, cut, each_rod, fixed_cut, gather, new_group
from model.rods.fast.lanes import LANES, LaneRecord
from model.rods.fast.newton import (
    NEAR,
    buckling_margin,
    correct,
    difference_jacobian,
    expected_residual,
    first_guess,
    improve,
    size_of,
    worst_residual,
)  # fmt: skip
from model.rods.fast.passes import WHOLE, evaluate, orientation
from model.rods.solution import AT_FORCE, AT_LARGEST, AT_LOAD, AT_MARGIN, AT_MOMENT, AT_ORIENTATION, AT_RESIDUAL, AT_TIP

MEMORY, MEMORY_SPRINGS = 23, 62
"""What a warm start needs: orientation (4), Jacobian (9), d seen / d change (9), largest moment (N m). With springs both matrices
are for six unknowns (36, 18), and the position (3) comes behind the orientation."""

FEW = 3
"""Rods that are solved one by one, as quickly as a whole group."""
COARSE_DIVISIONS = 1.0
"""Steps of a coarse pass along the whole rod: one an element, as a rule."""
MOST_MOVED = 3.0
"""m of tip motion per m of rod and rad of turn."""
ROUNDS = 12
"""Most steps of a group's search."""
RENEWALS = 2
"""Times that a group whose residual stays above `close` gets another Jacobian."""
MOST_DRIFT = 1e-4
"""Of the squared norm of q over a pass; good solves stay below 1e-5."""


def memory_of(springs: int) -> int:
    """Columns of the memory of a rod."""
    return MEMORY_SPRINGS if springs else MEMORY


@inline
def put_three(out: Array, row: int, at: int, a: Vector) -> None:
    """Three numbers of a row."""
    out[row, at], out[row, at + 1], out[row, at + 2] = a


@inline
def weighed_rows(rows: list[Six], change: Six) -> Vector:
    """Three rows of a matrix times a change."""
    x, y, z = rows[0], rows[1], rows[2]
    turn, shift = change.turn, change.shift
    return add(
        (dot(x.turn, turn), dot(y.turn, turn), dot(z.turn, turn)), (dot(x.shift, shift), dot(y.shift, shift), dot(z.shift, shift))
    )


@routine
def write_result(rod: Rod, springs: int, out: Array, row: int) -> None:
    """Write a solved rod into a row of `out`: read at the base, then moved by the last correction, which no pass has followed."""
    change, shift = rod.change, weighed_rows(rod.seen_by, rod.change)
    put_three(out, row, AT_TIP, add(rod.found.seen, shift))
    w, x, y, z = rod.tip.turn
    sign = math.copysign(1.0, w)
    out[row, AT_ORIENTATION] = sign * w
    put_three(out, row, AT_ORIENTATION + 1, scaled(sign, (x, y, z)))
    put_three(out, row, AT_FORCE, rod.here.force)
    put_three(out, row, AT_MOMENT, turned(orientation(rod.here), rod.here.m))
    a, b, c, d = rod.here.q
    # With steps far too long the residual can vanish without an equilibrium; the norm of q, which nothing holds at 1, shows it.
    closed = abs(a * a + b * b + c * c + d * d - 1.0) < MOST_DRIFT
    # No tip moves by much more than the rod's length times the turn of tip or base: a d seen / d change that says so comes from
    # such steps too.
    turn = max(size_of(change), size_of(rod.found.residual))
    closed = closed and dot(shift, shift) <= (MOST_MOVED * rod.length * turn) ** 2
    out[row, AT_RESIDUAL] = expected_residual(rod) if closed else math.inf
    out[row, AT_MARGIN] = buckling_margin(rod, springs)
    out[row, AT_LARGEST] = rod.largest_moment
    out[row, AT_LOAD] = rod.load_share


@kernel
def solve_direct(rods: Array, springs: int, settings: tuple[float, float, bool], steps: Ints, memory: Array, out: Array) -> None:
    """Solve every row of `rods` (see `columns`) and write a row of `out` (see `solution`).

    `settings` are divisions, close and whether to start from `memory` (n or 0 rows), which is always written. `steps` (n or 0
    rows) fixes the fine steps. Rows that did not converge have an AT_RESIDUAL that is not below `close`.
    """
    n = rods.shape[0]
    divisions, close, warm = settings
    room = new_group(rods, springs, ROD)
    for first in range(0, n, LANES):
        count = min(LANES, n - first)
        # A few rods are quicker one by one, more of them in all lanes: those without a rod then hold the last one.
        group = RodGroup(room.work, room.elements, room.parts, springs, room.linear, count if count <= FEW else LANES)
        gather(rods, group, first)
        if warm:
            for l in range(group.active):
                exchange(Rod(group.work, l), springs, memory, min(first + l, n - 1), False)
        else:
            cut(group, COARSE_DIVISIONS)
            first_guess(group)
            difference_jacobian(group)
            improve(group, NEAR, ROUNDS)
            see_largest_moment(group)
        cut(group, divisions)
        fixed_cut(group, steps, first)
        evaluate(group, group.springs, WHOLE)
        improve(group, close, ROUNDS)
        for _ in range(RENEWALS):
            if worst_residual(group) < close:
                break
            difference_jacobian(group)
            improve(group, close, ROUNDS)
        correct(group)
        for l in range(count):
            write_result(Rod(group.work, l), springs, out, first + l)
            if memory.shape[0] > 0:
                exchange(Rod(group.work, l), springs, memory, first + l, True)


@each_rod
def see_largest_moment(rod: Rod) -> None:
    """What the coarse solution met; it sets the fine steps."""
    rod.largest_moment = math.sqrt(rod.here.peak)


@routine
def exchange(rod: Rod, springs: int, memory: Array, row: int, keep: bool) -> None:
    """Copy tip pose, Jacobians and largest moment of a rod to a row of `memory` (`keep`) or from there, to start from it."""
    unknowns = 6 if springs > 0 else 3
    at = carry(rod.tip, 1 + unknowns, memory, row, 0, keep)
    at = carry_rows(rod.jacobian.turn, unknowns, memory, row, at, keep)
    if springs > 0:
        at = carry_rows(rod.jacobian.shift, unknowns, memory, row, at, keep)
    at = carry_rows(rod.seen_by, unknowns, memory, row, at, keep)
    if keep:
        memory[row, at] = rod.largest_moment
    else:
        rod.largest_moment = memory[row, at]


@inline
def carry_rows(rows: list[Six], count: int, memory: Array, row: int, at: int, keep: bool) -> int:
    """The same of three rows of a matrix."""
    for k in range(3):
        at = carry(rows[k], count, memory, row, at, keep)
    return at


@inline
def carry(numbers: LaneRecord, count: int, memory: Array, row: int, at: int, keep: bool) -> int:
    """Carry numbers to or from the columns of a memory from `at` on; returns the next."""
    for k in range(count):
        if keep:
            memory[row, at + k] = numbers[k]
        else:
            numbers[k] = memory[row, at + k]
    return at + count
