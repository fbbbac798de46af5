"""From a guess to an equilibrium: Newton on the rotation and the position of the tip."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from model.effects.shooting import layout as at
from model.effects.shooting.passes import product, shoot
from model.statics.jit import routine

Array = NDArray[np.float64]
Counts = NDArray[np.int64]

NUDGE = 1e-6
"""rad and m, central differences of the unknowns."""
CLOSE = 1e-10
"""rad and m, miss of a solved rod."""
ROUNDS = 40
SLOW = 0.5
"""A miss that shrinks by less than this in a round asks for a new Jacobian."""
LONGEST = 0.6
"""rad (and a fifth of it in m), a Newton step is shortened to this."""
LEAST_DETERMINANT = 1e-3
"""Of the Jacobian of the misses, 1 without dead loads: less is at or beyond a point of buckling."""


@routine
def turn_by(q: Array, x: Array, work: Array, out: Array) -> None:
    """q turned by the rotation vector x (base frame) into `out`."""
    angle = math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])
    half = 0.5 - angle * angle / 48.0 if angle < 1e-3 else math.sin(0.5 * angle) / angle
    work[0], work[1], work[2], work[3] = math.cos(0.5 * angle), half * x[0], half * x[1], half * x[2]
    product(work[:4], q, out)
    size = 1.0 / math.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2 + out[3] ** 2)
    for i in range(4):
        out[i] *= size


@routine
def by_unknowns(
    row: Array,
    share: float,
    q: Array,
    held: Array,
    arcs: Array,
    counts: Counts,
    work: Array,
    here: Array,
    slopes: Array,
    central: bool,
) -> None:
    """Derivatives of a pass by the six unknowns, (6, columns), into `slopes`; `here` is the pass itself."""
    sprung = False
    for j in range(at.SPRING_COUNT):
        sprung = sprung or row[at.SPRINGS + j * at.SPRING_WIDTH + 3] != 0.0
    wide = slopes.shape[1]
    x, near, moved, out = np.zeros(3), np.zeros(4), np.zeros(3), np.empty(wide)
    for k in range(6):
        if k >= 3 and not sprung:
            slopes[k] = 0.0
            slopes[k, wide - 6 + k] = 1.0
            continue
        for sign in (1.0, -1.0):
            x[:] = 0.0
            moved[:] = held
            if k < 3:
                x[k] = sign * NUDGE
            else:
                moved[k - 3] += sign * NUDGE
            turn_by(q, x, work[12], near)
            shoot(row, share, near, moved, arcs, counts, work, out)
            if not central:
                for c in range(wide):
                    slopes[k, c] = (out[c] - here[c]) / NUDGE
                break
            for c in range(wide):
                slopes[k, c] = out[c] if sign > 0 else (slopes[k, c] - out[c]) / (2.0 * NUDGE)


@routine
def eliminate(matrix: Array, right: Array, work: Array, out: Array) -> float:
    """matrix (6, 6) out = right by elimination with pivots; returns the determinant. `work` has at least 7 rows."""
    a, b = work[:6], work[6]
    determinant = 1.0
    for i in range(6):
        b[i] = right[i]
        for j in range(6):
            a[i, j] = matrix[i, j]
    for i in range(6):
        best = i
        for j in range(i + 1, 6):
            if abs(a[j, i]) > abs(a[best, i]):
                best = j
        if best != i:
            determinant = -determinant
            b[i], b[best] = b[best], b[i]
            for k in range(6):
                a[i, k], a[best, k] = a[best, k], a[i, k]
        determinant *= a[i, i]
        if a[i, i] == 0.0:
            return 0.0
        for j in range(i + 1, 6):
            share = a[j, i] / a[i, i]
            b[j] -= share * b[i]
            for k in range(i + 1, 6):
                a[j, k] -= share * a[i, k]
    for i in range(5, -1, -1):
        total = b[i]
        for k in range(i + 1, 6):
            total -= a[i, k] * out[k]
        out[i] = total / a[i, i]
    return determinant


@routine
def newton(
    row: Array,
    share: float,
    q: Array,
    held: Array,
    jacobian: Array,
    known: bool,
    counts: Counts,
    work: Array,
    out: Array,
) -> bool:
    """Move the unknowns q and held to equilibrium, by Newton with Broyden's updates; True when they got there.

    `jacobian` (6, 6) of the misses is where it begins when `known`, and what was reached.
    """
    none = np.empty(0)
    last, fresh = np.inf, known
    turned, before, change, slopes = np.empty(4), np.empty(6), np.zeros(6), np.empty((6, at.MARKERS + 6))
    miss = out[at.MARKERS :]
    for i in range(ROUNDS):
        shoot(row, share, q, held, none, counts, work, out)
        size = 0.0
        for j in range(6):
            size += miss[j] * miss[j]
        size = math.sqrt(size)
        if not size < np.inf:
            return False
        if size < CLOSE or (size < 1e-8 and size >= 0.5 * last):
            return True
        if not fresh or size > SLOW * last:
            by_unknowns(row, share, q, held, none, counts, work, out, slopes, False)
            for j in range(6):
                for k in range(6):
                    jacobian[j, k] = slopes[k, at.MARKERS + j]
            fresh = True
        elif i > 0:
            # The rank-one change that makes the Jacobian agree with the step just made.
            total = 0.0
            for k in range(6):
                total += change[k] * change[k]
            for j in range(6):
                gained = miss[j] - before[j]
                for k in range(6):
                    gained -= jacobian[j, k] * change[k]
                for k in range(6):
                    jacobian[j, k] += gained / total * change[k]
        last = size
        # One eigenvalue through zero is a point of snapping or buckling; what lies beyond is another branch.
        if not eliminate(jacobian, miss, work, change) > LEAST_DETERMINANT:
            return False
        longest = 0.0
        for j in range(6):
            before[j] = miss[j]
            longest = max(longest, abs(change[j]) * (1.0 if j < 3 else 5.0))
        shorter = -min(1.0, LONGEST / max(longest, LONGEST))
        for j in range(6):
            change[j] *= shorter
        turn_by(q, change[:3], work[12], turned)
        for j in range(4):
            q[j] = turned[j]
        for j in range(3):
            held[j] += change[3 + j]
    return False
