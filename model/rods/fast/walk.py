"""The kernel that walks along solved rods and writes down what it finds at arc lengths."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from model.rods.description import Rods
from model.rods.fast.algebra import Vector, times, turned, turned_back
from model.rods.fast.batches import full_of
from model.rods.fast.equations import Section, section_of, softened
from model.rods.fast.jit import inline, kernel, routine
from model.rods.fast.lanes import (
    ANCHOR,
    ELEMENT,
    LANES,
    LARGEST_MOMENT,
    STATE,
    TERMS,
    TIP,
    Counts,
    Full,
    Group,
    M,
    N,
    R,
    RowLayout,
    copy_numbers,
    cut,
    element_at,
    elements_of,
    fixed_cut,
    gather_rod,
    new_elements,
    vector_of,
)
from model.rods.fast.passes import advance, advance_group, start_at_tip, unit_quaternion
from model.rods.fast.stage_buffer import STEP_SHARE
from model.rods.solution import AT_LARGEST, AT_ORIENTATION, AT_TIP, Solution

Array = NDArray[np.float64]

AT_PLACE, AT_TURN, AT_FORCE, AT_MOMENT, AT_STRAIN = 0, 3, 7, 10, 13
"""Columns of a station: m, quaternion, N, N m (mount frame), axial strain v3 - 1."""
WIDTH = 14


def states_at(rods: Rods, solution: Solution, arcs: Array, divisions: float, steps: Counts) -> Array:
    """(n, k, WIDTH) at arcs (n, k) m; NaN for rods that did not converge. `steps` as of `batches.steps_of`."""
    out = np.full((*arcs.shape, WIDTH), np.nan)
    walk(rods.values, rods.form.columns, full_of(rods.form), (float(divisions), steps), solution.values, arcs, out)
    out[~solution.converged] = np.nan
    return out


@routine
def write_station(group: Group, e: int, l: int, solved: Array, row: int, out: Array, s: int) -> None:
    """The state of lane l as station s of a rod."""
    work = group.work
    q = unit_quaternion(work, l)
    back = turned(q, vector_of(work, R, l))
    force, m = vector_of(work, N, l), vector_of(work, M, l)
    moment = turned(q, m)
    for k in range(3):
        out[row, s, AT_FORCE + k] = force[k]
    out[row, s, AT_PLACE] = solved[row, AT_TIP] - back[0]
    out[row, s, AT_PLACE + 1] = solved[row, AT_TIP + 1] - back[1]
    out[row, s, AT_PLACE + 2] = solved[row, AT_TIP + 2] - back[2]
    out[row, s, AT_TURN], out[row, s, AT_TURN + 1], out[row, s, AT_TURN + 2], out[row, s, AT_TURN + 3] = q
    out[row, s, AT_MOMENT], out[row, s, AT_MOMENT + 1], out[row, s, AT_MOMENT + 2] = moment
    section, n = section_of(group.elements, group.full, element_at(e), l), turned_back(q, force)
    u, v = times(section.inv_bend, m), times(section.inv_stretch, n)
    out[row, s, AT_STRAIN] = elastic_axial_strain(section.terms, section, m, u, v, l) + section.v_rest[2] - 1.0


@inline
def elastic_axial_strain(terms: Array | None, section: Section, m: Vector, u: Vector, v: Vector, l: int) -> float:
    """Elastic axial strain of a section of lane l with linear strains u, v under m; see `equations` for the terms."""
    if terms is None:
        return v[2]
    a, b, c = vector_of(terms, section.at + TERMS, l)
    _, strain = softened(u, m, v[2], section, (a, b, c), None)
    return strain


@kernel
def walk(
    rods: Array,
    layout: tuple[int, int, int],
    full: Full,
    grid: tuple[float, Counts],
    solved: Array,
    arcs: Array,
    out: Array,
) -> None:
    """Fill `out` (n, k, WIDTH) at arcs (n, k); `grid` are divisions and fixed steps (n or 0 rows)."""
    at = RowLayout(layout[0], layout[1], layout[2])
    divisions, steps = grid
    n, count = rods.shape[0], elements_of(rods, at)
    work, elements, parts = np.zeros((STEP_SHARE + 1) * LANES), new_elements(count), np.empty(count, np.int64)
    saved = np.empty(STATE * LANES)
    for first in range(0, n, LANES):
        # Lanes without a rod hold the last one.
        group = Group(work, elements, full, parts, at.springs, LANES)
        for l in range(LANES):
            row = min(first + l, n - 1)
            gather_rod(rods, row, at, group, l)
            set_solved(group, solved, row, l)
        cut(group, divisions)
        fixed_cut(group, steps, first)
        start_at_tip(group, group.springs, 1.0)
        for e in range(count):
            pieces = max(parts[e], 1)
            for j in range(pieces):
                visit_stations(group, (e, j, pieces), arcs, first, solved, saved, out)
                advance_group(group, e, 1.0 - j / pieces, -1.0 / pieces, 1.0)


@routine
def visit_stations(
    group: Group, step: tuple[int, int, int], arcs: Array, first: int, solved: Array, saved: Array, out: Array
) -> None:
    """Write down what lies in a step, and stand where it begins afterwards."""
    work, (e, j, pieces), last = group.work, step, arcs.shape[0] - 1
    z, dz = 1.0 - j / pieces, -1.0 / pieces
    for s in range(arcs.shape[1]):
        some = False
        for l in range(LANES):
            share = share_at(group.elements, step, group.parts.size, arcs[min(first + l, last), s], l)
            work[STEP_SHARE * LANES + l] = share
            some = some or share >= 0.0
        if not some:
            continue
        copy_numbers(work, saved, STATE * LANES)
        for l in range(LANES):
            advance(group, element_at(e), z, dz * max(work[STEP_SHARE * LANES + l], 0.0), l, 1.0, None)
        for l in range(min(LANES, last + 1 - first)):
            if work[STEP_SHARE * LANES + l] >= 0.0:
                write_station(group, e, l, solved, first + l, out, s)
        copy_numbers(saved, work, STATE * LANES)


@routine
def share_at(elements: Array, step: tuple[int, int, int], size: int, arc: float, l: int) -> float:
    """Share of the step at which lane l passes the arc length (m from the base); negative if it does not."""
    e, j, pieces = step
    below = 0.0
    for i in range(e + 1, size):
        below += elements[i * ELEMENT * LANES + l]
    length = elements[e * ELEMENT * LANES + l]
    above = arc - below
    # Exactly nothing at the end: compilers may divide by multiplying.
    start, end = (1.0 - j / pieces) * length, (1.0 - (j + 1) / pieces) * length if j + 1 < pieces else 0.0
    outermost, innermost = e == 0 and j == 0, j + 1 == pieces and below == 0.0
    inside = (end < above or (innermost and end <= above)) and (above <= start or outermost)
    # Of the elements that touch the station, one without a length sees only half of what is to come.
    if not inside or (length == 0.0 and not innermost):
        return -1.0
    return min(1.0, max(0.0, (start - above) / (start - end))) if start > end else 0.0


@inline
def set_solved(group: Group, solved: Array, row: int, l: int) -> None:
    """Set the unknowns of lane l to a solution, and the moment that its cuts follow."""
    work = group.work
    work[LARGEST_MOMENT * LANES + l] = solved[row, AT_LARGEST]
    for k in range(4):
        work[(TIP + k) * LANES + l] = solved[row, AT_ORIENTATION + k]
    for k in range(3):
        work[(ANCHOR + k) * LANES + l] = solved[row, AT_TIP + k]
