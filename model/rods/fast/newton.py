"""Find the tip pose whose base satisfies the boundary condition, by Newton's method with Broyden's updates.

The tip is turned in the mount frame, where the residual, by how much the base misses its pose, is measured too. Without dead
loads the whole rod then turns as one, the Jacobian is the identity and the first step exact; dead loads bend it away from there.
That makes three equations in three unknowns. Springs at the tip depend on where it is: its position joins as three more. A group
of rods is solved together:
    1. one coarse pass without dead loads gives the first guess,
    2. a coarse finite-difference Jacobian and Broyden's updates bring the residual below NEAR,
    3. fine passes with the same Jacobian, still updated, bring it below `close`,
    4. what is left is removed to first order from orientation and position.
"""

from __future__ import annotations

import math

from model.rods.fast.algebra import Vector, along, conjugate, dot, minus, product, scaled, unit
from model.rods.fast.compiler import inline, routine
from model.rods.fast.group import FOUND, POSE, SIX, Rod, RodGroup, Six, each_rod
from model.rods.fast.lanes import copy, copy_lanes
from model.rods.fast.passes import WHOLE, change_tip, evaluate, orientation

NUDGE = 1e-4
"""Finite-difference change of an unknown (rad, lengths)."""
LONGEST_TURN = 0.7
"""A Newton step (rad, lengths) is shortened to this."""
NEAR = 1e-3
"""Residual at which coarse passes have done their part: below their own discretisation error."""
HALF_TURNED = 0.5
"""Cosine of half the angle (2.1 rad) from which a tip counts as turned far."""
LEAST_LEFT, LEAST_LEFT_OF_TURNED = 0.01, 0.1
"""Least share of the residual that a step is expected to leave, and the same for a tip that is turned far."""


@inline
def first_guess(group: RodGroup) -> None:
    """Set the unknowns to what they would be without dead loads and springs."""
    guess_base(group)
    evaluate(group, 0, 0.0)
    guess_tip(group)


@each_rod
def guess_base(rod: Rod) -> None:
    """Turn the tip as the base is."""
    rod.tip.turn = rod.base


@each_rod
def guess_tip(rod: Rod) -> None:
    """A pass that starts at B and ends at R reaches B from B R^T B."""
    b = rod.tip.turn
    rod.tip.turn = product(b, product(conjugate(orientation(rod.here)), b))
    rod.tip.place = rod.found.seen


@routine
def difference_jacobian(group: RodGroup) -> None:
    """Fill d residual / d change and d seen / d change by finite differences; `tip` and `found` are then those before it."""
    all_rods = Rod(group.work, 0)
    evaluate(group, group.springs, WHOLE)
    copy_lanes(all_rods.tip, all_rods.tip_before, POSE)
    copy_lanes(all_rods.found, all_rods.found_before, FOUND)
    for c in range(6 if group.springs > 0 else 3):
        nudge(group, c)
        change_tip(group)
        evaluate(group, group.springs, WHOLE)
        differ(group, c)
        if group.springs > 0:
            differ_shift(group, c)
        copy_lanes(all_rods.tip_before, all_rods.tip, POSE)
    copy_lanes(all_rods.found_before, all_rods.found, FOUND)


@each_rod
def nudge(rod: Rod, c: int) -> None:
    """Change unknown c only."""
    rod.change.turn, rod.change.shift = scaled(NUDGE, unit(c)), scaled(NUDGE, unit(c - 3))


@each_rod
def differ(rod: Rod, c: int) -> None:
    """Column c of d residual.turn / d change and of d seen / d change."""
    found, before = rod.found, rod.found_before
    set_column(rod.jacobian.turn, c, scaled(1.0 / NUDGE, minus(found.residual.turn, before.residual.turn)))
    set_column(rod.seen_by, c, scaled(1.0 / NUDGE, minus(found.seen, before.seen)))


@each_rod
def differ_shift(rod: Rod, c: int) -> None:
    """Column c of d residual.shift / d change."""
    now, before = rod.found.residual.shift, rod.found_before.residual.shift
    set_column(rod.jacobian.shift, c, scaled(1.0 / NUDGE, minus(now, before)))


@inline
def set_column(rows: list[Six], c: int, column: Vector) -> None:
    """Column c of three rows. (Vectors are written whole, at places known to the compiler: else it makes no vectors of lanes.)"""
    for k in range(3):
        row = rows[k]
        if c < 3:
            row.turn = with_entry(row.turn, c, column[k])
        else:
            row.shift = with_entry(row.shift, c - 3, column[k])


