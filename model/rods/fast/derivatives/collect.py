"""What a column collects in a step: the sums T of `tangent` by the numbers of an element, the shift p and the mean strain.

Sums are over the six stages of a step that have a weight, which is in their answers already. The sums of one kind are made in
a loop over the lanes of their own, so that what they need fits into a processor's registers.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from model.rods.fast.algebra import Vector, add, along, dot, plus_times, scaled, times
from model.rods.fast.compiler import fused, inline
from model.rods.fast.derivatives.tangent import NOTHING, ColumnWalk, step_of
from model.rods.fast.lanes import LANES, Array
from model.rods.fast.runge_kutta import B1, B3, B4, B5, B6, B7, C3, C4, C5, C6

Sums = TypeVar("Sums")


@inline
def over_stages(more: Callable[[Sums, ColumnWalk, int, float, float], Sums], sums: Sums, walk: ColumnWalk) -> Sums:
    """Sums over the stages that have a weight: `more`(sums, walk, i, B_i, C_i) adds what is found at stage i."""
    sums = more(more(sums, walk, 0, B1, 0.0), walk, 2, B3, C3)
    sums = more(more(sums, walk, 3, B4, C4), walk, 4, B5, C5)
    return more(more(sums, walk, 5, B6, C6), walk, 6, B7, 1.0)


@inline
def more_moments(
    sums: tuple[float, Vector, float], walk: ColumnWalk, i: int, weight: float, share: float
) -> tuple[float, Vector, float]:
    """dm . u, dm, dm3 m3."""
    dm, stage = walk.answers[i].dm, walk.stages[i]
    return sums[0] + dot(dm, stage.u), add(sums[1], dm), fused(dm[2], stage.m[2], sums[2])


@inline
def collect_moments(walk: ColumnWalk, z: float, dz: float) -> None:
    """T by dm: on length, rest curvature, and torsional stiffness."""
    (share, h), work, inverse = step_of(walk, dz), walk.column.work, walk.section.inv_bend
    along_it, dm, twist = over_stages(more_moments, (0.0, NOTHING, 0.0), walk)
    work.length += share * along_it
    work.rest_curvature = along(work.rest_curvature, h, dm)
    work.bend = along(work.bend, -h, (0.0, 0.0, inverse[2] * inverse[2] * twist))


@inline
def more_forces(
    sums: tuple[float, float, Vector, Vector], walk: ColumnWalk, i: int, weight: float, share: float
) -> tuple[float, float, Vector, Vector]:
    """dv3, dn . v, dn, dn n."""
    answer, stage = walk.answers[i], walk.stages[i]
    sheared = plus_times(sums[3], answer.dn, stage.n)
    return sums[0] + answer.strain, sums[1] + dot(answer.dn, stage.v), add(sums[2], answer.dn), sheared


@inline
def collect_forces(walk: ColumnWalk, z: float, dz: float) -> None:
    """Mean strain, and T by dn: on length, rest strain, and shear stiffness."""
    (share, h), work, inverse = step_of(walk, dz), walk.column.work, walk.section.inv_stretch
    strain, along_it, dn, sheared = over_stages(more_forces, (0.0, 0.0, NOTHING, NOTHING), walk)
    walk.column.mean_strain += share * strain
    # A mean strain is no longer for the element's length, but sees directly what stretches it.
    work.length += share * along_it
    work.stretch = along(work.stretch, -h, times(times(inverse, inverse), (sheared[0], sheared[1], 0.0)))
    work.rest_strain = along(work.rest_strain, h, (dn[0], dn[1], dn[2] + walk.added))


@inline
def more_shift(sums: tuple[Vector, Vector], walk: ColumnWalk, i: int, weight: float, share: float) -> tuple[Vector, Vector]:
    """dp/dt in the mount frame, and by the share of the step that is still to come."""
    moved, stage = scaled(-1.0, walk.answers[i].moved), walk.stages[i]
    slope = (dot(stage.rows[0], moved), dot(stage.rows[1], moved), dot(stage.rows[2], moved))
    return add(sums[0], slope), along(sums[1], 1.0 - share, slope)


@inline
def collect_shift(walk: ColumnWalk, z: float, dz: float) -> None:
    """p, and T by it: on the load, and with it on length."""
    (share, h), column, load = step_of(walk, dz), walk.column, walk.section.load
    slopes, slopes_left = over_stages(more_shift, (NOTHING, NOTHING), walk)
    # p feeds nothing back, so that its integral over the step needs its slopes alone.
    passed = along(column.p, h, slopes_left)
    column.p = along(column.p, h, slopes)
    column.work.length += share * dot(passed, load)
    column.work.load = along(column.work.load, h, passed)


@inline
def more_rises(
    sums: tuple[float, float, Vector, Vector, Vector], walk: ColumnWalk, i: int, weight: float, share: float
) -> tuple[float, float, Vector, Vector, Vector]:
    """z dm, z^2 dm, z^3 dm, behind z at the start of the step and by how much it shrinks."""
    start, fall, first, second, third = sums
    z, dm = start - share * fall, walk.answers[i].dm
    return start, fall, along(first, z, dm), along(second, z * z, dm), along(third, z * z * z, dm)


@inline
def collect_rises(walk: ColumnWalk, z: float, dz: float) -> None:
    """T on what a rest curvature rises by."""
    (share, h), work = step_of(walk, dz), walk.column.work
    _, _, first, second, third = over_stages(more_rises, (z, share, NOTHING, NOTHING, NOTHING), walk)
    work.rise1, work.rise2, work.rise3 = (along(work.rise1, h, first), along(work.rise2, h, second), along(work.rise3, h, third))


@inline
def through_softness(walk: ColumnWalk, i: int, weight: float) -> tuple[float, float, float, float]:
    """dn3 of stage i, and work T (see `tangent`) by F1 and F2, through D and e that solve F1 = F2 = 0 of `equations.balance`,
    and by the T of `Softening`, which holds how they answer to F1 and F2, and these to the section."""
    answer, s = walk.answers[i], walk.stages[i].softening
    dn = fused(weight, walk.added, answer.dn[2])
    bending = (answer.dm[0] * s.k[0] + answer.dm[1] * s.k[1]) * s.k[2]
    by_f1, by_f2 = dn * s.e_by_f1 - bending * s.d_by_f1, dn * s.e_by_f2 - bending * s.d_by_f2
    return dn, by_f1, by_f2, s.f1_by_total * by_f1 + s.f2_by_total * by_f2


@inline
def more_active(
    sums: tuple[float, float, Vector, Vector, Vector, Vector], walk: ColumnWalk, i: int, weight: float, share: float
) -> tuple[float, float, Vector, Vector, Vector, Vector]:
    """T of stage i by what actuators within the section make of it, at the same rest strains, and this times z, z^2, z^3."""
    start, fall, constant, first, second, third = sums
    answer, (k1, k2, inverse_d), inverse = walk.answers[i], walk.stages[i].softening.k, walk.section.inv_bend
    dn, _, by_f2, by_total = through_softness(walk, i, weight)
    more, z = 2.0 * by_total / inverse_d, start - share * fall
    by = (
        answer.dm[0] * (inverse_d - 1.0) + more * k1 / inverse[0],
        answer.dm[1] * (inverse_d - 1.0) + more * k2 / inverse[1],
        -by_f2 - dn,
    )
    return start, fall, add(constant, by), along(first, z, by), along(second, z * z, by), along(third, z * z * z, by)


@inline
def collect_active(walk: ColumnWalk, z: float, dz: float) -> None:
    """T on what the actuators make; nothing where no section is hyperelastic."""
    (share, h), work = step_of(walk, dz), walk.column.work
    _, _, constant, first, second, third = over_stages(more_active, (z, share, NOTHING, NOTHING, NOTHING, NOTHING), walk)
    work.active, work.active1 = along(work.active, h, constant), along(work.active1, h, first)
    work.active2, work.active3 = along(work.active2, h, second), along(work.active3, h, third)


@inline
def more_terms(sums: tuple[Vector, Vector], walk: ColumnWalk, i: int, weight: float, share: float) -> tuple[Vector, Vector]:
    """Add the work of stage i by the bending (2) and axial stiffness, without the factors of `collect_terms`, and by the
    softening's a, b, c."""
    stage, inverse = walk.stages[i], walk.section.inv_bend
    s, dm, m, inverse_d = stage.softening, walk.answers[i].dm, stage.m, stage.softening.k[2]
    _, by_f1, by_f2, by_total = through_softness(walk, i, weight)
    by_root = s.f1_by_root * by_f1
    # m + mu of the actuators
    m1, m2 = s.k[0] / (inverse_d * inverse[0]), s.k[1] / (inverse_d * inverse[1])
    by_stiffness = (
        dm[0] * m[0] * inverse_d + (2.0 * m[0] - m1) * m1 * by_total + by_root / inverse[0],
        dm[1] * m[1] * inverse_d + (2.0 * m[1] - m2) * m2 * by_total + by_root / inverse[1],
        s.f2_by_axial * by_f2,
    )
    by_series = (s.f1_by_a * by_f1, s.f2_by_b * by_f2 + s.f1_by_b * by_f1, s.f2_by_c * by_f2)
    return add(sums[0], by_stiffness), add(sums[1], by_series)


