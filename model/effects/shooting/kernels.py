"""The entry points: batches of rods to equilibria, and equilibria to their derivatives."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from model.effects.shooting import layout as at
from model.effects.shooting.newton import by_unknowns, eliminate, newton
from model.effects.shooting.passes import shoot
from model.statics.jit import kernel

Array = NDArray[np.float64]
Counts = NDArray[np.int64]

FAR = math.cos(0.5 * 0.8)
"""Cosine of half the angle (0.8 rad) from the start of a solve that is still taken without question."""
MOST_PARTS = 16
"""Load steps from zero, when nothing else works."""


@kernel
def solve_rows(
    rows: Array, arcs: Array, steps: Counts, start: Array, warm: bool, out: Array, unknowns: Array
) -> NDArray[np.bool_]:
    """Solve every row; returns which were solved.

    `start` (n, 43) holds quaternion and position of the tip and the Jacobian of the misses there; it is used when
    `warm`. `unknowns` gets the same for the solution.
    """
    n = rows.shape[0]
    solved = np.zeros(n, np.bool_)
    work, short = np.zeros((13, 10)), np.empty(at.MARKERS + 6)
    q, held, jacobian = np.zeros(4), np.zeros(3), np.zeros((6, 6))
    for r in range(n):
        row, counts = rows[r], steps[r]
        known = warm
        parts = 1
        while not solved[r] and parts <= MOST_PARTS:
            if known:
                q[:] = start[r, :4]
                held[:] = start[r, 4:7]
                jacobian[:] = start[r, 7:].reshape(6, 6)
            else:
                q[:] = 0.0
                q[0] = 1.0
                held[:] = 0.0
                held[2] = row[at.ELEMENTS] + row[at.ELEMENTS + at.ELEMENT_WIDTH]
            solved[r] = True
            for i in range(1, parts + 1):
                if not newton(row, i / parts, q, held, jacobian, known or i > 1, counts, work, short):
                    solved[r] = False
                    break
            if known:
                # A tip that turned far from where it started may have snapped: follow it from zero load instead.
                near = 0.0
                for i in range(4):
                    near += q[i] * start[r, i]
                solved[r] = solved[r] and abs(near) > FAR
                known = False
            parts *= 4
        unknowns[r, :4] = q
        unknowns[r, 4:7] = held
        unknowns[r, 7:] = jacobian.ravel()
        if solved[r]:
            shoot(row, 1.0, q, held, arcs, counts, work, out[r])
        else:
            out[r] = np.nan
    return solved


@kernel
def sensitivities(
    rows: Array, arcs: Array, steps: Counts, out: Array, unknowns: Array, directions: Array, step: float, result: Array
) -> None:
    """d(out) / d(direction) of solved rows: `directions` (p, n, WIDTH) -> `result` (p, n, columns without the miss)."""
    p, n, _ = directions.shape
    wide = out.shape[1]
    work, row, near = np.zeros((13, 10)), np.empty(rows.shape[1]), np.empty(wide)
    slopes, change, jacobian = np.empty((6, wide)), np.empty(6), np.empty((6, 6))
    for r in range(n):
        if not np.isfinite(out[r, 0]):
            result[:, r] = np.nan
            continue
        counts, q, held = steps[r], unknowns[r, :4], unknowns[r, 4:7]
        by_unknowns(rows[r], 1.0, q, held, arcs, counts, work, out[r], slopes, True)
        for i in range(6):
            for c in range(6):
                jacobian[c, i] = slopes[i, wide - 6 + c]
        for k in range(p):
            moves = False
            for c in range(row.size):
                along = directions[k, r, c]
                row[c] = rows[r, c] + step * along
                moves = moves or along != 0.0
            if not moves:
                result[k, r] = 0.0
                continue
            shoot(row, 1.0, q, held, arcs, counts, work, near)
            for c in range(wide):
                near[c] = (near[c] - out[r, c]) / step
            eliminate(jacobian, near[wide - 6 :], work, change)
            for c in range(wide - 6):
                total = near[c]
                for i in range(6):
                    total -= slopes[i, c] * change[i]
                result[k, r, c] = total
