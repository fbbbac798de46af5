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

from model.arrays import Array, Ints
from model.rods.columns import BASE_TURN, LENGTH
from model.rods.fast.algebra import add, along, cross, minus, scaled, turned, unit
from model.rods.fast.compiler import allocating, inline, kernel, routine
from model.rods.fast.derivatives.columns_walk import (
    DONE,
    STATION,
    Direction,
    Done,
    GroupColumns,
    SectionChange,
    Station,
    TipChange,
    add_change,
    collect_work,
    combine,
    load_direction,
    scan_directions,
    start_within,
    walk_columns,
)  # fmt: skip
from model.rods.fast.derivatives.ends import (
    ENDS,
    EndParameters,
    Ends,
    base_parameter_change,
    base_residual_change,
    linearise_ends,
    springs_by_motion,
    tip_wrench_change,
)  # fmt: skip
from model.rods.fast.derivatives.tangent import COLUMN, NOTHING, TIP_COLUMNS, WALK, TangentColumn
from model.rods.fast.direct import put_three
from model.rods.fast.group import BLOCK, SIX, Rod, RodGroup, Six, elements_of, new_group, three
from model.rods.fast.lanes import LANES, LaneRecord, copy_lanes, new_numbers, record
from model.rods.fast.newton import newton_step, set_column
from model.rods.fast.walk import stand_at_tip

Asked = tuple[Array, Array, int, bool]
"""Directions (n or 1, k, width) of rows; arc lengths (n, s) of stations, m from the base; how many of these, the first, go
with their share of an element when lengths change, the others staying where they are; whether mean strains are wanted."""

BY_TIP, BY_ROTATION, BY_BASE_FORCE, BY_BASE_MOMENT, BY_BASE_TURN, OUTPUTS = 0, 3, 6, 9, 12, 15
"""d tip (m), d rotation of the tip (rad, mount frame), d base force (N), d base moment (N m), d rotation of the base
(rad); then the mean strain of each element (1) where asked, then d position (m) and d rotation (rad) of each station."""
OF_STATION = 6


@record
class Unknown(LaneRecord):
    """What a unit of an unknown does."""

    start: TipChange
    """The state at the tip."""
    base: SectionChange
    """The section at the base."""


@record
class DirectionChange(LaneRecord):
    """What a direction does."""

    start: TipChange
    """The state at the tip."""
    factors: TipChange
    """By which the columns that start at the tip add up."""
    base: SectionChange
    station: SectionChange
    """The section at the base and at a station."""


UNKNOWN, CHANGE = Unknown.size, DirectionChange.size


class Room(NamedTuple):
    """Where what belongs to the ends is kept."""

    ends: Array
    """Of `Ends`."""
    base: Array
    """Of `Station`: what was seen at the base."""
    unknowns: Array
    """(unknowns) of `Unknown`."""
    steps: Array
    """(unknowns) of `Six`: the Newton step of a unit of each residual, with springs only."""
    change: Array
    """Of `DirectionChange`."""


@kernel
def differentiate(rods: Array, springs: int, grid: tuple[float, Ints], asked: Asked, solved: Array, out: Array) -> None:
    """Fill `out` (n, k, outputs), columns `BY_*`, with derivatives along the k directions of `asked` at the solutions `solved`.

    `grid`: divisions and fixed steps (n or 0 rows), with which the rods were solved.
    """
    directions, arcs, _, strained = asked
    n, width = rods.shape
    stations, size = arcs.shape[1], elements_of(rods, springs)
    group = new_group(rods, springs, WALK)
    columns = new_columns(size, size if strained else 0, stations)
    room = Room(
        np.zeros(ENDS * LANES),
        columns.stations[stations],
        np.zeros((6, UNKNOWN * LANES)),
        np.zeros((6, SIX * LANES)),
        np.zeros(CHANGE * LANES),
    )
    direction = Direction(
        np.zeros((width, LANES)),
        np.zeros(width, np.bool_),
        np.zeros((directions.shape[1], width)),
        np.zeros(DONE * LANES),
        np.zeros((size if strained else 0, LANES)),
    )
    for first in range(0, n, LANES):
        stand_at_tip(rods, group, solved, grid, first)
        walk_columns(group, columns, arcs, first)
        for l in range(LANES):
            tilt = three(rods, min(first + l, n - 1), BASE_TURN)
            linearise_ends(Rod(group.work, l), Ends(room.ends, l), tilt)
        differentiate_unknowns(group, room)
        if first == 0 or len(directions) > 1:
            scan_directions(directions, n, first, direction.most)
        rows = out[first : min(first + LANES, n)]
        for k in range(directions.shape[1]):
            load_direction(directions, n, first, k, direction)
            if not direction.some.any():
                rows[:, k] = 0.0
                continue
            collect_work(columns.x, columns.walked[stations], group, direction)
            differentiate_direction(group, room, direction)
            write_ends(room.change, rows, k)
            if strained:
                write_strains(columns.x, direction, room.change, rows, k)
            write_stations(group, columns, direction, room.change, asked, rows, k)


