"""Implicit differentiation at a solution, a group of rods at a time: one pass, whatever the number of parameters.

With the columns Y of `tangent` the change of a section's state behind parameters d is, in the mount frame,
    X = Y (x + G d)        x: what changes at the tip, G: what comes from within, by reciprocity
    G_turn = - T_moment,  G_moment = T_turn + M x T_moment,  G_force = integral df dt,  G_shift = - T_force
where T_moment is what the columns that start with a unit moment collected, and so on, and M the moment at the tip: the
turn of a section is conjugate to the change of its moment halfway between both frames. Of x the turn of the tip (and,
with springs, its shift) is unknown; the base must not miss its pose (`ends`), which is a 3 by 3 (6 by 6) system.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from model.rods.columns import LENGTH, TIP_FORCE, TIP_MOMENT
from model.rods.fast.algebra import add, along, cross, turned, unit
from model.rods.fast.derivatives.column_layout import (
    BUFFER,
    BY_FORCE,
    BY_MOMENT,
    BY_TURN,
    COLUMN,
    MEAN_STRAIN,
    TIP_COLUMNS,
)
from model.rods.fast.derivatives.columns_walk import (
    SECTION,
    Columns,
    Direction,
    collect_work,
    combine,
    load_direction,
    scan_directions,
    section_changes,
    start_columns,
    tip_factors,
)
from model.rods.fast.derivatives.crossings import visit_station
from model.rods.fast.derivatives.ends import (
    ENDS,
    FOLLOWER_FORCE,
    FOLLOWER_MOMENT,
    base_parameter_change,
    base_residual_change,
    linearise_ends,
    springs_by_motion,
    tip_wrench_change,
    vector_in,
)
from model.rods.fast.derivatives.tangent import step_all
from model.rods.fast.jit import inline, kernel, routine
from model.rods.fast.lanes import (
    JACOBIAN,
    LANES,
    RESIDUAL,
    TIP,
    TURN,
    Counts,
    Full,
    Group,
    RowLayout,
    cut,
    elements_of,
    fixed_cut,
    gather_rod,
    new_elements,
    new_numbers,
    put,
    quaternion_of,
    vector_of,
)
from model.rods.fast.newton import jacobian_of, newton_step_3, newton_step_6
from model.rods.fast.passes import add_springs, read_base, set_tip
from model.rods.fast.stage_buffer import STEP_SHARE, load_element
from model.rods.fast.walk import set_solved

Array = NDArray[np.float64]
Asked = tuple[Array, Array, int, bool]
"""Directions (n or 1, k, width) of rows; arc lengths (n, s) of stations, m from the base; how many of these, the first, go
with their share of an element when lengths change, the others staying where they are; whether mean strains are wanted."""

BY_TIP, BY_ROTATION, BY_BASE_FORCE, BY_BASE_MOMENT, BY_BASE_TURN, OUTPUTS = 0, 3, 6, 9, 12, 15
"""d tip (m), d rotation of the tip (rad, mount frame), d base force (N), d base moment (N m), d rotation of the base
(rad); then the mean strain of each element (1) where asked, then d position (m) and d rotation (rad) of each station."""
STATION = 6


class Unknowns(NamedTuple):
    """What a unit of each unknown does."""

    starts: Array
    """(unknowns, TIP_COLUMNS LANES): the state at the tip."""
    answers: Array
    """(unknowns, SECTION LANES): the change at the base."""
    steps: Array
    """(unknowns, unknowns LANES): the Newton step that a unit of each residual asks for; six unknowns alone."""


class Change(NamedTuple):
    """What a direction does."""

    start: Array
    """(TIP_COLUMNS LANES): the state at the tip."""
    factors: Array
    """(TIP_COLUMNS LANES): by which the columns that start at the tip add up."""
    base: Array
    """(SECTION LANES): the change of the section at the base."""
    station: Array
    """(SECTION LANES): the same at a station."""


@kernel
def differentiate(
    rods: Array,
    layout: tuple[int, int, int],
    full: Full,
    grid: tuple[float, Counts],
    asked: Asked,
    solved: Array,
    out: Array,
) -> None:
    """d outputs / d parameter (n, k, outputs) for the directions of `asked`, at the solutions `solved`; `grid` are divisions
    and fixed steps (n or 0 rows)."""
    at = RowLayout(layout[0], layout[1], layout[2])
    directions, arcs, _, strained = asked
    n, width = rods.shape
    stations, size = arcs.shape[1], elements_of(rods, at)
    count = TIP_COLUMNS + (size if strained else 0)
    work, elements, parts, ends = (
        new_numbers(BUFFER * LANES),
        new_elements(size),
        np.empty(size, np.int64),
        np.zeros(ENDS * LANES),
    )
    x = new_numbers(size * count * COLUMN * LANES).reshape((size, count, COLUMN * LANES))
    columns = Columns(
        x,
        np.zeros(3 * LANES),
        np.zeros((stations, *x.shape)),
        np.zeros((stations + 1, size, LANES)),
        np.zeros((stations + 1, TIP_COLUMNS, SECTION * LANES)),
        np.zeros((stations, 6 * LANES)),
        np.zeros((count + 1, COLUMN * LANES)),
    )
    columns.walked[stations] = 1.0
    amount = 6 if at.springs > 0 else 3
    unknowns = Unknowns(
        np.zeros((amount, TIP_COLUMNS * LANES)),
        np.zeros((amount, SECTION * LANES)),
        np.zeros((amount, amount * LANES)),
    )
    direction = Direction(
        np.zeros((width, LANES)),
        np.zeros(width, np.bool_),
        np.zeros((directions.shape[1], width)),
        np.zeros((count + 3, LANES)),
    )
    change = Change(
        np.zeros(TIP_COLUMNS * LANES),
        np.zeros(TIP_COLUMNS * LANES),
        np.zeros(SECTION * LANES),
        np.zeros(SECTION * LANES),
    )
    for first in range(0, n, LANES):
        group = Group(work, elements, full, parts, at.springs, min(LANES, n - first))
        for l in range(LANES):
            row = min(first + l, n - 1)
            gather_rod(rods, row, at, group, l)
            set_solved(group, solved, row, l)
        cut(group, grid[0])
        fixed_cut(group, grid[1], first)
        walk_columns(group, columns, arcs, first)
        for l in range(LANES):
            linearise_ends(work, ends, rods, min(first + l, n - 1), l)
        differentiate_unknowns(group, ends, columns.sections[stations], unknowns)
        if first == 0 or len(directions) > 1:
            scan_directions(directions, n, first, direction.most)
        for k in range(directions.shape[1]):
            load_direction(directions, n, first, k, direction)
            if not direction.some.any():
                out[first : first + group.active, k] = 0.0
                continue
            collect_work(x, columns.walked[stations], group, columns.moment, direction, at.block)
            differentiate_direction(group, ends, columns.sections[stations], direction, unknowns, change)
            write_ends(change, out, first, k, group.active)
            if strained:
                write_strains(x, direction, change, out, first, k, group.active)
            write_stations(group, columns, direction, change, asked, (first, k, at.block), out)


@routine
def walk_columns(group: Group, columns: Columns, arcs: Array, first: int) -> None:
    """Walk all lanes and their columns from tip to base, past the stations."""
    work, x = group.work, columns.x
    set_tip(work, 1.0, LANES)
    add_springs(work, group.springs, LANES)
    start_columns(work, columns)
    for e in range(len(x)):
        # An element that no rod of the group has still tells what its length would do.
        pieces = max(group.parts[e], 1)
        load_element(group, e)
        for j in range(pieces):
            for s in range(arcs.shape[1]):
                visit_station(group, columns, arcs, first, (e, j, pieces), s)
            for l in range(LANES):
                work[STEP_SHARE * LANES + l] = 1.0
            # Columns go on from where they left the element before, and collect anew.
            step_all(group, x[e if j > 0 else max(e - 1, 0)], x[e], (e, j, pieces))
    read_base(work, LANES)
    section_changes(work, x[len(x) - 1], columns.sections[arcs.shape[1]])


@routine
def differentiate_unknowns(group: Group, ends: Array, sections: Array, unknowns: Unknowns) -> None:
    """Fill `unknowns` and, for three of them, JACOBIAN; `sections` are the changes at the base by the columns."""
    work, springs = group.work, group.springs
    none = (0.0, 0.0, 0.0)
    for c in range(len(unknowns.starts)):
        start, change = unknowns.starts[c], unknowns.answers[c]
        for l in range(LANES):
            axis = unit(c % 3)
            turn = axis if c < 3 else none
            put(start, BY_TURN, l, turn)
            pulled = springs_by_motion(work, springs, turn, axis if c >= 3 else none, l)
            put(start, BY_MOMENT, l, add(cross(turn, vector_of(ends, FOLLOWER_MOMENT, l)), pulled[1]))
            put(start, BY_FORCE, l, add(cross(turn, vector_of(ends, FOLLOWER_FORCE, l)), pulled[0]))
        combine(sections, start, change)
        for l in range(LANES):
            turn = vector_of(start, BY_TURN, l)
            force = cross(turn, vector_of(ends, FOLLOWER_FORCE, l))
            moment = cross(turn, vector_of(ends, FOLLOWER_MOMENT, l))
            residual = base_residual_change(work, ends, change, force, moment, l)
            work[(JACOBIAN + c) * LANES + l] = residual[0]
            work[(JACOBIAN + 6 + c) * LANES + l] = residual[1]
            work[(JACOBIAN + 12 + c) * LANES + l] = residual[2]
            for r in range(3 if springs > 0 else 0):
                fixed = 1.0 if c == 3 + r else 0.0
                work[(JACOBIAN + 6 * (3 + r) + c) * LANES + l] = change[(3 + r) * LANES + l] + fixed
    for c in range(6 if springs > 0 else 0):
        for i in range(6 * LANES):
            work[RESIDUAL * LANES + i] = 1.0 if i // LANES == c else 0.0
        for l in range(LANES):
            newton_step_6(work, l)
        for i in range(6 * LANES):
            unknowns.steps[c, i] = work[TURN * LANES + i]


@routine
def differentiate_direction(
    group: Group, ends: Array, sections: Array, direction: Direction, unknowns: Unknowns, change: Change
) -> None:
    """Fill `change` but for its station: what a direction does, the base held in its place."""
    work, d, base = group.work, direction.d, change.base
    for l in range(LANES):
        force, moment = tip_wrench_change(work, group.springs, d, l)
        put(change.start, BY_TURN, l, (0.0, 0.0, 0.0))
        put(change.start, BY_MOMENT, l, moment)
        put(change.start, BY_FORCE, l, force)
    tip_factors(change.start, direction.work, change.factors)
    combine(sections, change.factors, base)
    for l in range(LANES):
        put(base, 3, l, along(vector_of(base, 3, l), -1.0, shift_within(direction.work, l)))
        q = quaternion_of(work, TIP, l)
        force, moment = turned(q, vector_in(d, TIP_FORCE, l)), turned(q, vector_in(d, TIP_MOMENT, l))
        residual = base_residual_change(work, ends, base, force, moment, l)
        put(work, RESIDUAL, l, add(residual, base_parameter_change(work, ends, d, l)))
    if group.springs > 0:
        for l in range(LANES):
            put(work, RESIDUAL + 3, l, vector_of(base, 3, l))
        for i in range(6 * LANES):
            work[TURN * LANES + i] = 0.0
        for c in range(6):
            for r in range(6):
                for l in range(LANES):
                    work[(TURN + r) * LANES + l] += unknowns.steps[c, r * LANES + l] * work[(RESIDUAL + c) * LANES + l]
    else:
        for l in range(LANES):
            put(work, TURN, l, newton_step_3(jacobian_of(work, l), vector_of(work, RESIDUAL, l)))
    for c in range(len(unknowns.starts)):
        at_tip, at_base = unknowns.starts[c], unknowns.answers[c]
        for l in range(LANES):
            by = work[(TURN + c) * LANES + l]
            for k in (0, 3, 6):
                add_times(change.start, at_tip, k, by, l)
                add_times(change.factors, at_tip, k, by, l)
                add_times(base, at_base, k, by, l)


@inline
def shift_within(work_done: Array, l: int) -> tuple[float, float, float]:
    """T_force: minus the shift that comes from within the rod."""
    return (work_done[BY_FORCE, l], work_done[BY_FORCE + 1, l], work_done[BY_FORCE + 2, l])


@inline
def add_times(into: Array, what: Array, k: int, by: float, l: int) -> None:
    """Add three quantities of `what`, by a factor."""
    put(into, k, l, along(vector_of(into, k, l), by, vector_of(what, k, l)))


@routine
def write_ends(change: Change, out: Array, row: int, k: int, active: int) -> None:
    """What comes out at the ends."""
    for l in range(active):
        for q in range(3):
            out[row + l, k, BY_TIP + q] = -change.base[(3 + q) * LANES + l]
            out[row + l, k, BY_ROTATION + q] = change.start[(BY_TURN + q) * LANES + l]
            out[row + l, k, BY_BASE_FORCE + q] = change.factors[(BY_FORCE + q) * LANES + l]
            out[row + l, k, BY_BASE_MOMENT + q] = change.base[(6 + q) * LANES + l]
            out[row + l, k, BY_BASE_TURN + q] = change.base[q * LANES + l]


@routine
def write_strains(x: Array, direction: Direction, change: Change, out: Array, row: int, k: int, active: int) -> None:
    """The mean strain of each element; those of the outputs run from the base, those of the pass from the tip."""
    size = len(x)
    for e in range(size):
        for l in range(active):
            total = direction.work[TIP_COLUMNS + e, l]
            for j in range(TIP_COLUMNS):
                total += x[e, j, MEAN_STRAIN * LANES + l] * change.factors[j * LANES + l]
            out[row + l, k, OUTPUTS + size - 1 - e] = total


@routine
def write_stations(
    group: Group,
    columns: Columns,
    direction: Direction,
    change: Change,
    asked: Asked,
    where: tuple[int, int, int],
    out: Array,
) -> None:
    """What comes out at the stations; `where` are the first row of the group, the direction and the block of a row."""
    _, arcs, attached, strained = asked
    row, k, block = where
    size, slopes, station = len(columns.x), columns.slopes, change.station
    at = OUTPUTS + (size if strained else 0)
    for s in range(arcs.shape[1]):
        collect_work(columns.passed[s], columns.walked[s], group, columns.moment, direction, block)
        tip_factors(change.start, direction.work, change.factors)
        combine(columns.sections[s], change.factors, station)
        for l in range(group.active):
            # What was followed is a share of an element; the station stays at its arc length.
            slid = 0.0
            for e in range(size):
                slid += (1.0 - columns.walked[s, e, l]) * direction.d[len(direction.d) - (e + 1) * block + LENGTH, l]
            if s < attached:
                slid = 0.0
            for q in range(3):
                shift = station[(3 + q) * LANES + l] - direction.work[BY_FORCE + q, l]
                shift -= change.base[(3 + q) * LANES + l]
                out[row + l, k, at + STATION * s + q] = shift - slid * slopes[s, q * LANES + l]
                out[row + l, k, at + STATION * s + 3 + q] = (
                    station[q * LANES + l] - slid * slopes[s, (3 + q) * LANES + l]
                )
