"""The columns of `tangent` for a group of rods: started at the tip, stepped with the rods past their stations, and what a
direction in parameter space makes of them by reciprocity.

Loops run over all lanes: those without a rod hold a copy.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

from model.arrays import Array, Mask
from model.rods.columns import LENGTH, LOAD
from model.rods.fast.algebra import Vector, add, along, cross, minus, scaled, turned, turned_back, unit
from model.rods.fast.compiler import inline, routine
from model.rods.fast.derivatives.collect import collect
from model.rods.fast.derivatives.tangent import (
    COLUMN,
    FORCES,
    MOMENTS,
    NOTHING,
    PLACED,
    TIP_COLUMNS,
    TURNS,
    ColumnWalk,
    TangentColumn,
    load_column,
    step_column,
)  # fmt: skip
from model.rods.fast.equations import strains
from model.rods.fast.group import BLOCK, SECTION, BasePoint, Rod, RodGroup, each_rod, section_of
from model.rods.fast.lanes import LANES, LaneRecord, copy, copy_lanes, record
from model.rods.fast.passes import WHOLE, advance, orientation, read_base, start_at_tip
from model.rods.fast.walk import passes


@record
class SectionChange(LaneRecord):
    """What a change does to a section, mount frame."""

    turn: Vector
    shift: Vector
    moment: Vector


@record
class TipChange(LaneRecord):
    """One number for each column that starts at the tip: a change of the wrench there, or what else belongs to each."""

    turn: Vector
    moment: Vector
    force: Vector


@record
class Station(LaneRecord):
    """What was seen of the columns at a station, or at the base."""

    by: Annotated[list[SectionChange], TIP_COLUMNS]
    """What each column that starts at the tip does to the section there."""
    place_slope: Vector
    turn_slope: Vector
    """What position and orientation do along the arc there: R v, R u."""


@record
class Done(LaneRecord):
    """What a direction does within the rod up to a station."""

    work: TipChange
    """T of the columns that start at the tip; that of the turn with M x T_moment."""
    force: Vector
    """Change of N."""


STATION, DONE = Station.size, Done.size


class GroupColumns(NamedTuple):
    """The columns of a group, and what was seen of them at its stations."""

    x: Array
    """(elements, columns of `TangentColumn`)."""
    beside: Array
    """(columns of `TangentColumn`) where a station is passed."""
    passed: Array
    """(stations, elements, columns of `TangentColumn`): x there."""
    walked: Array
    """(stations + 1, elements, LANES): share of each element between the tip and a station; the base last."""
    stations: Array
    """(stations + 1) of `Station`, the base last."""


class Direction(NamedTuple):
    """A direction in parameter space for every lane."""

    d: Array
    """(width, LANES), in the order of `columns`."""
    some: Mask
    """(width,): which of its numbers are not zero everywhere."""
    most: Array
    """(k, width): see `scan_directions`."""
    done: Array
    """Of `Done`."""
    forced: Array
    """(forced columns, LANES): T of those."""


@routine
def walk_columns(group: RodGroup, columns: GroupColumns, arcs: Array, first: int) -> None:
    """Walk all lanes and their columns from tip to base, and keep what is seen at the stations `arcs` (n, s), m from the base.

    Lane 0 is the rod of row `first`. Element e, tip first, leaves its columns in x[e]: they start from x[e - 1], the first ones
    from the tip, and collect T from nothing.
    """
    x, base = columns.x, columns.stations[arcs.shape[1]]
    start_at_tip(group, group.springs, WHOLE)
    start_columns(group, columns)
    for e in range(len(x)):
        # One piece at least: the derivative by the length of an empty element is wanted, too.
        pieces = max(group.parts[e], 1)
        for l in range(LANES):
            walk = ColumnWalk(group.work, l)
            copy(section_of(group, e, l), walk.section, SECTION)
        for j in range(pieces):
            start = x[e if j > 0 else max(e - 1, 0)]
            for s in range(arcs.shape[1]):
                if passes(group, (e, j, pieces), arcs, first, s):
                    step_all(group, start, columns.beside, e, j, pieces)
                    see_station(group, columns, s, e, 1.0 - j / pieces, pieces)
            set_share(group)
            step_all(group, start, x[e], e, j, pieces)
            go_on(group)
    read_base(group)
    for l in range(LANES):
        see_section(Rod(group.work, l).here, x[len(x) - 1], base, l)


@each_rod
def set_share(rod: Rod) -> None:
    """Let the next step be taken in full: `passes` has left each rod the share at which it meets a station."""
    rod.share = 1.0


@each_rod
def go_on(rod: Rod) -> None:
    """Move the rod to the end of the step, where `step_all` has put `beside`."""
    to, here = rod.beside, rod.here
    here.q, here.m, here.r, here.force, here.peak = to.q, to.m, to.r, to.force, to.peak


@routine
def start_columns(group: RodGroup, columns: GroupColumns) -> None:
    """Columns at the tip: a unit turn, moment and force about each axis of the mount frame; forced ones are empty."""
    x = columns.x[0]
    x[:] = 0.0
    for l in range(LANES):
        here = Rod(group.work, l).here
        ColumnWalk(group.work, l).tip_moment = turned(here.q, here.m)
        for k in range(3):
            axis = turned_back(here.q, unit(k))
            turn = TangentColumn(x, l, (TURNS + k) * COLUMN)
            turn.theta, turn.dm = axis, cross(here.m, axis)
            TangentColumn(x, l, (MOMENTS + k) * COLUMN).dm = axis


@routine
def step_all(group: RodGroup, start: Array, into: Array, e: int, j: int, pieces: int) -> None:
    """Step j of `pieces` through element e, of each lane the share `rod.share` of it.

    Rods go from `here` to `beside`, columns from `start` to `into`.
    """
    work, z, dz = group.work, 1.0 - j / pieces, -1.0 / pieces
    for l in range(LANES):
        walk = ColumnWalk(work, l)
        advance(walk.rod, walk.section, group.linear, z, dz * walk.rod.share, 1.0, walk.stages, walk.rod.beside)
    for c in range(into.size // (COLUMN * LANES)):
        load_column(work, start, c, COLUMN if j > 0 else PLACED, e)
        for l in range(LANES):
            step_column(ColumnWalk(work, l), dz)
        collect(work, group.linear, z, dz)
        copy_lanes(ColumnWalk(work, 0).column, TangentColumn(into, 0, c * COLUMN), COLUMN)


@routine
def see_station(group: RodGroup, columns: GroupColumns, s: int, e: int, z: float, pieces: int) -> None:
    """Keep slopes, section and columns at station s for lanes that pass it in the step of 1 / `pieces` from z in element e."""
    x, beside, walked, passed = columns.x, columns.beside, columns.walked[s], columns.passed[s]
    for l in range(group.active):
        walk = ColumnWalk(group.work, l)
        rod, share = walk.rod, walk.rod.share / pieces
        if rod.share < 0.0:
            continue
        see_slopes(rod.beside, walk, z - share, Station(columns.stations[s], l))
        see_section(rod.beside, beside, columns.stations[s], l)
        for i in range(len(x)):
            walked[i, l] = 1.0 if i < e else 1.0 - z + share if i == e else 0.0
            column = beside if i == e else x[i]
            for k in range(l, column.size, LANES):
                passed[i, k] = column[k] if i <= e else 0.0


@inline
def see_slopes(at: BasePoint, walk: ColumnWalk, z: float, station: Station) -> None:
    """R v and R u at the place z of the element."""
    q, section = orientation(at), walk.section
    found = strains(at.m, turned_back(q, at.force), section, z, None, False)
    station.place_slope, station.turn_slope = turned(q, found.v), turned(q, found.u)


@inline
def see_section(at: BasePoint, x: Array, stations: Array, l: int) -> None:
    """What the columns of lane l that started at the tip do to the section at a point."""
    q = orientation(at)
    for j in range(TIP_COLUMNS):
        column, change = TangentColumn(x, l, j * COLUMN), Station(stations, l).by[j]
        change.turn, change.shift = turned(q, column.theta), column.p
        change.moment = turned(q, add(column.dm, cross(column.theta, at.m)))


@routine
def scan_directions(directions: Array, rods: int, first: int, most: Array) -> None:
    """The largest of every number of every direction over the lanes, without sign, into `most` (k, width): most are zero, and
    what is read in the order of memory comes several times as fast."""
    most[:] = 0.0
    count, width = most.shape
    for l in range(LANES if directions.shape[0] > 1 else 1):
        for k in range(count):
            row, of_row = directions[lane_row(directions, rods, first, l), k], most[k]
            for c in range(width):
                of_row[c] = max(of_row[c], abs(row[c]))


@routine
def load_direction(directions: Array, rods: int, first: int, k: int, to: Direction) -> None:
    """Direction k of every lane into `to`."""
    for c in range(directions.shape[2]):
        changes = to.most[k, c] > 0.0
        if changes:
            for l in range(LANES):
                to.d[c, l] = directions[lane_row(directions, rods, first, l), k, c]
        elif to.some[c]:
            for l in range(LANES):
                to.d[c, l] = 0.0
        to.some[c] = changes


@inline
def lane_row(directions: Array, rods: int, first: int, l: int) -> int:
    """The row of lane l; lanes without a rod have the last one's."""
    return min(first + l, rods - 1) if directions.shape[0] > 1 else 0


