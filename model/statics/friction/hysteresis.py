"""One state of rods with a memory: moments and memory are brought to agree within the passes that close the base.

The bending rest curvature of an element is a function of the moment m at its middle,
    u*(m) = still + slope m + sum_j c_j p_j(m),   p_j(m) = m - (m - p_j) min(1, y_j / |m - p_j|),
with p_j the play before the state. A pass comes from the tip and knows the moment where it enters the element; the
rise from there to the middle is taken from the pass before. It changes little from pass to pass, so that the passes
which Newton needs anyway settle it too. Elements are cut into an even number of steps: one ends at the middle.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from model.statics.algebra import dot
from model.statics.group import AT_MISS, COARSE_DIVISIONS, ROUNDS, new_elements, write_result
from model.statics.jit import inline, kernel, routine
from model.statics.lanes import (
    BEFORE,
    ELEMENT,
    KEPT,
    LANES,
    LARGEST,
    MISS,
    PEAK,
    PLACE,
    REST,
    TURN,
    Counts,
    M,
    cut,
    gather_elements,
    gather_ends,
    new_work,
    vector_of,
)
from model.statics.newton import (
    NEAR,
    broyden,
    copy,
    difference_jacobian,
    first_guess,
    improve,
    newton_turn,
    size_of,
    worst,
)
from model.statics.passes import advance, advance_alone, pull, read_base, read_gap, set_tip, turn_tip

Array = NDArray[np.float64]

STILL, SLOPE, RISEN, MIDDLE, PLAYS = 0, 2, 4, 6, 8
"""Law of an element, x and y each: u* at no moment (1/m), its growth with the moment (1/(N m^2)), the moment's rise from
the tip end to the middle and the moment at the middle (N m; both start as a guess and are written)."""
COMPLIANCE, YIELD, PLAY = 0, 1, 2
"""Of every play behind them: c (1/(N m^2)), y (N m), p (N m, x and y)."""
LAW = 4

AGREED = 0.5
"""Times `close`: change of the bend over a rod's length (rad) at which moments and memory agree."""
MOST_ROUNDS = 3 * ROUNDS
TELLING = 10.0
"""A turn teaches the Jacobian when it is so many times what the memory moved in the same pass."""


@inline
def rest_of(laws: Array, o: int, plays: int, x: float, y: float, l: int) -> tuple[float, float]:
    """u* (x, y) of the element at o under the moment (x, y) at its middle."""
    u = laws[(o + STILL) * LANES + l] + laws[(o + SLOPE) * LANES + l] * x
    v = laws[(o + STILL + 1) * LANES + l] + laws[(o + SLOPE + 1) * LANES + l] * y
    for j in range(plays):
        k = o + PLAYS + LAW * j
        dx, dy = x - laws[(k + PLAY) * LANES + l], y - laws[(k + PLAY + 1) * LANES + l]
        held = min(1.0, laws[(k + YIELD) * LANES + l] / (math.sqrt(dx * dx + dy * dy) + 1e-300))
        u += laws[(k + COMPLIANCE) * LANES + l] * (x - held * dx)
        v += laws[(k + COMPLIANCE) * LANES + l] * (y - held * dy)
    return u, v


@routine
def enter(work: Array, elements: Array, laws: Array, e: int, plays: int, active: int) -> None:
    """Set u* of element e from the moment at its tip end, which is left in MIDDLE, and the rise of the last pass."""
    o, p = e * (PLAYS + LAW * plays), e * ELEMENT + 7
    for l in range(active):
        x, y = work[M * LANES + l], work[(M + 1) * LANES + l]
        u, v = rest_of(laws, o, plays, x + laws[(o + RISEN) * LANES + l], y + laws[(o + RISEN + 1) * LANES + l], l)
        elements[p * LANES + l], elements[(p + 1) * LANES + l] = u, v
        laws[(o + MIDDLE) * LANES + l], laws[(o + MIDDLE + 1) * LANES + l] = x, y


@routine
def meet(work: Array, elements: Array, laws: Array, e: int, plays: int, active: int, gap: Array) -> None:
    """Read the moment at the middle of element e; adds to `gap` (rad) what u* should have been bent more or less."""
    o, p = e * (PLAYS + LAW * plays), e * ELEMENT
    for l in range(active):
        x, y = work[M * LANES + l], work[(M + 1) * LANES + l]
        u, v = rest_of(laws, o, plays, x, y, l)
        missed = abs(u - elements[(p + 7) * LANES + l]) + abs(v - elements[(p + 8) * LANES + l])
        gap[l] += missed * elements[p * LANES + l]
        laws[(o + RISEN) * LANES + l] = x - laws[(o + MIDDLE) * LANES + l]
        laws[(o + RISEN + 1) * LANES + l] = y - laws[(o + MIDDLE + 1) * LANES + l]
        laws[(o + MIDDLE) * LANES + l], laws[(o + MIDDLE + 1) * LANES + l] = x, y


