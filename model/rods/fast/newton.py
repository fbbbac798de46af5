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

from model.rods.fast.algebra import Vector, along, conjugate, dot, minus, product, scaled, unit
from model.rods.fast.compiler import inline, routine
from model.rods.fast.group import Group, Pose, Rod, Six, each_rod
from model.rods.fast.lanes import copy
from model.rods.fast.passes import change_tip, evaluate, orientation

NUDGE = 1e-4
"""Finite-difference change of an unknown (rad, lengths)."""
LONGEST_TURN = 0.7
"""A Newton step (rad, lengths) is shortened to this."""
NEAR = 1e-3
"""Residual at which coarse passes have done their part: below their own discretisation error."""
HALF_TURNED = 0.5
"""Cosine of half the angle (2.1 rad) from which a tip counts as turned far."""
LEAST_LEFT, LEAST_LEFT_OF_TURNED = 0.01, 0.1
"""Share of the residual that is expected at least after a step, and of rods that turn their tip far."""
SIX = 6


@inline
def first_guess(group: Group) -> None:
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
    rod.tip.place = rod.seen


@routine
def difference_jacobian(group: Group) -> None:
    """d residual / d change and d seen / d change by finite differences; leaves the pass at the unchanged tip behind."""
    evaluate(group, group.springs, 1.0)
    keep_tip(group)
    keep_residual(group)
    for c in range(6 if group.springs > 0 else 3):
        nudge(group, c)
        change_tip(group)
        evaluate(group, group.springs, 1.0)
        differ_turn(group, c)
        if group.springs > 0:
            differ_shift(group, c)
        take_tip_back(group)
    take_residual_back(group)


@inline
def copy_pose(a: Pose, into: Pose) -> None:
    """A tip."""
    into.turn, into.place = a.turn, a.place


@inline
def copy_six(a: Six, into: Six) -> None:
    """A residual."""
    into.turn, into.shift = a.turn, a.shift


@each_rod
def keep_tip(rod: Rod) -> None:
    """Keep the tip."""
    copy_pose(rod.tip, rod.tip_before)


@each_rod
def keep_residual(rod: Rod) -> None:
    """Keep what came of it."""
    copy_six(rod.residual, rod.residual_before)
    rod.seen_before = rod.seen


@each_rod
def take_tip_back(rod: Rod) -> None:
    """Undo a nudge."""
    copy_pose(rod.tip_before, rod.tip)


@each_rod
def take_residual_back(rod: Rod) -> None:
    """Undo what it brought."""
    copy_six(rod.residual_before, rod.residual)
    rod.seen = rod.seen_before


@each_rod
def nudge(rod: Rod, c: int) -> None:
    """Change unknown c only."""
    rod.change.turn, rod.change.shift = scaled(NUDGE, unit(c)), scaled(NUDGE, unit(c - 3))


@each_rod
def differ_turn(rod: Rod, c: int) -> None:
    """Column c of the rows of the Jacobian that belong to the turn, and of d seen / d change."""
    set_column(rod.jacobian, 0, c, scaled(1.0 / NUDGE, minus(rod.residual.turn, rod.residual_before.turn)))
    set_column(rod.seen_by_change, 0, c, scaled(1.0 / NUDGE, minus(rod.seen, rod.seen_before)))


@each_rod
def differ_shift(rod: Rod, c: int) -> None:
    """Column c of the rows that belong to the shift."""
    set_column(rod.jacobian, 3, c, scaled(1.0 / NUDGE, minus(rod.residual.shift, rod.residual_before.shift)))


@inline
def set_column(rows: list[Six], first: int, c: int, column: Vector) -> None:
    """Three rows' entries of column c."""
    set_entry(rows[first], c, column[0])
    set_entry(rows[first + 1], c, column[1])
    set_entry(rows[first + 2], c, column[2])


@inline
def set_entry(row: Six, c: int, x: float) -> None:
    """Entry c. (All are written, in places known to the compiler: else it makes no vectors of the lanes.)"""
    (i, j, k), (u, v, w) = row.turn, row.shift
    row.turn = (x if c == 0 else i, x if c == 1 else j, x if c == 2 else k)
    row.shift = (x if c == 3 else u, x if c == 4 else v, x if c == 5 else w)


@inline
def newton_step(group: Group) -> None:
    """change = -J^-1 residual."""
    if group.springs > 0:
        step_by_six(group)
    else:
        step_by_three(group)


@each_rod
def step_by_three(rod: Rod) -> None:
    """The step in three unknowns."""
    (a, b, c), (d, e, f), (g, h, i) = by_turn(rod.jacobian)
    x, y, z = rod.residual.turn
    ca, cb, cc = e * i - f * h, f * g - d * i, d * h - e * g
    scale = -1.0 / (a * ca + b * cb + c * cc)
    rod.change.turn = (
        (ca * x + (c * h - b * i) * y + (b * f - c * e) * z) * scale,
        (cb * x + (a * i - c * g) * y + (c * d - a * f) * z) * scale,
        (cc * x + (b * g - a * h) * y + (a * e - b * d) * z) * scale,
    )


@inline
def by_turn(rows: list[Six]) -> tuple[Vector, Vector, Vector]:
    """The first three rows of a matrix, as far as they belong to the turn."""
    return (rows[0].turn, rows[1].turn, rows[2].turn)


