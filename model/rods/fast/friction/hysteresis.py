"""One state of rods with a memory: moments and memory are brought to agree within the passes that close the base.

The bending rest curvature of an element is a function of the moment m at its middle,
    u*(m) = still + slope m + sum_j c_j p_j(m),   p_j(m) = m - (m - p_j) min(1, y_j / |m - p_j|),
with p_j the play before the state. A pass comes from the tip and knows the moment where it enters the element; the
rise from there to the middle is taken from the pass before. It changes little from pass to pass, so that the passes
which Newton needs anyway settle it too. Elements are cut into an even number of steps: one ends at the middle.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from model.rods.fast.direct import COARSE_DIVISIONS, ROUNDS, write_result
from model.rods.fast.jit import inline, kernel, routine
from model.rods.fast.lanes import (
    ELEMENT,
    LANES,
    LARGEST_MOMENT,
    PEAK_M2,
    PLACE,
    RESIDUAL,
    RESIDUAL_BEFORE,
    SAVED_PLACE,
    TURN,
    U_REST,
    Full,
    Group,
    M,
    RowLayout,
    cut,
    gather_rod,
    new_elements,
    new_work,
    set_rest_norm,
)
from model.rods.fast.newton import (
    NEAR,
    broyden,
    copy,
    difference_jacobian,
    first_guess,
    improve,
    newton_turn,
    size_of,
    worst_residual,
)
from model.rods.fast.passes import advance_group, read_base, read_gap, start_at_tip, turn_tip
from model.rods.solution import AT_RESIDUAL

Array = NDArray[np.float64]
Counts = NDArray[np.int64]

REST_AT_NO_MOMENT, SLOPE, RISE_TO_MIDDLE, MIDDLE, PLAYS = 0, 2, 4, 6, 8
"""Law of an element, x and y each: u* at no moment (1/m), its growth with the moment (1/(N m^2)), the moment's rise from
the tip end to the middle and the moment at the middle (N m; both start as a guess and are written)."""
COMPLIANCE, YIELD, PLAY = 0, 1, 2
"""Of every play behind them: c (1/(N m^2)), y (N m), p (N m, x and y)."""
LAW = 4

AGREED = 0.5
"""Times `close`: change of the bend over a rod's length (rad) at which moments and memory agree."""
MOST_ROUNDS = 3 * ROUNDS
TEACHES = 10.0
"""A turn teaches the Jacobian when it is so many times what the memory moved in the same pass."""


class Laws(NamedTuple):
    """The laws of a group."""

    table: Array
    """(elements width LANES), tip first."""
    width: int
    """Quantities of an element: PLAYS + LAW plays."""
    plays: int
    gap: Array
    """(LANES,) rad by which u* lagged behind the moment in the last pass, over the rod."""


@inline
def rest_of(laws: Laws, o: int, x: float, y: float, l: int) -> tuple[float, float]:
    """u* (x, y) of the element at o under the moment (x, y) at its middle."""
    table = laws.table
    u = table[(o + REST_AT_NO_MOMENT) * LANES + l] + table[(o + SLOPE) * LANES + l] * x
    v = table[(o + REST_AT_NO_MOMENT + 1) * LANES + l] + table[(o + SLOPE + 1) * LANES + l] * y
    for j in range(laws.plays):
        k = o + PLAYS + LAW * j
        dx, dy = x - table[(k + PLAY) * LANES + l], y - table[(k + PLAY + 1) * LANES + l]
        slip = min(1.0, table[(k + YIELD) * LANES + l] / (math.sqrt(dx * dx + dy * dy) + 1e-300))
        u += table[(k + COMPLIANCE) * LANES + l] * (x - slip * dx)
        v += table[(k + COMPLIANCE) * LANES + l] * (y - slip * dy)
    return u, v


@routine
def set_rest(group: Group, laws: Laws, e: int) -> None:
    """Set u* of element e from the moment at its tip end, which is left in MIDDLE, and the rise of the last pass."""
    work, elements, table = group.work, group.elements, laws.table
    o, p = e * laws.width, e * ELEMENT + U_REST
    for l in range(group.active):
        x, y = work[M * LANES + l], work[(M + 1) * LANES + l]
        rise_x, rise_y = table[(o + RISE_TO_MIDDLE) * LANES + l], table[(o + RISE_TO_MIDDLE + 1) * LANES + l]
        elements[p * LANES + l], elements[(p + 1) * LANES + l] = rest_of(laws, o, x + rise_x, y + rise_y, l)
        table[(o + MIDDLE) * LANES + l], table[(o + MIDDLE + 1) * LANES + l] = x, y


@routine
def read_middle(group: Group, laws: Laws, e: int) -> None:
    """Read the moment at the middle of element e; adds to the gap what u* should have been bent more or less."""
    work, elements, table = group.work, group.elements, laws.table
    o, p = e * laws.width, e * ELEMENT
    for l in range(group.active):
        x, y = work[M * LANES + l], work[(M + 1) * LANES + l]
        u, v = rest_of(laws, o, x, y, l)
        missed = abs(u - elements[(p + U_REST) * LANES + l]) + abs(v - elements[(p + U_REST + 1) * LANES + l])
        laws.gap[l] += missed * elements[p * LANES + l]
        table[(o + RISE_TO_MIDDLE) * LANES + l] = x - table[(o + MIDDLE) * LANES + l]
        table[(o + RISE_TO_MIDDLE + 1) * LANES + l] = y - table[(o + MIDDLE + 1) * LANES + l]
        table[(o + MIDDLE) * LANES + l], table[(o + MIDDLE + 1) * LANES + l] = x, y


