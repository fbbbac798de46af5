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

from model.rods.fast.compiler import inline, kernel
from model.rods.fast.direct import exchange, write_result
from model.rods.fast.group import ROD, Group, Rod, cut, gather, new_group
from model.rods.fast.lanes import LANES, copy, new_numbers
from model.rods.fast.newton import (
    buckling_margin,
    correct,
    difference_jacobian,
    expected_residual,
    first_guess,
    improve,
)
from model.rods.fast.passes import WHOLE, evaluate
from model.rods.solution import AT_LARGEST

Array = NDArray[np.float64]
Flags = NDArray[np.int8]
Rows = NDArray[np.int64]

FIRST_STEP, LEAST_STEP = 0.1, 1e-4
"""Share of the load."""
MOST_TRIES = 300
ROUNDS, QUICK_ROUNDS = 6, 3
"""The most of a step of load, and those after which the next one may be twice as large."""
FARTHEST = 0.35
"""rad: a tip that turns by more within one step may have changed branch."""
FOLLOWED, LOST = 1, 0


@kernel
def follow_load(
    rods: Array,
    springs: int,
    settings: tuple[float, float, float],
    rows: Rows,
    memory: Array,
    out: Array,
    reached: Flags,
) -> None:
    """Load the rods listed in `rows` from zero and write their rows of `out` and of `memory` (n or 0 rows), from which a solve
    nearby then starts; `reached[i]` is FOLLOWED or LOST.

    `settings` are divisions, close and the least margin to buckling. A rod that is lost holds its last equilibrium and the
    share of load it belongs to.
    """
    divisions, close, least_margin = settings
    room = new_group(rods, springs, ROD)
    group = Group(room.work, room.elements, room.parts, springs, room.linear, 1)
    kept = new_numbers(ROD * LANES)
    for i in range(rows.shape[0]):
        row = rows[i]
        gather(rods, group, row)
        rod, saved = Rod(room.work, 0), Rod(kept, 0)
        rod.largest_moment = out[row, AT_LARGEST]
        cut(group, divisions)
        rod.load_share = 0.0
        first_guess(group)
        difference_jacobian(group)
        share, step = 0.0, FIRST_STEP
        tries = 0
        while share < 1.0 and step >= LEAST_STEP and tries < MOST_TRIES:
            tries += 1
            copy(rod, saved, ROD)
            rod.load_share = min(1.0, share + step)
            evaluate(group, group.springs, WHOLE)
            rounds = improve(group, close, ROUNDS)
            if expected_residual(rod) < close and turned_by(rod, saved) < FARTHEST:
                difference_jacobian(group)
                if buckling_margin(rod, group.springs) > least_margin:
                    share = rod.load_share
                    if rounds <= QUICK_ROUNDS:
                        step *= 2.0
                    continue
            copy(saved, rod, ROD)
            step *= 0.5
        rod.load_share = share
        evaluate(group, group.springs, WHOLE)
        correct(group)
        write_result(rod, group.springs, out, row)
        if memory.shape[0] > 0:
            exchange(rod, group.springs, memory, row, True)
        reached[i] = FOLLOWED if share >= 1.0 else LOST


@inline
def turned_by(rod: Rod, saved: Rod) -> float:
    """Angle (rad) between the tip's orientation now and when it was saved."""
    q, p = rod.tip.turn, saved.tip.turn
    return 2.0 * math.acos(min(1.0, abs(q[0] * p[0] + q[1] * p[1] + q[2] * p[2] + q[3] * p[3])))
