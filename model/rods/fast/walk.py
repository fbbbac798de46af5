"""The kernel that walks along solved rods and writes down what it finds at arc lengths."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from model.rods.description import Rods
from model.rods.fast.algebra import Vector, dot, times, turned, turned_back
from model.rods.fast.batches import full_of
from model.rods.fast.equations import Section, section_of, softened
from model.rods.fast.jit import inline, kernel, routine
from model.rods.fast.lanes import (
    ANCHOR,
    ELEMENT,
    LANES,
    LARGEST_MOMENT,
    TERMS,
    TIP,
    Counts,
    Full,
    Group,
    M,
    N,
    R,
    RowLayout,
    cut,
    element_at,
    elements_of,
    fixed_cut,
    gather_rod,
    new_elements,
    new_work,
    vector_of,
)
from model.rods.fast.passes import advance_alone, start_at_tip, unit_quaternion
from model.rods.solution import AT_LARGEST, AT_ORIENTATION, AT_TIP, Solution

Array = NDArray[np.float64]

AT_PLACE, AT_TURN, AT_FORCE, AT_MOMENT, AT_ENERGY, AT_STRAIN = 0, 3, 7, 10, 13, 14
"""Columns of a station: m, quaternion, N, N m (mount frame), J/m, axial strain v3 - 1."""
WIDTH = 15
STATE = 14
"""Quantities of the state, saved while a station inside a step is visited."""


def states_at(rods: Rods, solution: Solution, arcs: Array, divisions: float, steps: Counts) -> Array:
    """(n, k, WIDTH) at arcs (n, k) m; NaN for rods that did not converge. `steps` as of `batches.steps_of`."""
    out = np.full((*arcs.shape, WIDTH), np.nan)
    walk(rods.values, rods.form.columns, full_of(rods.form), (float(divisions), steps), solution.values, arcs, out)
    out[~solution.converged] = np.nan
    return out


@routine
def write_station(group: Group, e: int, solved: Array, row: int, out: Array, s: int) -> None:
    """The state of lane 0 as station s of a rod."""
    work = group.work
    q = unit_quaternion(work, 0)
    back = turned(q, vector_of(work, R, 0))
    force, m = vector_of(work, N, 0), vector_of(work, M, 0)
    moment = turned(q, m)
    for k in range(3):
        out[row, s, AT_FORCE + k] = work[(N + k) * LANES]
    out[row, s, AT_PLACE] = solved[row, AT_TIP] - back[0]
    out[row, s, AT_PLACE + 1] = solved[row, AT_TIP + 1] - back[1]
    out[row, s, AT_PLACE + 2] = solved[row, AT_TIP + 2] - back[2]
    out[row, s, AT_TURN], out[row, s, AT_TURN + 1], out[row, s, AT_TURN + 2], out[row, s, AT_TURN + 3] = q
    out[row, s, AT_MOMENT], out[row, s, AT_MOMENT + 1], out[row, s, AT_MOMENT + 2] = moment
    section, n = section_of(group.elements, group.full, element_at(e), 0), turned_back(q, force)
    u, v = times(section.inv_bend, m), times(section.inv_stretch, n)
    out[row, s, AT_ENERGY] = stored(section.terms, section, m, n, u, v)
    out[row, s, AT_STRAIN] = axial_strain(section.terms, section, m, u, v) + section.v_rest[2] - 1.0


@inline
def axial_strain(terms: Array | None, section: Section, m: Vector, u: Vector, v: Vector) -> float:
    """Elastic axial strain e of a section of lane 0 with linear strains u, v."""
    strain = v[2]
    if terms is not None:
        strain = softened(u, m, v[2], section, vector_of(terms, section.at + TERMS, 0))[1]
    return strain


@inline
def stored(terms: Array | None, section: Section, m: Vector, n: Vector, u: Vector, v: Vector) -> float:
    """Energy per length (J/m) of a section of lane 0 with linear strains u, v under m, n; see `equations` for the terms."""
    if terms is None:
        return 0.5 * (dot(u, m) + dot(v, n))
    a, b, c = vector_of(terms, section.at + TERMS, 0)
    d, strain = softened(u, m, v[2], section, (a, b, c))
    bent = (m[0] * u[0] + m[1] * u[1]) / (d * d)
    x = a * bent * math.sqrt(section.inv_bend[0] * section.inv_bend[1])
    # The integral of g over x is half of x^2, or for a section that softens -x / 2 - ln(1 - 2 x) / 4.
    level = 0.5 * x if x >= 0.0 else -0.5 - 0.25 * math.log(1.0 - 2.0 * x) / x
    y, z = b * strain, c * strain
    bending = 0.5 * bent * (1.0 + level + y / (1.0 - min(y, 0.0)))
    # Next to nothing the integral of e / (1 - c e) would lose its digits.
    grown = 1.0 + z * (2.0 / 3.0 + 0.5 * min(z, 0.0)) if z > -1e-3 else -2.0 * (z + math.log(1.0 - z)) / (z * z)
    stretching = 0.5 * strain * strain * grown / section.inv_stretch[2]
    return bending + stretching + 0.5 * (u[2] * m[2] + v[0] * n[0] + v[1] * n[1])


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
    count = elements_of(rods, at)
    group = Group(new_work(), new_elements(count), full, np.empty(count, np.int64), at.springs, 1)
    saved = np.empty(STATE)
    for row in range(rods.shape[0]):
        gather_rod(rods, row, at, group, 0)
        set_solved(group, solved, row, 0)
        cut_rod(group, divisions, steps, row)
        start_at_tip(group, group.springs, 1.0)
        work, elements, parts = group.work, group.elements, group.parts
        top = 0.0
        outermost, innermost = parts.size, -1  # of the elements that have a length
        for e in range(parts.size):
            top += elements[e * ELEMENT * LANES]
            if parts[e] > 0:
                outermost, innermost = min(outermost, e), e
        for e in range(parts.size):
            length = elements[e * ELEMENT * LANES]
            for j in range(parts[e]):
                dz = -1.0 / parts[e]
                z = 1.0 + j * dz
                start = top - j * length / parts[e]
                # The same expressions as the next step's start, or an arc length could fall between two steps.
                end = top - (j + 1) * length / parts[e] if j + 1 < parts[e] else top - length
                last = e == innermost and j == parts[e] - 1
                copy_state(work, LANES, saved, 1)
                for s in range(arcs.shape[1]):
                    arc = arcs[row, s]
                    # A station on a boundary belongs to the element towards the base, the tip to the outermost one.
                    if (end < arc <= start) or (last and arc <= end) or (e == outermost and j == 0 and arc > start):
                        partial = dz * min(1.0, max(0.0, (start - arc) / (start - end)))
                        advance_alone(group, e, z, partial, 0, 1.0)
                        write_station(group, e, solved, row, out, s)
                        copy_state(saved, 1, work, LANES)
                advance_alone(group, e, z, dz, 0, 1.0)
            top -= length


@inline
def set_solved(group: Group, solved: Array, row: int, l: int) -> None:
    """Set the unknowns of lane l to a solution, and the moment that its cuts follow."""
    work = group.work
    work[LARGEST_MOMENT * LANES + l] = solved[row, AT_LARGEST]
    for k in range(4):
        work[(TIP + k) * LANES + l] = solved[row, AT_ORIENTATION + k]
    for k in range(3):
        work[(ANCHOR + k) * LANES + l] = solved[row, AT_TIP + k]


@inline
def cut_rod(group: Group, divisions: float, steps: Counts, row: int) -> None:
    """Cut lane 0; elements without length are passed over where the steps are fixed."""
    cut(group, divisions)
    if steps.shape[0] > 0:
        fixed_cut(group, steps, row)
        for e in range(group.parts.size):
            group.parts[e] = group.parts[e] if group.elements[e * ELEMENT * LANES] > 0.0 else 0


@inline
def copy_state(source: Array, spacing: int, into: Array, gap: int) -> None:
    """The state of lane 0, its quantities so far apart in either array."""
    for k in range(STATE):
        into[k * gap] = source[k * spacing]