@routine
def evaluate_with_memory(group: Group, laws: Laws) -> None:
    """As `passes.evaluate` with all loads, u* following the moment; the gap says by how much it lagged behind."""
    start_at_tip(group, group.springs, 1.0)
    laws.gap[:] = 0.0
    parts = group.parts
    for e in range(parts.size):
        set_rest(group, laws, e)
        for j in range(parts[e]):
            dz = -1.0 / parts[e]
            if 2 * j == parts[e]:
                read_middle(group, laws, e)
            advance_group(group, e, 1.0 + j * dz, dz, 1.0)
    read_base(group.work, group.active)
    if group.springs > 0:
        read_gap(group.work, group.active)


@inline
def gaps_closed(group: Group, laws: Laws, close: float) -> bool:
    """Whether moments and memory agree in every lane; one that is no number does not."""
    agreed = True
    for l in range(group.active):
        agreed = agreed and laws.gap[l] < AGREED * close
    return agreed


@routine
def settle(group: Group, laws: Laws, close: float) -> None:
    """As `newton.improve`, until the memory agrees too."""
    work = group.work
    copy(work, RESIDUAL, RESIDUAL_BEFORE, 6)
    for _ in range(MOST_ROUNDS):
        if worst_residual(group) < close and gaps_closed(group, laws, close):
            return
        newton_turn(group)
        turn_tip(group)
        for l in range(group.active):
            # What the memory does to the base must not be taken for the work of a turn: no turn, nothing learnt.
            if not size_of(work, TURN, group.springs, l) > TEACHES * laws.gap[l]:
                for k in range(6):
                    work[(TURN + k) * LANES + l] = 0.0
        copy(work, RESIDUAL, RESIDUAL_BEFORE, 6)
        copy(work, PLACE, SAVED_PLACE, 3)
        evaluate_with_memory(group, laws)
        broyden(group)


@inline
def gather_laws(given: Array, row: int, laws: Laws, elements: Array, l: int) -> None:
    """Copy the laws of rod `row` into a lane, tip first, and set u* by the moments guessed for the middles."""
    count, table = given.shape[1], laws.table
    for e in range(count):
        o, p = e * laws.width, e * ELEMENT
        for k in range(laws.width):
            table[(o + k) * LANES + l] = given[row, count - 1 - e, k]
        x, y = table[(o + MIDDLE) * LANES + l], table[(o + MIDDLE + 1) * LANES + l]
        u, v = rest_of(laws, o, x, y, l)
        elements[(p + U_REST) * LANES + l], elements[(p + U_REST + 1) * LANES + l] = u, v
        set_rest_norm(elements, p, l)


@inline
def even(parts: Counts) -> None:
    """Make every number of steps even."""
    for e in range(parts.size):
        parts[e] += parts[e] % 2


@routine
def set_largest(group: Group) -> None:
    """The largest moment and |u*| of the last pass, which the cuts follow."""
    for l in range(group.active):
        group.work[LARGEST_MOMENT * LANES + l] = math.sqrt(group.work[PEAK_M2 * LANES + l])
        for e in range(group.parts.size):
            set_rest_norm(group.elements, e * ELEMENT, l)


@kernel
def solve_state(
    rods: Array,
    layout: tuple[int, int, int],
    full: Full,
    settings: tuple[float, float],
    table: Array,
    out: Array,
) -> None:
    """As `direct.solve_direct` from a cold start; `table` (n, elements, PLAYS + LAW plays) holds the laws.

    `settings` are divisions and close. RISE_TO_MIDDLE and MIDDLE are read as guesses and written. Rows that did not converge
    have an AT_RESIDUAL that is not below `close`.
    """
    at = RowLayout(layout[0], layout[1], layout[2])
    divisions, close = settings
    n, count, width = table.shape
    laws = Laws(np.zeros(count * width * LANES), width, (width - PLAYS) // LAW, np.zeros(LANES))
    work, elements, parts = new_work(), new_elements(count), np.empty(count, np.int64)
    for first in range(0, n, LANES):
        group = Group(work, elements, full, parts, at.springs, min(LANES, n - first))
        for l in range(group.active):
            gather_rod(rods, first + l, at, group, l)
            gather_laws(table, first + l, laws, elements, l)
        cut(group, COARSE_DIVISIONS)
        first_guess(group)
        difference_jacobian(group)
        improve(group, NEAR, ROUNDS)
        for fine in (False, True):
            # First coarsely: how finely the rod must be cut depends on what the memory of this state bends.
            if fine:
                set_largest(group)
                cut(group, divisions)
            even(parts)
            evaluate_with_memory(group, laws)
            settle(group, laws, close if fine else max(NEAR, close))
        newton_turn(group)
        turn_tip(group)
        for l in range(group.active):
            write_result(work, group.springs, out, first + l, l)
            if not laws.gap[l] < AGREED * close:
                out[first + l, AT_RESIDUAL] = math.inf
            for e in range(count):
                for k in range(RISE_TO_MIDDLE, PLAYS):
                    table[first + l, count - 1 - e, k] = laws.table[(e * width + k) * LANES + l]
