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

from model.rods.fast.direct import write_result
from model.rods.fast.jit import inline, kernel
from model.rods.fast.lanes import (
    JACOBIAN,
    LANES,
    LARGEST_MOMENT,
    LOAD_SHARE,
    TIP,
    Full,
    Group,
    RowLayout,
    cut,
    elements_of,
    gather_rod,
    new_elements,
    new_work,
    quaternion_of,
)
from model.rods.fast.newton import (
    buckling_margin,
    difference_jacobian,
    expected_residual,
    first_guess,
    improve,
    newton_turn,
)
from model.rods.fast.passes import evaluate, turn_tip
from model.rods.solution import AT_LARGEST

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
"""JACOBIAN and PLACE_BY_TURN lie side by side."""


@kernel
def follow_load(
    rods: Array,
    layout: tuple[int, int, int],
    full: Full,
    settings: tuple[float, float, float],
    rows: Rows,
    out: Array,
    reached: Flags,
) -> None:
    """Load the rods listed in `rows` from zero and write their rows of `out`; `reached[i]` is FOLLOWED or LOST.

    `settings` are divisions, close and the least margin to buckling. A rod that is lost holds its last equilibrium and the
    share of load it belongs to.
    """
    at = RowLayout(layout[0], layout[1], layout[2])
    divisions, close, least_margin = settings
    work, count = new_work(), elements_of(rods, at)
    saved = np.empty(7 + BOTH_JACOBIANS)
    group = Group(work, new_elements(count), full, np.empty(count, np.int64), at.springs, 1)
    for i in range(rows.shape[0]):
        row = rows[i]
        gather_rod(rods, row, at, group, 0)
        work[LARGEST_MOMENT * LANES] = out[row, AT_LARGEST]
        cut(group, divisions)
        work[LOAD_SHARE * LANES] = 0.0
        first_guess(group)
        difference_jacobian(group)
        share, step = 0.0, FIRST_STEP
        tries = 0
        while share < 1.0 and step >= LEAST_STEP and tries < MOST_TRIES:
            tries += 1
            save(work, saved)
            work[LOAD_SHARE * LANES] = min(1.0, share + step)
            evaluate(group, group.springs, 1.0)
            rounds = improve(group, close, ROUNDS)
            if expected_residual(work, group.springs, 0) < close and turned_by(work, saved) < FARTHEST:
                difference_jacobian(group)
                if buckling_margin(work, group.springs, 0) > least_margin:
                    share = work[LOAD_SHARE * LANES]
                    if rounds <= 3:
                        step *= 2.0
                    continue
            restore(work, saved)
            step *= 0.5
        work[LOAD_SHARE * LANES] = share
        evaluate(group, group.springs, 1.0)
        newton_turn(group)
        turn_tip(group)
        write_result(work, group.springs, out, row, 0)
        reached[i] = FOLLOWED if share >= 1.0 else LOST


@inline
def save(work: Array, saved: Array) -> None:
    """Save the unknowns and Jacobians of lane 0."""
    for k in range(7):
        saved[k] = work[(TIP + k) * LANES]
    for k in range(BOTH_JACOBIANS):
        saved[7 + k] = work[(JACOBIAN + k) * LANES]


@inline
def restore(work: Array, saved: Array) -> None:
    """Undo what happened since `save`."""
    for k in range(7):
        work[(TIP + k) * LANES] = saved[k]
    for k in range(BOTH_JACOBIANS):
        work[(JACOBIAN + k) * LANES] = saved[7 + k]


@inline
def turned_by(work: Array, saved: Array) -> float:
    """Angle (rad) between the tip's orientation now and when it was saved."""
    q = quaternion_of(work, TIP, 0)
    same = abs(q[0] * saved[0] + q[1] * saved[1] + q[2] * saved[2] + q[3] * saved[3])
    return 2.0 * math.acos(min(1.0, same))