@allocating
def new_columns(size: int, forced: int, stations: int) -> GroupColumns:
    """Room for the columns of rods of `size` elements: nine that start at the tip, and one for each of `forced` mean strains.
    `walked` is 1 at the base, which comes after the stations: all of every element lies between it and the tip."""
    numbers = (TIP_COLUMNS + forced) * COLUMN * LANES
    walked = np.zeros((stations + 1, size, LANES))
    walked[stations] = 1.0
    return GroupColumns(
        new_numbers(size * numbers).reshape((size, numbers)),
        new_numbers(numbers),
        np.zeros((stations, size, numbers)),
        walked,
        np.zeros((stations + 1, STATION * LANES)),
    )


@routine
def differentiate_unknowns(group: RodGroup, room: Room) -> None:
    """Fill `room.unknowns` with what a unit of each unknown does to tip and base; the residuals are columns of the Jacobian.

    With springs fill `room.steps`, too: the Newton step of a unit of each residual, so that all directions share the inverse.
    """
    for c in range(6 if group.springs > 0 else 3):
        turn, shift = unit(c), unit(c - 3)
        for l in range(LANES):
            rod, ends, unknown = Rod(group.work, l), Ends(room.ends, l), Unknown(room.unknowns[c], l)
            start, base = unknown.start, unknown.base
            pulled = springs_by_motion(rod, group.springs, turn, shift)
            force, moment = cross(turn, ends.force), cross(turn, ends.moment)
            start.turn, start.moment, start.force = turn, add(moment, pulled[1]), add(force, pulled[0])
            combine(Station(room.base, l).by, start, base)
            set_column(rod.jacobian.turn, c, base_residual_change(rod, ends, base, force, moment))
            if group.springs > 0:
                set_column(rod.jacobian.shift, c, add(base.shift, shift))
    for c in range(6 if group.springs > 0 else 0):
        for l in range(LANES):
            residual = Rod(group.work, l).found.residual
            residual.turn, residual.shift = unit(c), unit(c - 3)
        newton_step(group)
        copy_lanes(Rod(group.work, 0).change, Six(room.steps[c], 0), SIX)


@routine
def differentiate_direction(group: RodGroup, room: Room, direction: Direction) -> None:
    """Fill `room.change` with what a direction does: first with the tip's pose held, then with the change of the pose by which
    the base meets its condition again (a Newton step)."""
    for l in range(LANES):
        rod, change, d = Rod(group.work, l), DirectionChange(room.change, l), EndParameters(direction.d, l)
        force, moment = tip_wrench_change(rod, group.springs, d)
        change.start.turn, change.start.moment, change.start.force = NOTHING, moment, force
        see_change(Station(room.base, l), change, Done(direction.done, l), change.base)
    for l in range(LANES):
        rod, change, d = Rod(group.work, l), DirectionChange(room.change, l), EndParameters(direction.d, l)
        ends, q = Ends(room.ends, l), rod.tip.turn
        residual = base_residual_change(rod, ends, change.base, turned(q, d.tip_force), turned(q, d.tip_moment))
        rod.found.residual.turn = add(residual, base_parameter_change(rod, ends, d))
        rod.found.residual.shift = change.base.shift
    if group.springs > 0:
        step_by_table(group, room)
    else:
        newton_step(group)
    for c in range(6 if group.springs > 0 else 3):
        for l in range(LANES):
            change, unknown, by = DirectionChange(room.change, l), Unknown(room.unknowns[c], l), Rod(group.work, l).change[c]
            add_tip_change(change.start, unknown.start, by)
            add_tip_change(change.factors, unknown.start, by)
            add_change(change.base, unknown.base, by)


