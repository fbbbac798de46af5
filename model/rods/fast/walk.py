"""The kernel that walks along solved rods and writes down what it finds at arc lengths."""

from __future__ import annotations

import numpy as np

from model.arrays import Array, Ints
from model.rods.description import Rods
from model.rods.fast.algebra import add, scaled, turned, turned_back
from model.rods.fast.compiler import kernel, routine
from model.rods.fast.direct import put_three
from model.rods.fast.equations import RodSection, strains
from model.rods.fast.group import ROD, Rod, RodGroup, cut, fixed_cut, gather, new_group, section_of, three
from model.rods.fast.lanes import LANES
from model.rods.fast.passes import WHOLE, advance, advance_group, orientation, start_at_tip
from model.rods.solution import AT_LARGEST, AT_ORIENTATION, AT_TIP, Solution

AT_PLACE, AT_TURN, AT_FORCE, AT_MOMENT, AT_STRAIN = 0, 3, 7, 10, 13
"""Columns of a station: m, quaternion, N, N m (mount frame), axial strain v3 - 1."""
WIDTH = 14


def states_at(rods: Rods, solution: Solution, arcs: Array, divisions: float, steps: Ints) -> Array:
    """(n, k, WIDTH) at arcs (n, k) m; NaN for rods that did not converge. `steps` as of `batches.steps_of`."""
    out = np.full((*arcs.shape, WIDTH), np.nan)
    walk(rods.values, rods.form.springs, (float(divisions), steps), solution.values, arcs, out)
    out[~solution.converged] = np.nan
    return out


@routine
def write_station(rod: Rod, section: RodSection, z: float, solved: Array, row: int, out: Array, s: int) -> None:
    """Write the state at `rod.beside`, at the share z of its element, as station s of a row."""
    there = rod.beside
    q = orientation(there)
    found = out[row]
    put_three(found, s, AT_PLACE, add(three(solved, row, AT_TIP), scaled(-1.0, turned(q, there.r))))
    found[s, AT_TURN], found[s, AT_TURN + 1], found[s, AT_TURN + 2], found[s, AT_TURN + 3] = q
    put_three(found, s, AT_FORCE, there.force)
    put_three(found, s, AT_MOMENT, turned(q, there.m))
    v = strains(there.m, turned_back(q, there.force), section, z, None, False).v
    found[s, AT_STRAIN] = v[2] - 1.0


@kernel
def walk(rods: Array, springs: int, grid: tuple[float, Ints], solved: Array, arcs: Array, out: Array) -> None:
    """Fill `out` (n, k, WIDTH), columns `AT_*`, at k arcs (n, k) m from the base of each rod, under its whole dead load.

    From the tip to the base, element by element, z from 1 at the tip's end of each to 0. `grid` are divisions and fixed steps (n
    rows, or none), which replace those that follow from the divisions.
    """
    group = new_group(rods, springs, ROD)
    for first in range(0, rods.shape[0], LANES):
        stand_at_tip(rods, group, solved, grid, first)
        start_at_tip(group, springs, WHOLE)
        for e in range(group.parts.size):
            pieces = max(group.parts[e], 1)
            for j in range(pieces):
                for s in range(arcs.shape[1]):
                    visit_station(group, (e, j, pieces), arcs, first, s, solved, out)
                advance_group(group, e, 1.0 - j / pieces, -1.0 / pieces, WHOLE)


@routine
def stand_at_tip(rods: Array, group: RodGroup, solved: Array, grid: tuple[float, Ints], first: int) -> None:
    """Gather the solved rods from row `first` on and cut them as their solve was cut."""
    gather(rods, group, first)
    for l in range(LANES):
        rod, row = Rod(group.work, l), min(first + l, rods.shape[0] - 1)
        rod.largest_moment = solved[row, AT_LARGEST]
        x, y, z = three(solved, row, AT_ORIENTATION + 1)
        rod.tip.turn = (solved[row, AT_ORIENTATION], x, y, z)
        rod.tip.place = three(solved, row, AT_TIP)
    cut(group, grid[0])
    fixed_cut(group, grid[1], first)


@routine
def visit_station(
    group: RodGroup, step: tuple[int, int, int], arcs: Array, first: int, s: int, solved: Array, out: Array
) -> None:
    """Write down station s of rods (from row `first` on) that pass it in a step: element e, tip first, piece j of `pieces`."""
    (e, j, pieces), last_row = step, arcs.shape[0] - 1
    z, dz = 1.0 - j / pieces, -1.0 / pieces
    if not passes(group, step, arcs, first, s):
        return
    for l in range(LANES):
        rod = Rod(group.work, l)
        advance(rod, section_of(group, e, l), group.linear, z, dz * rod.share, WHOLE, None, rod.beside)
    for l in range(min(LANES, last_row + 1 - first)):
        rod = Rod(group.work, l)
        if rod.share >= 0.0:
            write_station(rod, section_of(group, e, l), z + dz * rod.share, solved, first + l, out, s)


@routine
def passes(group: RodGroup, step: tuple[int, int, int], arcs: Array, first: int, s: int) -> bool:
    """Whether any rod passes station s in a step, and at which share of it each does; the others' has no meaning."""
    any_passes = False
    for l in range(LANES):
        rod = Rod(group.work, l)
        rod.share = share_at(group, step, arcs[min(first + l, arcs.shape[0] - 1), s], l)
        any_passes = any_passes or rod.share >= 0.0
    return any_passes


@routine
def share_at(group: RodGroup, step: tuple[int, int, int], arc: float, l: int) -> float:
    """Share of the step at which lane l passes the arc length (m from the base); negative if it does not."""
    e, j, pieces = step
    below = 0.0
    for i in range(e + 1, group.parts.size):
        below += section_of(group, i, l).length
    length = section_of(group, e, l).length
    above = arc - below  # m from the base end of the element, as start and end of the step are
    # Exactly nothing at the end: compilers may divide by multiplying.
    start, end = (1.0 - j / pieces) * length, (1.0 - (j + 1) / pieces) * length if j + 1 < pieces else 0.0
    outermost, innermost = e == 0 and j == 0, j + 1 == pieces and below == 0.0
    inside = (end < above or (innermost and end <= above)) and (above <= start or outermost)
    # An element without length leaves the station to its neighbour towards the base.
    if not inside or (length == 0.0 and not innermost):
        return -1.0
    return min(1.0, max(0.0, (start - above) / (start - end))) if start > end else 0.0
