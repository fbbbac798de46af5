"""Implicit differentiation at a solution, a group of rods at a time.

With x the unknowns (pose of the tip), G(x, p) = 0 the miss of the base and y(x, p) what is read there,
    dx/dp = -(dG/dx)^-1 dG/dp,   dy/dp = dy/dx dx/dp + dy/dp.
The partial derivatives are central differences of single passes, so nothing is solved again: two passes for each
unknown and two for each direction in parameter space, whatever the section law.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from model.statics.algebra import turned
from model.statics.group import AT_LARGEST, AT_ORIENTATION, AT_TIP, new_elements
from model.statics.jit import inline, kernel
from model.statics.lanes import (
    HELD,
    JACOBIAN,
    KEPT,
    LANES,
    LARGEST,
    MISS,
    PLACE,
    TIP,
    TURN,
    M,
    N,
    cut,
    gather_elements,
    gather_ends,
    new_work,
    put,
    vector_of,
)
from model.statics.newton import by_cofactors, copy, eliminate, jacobian_of
from model.statics.passes import evaluate, turn_tip, unit_quaternion

Array = NDArray[np.float64]

NUDGE = 2e-5
"""Change of an unknown (rad, lengths): truncation and rounding of a central difference are both near 1e-10 there."""
BY_TIP, BY_TURN, BY_FORCE, BY_MOMENT = 0, 3, 6, 9
"""d tip (m), d rotation of the tip (rad, mount frame), d base force (N), d base moment (N m) by a parameter."""
READ = 9
"""Place (3), base force (3) and base moment (3): what a pass reads beside the miss."""
OUTPUTS = 12


@inline
def read(work: Array, active: int, sign: float, scale: float, misses: Array, reads: Array, column: int) -> None:
    """Add sign scale times the miss and the readings of the last pass to a column of derivatives."""
    for l in range(active):
        moment = turned(unit_quaternion(work, l), vector_of(work, M, l))
        for k in range(6):
            misses[l, k, column] += sign * scale * work[(MISS + k) * LANES + l]
        for k in range(3):
            reads[l, k, column] += sign * scale * work[(PLACE + k) * LANES + l]
            reads[l, 3 + k, column] += sign * scale * work[(N + k) * LANES + l]
        reads[l, 6, column] += sign * scale * moment[0]
        reads[l, 7, column] += sign * scale * moment[1]
        reads[l, 8, column] += sign * scale * moment[2]


@kernel
def differentiate(
    rods: Array,
    head: int,
    block: int,
    rises: Array | None,
    series: Array | None,
    springs: int,
    divisions: float,
    directions: Array,
    nudges: Array,
    solved: Array,
    out: Array,
) -> None:
    """d outputs / d parameter (n, k, OUTPUTS) for directions (n or 1, k, width) of rows, at the solutions `solved`.

    `nudges` (n or 1, k) says how far each direction is followed for its difference.
    """
    n, width = rods.shape
    count = directions.shape[1]
    unknowns = 6 if springs > 0 else 3
    work = new_work()
    parts = np.empty((width - head) // block, np.int64)
    elements = new_elements(parts.size)
    trial = np.empty((LANES, width))
    misses, reads = np.empty((LANES, 6, unknowns + count)), np.empty((LANES, READ, unknowns + count))
    for first in range(0, n, LANES):
        active = min(LANES, n - first)
        misses[:], reads[:] = 0.0, 0.0
        for l in range(active):
            gather_ends(rods, first + l, head, block, work, l)
            gather_elements(rods, first + l, head, block, elements, rises, series, l)
            work[LARGEST * LANES + l] = solved[first + l, AT_LARGEST]
            for k in range(4):
                work[(TIP + k) * LANES + l] = solved[first + l, AT_ORIENTATION + k]
            for k in range(3):
                work[(HELD + k) * LANES + l] = solved[first + l, AT_TIP + k]
        cut(work, elements, parts, divisions, active)
        copy(work, TIP, KEPT, 7)
        for c in range(unknowns):
            for sign in (1.0, -1.0):
                for k in range(6):
                    for l in range(LANES):
                        work[(TURN + k) * LANES + l] = sign * NUDGE if k == c else 0.0
                turn_tip(work, springs, active)
                evaluate(work, elements, rises, series, parts, springs, 1.0, active)
                read(work, active, sign, 0.5 / NUDGE, misses, reads, c)
                copy(work, KEPT, TIP, 7)
        for c in range(count):
            for sign in (1.0, -1.0):
                for l in range(active):
                    row = first + l if directions.shape[0] > 1 else 0
                    nudge = sign * nudges[row, c]
                    for k in range(width):
                        trial[l, k] = rods[first + l, k] + nudge * directions[row, c, k]
                    gather_ends(trial, l, head, block, work, l)
                    gather_elements(trial, l, head, block, elements, rises, series, l)
                evaluate(work, elements, rises, series, parts, springs, 1.0, active)
                read(work, active, sign, 0.5, misses, reads, unknowns + c)
        for l in range(active):
            row = first + l if directions.shape[0] > 1 else 0
            for r in range(unknowns):
                for c in range(unknowns):
                    work[(JACOBIAN + 6 * r + c) * LANES + l] = misses[l, r, c]
            for c in range(count):
                scale = 1.0 / nudges[row, c]
                for r in range(unknowns):
                    work[(MISS + r) * LANES + l] = misses[l, r, unknowns + c] * scale
                if springs > 0:
                    eliminate(work, l)
                else:
                    put(work, TURN, l, by_cofactors(jacobian_of(work, l), vector_of(work, MISS, l)))
                for k in range(READ):
                    change = reads[l, k, unknowns + c] * scale
                    for u in range(unknowns):
                        change += reads[l, k, u] * work[(TURN + u) * LANES + l]
                    out[first + l, c, k if k < BY_TURN else k + 3] = change
                for k in range(3):
                    out[first + l, c, BY_TURN + k] = work[(TURN + k) * LANES + l]