@inline
def with_entry(a: Vector, k: int, x: float) -> Vector:
    """The vector with another entry k."""
    return (x if k == 0 else a[0], x if k == 1 else a[1], x if k == 2 else a[2])


@inline
def newton_step(group: RodGroup) -> None:
    """change = -J^-1 residual."""
    if group.springs > 0:
        step_by_six(group)
    else:
        step_by_three(group)


@each_rod
def step_by_three(rod: Rod) -> None:
    """change.turn = -J^-1 residual.turn with the inverse of a 3 by 3 matrix by its cofactors."""
    (a, b, c), (d, e, f), (g, h, i) = turn_by_turn(rod)
    x, y, z = rod.found.residual.turn
    ca, cb, cc = e * i - f * h, f * g - d * i, d * h - e * g
    scale = -1.0 / (a * ca + b * cb + c * cc)
    rod.change.turn = (
        (ca * x + (c * h - b * i) * y + (b * f - c * e) * z) * scale,
        (cb * x + (a * i - c * g) * y + (c * d - a * f) * z) * scale,
        (cc * x + (b * g - a * h) * y + (a * e - b * d) * z) * scale,
    )


@inline
def turn_by_turn(rod: Rod) -> tuple[Vector, Vector, Vector]:
    """The Jacobian of three unknowns, row by row."""
    rows = rod.jacobian.turn
    return (rows[0].turn, rows[1].turn, rows[2].turn)


@each_rod
def step_by_six(rod: Rod) -> None:
    """change = -J^-1 residual by back substitution in `pivots`."""
    eliminate(rod)
    x, a = rod.change, rod.pivots
    for i in range(SIX):
        r = SIX - 1 - i
        total = -a[SIX][r]
        for c in range(r + 1, SIX):
            total -= a[r][c] * x[c]
        x[r] = total / a[r][r]


@routine
def eliminate(rod: Rod) -> float:
    """Bring the Jacobian to triangular form in `pivots`, with the residual as their last row; returns the determinant."""
    a, determinant = rod.pivots, 1.0
    b = a[SIX]
    copy(rod.found.residual, b, SIX)
    for r in range(3):
        copy(rod.jacobian.turn[r], a[r], SIX)
        copy(rod.jacobian.shift[r], a[3 + r], SIX)
    for k in range(SIX):
        pivot = k  # row of the largest entry in column k
        for r in range(k + 1, SIX):
            if abs(a[r][k]) > abs(a[pivot][k]):
                pivot = r
        if pivot != k:
            determinant = -determinant
            b[k], b[pivot] = b[pivot], b[k]
            for c in range(k, SIX):
                a[k][c], a[pivot][c] = a[pivot][c], a[k][c]
        determinant *= a[k][k]
        for r in range(k + 1, SIX):
            factor = a[r][k] / a[k][k]
            b[r] -= factor * b[k]
            for c in range(k, SIX):
                a[r][c] -= factor * a[k][c]
    return determinant


@each_rod
def shorten(rod: Rod) -> None:
    """Shorten a change to LONGEST_TURN."""
    change = rod.change
    size = dot(change.turn, change.turn) + dot(change.shift, change.shift)
    share = min(1.0, LONGEST_TURN / (math.sqrt(size) + 1e-300))
    change.turn, change.shift = scaled(share, change.turn), scaled(share, change.shift)


@inline
def broyden(group: RodGroup) -> None:
    """Make the Jacobian explain the last step: J += (residual - residual_before - J change) change^T / |change|^2."""
    if group.springs > 0:
        broyden_six(group)
    else:
        broyden_three(group)


@each_rod
def broyden_six(rod: Rod) -> None:
    """`broyden` in turn and shift, of all six rows of J."""
    now, before, change = rod.found.residual, rod.found_before.residual, rod.change
    scale = 1.0 / (dot(change.turn, change.turn) + dot(change.shift, change.shift) + 1e-30)
    for k in range(3):
        update_row(rod.jacobian.turn[k], now.turn[k] - before.turn[k], change, scale)
        update_row(rod.jacobian.shift[k], now.shift[k] - before.shift[k], change, scale)


