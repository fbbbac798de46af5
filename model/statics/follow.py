"""Following a rod's equilibrium while its loads grow from nothing: slower, and sure of the branch it ends on.

A rod that the direct solve could not bring to rest, or brought to rest near or beyond a buckling point, is loaded
step by step. Each step starts from the last equilibrium with a fresh Jacobian, and counts only when the new
equilibrium is close by and still on the near side of buckling; otherwise the step is halved. What cannot be passed
that way is a fold or a branching point: there the rod snaps, and the last share of the load is the answer.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from model.statics.group import AT_LARGEST, new_elements, write_result
from model.statics.jit import inline, kernel
from model.statics.lanes import (
    JACOBIAN,
    LANES,
    LARGEST,
    SHARE,
    TIP,
    cut,
    gather_elements,
    gather_ends,
    new_work,
    quaternion_of,
)
from model.statics.newton import difference_jacobian, first_guess, improve, left_over, near_side, newton_turn
from model.statics.passes import evaluate, turn_tip

Array = NDArray[np.float64]
Flags = NDArray[np.int8]
Rows = NDArray[np.int64]

FIRST_STEP, LEAST_STEP = 0.1, 1e-4
"""Share of the load."""
MOST_TRIES = 300
ROUNDS = 6
FARTHEST = 0.35
"""rad: a tip that turns by more within one step may have changed branch."""
FOLLOWED, LOST = 1, 0

BOTH_JACOBIANS = 54
"""JACOBIAN and CARRY lie side by side."""


@kernel
def follow_load(
    rods: Array,
    head: int,
    block: int,
    rises: Array | None,
    series: Array | None,
    springs: int,
    divisions: float,
    close: float,
    rows: Rows,
    least_margin: float,
    out: Array,
    reached: Flags,
) -> None:
    """Load the rods listed in `rows` from zero and write their rows of `out`; `reached[i]` is FOLLOWED or LOST.

    A rod that is lost holds its last equilibrium and the share of load it belongs to.
    """
    work = new_work()
    good = np.empty(7 + BOTH_JACOBIANS)
    count = (rods.shape[1] - head) // block
    parts = np.empty(count, np.int64)
    elements = new_elements(count)
    for i in range(rows.shape[0]):
        row = rows[i]
        gather_ends(rods, row, head, block, work, 0)
        gather_elements(rods, row, head, block, elements, rises, series, 0)
        work[LARGEST * LANES] = out[row, AT_LARGEST]
        cut(work, elements, parts, divisions, 1)
        work[SHARE * LANES] = 0.0
        first_guess(work, elements, rises, series, parts, 1)
        difference_jacobian(work, elements, rises, series, parts, springs, 1)
        share, step = 0.0, FIRST_STEP
        tries = 0
        while share < 1.0 and step >= LEAST_STEP and tries < MOST_TRIES:
            tries += 1
            keep(work, good)
            work[SHARE * LANES] = min(1.0, share + step)
            evaluate(work, elements, rises, series, parts, springs, 1.0, 1)
            rounds = improve(work, elements, rises, series, parts, springs, 1, close, ROUNDS)
            if left_over(work, springs, 0) < close and turned_by(work, good) < FARTHEST:
                difference_jacobian(work, elements, rises, series, parts, springs, 1)
                if near_side(work, springs, 0) > least_margin:
                    share = work[SHARE * LANES]
                    if rounds <= 3:
                        step *= 2.0
                    continue
            bring_back(work, good)
            step *= 0.5
        work[SHARE * LANES] = share
        evaluate(work, elements, rises, series, parts, springs, 1.0, 1)
        newton_turn(work, springs, 1)
        turn_tip(work, springs, 1)
        write_result(work, springs, out, row, 0)
        reached[i] = FOLLOWED if share >= 1.0 else LOST


@inline
def keep(work: Array, good: Array) -> None:
    """Remember the unknowns and Jacobians of lane 0."""
    for k in range(7):
        good[k] = work[(TIP + k) * LANES]
    for k in range(BOTH_JACOBIANS):
        good[7 + k] = work[(JACOBIAN + k) * LANES]


@inline
def bring_back(work: Array, good: Array) -> None:
    """Undo what happened since `keep`."""
    for k in range(7):
        work[(TIP + k) * LANES] = good[k]
    for k in range(BOTH_JACOBIANS):
        work[(JACOBIAN + k) * LANES] = good[7 + k]


@inline
def turned_by(work: Array, good: Array) -> float:
    """Angle (rad) between the tip's orientation now and when it was kept."""
    q = quaternion_of(work, TIP, 0)
    same = abs(q[0] * good[0] + q[1] * good[1] + q[2] * good[2] + q[3] * good[3])
    return 2.0 * math.acos(min(1.0, same))
