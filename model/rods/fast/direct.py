"""The direct solve: groups of rods from a cold or warm start to the result of each, no load steps."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from model.rods.fast.algebra import dot, turned
from model.rods.fast.jit import inline, kernel, routine
from model.rods.fast.lanes import (
    ANCHOR,
    JACOBIAN,
    LANES,
    LARGEST_MOMENT,
    LOAD_SHARE,
    PEAK_M2,
    PLACE,
    PLACE_BY_TURN,
    ROD_LENGTH,
    TIP,
    TURN,
    Counts,
    Full,
    Group,
    M,
    N,
    Q,
    RowLayout,
    cut,
    elements_of,
    fixed_cut,
    gather_rod,
    new_elements,
    new_work,
    quaternion_of,
    vector_of,
)
from model.rods.fast.newton import (
    NEAR,
    buckling_margin,
    difference_jacobian,
    expected_residual,
    first_guess,
    improve,
    newton_turn,
    size_of,
    worst_residual,
)
from model.rods.fast.passes import evaluate, turn_tip, unit_quaternion
from model.rods.solution import (
    AT_FORCE,
    AT_LARGEST,
    AT_LOAD,
    AT_MARGIN,
    AT_MOMENT,
    AT_ORIENTATION,
    AT_RESIDUAL,
    AT_TIP,
)

Array = NDArray[np.float64]

MEMORY, MEMORY_SPRINGS = 23, 62
"""What a warm start needs: orientation (4), Jacobian (9), d PLACE / d TURN (9), largest moment (N m). With springs both matrices
are for six unknowns (36, 18), and the position (3) comes behind the orientation."""

FEW = 3
"""Rods that are solved one by one, as quickly as a whole group."""
COARSE_DIVISIONS = 1.0
"""Steps of a coarse pass along the whole rod: one an element, as a rule."""
MOST_MOVED = 3.0
"""m of tip motion per m of rod and rad of turn."""
ROUNDS = 12
RENEWALS = 2
"""Times that a group whose residual stays above `close` gets another Jacobian."""
MOST_DRIFT = 1e-4
"""Of the squared norm of q over a pass; good solves stay below 1e-5."""


def memory_of(springs: int) -> int:
    """Columns of the memory of a rod."""
    return MEMORY_SPRINGS if springs else MEMORY


@routine
def write_result(work: Array, springs: int, out: Array, row: int, l: int) -> None:
    """What was read at the base, with the last correction (TURN, already made) moved_by over to first order."""
    q = quaternion_of(work, TIP, l)
    sign = math.copysign(1.0, q[0])
    turn = vector_of(work, TURN, l)
    moved_by = 0.0
    for k in range(3):
        moved = dot(vector_of(work, PLACE_BY_TURN + 6 * k, l), turn)
        if springs > 0:
            moved += dot(vector_of(work, PLACE_BY_TURN + 6 * k + 3, l), vector_of(work, TURN + 3, l))
        out[row, AT_TIP + k] = work[(PLACE + k) * LANES + l] + moved
        moved_by += moved * moved
    moment = turned(unit_quaternion(work, l), vector_of(work, M, l))
    out[row, AT_ORIENTATION], out[row, AT_ORIENTATION + 1] = sign * q[0], sign * q[1]
    out[row, AT_ORIENTATION + 2], out[row, AT_ORIENTATION + 3] = sign * q[2], sign * q[3]
    for k in range(3):
        out[row, AT_FORCE + k] = work[(N + k) * LANES + l]
    out[row, AT_MOMENT], out[row, AT_MOMENT + 1], out[row, AT_MOMENT + 2] = moment
    a, b, c, d = quaternion_of(work, Q, l)
    # Steps far too long can close a rod that is none; the norm of q, which nothing holds at 1, gives them away.
    closed = abs(a * a + b * b + c * c + d * d - 1.0) < MOST_DRIFT
    # No tip moves by much more than the rod's length times the turn: a d PLACE / d TURN that says so comes from such steps too.
    closed = closed and moved_by <= (MOST_MOVED * work[ROD_LENGTH * LANES + l] * size_of(work, TURN, springs, l)) ** 2
    out[row, AT_RESIDUAL] = expected_residual(work, springs, l) if closed else math.inf
    out[row, AT_MARGIN] = buckling_margin(work, springs, l)
    out[row, AT_LARGEST] = work[LARGEST_MOMENT * LANES + l]
    out[row, AT_LOAD] = work[LOAD_SHARE * LANES + l]


@kernel
def solve_direct(
    rods: Array,
    layout: tuple[int, int, int],
    full: Full,
    settings: tuple[float, float, bool],
    steps: Counts,
    memory: Array,
    out: Array,
) -> None:
    """Solve every row of `rods` (see `columns`) and write a row of `out` (see `solution`).

    `layout` is that of `RowLayout` (a plain tuple comes in ten times faster), `settings` are divisions, close and whether
    to start from `memory` (n or 0 rows), which is always written. `steps` (n or 0 rows) fixes the fine steps. Rows that did
    not converge have an AT_RESIDUAL that is not below `close`.
    """
    n, at = rods.shape[0], RowLayout(layout[0], layout[1], layout[2])
    divisions, close, warm = settings
    work, count = new_work(), elements_of(rods, at)
    parts, elements = np.empty(count, np.int64), new_elements(count)
    for first in range(0, n, LANES):
        own = min(LANES, n - first)
        # Side by side many are quicker than one by one: lanes without a rod then hold the last one.
        group = Group(work, elements, full, parts, at.springs, own if own <= FEW else LANES)
        for l in range(group.active):
            gather_rod(rods, min(first + l, n - 1), at, group, l)
        if warm:
            recall(memory, first, group)
        else:
            cut(group, COARSE_DIVISIONS)
            first_guess(group)
            difference_jacobian(group)
            improve(group, NEAR, ROUNDS)
            for l in range(group.active):
                work[LARGEST_MOMENT * LANES + l] = math.sqrt(work[PEAK_M2 * LANES + l])
        cut(group, divisions)
        fixed_cut(group, steps, first)
        evaluate(group, group.springs, 1.0)
        improve(group, close, ROUNDS)
        for _ in range(RENEWALS):
            if worst_residual(group) < close:
                break
            difference_jacobian(group)
            improve(group, close, ROUNDS)
        newton_turn(group)
        turn_tip(group)
        for l in range(own):
            write_result(work, group.springs, out, first + l, l)
        if memory.shape[0] > 0:
            remember(group, memory, first)


@inline
def recall(memory: Array, first: int, group: Group) -> None:
    """Start from the pose and the Jacobians of an earlier solve; its largest moment sets the steps."""
    work, active = group.work, group.active
    shift, unknowns = (3, 6) if group.springs > 0 else (0, 3)
    jacobian, by_turn = 4 + shift, 4 + shift + unknowns * unknowns
    for l in range(active):
        row = min(first + l, memory.shape[0] - 1)
        for k in range(4):
            work[(TIP + k) * LANES + l] = memory[row, k]
        for k in range(shift):
            work[(ANCHOR + k) * LANES + l] = memory[row, 4 + k]
        for c in range(unknowns):
            for r in range(unknowns):
                work[(JACOBIAN + 6 * r + c) * LANES + l] = memory[row, jacobian + unknowns * r + c]
            for r in range(3):
                work[(PLACE_BY_TURN + 6 * r + c) * LANES + l] = memory[row, by_turn + unknowns * r + c]
        work[LARGEST_MOMENT * LANES + l] = memory[row, by_turn + 3 * unknowns]


@inline
def remember(group: Group, memory: Array, first: int) -> None:
    """Keep what `recall` reads."""
    work, active = group.work, min(group.active, memory.shape[0] - first)
    shift, unknowns = (3, 6) if group.springs > 0 else (0, 3)
    jacobian, by_turn = 4 + shift, 4 + shift + unknowns * unknowns
    for l in range(active):
        row = first + l
        for k in range(4):
            memory[row, k] = work[(TIP + k) * LANES + l]
        for k in range(shift):
            memory[row, 4 + k] = work[(ANCHOR + k) * LANES + l]
        for c in range(unknowns):
            for r in range(unknowns):
                memory[row, jacobian + unknowns * r + c] = work[(JACOBIAN + 6 * r + c) * LANES + l]
            for r in range(3):
                memory[row, by_turn + unknowns * r + c] = work[(PLACE_BY_TURN + 6 * r + c) * LANES + l]
        memory[row, by_turn + 3 * unknowns] = work[LARGEST_MOMENT * LANES + l]
