"""The direct solve: groups of rods from a cold or warm start to the result of each, no load steps."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from model.statics.algebra import dot, turned
from model.statics.jit import inline, kernel, routine
from model.statics.lanes import (
    CARRY,
    ELEMENT,
    HELD,
    JACOBIAN,
    LANES,
    LARGEST,
    PEAK,
    PLACE,
    SHARE,
    TIP,
    TURN,
    WHOLE,
    Counts,
    M,
    N,
    Q,
    cut,
    fixed_cut,
    gather_elements,
    gather_ends,
    new_work,
    quaternion_of,
    vector_of,
)
from model.statics.newton import (
    NEAR,
    difference_jacobian,
    first_guess,
    improve,
    left_over,
    near_side,
    newton_turn,
    size_of,
)
from model.statics.passes import evaluate, turn_tip, unit_quaternion

Array = NDArray[np.float64]

AT_TIP, AT_ORIENTATION, AT_FORCE, AT_MOMENT = 0, 3, 7, 10
"""m, quaternion, N, N m; all in the mount frame."""
AT_MISS, AT_MARGIN, AT_LARGEST, AT_FRACTION = 13, 14, 15, 16
"""What is left of the base's miss (rad, lengths), margin to buckling, largest moment (N m), share of load."""
RESULT = 17
MEMORY, MEMORY_SPRINGS = 23, 62
"""What a warm start needs: orientation (4), Jacobian (9), carry (9), largest moment (N m). With springs both matrices
are for six unknowns (36, 18), and the position (3) comes behind the orientation."""

COARSE_DIVISIONS = 1.0
"""Steps of a coarse pass along the whole rod: one an element, as a rule."""
MOST_CARRIED = 3.0
"""m of tip motion per m of rod and rad of turn."""
ROUNDS = 12
MOST_DRIFT = 1e-4
"""Of the squared norm of q over a pass; good solves stay below 1e-5."""


@inline
def new_elements(count: int) -> Array:
    """Room for so many elements."""
    return np.zeros(count * ELEMENT * LANES)


@routine
def write_result(work: Array, springs: int, out: Array, row: int, l: int) -> None:
    """What was read at the base, with the last correction (TURN, already made) carried over to first order."""
    q = quaternion_of(work, TIP, l)
    sign = math.copysign(1.0, q[0])
    turn = vector_of(work, TURN, l)
    carried = 0.0
    for k in range(3):
        moved = dot(vector_of(work, CARRY + 6 * k, l), turn)
        if springs > 0:
            moved += dot(vector_of(work, CARRY + 6 * k + 3, l), vector_of(work, TURN + 3, l))
        out[row, AT_TIP + k] = work[(PLACE + k) * LANES + l] + moved
        carried += moved * moved
    moment = turned(unit_quaternion(work, l), vector_of(work, M, l))
    out[row, AT_ORIENTATION], out[row, AT_ORIENTATION + 1] = sign * q[0], sign * q[1]
    out[row, AT_ORIENTATION + 2], out[row, AT_ORIENTATION + 3] = sign * q[2], sign * q[3]
    for k in range(3):
        out[row, AT_FORCE + k] = work[(N + k) * LANES + l]
    out[row, AT_MOMENT], out[row, AT_MOMENT + 1], out[row, AT_MOMENT + 2] = moment
    a, b, c, d = quaternion_of(work, Q, l)
    # Steps far too long can close a rod that is none; the norm of q, which nothing holds at 1, gives them away.
    closed = abs(a * a + b * b + c * c + d * d - 1.0) < MOST_DRIFT
    # No tip moves by much more than the rod's length times the turn: a CARRY that says so comes from such steps too.
    closed = closed and carried <= (MOST_CARRIED * work[WHOLE * LANES + l] * size_of(work, TURN, springs, l)) ** 2
    out[row, AT_MISS] = left_over(work, springs, l) if closed else math.inf
    out[row, AT_MARGIN] = near_side(work, springs, l)
    out[row, AT_LARGEST] = work[LARGEST * LANES + l]
    out[row, AT_FRACTION] = work[SHARE * LANES + l]


