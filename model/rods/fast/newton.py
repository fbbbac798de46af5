"""Which pose of the tip brings the base to its place, by Newton and Broyden.

The tip is turned in the mount frame and the residual, by how much the base misses its pose, is measured there too.
Without dead loads the whole rod then turns as one, the Jacobian is the identity and the first step exact; dead loads bend
it away from there.
That makes three equations in three unknowns. Springs at the tip depend on where it is: its position joins as three
more. A group of rods is solved together:
    1. one coarse pass without dead loads gives the first guess,
    2. a coarse finite-difference Jacobian and Broyden's updates bring the residual below NEAR,
    3. fine passes with the same Jacobian, still updated, bring it below `close`,
    4. what is left is removed to first order from orientation and position.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from model.rods.fast.algebra import Vector, along, dot, product, scaled
from model.rods.fast.jit import allocating, inline, routine
from model.rods.fast.lanes import (
    ANCHOR,
    BASE,
    JACOBIAN,
    LANES,
    PLACE,
    PLACE_BY_TURN,
    RESIDUAL,
    RESIDUAL_BEFORE,
    SAVED,
    SAVED_PLACE,
    TIP,
    TURN,
    Group,
    put,
    put_quaternion,
    quaternion_of,
    vector_of,
)
from model.rods.fast.passes import evaluate, turn_tip, unit_quaternion

Array = NDArray[np.float64]

NUDGE = 1e-4
"""Finite-difference change of an unknown (rad, lengths)."""
LONGEST_TURN = 0.7
"""A Newton step (rad, lengths) is shortened to this."""
NEAR = 1e-3
"""Residual at which coarse passes have done their part: below their own discretisation error."""

HALF_TURNED = 0.5
"""Cosine of half the angle (2.1 rad) from which a tip counts as turned far."""


@inline
def first_guess(group: Group) -> None:
    """Set the unknowns to what they would be without dead loads and springs."""
    work, active = group.work, group.active
    for l in range(active):
        put_quaternion(work, TIP, l, quaternion_of(work, BASE, l))
    evaluate(group, 0, 0.0)
    for l in range(active):
        # A pass that starts at B and ends at R reaches B from B R^T B.
        r = unit_quaternion(work, l)
        b = quaternion_of(work, TIP, l)
        put_quaternion(work, TIP, l, product(b, product((r[0], -r[1], -r[2], -r[3]), b)))
        put(work, ANCHOR, l, vector_of(work, PLACE, l))


@routine
def difference_jacobian(group: Group) -> None:
    """d RESIDUAL / d TURN and d PLACE / d TURN by finite differences; leaves the pass at the unchanged tip behind."""
    work, springs, active = group.work, group.springs, group.active
    unknowns = 6 if springs > 0 else 3
    evaluate(group, group.springs, 1.0)
    copy(work, TIP, SAVED, 7)
    copy(work, PLACE, SAVED_PLACE, 3)
    copy(work, RESIDUAL, RESIDUAL_BEFORE, 6)
    for c in range(unknowns):
        for k in range(6):
            for l in range(LANES):
                work[(TURN + k) * LANES + l] = NUDGE if k == c else 0.0
        turn_tip(group)
        evaluate(group, group.springs, 1.0)
        for r in range(unknowns):
            for l in range(active):
                rise = work[(RESIDUAL + r) * LANES + l] - work[(RESIDUAL_BEFORE + r) * LANES + l]
                work[(JACOBIAN + 6 * r + c) * LANES + l] = rise * (1.0 / NUDGE)
        for r in range(3):
            for l in range(active):
                rise = work[(PLACE + r) * LANES + l] - work[(SAVED_PLACE + r) * LANES + l]
                work[(PLACE_BY_TURN + 6 * r + c) * LANES + l] = rise * (1.0 / NUDGE)
        copy(work, SAVED, TIP, 7)
    copy(work, RESIDUAL_BEFORE, RESIDUAL, 6)
    copy(work, SAVED_PLACE, PLACE, 3)


@inline
def copy(work: Array, source: int, target: int, quantities: int) -> None:
    """Quantities from `source` on into those from `target` on."""
    for i in range(quantities * LANES):
        work[target * LANES + i] = work[source * LANES + i]


@inline
def newton_turn(group: Group) -> None:
    """TURN = -J^-1 RESIDUAL, shortened to LONGEST_TURN."""
    work, springs, active = group.work, group.springs, group.active
    if springs > 0:
        for l in range(active):
            newton_step_6(work, l)
    else:
        for l in range(active):
            put(work, TURN, l, newton_step_3(jacobian_of(work, l), vector_of(work, RESIDUAL, l)))
    for l in range(active):
        t = vector_of(work, TURN, l)
        size = dot(t, t)
        if springs > 0:
            d = vector_of(work, TURN + 3, l)
            size += dot(d, d)
        shorten = min(1.0, LONGEST_TURN / (math.sqrt(size) + 1e-300))
        put(work, TURN, l, scaled(shorten, t))
        if springs > 0:
            put(work, TURN + 3, l, scaled(shorten, vector_of(work, TURN + 3, l)))


@inline
def jacobian_of(work: Array, l: int) -> tuple[Vector, Vector, Vector]:
    """The rows of the 3 by 3 Jacobian."""
    return (vector_of(work, JACOBIAN, l), vector_of(work, JACOBIAN + 6, l), vector_of(work, JACOBIAN + 12, l))


@inline
def newton_step_3(jacobian: tuple[Vector, Vector, Vector], residual: Vector) -> Vector:
    """-J^-1 residual for three unknowns."""
    (a, b, c), (d, e, f), (g, h, i) = jacobian
    x, y, z = residual
    ca, cb, cc = e * i - f * h, f * g - d * i, d * h - e * g
    scale = -1.0 / (a * ca + b * cb + c * cc)
    return (
        (ca * x + (c * h - b * i) * y + (b * f - c * e) * z) * scale,
        (cb * x + (a * i - c * g) * y + (c * d - a * f) * z) * scale,
        (cc * x + (b * g - a * h) * y + (a * e - b * d) * z) * scale,
    )


@allocating
def newton_step_6(work: Array, l: int) -> None:
    """TURN = -J^-1 RESIDUAL for six unknowns of one lane, by elimination with pivots."""
    a = np.empty((6, 7))
    for r in range(6):
        for c in range(6):
            a[r, c] = work[(JACOBIAN + 6 * r + c) * LANES + l]
        a[r, 6] = -work[(RESIDUAL + r) * LANES + l]
    for k in range(6):
        top = k
        for r in range(k + 1, 6):
            if abs(a[r, k]) > abs(a[top, k]):
                top = r
        for c in range(k, 7):
            a[k, c], a[top, c] = a[top, c], a[k, c]
        for r in range(k + 1, 6):
            factor = a[r, k] / a[k, k]
            for c in range(k, 7):
                a[r, c] -= factor * a[k, c]
    for r in range(5, -1, -1):
        for c in range(r + 1, 6):
            a[r, 6] -= a[r, c] * a[c, 6]
        a[r, 6] /= a[r, r]
        work[(TURN + r) * LANES + l] = a[r, 6]


@inline
def broyden(group: Group) -> None:
    """Make the Jacobian explain the last step: J += (RESIDUAL - RESIDUAL_BEFORE - J TURN) TURN^T / |TURN|^2."""
    work, springs, active = group.work, group.springs, group.active
    if springs > 0:
        for l in range(active):
            size = 1e-30
            for k in range(6):
                size += work[(TURN + k) * LANES + l] ** 2
            for r in range(6):
                gap = work[(RESIDUAL + r) * LANES + l] - work[(RESIDUAL_BEFORE + r) * LANES + l]
                for k in range(6):
                    gap -= work[(JACOBIAN + 6 * r + k) * LANES + l] * work[(TURN + k) * LANES + l]
                for k in range(6):
                    work[(JACOBIAN + 6 * r + k) * LANES + l] += gap / size * work[(TURN + k) * LANES + l]
    else:
        for l in range(active):
            turn = vector_of(work, TURN, l)
            scale = 1.0 / (dot(turn, turn) + 1e-30)
            gained = along(vector_of(work, RESIDUAL, l), -1.0, vector_of(work, RESIDUAL_BEFORE, l))
            a, b, c = jacobian_of(work, l)
            put(work, JACOBIAN, l, along(a, (gained[0] - dot(a, turn)) * scale, turn))
            put(work, JACOBIAN + 6, l, along(b, (gained[1] - dot(b, turn)) * scale, turn))
            put(work, JACOBIAN + 12, l, along(c, (gained[2] - dot(c, turn)) * scale, turn))
            # PLACE_BY_TURN learns in the same way, so that the last correction moves the tip as the last step did.
            moved = along(vector_of(work, PLACE, l), -1.0, vector_of(work, SAVED_PLACE, l))
            a, b, c = (
                vector_of(work, PLACE_BY_TURN, l),
                vector_of(work, PLACE_BY_TURN + 6, l),
                vector_of(work, PLACE_BY_TURN + 12, l),
            )
            put(work, PLACE_BY_TURN, l, along(a, (moved[0] - dot(a, turn)) * scale, turn))
            put(work, PLACE_BY_TURN + 6, l, along(b, (moved[1] - dot(b, turn)) * scale, turn))
            put(work, PLACE_BY_TURN + 12, l, along(c, (moved[2] - dot(c, turn)) * scale, turn))


@inline
def size_of(work: Array, k: int, springs: int, l: int) -> float:
    """Root sum of squares of RESIDUAL, RESIDUAL_BEFORE or TURN; NaN counts as infinite."""
    turned_by = vector_of(work, k, l)
    size = dot(turned_by, turned_by)
    if springs > 0:
        moved_by = vector_of(work, k + 3, l)
        size += dot(moved_by, moved_by)
    return math.sqrt(size) if size == size else math.inf


@inline
def expected_residual(work: Array, springs: int, l: int) -> float:
    """What one more Newton step without a pass is expected to leave of the residual.

    The last step left the share RESIDUAL / RESIDUAL_BEFORE; the next one leaves about as much, four times that to be safe.
    PLACE_BY_TURN knows only the directions of the last steps well, so a hundredth is the least that is expected, and a tenth of
    rods that turn their tip far: of 300,000 random robots one was 0.03 mm off that was judged as the others.
    """
    residual, before = size_of(work, RESIDUAL, springs, l), size_of(work, RESIDUAL_BEFORE, springs, l)
    q, b = quaternion_of(work, TIP, l), quaternion_of(work, BASE, l)
    straight = abs(q[0] * b[0] + q[1] * b[1] + q[2] * b[2] + q[3] * b[3])
    least = 0.01 if straight > HALF_TURNED else 0.1
    return residual * min(1.0, max(least, 4.0 * residual / (before + 1e-300))) if residual < math.inf else math.inf


@inline
def worst_residual(group: Group) -> float:
    """The largest expected residual in the group."""
    most = 0.0
    for l in range(group.active):
        most = max(most, expected_residual(group.work, group.springs, l))
    return most


@routine
def improve(group: Group, close: float, most_rounds: int) -> int:
    """Newton steps with Broyden's updates from an evaluated point until the expected residual is below `close` in every lane
    (the step that `expected_residual` counts on is the caller's); returns the rounds used."""
    work = group.work
    copy(work, RESIDUAL, RESIDUAL_BEFORE, 6)
    for i in range(most_rounds):
        if worst_residual(group) < close:
            return i
        newton_turn(group)
        turn_tip(group)
        copy(work, RESIDUAL, RESIDUAL_BEFORE, 6)
        copy(work, PLACE, SAVED_PLACE, 3)
        evaluate(group, group.springs, 1.0)
        broyden(group)
    return most_rounds


@routine
def buckling_margin(work: Array, springs: int, l: int) -> float:
    """How far the solution in lane l is on the near side of buckling: 1 without dead loads, 0 or less beyond.

    All eigenvalues of the Jacobian are 1 without dead loads; on the way to a fold or a branching point one of them goes
    through zero. Routh's conditions say whether all real parts of the 3 by 3 Jacobian are positive; its determinant
    alone would residual a straight rod, which buckles in two planes at once. Returned is the smallest of the three
    conditions, scaled. With springs it is the determinant of the 6 by 6 Jacobian: a part of that alone may be singular
    where the rod is not.
    """
    if springs > 0:
        return determinant_of(work, l)
    (a, b, c), (d, e, f), (g, h, i) = jacobian_of(work, l)
    trace = a + e + i
    minors = a * e - b * d + a * i - c * g + e * i - f * h
    determinant = a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g)
    return min(trace / 3.0, determinant, (trace * minors - determinant) / 8.0)


@allocating
def determinant_of(work: Array, l: int) -> float:
    """Determinant of the 6 by 6 Jacobian of lane l, by elimination with pivots."""
    a = np.empty((6, 6))
    for r in range(6):
        for c in range(6):
            a[r, c] = work[(JACOBIAN + 6 * r + c) * LANES + l]
    total = 1.0
    for k in range(6):
        top = k
        for r in range(k + 1, 6):
            if abs(a[r, k]) > abs(a[top, k]):
                top = r
        if top != k:
            total = -total
            for c in range(k, 6):
                a[k, c], a[top, c] = a[top, c], a[k, c]
        total *= a[k, k]
        for r in range(k + 1, 6):
            factor = a[r, k] / a[k, k]
            for c in range(k, 6):
                a[r, c] -= factor * a[k, c]
    return total