@routine
def evaluate_with_memory(
    work: Array,
    elements: Array,
    rises: Array | None,
    series: Array | None,
    laws: Array,
    plays: int,
    parts: Counts,
    springs: int,
    active: int,
    gap: Array,
) -> None:
    """As `passes.evaluate` with all loads, u* following the moment; `gap` (LANES) says by how much it lagged behind."""
    set_tip(work, 1.0, active)
    pull(work, springs, active)
    gap[:] = 0.0
    for e in range(parts.size):
        enter(work, elements, laws, e, plays, active)
        for j in range(parts[e]):
            dz = -1.0 / parts[e]
            z = 1.0 + j * dz
            if 2 * j == parts[e]:
                meet(work, elements, laws, e, plays, active, gap)
            if active == LANES:
                for l in range(LANES):
                    advance(work, elements, rises, series, e * ELEMENT, (3 * e, 9 * e), z, dz, l, 1.0, None)
            else:
                for l in range(active):
                    advance_alone(work, elements, rises, series, e, z, dz, l, 1.0)
    read_base(work, active)
    if springs > 0:
        read_gap(work, active)


@routine
def settle(
    work: Array,
    elements: Array,
    rises: Array | None,
    series: Array | None,
    laws: Array,
    plays: int,
    parts: Counts,
    springs: int,
    active: int,
    close: float,
    gap: Array,
) -> None:
    """As `newton.improve`, until the memory agrees too."""
    copy(work, MISS, BEFORE, 6)
    for _ in range(MOST_ROUNDS):
        if worst(work, springs, active) < close and gap[:active].max() < AGREED * close:
            return
        newton_turn(work, springs, active)
        turn_tip(work, springs, active)
        for l in range(active):
            # What the memory does to the base must not be taken for the work of a turn: no turn, nothing learnt.
            if not size_of(work, TURN, springs, l) > TELLING * gap[l]:
                for k in range(6):
                    work[(TURN + k) * LANES + l] = 0.0
        copy(work, MISS, BEFORE, 6)
        copy(work, PLACE, KEPT + 7, 3)
        evaluate_with_memory(work, elements, rises, series, laws, plays, parts, springs, active, gap)
        broyden(work, springs, active)


@inline
def gather_laws(table: Array, row: int, laws: Array, elements: Array, plays: int, l: int) -> None:
    """Copy the laws of rod `row` into a lane, tip first, and set u* by the moments guessed for the middles."""
    count, width = table.shape[1], table.shape[2]
    for e in range(count):
        o, p = e * width, e * ELEMENT
        for k in range(width):
            laws[(o + k) * LANES + l] = table[row, count - 1 - e, k]
        x, y = laws[(o + MIDDLE) * LANES + l], laws[(o + MIDDLE + 1) * LANES + l]
        u, v = rest_of(laws, o, plays, x, y, l)
        elements[(p + 7) * LANES + l], elements[(p + 8) * LANES + l] = u, v
        rest = vector_of(elements, p + 7, l)
        elements[(p + REST) * LANES + l] = math.sqrt(dot(rest, rest))


@inline
def even(parts: Counts) -> None:
    """Make every number of steps even."""
    for e in range(parts.size):
        parts[e] += parts[e] % 2


@routine
def note_largest(work: Array, elements: Array, count: int, active: int) -> None:
    """The largest moment and |u*| of the last pass, which the cuts follow."""
    for l in range(active):
        work[LARGEST * LANES + l] = math.sqrt(work[PEAK * LANES + l])
        for e in range(count):
            rest = vector_of(elements, e * ELEMENT + 7, l)
            elements[(e * ELEMENT + REST) * LANES + l] = math.sqrt(dot(rest, rest))


@kernel
def solve_state(
    rods: Array,
    head: int,
    block: int,
    rises: Array | None,
    series: Array | None,
    springs: int,
    divisions: float,
    close: float,
    table: Array,
    out: Array,
) -> None:
    """As `group.solve_direct` from a cold start; `table` (n, elements, PLAYS + LAW plays) holds the laws.

    RISEN and MIDDLE are read as guesses and written. Rows that did not converge have an AT_MISS that is not below `close`.
    """
    n, count = rods.shape[0], table.shape[1]
    plays = (table.shape[2] - PLAYS) // LAW
    work, gap = new_work(), np.zeros(LANES)
    parts = np.empty(count, np.int64)
    elements, laws = new_elements(count), np.zeros(count * table.shape[2] * LANES)
    for first in range(0, n, LANES):
        active = min(LANES, n - first)
        for l in range(active):
            gather_ends(rods, first + l, head, block, work, l)
            gather_elements(rods, first + l, head, block, elements, rises, series, l)
            gather_laws(table, first + l, laws, elements, plays, l)
        cut(work, elements, parts, COARSE_DIVISIONS, active)
        first_guess(work, elements, rises, series, parts, active)
        difference_jacobian(work, elements, rises, series, parts, springs, active)
        improve(work, elements, rises, series, parts, springs, active, NEAR, ROUNDS)
        for fine in (False, True):
            # First coarsely: how finely the rod must be cut depends on what the memory of this state bends.
            if fine:
                note_largest(work, elements, count, active)
                cut(work, elements, parts, divisions, active)
            even(parts)
            wanted = close if fine else max(NEAR, close)
            evaluate_with_memory(work, elements, rises, series, laws, plays, parts, springs, active, gap)
            settle(work, elements, rises, series, laws, plays, parts, springs, active, wanted, gap)
        newton_turn(work, springs, active)
        turn_tip(work, springs, active)
        for l in range(active):
            write_result(work, springs, out, first + l, l)
            if not gap[l] < AGREED * close:
                out[first + l, AT_MISS] = math.inf
            for e in range(count):
                for k in range(RISEN, PLAYS):
                    table[first + l, count - 1 - e, k] = laws[(e * table.shape[2] + k) * LANES + l]