@inline
def collect_terms(walk: ColumnWalk, z: float, dz: float) -> None:
    """T on the hyperelastic terms, and on the stiffnesses that they change: bending and axial."""
    h, work, (x, y, _), axial = (step_of(walk, dz)[1], walk.column.work, walk.section.inv_bend, walk.section.inv_stretch[2])
    stiff, series = over_stages(more_terms, (NOTHING, NOTHING), walk)
    work.bend = along(work.bend, -h, (x * x * stiff[0], y * y * stiff[1], 0.0))
    work.stretch = along(work.stretch, -h, (0.0, 0.0, axial * axial * stiff[2]))
    work.series = along(work.series, h, series)


@inline
def each(one: Callable[[ColumnWalk, float, float], None], work: Array, z: float, dz: float) -> None:
    """For each lane."""
    for l in range(LANES):
        one(ColumnWalk(work, l), z, dz)


@inline
def collect(work: Array, linear: bool, z: float, dz: float) -> None:
    """Add what all lanes collect in the step from z by dz (shares of the element) to their columns."""
    each(collect_moments, work, z, dz)
    each(collect_forces, work, z, dz)
    each(collect_shift, work, z, dz)
    each(collect_rises, work, z, dz)
    each(collect_terms, work, z, dz)
    if not linear:
        each(collect_active, work, z, dz)