@inline
def update_row(row: Six, gained: float, change: Six, scale: float) -> None:
    """row += (gained - row . change) scale change, `gained` what a change made of that row's number, `scale` 1 / |change|^2."""
    by = (gained - (dot(row.turn, change.turn) + dot(row.shift, change.shift))) * scale
    row.turn, row.shift = along(row.turn, by, change.turn), along(row.shift, by, change.shift)


@each_rod
def broyden_three(rod: Rod) -> None:
    """`broyden` in the turn alone (rad), of three rows of J; and S = d seen / d change (m) alike, S += (d seen - S turn) turn^T /
    |turn|^2, so that the correction that no pass follows moves the tip as the last step did."""
    now, before, turn = rod.found, rod.found_before, rod.change.turn
    scale = 1.0 / (dot(turn, turn) + 1e-30)
    gained, moved = minus(now.residual.turn, before.residual.turn), minus(now.seen, before.seen)
    for k in range(3):
        rod.jacobian.turn[k].turn = updated_row(rod.jacobian.turn[k].turn, gained[k], turn, scale)
        rod.seen_by[k].turn = updated_row(rod.seen_by[k].turn, moved[k], turn, scale)


@inline
def updated_row(row: Vector, gained: float, turn: Vector, scale: float) -> Vector:
    """`update_row` for a turn alone, as a new row."""
    return along(row, (gained - dot(row, turn)) * scale, turn)


@inline
def size_of(six: Six) -> float:
    """Root sum of squares; NaN counts as infinite."""
    size = dot(six.turn, six.turn) + dot(six.shift, six.shift)
    return math.sqrt(size) if size == size else math.inf


@inline
def expected_residual(rod: Rod) -> float:
    """Residual expected after one more Newton step, r min(1, max(least, 4 r / r_before)) for the residual r; inf where it is NaN.

    The last step left the share r / r_before; the next one leaves about as much, and 4 is a margin. d seen / d change is accurate
    only in the directions of the last steps, so a least share is expected, a larger one of tips that have turned far.
    """
    residual, before = size_of(rod.found.residual), size_of(rod.found_before.residual)
    q, b = rod.tip.turn, rod.base
    straight = abs(q[0] * b[0] + q[1] * b[1] + q[2] * b[2] + q[3] * b[3])
    least = LEAST_LEFT if straight > HALF_TURNED else LEAST_LEFT_OF_TURNED
    return residual * min(1.0, max(least, 4.0 * residual / (before + 1e-300))) if residual < math.inf else math.inf


@inline
def worst_residual(group: RodGroup) -> float:
    """The largest expected residual in the group."""
    most = 0.0
    for l in range(group.active):
        most = max(most, expected_residual(Rod(group.work, l)))
    return most


@inline
def correct(group: RodGroup) -> None:
    """A Newton step, not yet followed by a pass."""
    newton_step(group)
    shorten(group)
    change_tip(group)


@routine
def improve(group: RodGroup, close: float, most_rounds: int) -> int:
    """Newton steps with Broyden's updates from an evaluated point until the expected residual is below `close` in every lane
    (the step that `expected_residual` counts on is the caller's); returns the rounds used."""
    all_rods = Rod(group.work, 0)
    copy_lanes(all_rods.found, all_rods.found_before, FOUND)
    for i in range(most_rounds):
        if worst_residual(group) < close:
            return i
        correct(group)
        copy_lanes(all_rods.found, all_rods.found_before, FOUND)
        evaluate(group, group.springs, WHOLE)
        broyden(group)
    return most_rounds


@routine
def buckling_margin(rod: Rod, springs: int) -> float:
    """Margin of a solution to buckling: 1 without dead loads, 0 where it buckles, negative beyond.

    All eigenvalues of the Jacobian are 1 without dead loads; on the way to a fold or a branching point one of them goes through
    zero. Routh's conditions say whether all real parts of the 3 by 3 Jacobian are positive; its determinant alone would miss a
    straight rod, which buckles in two planes at once. Returned is the smallest of the three conditions, scaled; with springs the
    determinant of the 6 by 6 Jacobian, of which a part alone may be singular where the rod is not.
    """
    if springs > 0:
        return eliminate(rod)
    (a, b, c), (d, e, f), (g, h, i) = turn_by_turn(rod)
    trace = a + e + i
    minors = a * e - b * d + a * i - c * g + e * i - f * h
    determinant = a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g)
    return min(trace / 3.0, determinant, (trace * minors - determinant) / 8.0)