@inline
def nine_works(x: Array, c: int, l: int) -> tuple[Vector, Vector, Vector]:
    """T number c of the columns that start at the tip with a turn, a moment, a force."""
    return (
        (work_of(x, 0, c, l), work_of(x, 1, c, l), work_of(x, 2, c, l)),
        (work_of(x, 3, c, l), work_of(x, 4, c, l), work_of(x, 5, c, l)),
        (work_of(x, 6, c, l), work_of(x, 7, c, l), work_of(x, 8, c, l)),
    )


@inline
def work_of(x: Array, j: int, c: int, l: int) -> float:
    """T number c of column j."""
    return TangentColumn(x, l, j * COLUMN).work[c]


@routine
def collect_work(x: Array, walked: Array, group: RodGroup, to: Direction) -> None:
    """Fill `to.done` and `to.forced`: work T and change of force by what a direction changes within the rod, from tip to a point.

    There the columns are `x`, and `walked` (elements, LANES) the share of each element between the tip and the point.
    """
    to.done[:], to.forced[:] = 0.0, 0.0
    for e in range(len(x)):
        o = to.some.size - (e + 1) * BLOCK
        for c in range(BLOCK):
            if not to.some[o + c]:
                continue
            change, of_element = to.d[o + c], x[e]
            for l in range(LANES):
                (turn, moment, force), work = nine_works(of_element, c, l), Done(to.done, l).work
                work.turn = along(work.turn, change[l], turn)
                work.moment = along(work.moment, change[l], moment)
                work.force = along(work.force, change[l], force)
            for j in range(len(to.forced)):
                for l in range(LANES):
                    to.forced[j, l] += work_of(of_element, TIP_COLUMNS + j, c, l) * change[l]
            if c == LENGTH or LOAD <= c < LOAD + 3:  # these change the weight that has been passed, and so N
                for l in range(LANES):
                    section, done = section_of(group, e, l), Done(to.done, l)
                    force_change = section.load if c == LENGTH else scaled(section.length, unit(c - LOAD))
                    done.force = along(done.force, walked[e, l] * change[l], force_change)
    for l in range(LANES):
        work = Done(to.done, l).work
        work.turn = add(work.turn, cross(ColumnWalk(group.work, l).tip_moment, work.moment))


@inline
def start_within(start: TipChange, done: Done, factors: TipChange) -> None:
    """Factors of the columns that start at the tip: what changes there, and G of `implicit`."""
    factors.turn = minus(start.turn, done.work.moment)
    factors.moment = add(start.moment, done.work.turn)
    factors.force = add(start.force, done.force)


@inline
def combine(by: list[SectionChange], factors: TipChange, change: SectionChange) -> None:
    """`change` of a section by the factors of the columns that start at the tip."""
    change.turn, change.shift, change.moment = NOTHING, NOTHING, NOTHING
    for k in range(3):
        add_change(change, by[TURNS + k], factors.turn[k])
        add_change(change, by[MOMENTS + k], factors.moment[k])
        add_change(change, by[FORCES + k], factors.force[k])


@inline
def add_change(change: SectionChange, more: SectionChange, factor: float) -> None:
    """change += factor more."""
    change.turn = along(change.turn, factor, more.turn)
    change.shift = along(change.shift, factor, more.shift)
    change.moment = along(change.moment, factor, more.moment)