@each_rod
def step_by_six(rod: Rod) -> None:
    """The step in six unknowns."""
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
    a, total = rod.pivots, 1.0
    b = a[SIX]
    for r in range(SIX):
        copy(rod.jacobian[r], a[r], SIX)
        b[r] = rod.residual[r]
    for k in range(SIX):
        top = k
        for r in range(k + 1, SIX):
            if abs(a[r][k]) > abs(a[top][k]):
                top = r
        if top != k:
            total = -total
            b[k], b[top] = b[top], b[k]
            for c in range(k, SIX):
                a[k][c], a[top][c] = a[top][c], a[k][c]
        total *= a[k][k]
        for r in range(k + 1, SIX):
            factor = a[r][k] / a[k][k]
            b[r] -= factor * b[k]
            for c in range(k, SIX):
                a[r][c] -= factor * a[k][c]
    return total


@each_rod
def shorten(rod: Rod) -> None:
    """Shorten a change to LONGEST_TURN."""
    change = rod.change
    size = dot(change.turn, change.turn) + dot(change.shift, change.shift)
    share = min(1.0, LONGEST_TURN / (math.sqrt(size) + 1e-300))
    change.turn, change.shift = scaled(share, change.turn), scaled(share, change.shift)


@inline
def broyden(group: Group) -> None:
    """Make the Jacobian explain the last step: J += (residual - residual_before - J change) change^T / |change|^2."""
    learn_turn(group)
    if group.springs > 0:
        learn_shift(group)
    else:
        learn_seen(group)


@each_rod
def learn_turn(rod: Rod) -> None:
    """The rows that belong to the turn."""
    explain(rod.jacobian, 0, minus(rod.residual.turn, rod.residual_before.turn), rod.change)


@each_rod
def learn_shift(rod: Rod) -> None:
    """The rows that belong to the shift."""
    explain(rod.jacobian, 3, minus(rod.residual.shift, rod.residual_before.shift), rod.change)


@each_rod
def learn_seen(rod: Rod) -> None:
    """d seen / d change learns in the same way, so that the last correction moves the tip as the last step did."""
    explain(rod.seen_by_change, 0, minus(rod.seen, rod.seen_before), rod.change)


@inline
def explain(rows: list[Six], first: int, gained: Vector, change: Six) -> None:
    """Make three rows of a matrix explain what a change gained."""
    scale = 1.0 / (dot(change.turn, change.turn) + dot(change.shift, change.shift) + 1e-30)
    explain_row(rows[first], gained[0], change, scale)
    explain_row(rows[first + 1], gained[1], change, scale)
    explain_row(rows[first + 2], gained[2], change, scale)


@inline
def explain_row(row: Six, gained: float, change: Six, scale: float) -> None:
    """A row."""
    turn, shift = change.turn, change.shift
    by = (gained - (dot(row.turn, turn) + dot(row.shift, shift))) * scale
    row.turn, row.shift = along(row.turn, by, turn), along(row.shift, by, shift)


@inline
def size_of(six: Six) -> float:
    """Root sum of squares; NaN counts as infinite."""
    size = dot(six.turn, six.turn) + dot(six.shift, six.shift)
    return math.sqrt(size) if size == size else math.inf


@inline
def expected_residual(rod: Rod) -> float:
    """What one more Newton step without a pass is expected to leave of the residual.

    The last step left the share residual / residual_before; the next one leaves about as much, four times that to be safe.
    d seen / d change knows only the directions of the last steps well, so that a least share is expected: of 300,000 random
    robots one was 0.03 mm off whose tip had turned far and that was judged as the others.
    """
    residual, before = size_of(rod.residual), size_of(rod.residual_before)
    q, b = rod.tip.turn, rod.base
    straight = abs(q[0] * b[0] + q[1] * b[1] + q[2] * b[2] + q[3] * b[3])
    least = LEAST_LEFT if straight > HALF_TURNED else LEAST_LEFT_OF_TURNED
    return residual * min(1.0, max(least, 4.0 * residual / (before + 1e-300))) if residual < math.inf else math.inf


@inline
def worst_residual(group: Group) -> float:
    """The largest expected residual in the group."""
    most = 0.0
    for l in range(group.active):
        most = max(most, expected_residual(Rod(group.work, l)))
    return most


@inline
def correct(group: Group) -> None:
    """A Newton step, not yet followed by a pass."""
    newton_step(group)
    shorten(group)
    change_tip(group)


@routine
def improve(group: Group, close: float, most_rounds: int) -> int:
    """Newton steps with Broyden's updates from an evaluated point until the expected residual is below `close` in every lane
    (the step that `expected_residual` counts on is the caller's); returns the rounds used."""
    keep_residual(group)
    for i in range(most_rounds):
        if worst_residual(group) < close:
            return i
        correct(group)
        keep_residual(group)
        evaluate(group, group.springs, 1.0)
        broyden(group)
    return most_rounds


@routine
def buckling_margin(rod: Rod, springs: int) -> float:
    """How far a solution is on the near side of buckling: 1 without dead loads, 0 or less beyond.

    All eigenvalues of the Jacobian are 1 without dead loads; on the way to a fold or a branching point one of them goes
    through zero. Routh's conditions say whether all real parts of the 3 by 3 Jacobian are positive; its determinant
    alone would miss a straight rod, which buckles in two planes at once. Returned is the smallest of the three
    conditions, scaled. With springs it is the determinant of the 6 by 6 Jacobian: a part of that alone may be singular
    where the rod is not.
    """
    if springs > 0:
        return eliminate(rod)
    (a, b, c), (d, e, f), (g, h, i) = by_turn(rod.jacobian)
    trace = a + e + i
    minors = a * e - b * d + a * i - c * g + e * i - f * h
    determinant = a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g)
    return min(trace / 3.0, determinant, (trace * minors - determinant) / 8.0)