@kernel
def solve_direct(
    rods: Array,
    head: int,
    block: int,
    rises: Array | None,
    series: Array | None,
    springs: int,
    divisions: float,
    close: float,
    steps: Counts,
    memory: Array,
    warm: bool,
    out: Array,
) -> None:
    """Solve every row of `rods` (see `layout`) and write a row of `out`.

    `rises` (9 elements LANES) and `series` (3 elements LANES) are room for such terms, or None when there are none;
    no two threads may share them. `steps` (n or 0 rows) fixes the fine steps. `memory` (n or 0 rows) is read when
    `warm` and always written. Rows that did not converge have an AT_MISS that is not below `close`.
    """
    n = rods.shape[0]
    work = new_work()
    count = (rods.shape[1] - head) // block
    parts = np.empty(count, np.int64)
    elements = new_elements(count)
    for first in range(0, n, LANES):
        active = min(LANES, n - first)
        for l in range(active):
            gather_ends(rods, first + l, head, block, work, l)
            gather_elements(rods, first + l, head, block, elements, rises, series, l)
        if warm:
            recall(memory, first, work, springs, active)
        else:
            cut(work, elements, parts, COARSE_DIVISIONS, active)
            first_guess(work, elements, rises, series, parts, active)
            difference_jacobian(work, elements, rises, series, parts, springs, active)
            improve(work, elements, rises, series, parts, springs, active, NEAR, ROUNDS)
            for l in range(active):
                work[LARGEST * LANES + l] = math.sqrt(work[PEAK * LANES + l])
        cut(work, elements, parts, divisions, active)
        if steps.shape[0] > 0:
            fixed_cut(steps, first, parts, active)
        evaluate(work, elements, rises, series, parts, springs, 1.0, active)
        improve(work, elements, rises, series, parts, springs, active, close, ROUNDS)
        newton_turn(work, springs, active)
        turn_tip(work, springs, active)
        for l in range(active):
            write_result(work, springs, out, first + l, l)
        if memory.shape[0] > 0:
            remember(work, memory, first, springs, active)


@inline
def recall(memory: Array, first: int, work: Array, springs: int, active: int) -> None:
    """Start from the pose and the Jacobians of an earlier solve; its largest moment sets the steps."""
    shift, unknowns = (3, 6) if springs > 0 else (0, 3)
    jacobian, carry = 4 + shift, 4 + shift + unknowns * unknowns
    for l in range(active):
        row = first + l
        for k in range(4):
            work[(TIP + k) * LANES + l] = memory[row, k]
        for k in range(shift):
            work[(HELD + k) * LANES + l] = memory[row, 4 + k]
        for c in range(unknowns):
            for r in range(unknowns):
                work[(JACOBIAN + 6 * r + c) * LANES + l] = memory[row, jacobian + unknowns * r + c]
            for r in range(3):
                work[(CARRY + 6 * r + c) * LANES + l] = memory[row, carry + unknowns * r + c]
        work[LARGEST * LANES + l] = memory[row, carry + 3 * unknowns]


@inline
def remember(work: Array, memory: Array, first: int, springs: int, active: int) -> None:
    """Keep what `recall` reads."""
    shift, unknowns = (3, 6) if springs > 0 else (0, 3)
    jacobian, carry = 4 + shift, 4 + shift + unknowns * unknowns
    for l in range(active):
        row = first + l
        for k in range(4):
            memory[row, k] = work[(TIP + k) * LANES + l]
        for k in range(shift):
            memory[row, 4 + k] = work[(HELD + k) * LANES + l]
        for c in range(unknowns):
            for r in range(unknowns):
                memory[row, jacobian + unknowns * r + c] = work[(JACOBIAN + 6 * r + c) * LANES + l]
            for r in range(3):
                memory[row, carry + unknowns * r + c] = work[(CARRY + 6 * r + c) * LANES + l]
        memory[row, carry + 3 * unknowns] = work[LARGEST * LANES + l]
