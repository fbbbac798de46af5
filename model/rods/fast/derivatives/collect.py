"""What a column collects in a step: the sums T of `tangent` by the numbers of an element, and the shift p.

Sums are over the six stages of a step that have a weight, which is in their answers already. The sums of one kind are made in
a loop over the lanes of their own, so that what they need fits into a processor's registers.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from model.rods.columns import BEND, LENGTH, LOAD, REST_CURVATURE, REST_STRAIN, RISE, SERIES, STRETCH
from model.rods.fast.algebra import Vector, add, along, dot, plus_times, scaled, times
from model.rods.fast.derivatives.column_layout import (
    ANSWER,
    ANSWERS_AT,
    DM_HERE,
    DN_HERE,
    MOVED,
    SHIFT,
    STRETCH_BY,
    WORK_BY,
    add_number,
    add_to,
    step_of,
)
from model.rods.fast.instructions import fused
from model.rods.fast.jit import inline
from model.rods.fast.lanes import F_LOAD, INV_BEND, INV_STRETCH, LANES, Full, number_of, vector_of
from model.rods.fast.runge_kutta import B1, B3, B4, B5, B6, B7, C3, C4, C5, C6
from model.rods.fast.stage_buffer import (
    COLUMN_AT,
    CURVATURE,
    ELEMENT_AT,
    FORCE,
    MOMENT,
    ROWS,
    SOFTNESS,
    STAGE,
    STAGES_AT,
    STRAIN,
)

Array = NDArray[np.float64]
Six = tuple[float, float, float, float, float, float]
Vectors = tuple[Vector, Vector, Vector, Vector, Vector, Vector]
"""One for each stage that has a weight."""

WEIGHTS: Six = (B1, B3, B4, B5, B6, B7)
LEFT: Six = (1.0, 1.0 - C3, 1.0 - C4, 1.0 - C5, 1.0 - C6, 0.0)
"""Share of the step that is still to come."""
WORK_AT = COLUMN_AT + WORK_BY


@inline
def of_stages(buffer: Array, at: int, stride: int, l: int) -> Vectors:
    """Three quantities from `at` on, of each stage."""
    return (
        vector_of(buffer, at, l),
        vector_of(buffer, at + 2 * stride, l),
        vector_of(buffer, at + 3 * stride, l),
        vector_of(buffer, at + 4 * stride, l),
        vector_of(buffer, at + 5 * stride, l),
        vector_of(buffer, at + 6 * stride, l),
    )


@inline
def answers(buffer: Array, what: int, l: int) -> Vectors:
    """What the section answered."""
    return of_stages(buffer, ANSWERS_AT + what, ANSWER, l)


@inline
def saved(buffer: Array, what: int, l: int) -> Vectors:
    """What was saved of the rod."""
    return of_stages(buffer, STAGES_AT + what, STAGE, l)


@inline
def total(a: Vectors) -> Vector:
    """sum a."""
    return add(add(add(a[0], a[1]), add(a[2], a[3])), add(a[4], a[5]))


@inline
def total_times(a: Vectors, b: Vectors) -> Vector:
    """sum a b, entry by entry."""
    first = plus_times(plus_times(times(a[0], b[0]), a[1], b[1]), a[2], b[2])
    return plus_times(plus_times(plus_times(first, a[3], b[3]), a[4], b[4]), a[5], b[5])


@inline
def total_dot(a: Vectors, b: Vectors) -> float:
    """sum a . b."""
    x, y, z = total_times(a, b)
    return x + y + z


@inline
def weighted(a: Vectors, w: Six) -> Vector:
    """sum w a."""
    first = along(along(scaled(w[0], a[0]), w[1], a[1]), w[2], a[2])
    return along(along(along(first, w[3], a[3]), w[4], a[4]), w[5], a[5])


@inline
def collect_moments(full: Full, buffer: Array, z: float, dz: float, l: int) -> None:
    """T by dm: on rest curvature and its rises, on bending stiffness (less what `collect_terms` adds), on length."""
    share, h = step_of(buffer, dz, l)
    dm = answers(buffer, DM_HERE, l)
    add_number(buffer, WORK_AT + LENGTH, l, share * total_dot(dm, saved(buffer, CURVATURE, l)))
    add_to(buffer, WORK_AT + REST_CURVATURE, l, h, total(dm))
    bend, inverse = total_times(dm, saved(buffer, MOMENT, l)), vector_of(buffer, ELEMENT_AT + INV_BEND, l)
    if full is not None:
        bend = (0.0, 0.0, bend[2])
        # Places of the stages, z + C dz.
        half, third = z - C5 * share, z - C4 * share
        places = (z, z - C3 * share, third, half, half, z - share)
        squares = multiplied(places, places)
        add_to(buffer, WORK_AT + RISE, l, h, weighted(dm, places))
        add_to(buffer, WORK_AT + RISE + 3, l, h, weighted(dm, squares))
        add_to(buffer, WORK_AT + RISE + 6, l, h, weighted(dm, multiplied(places, squares)))
    add_to(buffer, WORK_AT + BEND, l, -h, times(times(inverse, inverse), bend))


@inline
def multiplied(a: Six, b: Six) -> Six:
    """a b, stage by stage."""
    return (a[0] * b[0], a[1] * b[1], a[2] * b[2], a[3] * b[3], a[4] * b[4], a[5] * b[5])


@inline
def collect_forces(full: Full, buffer: Array, dz: float, l: int) -> None:
    """T by dn: on rest strain, on axial and shear stiffness (as `collect_moments`), on length."""
    share, h = step_of(buffer, dz, l)
    dn, added = answers(buffer, DN_HERE, l), number_of(buffer, COLUMN_AT + STRETCH_BY, l)
    # A mean strain is no longer for the element's length, but sees directly what stretches it.
    add_number(buffer, WORK_AT + LENGTH, l, share * total_dot(dn, saved(buffer, STRAIN, l)))
    n, inverse = saved(buffer, FORCE, l), vector_of(buffer, ELEMENT_AT + INV_STRETCH, l)
    x, y, z = total_times(dn, n)
    z = fused(added, weighted(n, WEIGHTS)[2], z) if full is None else 0.0
    add_to(buffer, WORK_AT + STRETCH, l, -h, times(times(inverse, inverse), (x, y, z)))
    x, y, z = total(dn)
    add_to(buffer, WORK_AT + REST_STRAIN, l, h, (x, y, z + added))


@inline
def shift_slope(buffer: Array, i: int, l: int) -> Vector:
    """dp/dt at stage i, by its weight, mount frame."""
    rows, moved = STAGES_AT + i * STAGE + ROWS, vector_of(buffer, ANSWERS_AT + i * ANSWER + MOVED, l)
    return (
        -dot(vector_of(buffer, rows, l), moved),
        -dot(vector_of(buffer, rows + 3, l), moved),
        -dot(vector_of(buffer, rows + 6, l), moved),
    )


@inline
def collect_shift(buffer: Array, dz: float, l: int) -> None:
    """p, and T by it: on the load, and with it on length."""
    share, h = step_of(buffer, dz, l)
    slopes = (
        shift_slope(buffer, 0, l),
        shift_slope(buffer, 2, l),
        shift_slope(buffer, 3, l),
        shift_slope(buffer, 4, l),
        shift_slope(buffer, 5, l),
        shift_slope(buffer, 6, l),
    )
    # p feeds nothing back, so that its integral over the step needs its slopes alone.
    work_of_load = along(vector_of(buffer, COLUMN_AT + SHIFT, l), h, weighted(slopes, LEFT))
    add_to(buffer, COLUMN_AT + SHIFT, l, h, total(slopes))
    load = vector_of(buffer, ELEMENT_AT + F_LOAD, l)
    add_number(buffer, WORK_AT + LENGTH, l, share * dot(work_of_load, load))
    add_to(buffer, WORK_AT + LOAD, l, h, work_of_load)


@inline
def terms_of(buffer: Array, i: int, weight: float, l: int) -> tuple[Vector, Vector]:
    """What stage i adds, without the factors of `collect_terms`: T on two bending stiffnesses and the axial one; on a, b, c."""
    o, a = STAGES_AT + i * STAGE + SOFTNESS, ANSWERS_AT + i * ANSWER
    dm, m = vector_of(buffer, a + DM_HERE, l), vector_of(buffer, STAGES_AT + i * STAGE + MOMENT, l)
    dn = fused(weight, number_of(buffer, COLUMN_AT + STRETCH_BY, l), number_of(buffer, a + DN_HERE + 2, l))
    k = vector_of(buffer, o, l)
    _, d1, e1 = vector_of(buffer, o + 3, l)
    d2, e2, by_total = vector_of(buffer, o + 6, l)
    coupled, by_root, by_a = vector_of(buffer, o + 9, l)
    by_strain, axial, by_b = vector_of(buffer, o + 12, l)
    x = (dm[0] * k[0] + dm[1] * k[1]) * k[2]
    first, second = dn * e1 - x * d1, dn * e2 - x * d2
    mixed, rooted = by_total * first + coupled * second, by_root * first
    inverse = vector_of(buffer, ELEMENT_AT + INV_BEND, l)
    return (
        (
            dm[0] * m[0] * k[2] + m[0] * m[0] * mixed + rooted / inverse[0],
            dm[1] * m[1] * k[2] + m[1] * m[1] * mixed + rooted / inverse[1],
            axial * second,
        ),
        (by_a * first, by_strain * second - by_b * first, number_of(buffer, o + 15, l) * second),
    )


@inline
def collect_terms(buffer: Array, dz: float, l: int) -> None:
    """T on the hyperelastic terms, and on the stiffnesses that they have part in."""
    _, h = step_of(buffer, dz, l)
    stiff, series = terms_of(buffer, 0, B1, l)
    stiff, series = both(stiff, series, terms_of(buffer, 2, B3, l))
    stiff, series = both(stiff, series, terms_of(buffer, 3, B4, l))
    stiff, series = both(stiff, series, terms_of(buffer, 4, B5, l))
    stiff, series = both(stiff, series, terms_of(buffer, 5, B6, l))
    stiff, series = both(stiff, series, terms_of(buffer, 6, B7, l))
    x, y, _ = vector_of(buffer, ELEMENT_AT + INV_BEND, l)
    z = number_of(buffer, ELEMENT_AT + INV_STRETCH + 2, l)
    add_to(buffer, WORK_AT + BEND, l, -h, (x * x * stiff[0], y * y * stiff[1], 0.0))
    add_to(buffer, WORK_AT + STRETCH, l, -h, (0.0, 0.0, z * z * stiff[2]))
    add_to(buffer, WORK_AT + SERIES, l, h, series)


@inline
def both(a: Vector, b: Vector, more: tuple[Vector, Vector]) -> tuple[Vector, Vector]:
    """Both sums with what a stage adds."""
    return add(a, more[0]), add(b, more[1])


@inline
def collect(full: Full, buffer: Array, z: float, dz: float) -> None:
    """Add what all lanes collect in the step from z by dz (shares of the element) to the buffered column."""
    for l in range(LANES):
        collect_moments(full, buffer, z, dz, l)
    for l in range(LANES):
        collect_forces(full, buffer, dz, l)
    for l in range(LANES):
        collect_shift(buffer, dz, l)
    if full is not None:
        for l in range(LANES):
            collect_terms(buffer, dz, l)