@inline
def step_by_table(group: RodGroup, room: Room) -> None:
    """The Newton step in six unknowns."""
    for l in range(LANES):
        change = Rod(group.work, l).change
        change.turn, change.shift = NOTHING, NOTHING
    for c in range(6):
        for l in range(LANES):
            rod, step = Rod(group.work, l), Six(room.steps[c], l)
            by = rod.found.residual[c]
            rod.change.turn = along(rod.change.turn, by, step.turn)
            rod.change.shift = along(rod.change.shift, by, step.shift)


@inline
def see_change(station: Station, change: DirectionChange, done: Done, to: SectionChange) -> None:
    """What `change.start` and what was done within the rod do to the section at a station."""
    start_within(change.start, done, change.factors)
    combine(station.by, change.factors, to)
    to.shift = minus(to.shift, done.work.force)


@inline
def add_tip_change(change: TipChange, more: TipChange, factor: float) -> None:
    """change += factor more."""
    change.turn = along(change.turn, factor, more.turn)
    change.moment = along(change.moment, factor, more.moment)
    change.force = along(change.force, factor, more.force)


@routine
def write_ends(changes: Array, out: Array, k: int) -> None:
    """What comes out at the ends."""
    for l in range(len(out)):
        change, own = DirectionChange(changes, l), out[l]
        put_three(own, k, BY_TIP, scaled(-1.0, change.base.shift))
        put_three(own, k, BY_ROTATION, change.start.turn)
        put_three(own, k, BY_BASE_FORCE, change.factors.force)
        put_three(own, k, BY_BASE_MOMENT, change.base.moment)
        put_three(own, k, BY_BASE_TURN, change.base.turn)


@routine
def write_strains(x: Array, direction: Direction, changes: Array, out: Array, k: int) -> None:
    """The mean strain of each element; those of the outputs run from the base, those of the pass from the tip."""
    size = len(x)
    for e in range(size):
        for l in range(len(out)):
            factors, total = DirectionChange(changes, l).factors, direction.forced[e, l]
            for j in range(TIP_COLUMNS):
                total += TangentColumn(x[e], l, j * COLUMN).mean_strain * factors[j]
            out[l, k, OUTPUTS + size - 1 - e] = total


@routine
def write_stations(
    group: RodGroup, columns: GroupColumns, direction: Direction, changes: Array, asked: Asked, out: Array, k: int
) -> None:
    """Write the changes of position and rotation at the stations, direction k, into `out` (rods, k, outputs)."""
    _, arcs, attached, strained = asked
    size, d = len(columns.x), direction.d
    first_output = OUTPUTS + (size if strained else 0)
    for s in range(arcs.shape[1]):
        collect_work(columns.passed[s], columns.walked[s], group, direction)
        for l in range(len(out)):
            change, row, station = DirectionChange(changes, l), out[l], Station(columns.stations[s], l)
            see_change(station, change, Done(direction.done, l), change.station)
            # The columns followed a fixed share of the element; the station is at a fixed arc length, this far (m) from there.
            slid = 0.0
            for e in range(size if s >= attached else 0):
                slid += (1.0 - columns.walked[s, e, l]) * d[len(d) - (e + 1) * BLOCK + LENGTH, l]
            shift = minus(change.station.shift, change.base.shift)
            put_three(row, k, first_output + OF_STATION * s, along(shift, -slid, station.place_slope))
            put_three(row, k, first_output + OF_STATION * s + 3, along(change.station.turn, -slid, station.turn_slope))
