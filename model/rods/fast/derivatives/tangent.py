"""How the sections of a solved rod answer to a change, walking with the rod from the tip to the base.

A change turns a section by phi, shifts it by p against the tip (both mount frame) and changes the force N by dN. With
theta = R^T phi and the changes dm, dn of moment and force in the section's frame, the equations of `equations` become
    dn = R^T dN + n x theta,   (du, dv) = C (dm, dn)        C: tangent compliance of the section
    d theta/dt = u x theta - du
    d dm/dt = u x dm + du x m + v x dn + dv x n
    dp/dt = -R (theta x v + dv)
Nine columns start at the tip with a unit turn, a unit moment dM and a unit force dN about and along each axis; they
span all that can come from the tip. Forced columns start with nothing; along one element the section answers as if a
unit of axial force (over its length) were added: what they collect belongs to the mean strain of that element.

What comes from within the rod needs no columns of its own. By Betti's theorem the work
    T = integral (dm . du' + dn . dv' + p . df') dt
of a column on rest strains du', dv' and a load df' that are added anywhere says what these do to the state at the base
end: G of `implicit`. A parameter of a section adds rest strains too (those that the wrench makes of the changed
stiffness), so that each column collects T for every number of an element, in the order of `layout`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from model.rods.columns import BEND, BLOCK, LENGTH, LOAD, REST_CURVATURE, REST_STRAIN, RISE, SERIES, STRETCH
from model.rods.fast.algebra import Vector, add, along, cross, dot, plus_cross, scaled, times
from model.rods.fast.jit import fused, inline, put_number, routine
from model.rods.fast.lanes import F_LOAD, INV_BEND, INV_STRETCH, LANES, Full, Group, number_of, put, vector_of
from model.rods.fast.runge_kutta import (
    A21,
    A32,
    A41,
    A42,
    A43,
    A51,
    A52,
    A53,
    A54,
    A62,
    A63,
    A64,
    A65,
    A71,
    A72,
    A73,
    A74,
    A76,
    B1,
    B3,
    B4,
    B5,
    B6,
    B7,
    C3,
    C4,
    C5,
    C6,
)  # fmt: skip
from model.rods.fast.stage_buffer import (
    COLUMN_AT,
    CURVATURE,
    DN_FIXED,
    ELEMENT_AT,
    FORCE,
    MOMENT,
    ROWS,
    SOFTNESS,
    STAGE,
    STAGES,
    STAGES_AT,
    STEP_SHARE,
    STRAIN,
)

Array = NDArray[np.float64]
Change = tuple[float, float, float, float, float, float]
"""theta and dm."""


class Response(NamedTuple):
    """How a section answers to a change."""

    slope: Change
    """d(theta, dm)/dt."""
    dn: Vector
    dp: Vector
    """dp/dt, mount frame."""
    dm: Vector
    strain: float
    """dv3."""


class Work(NamedTuple):
    """What the stages of a step add up: T by the numbers of an element, and the slope of p."""

    length: float
    bend: Vector
    stretch: Vector
    rest_curvature: Vector
    rest_strain: Vector
    series: Vector
    dp: Vector
    dp_left: Vector
    """dp by what is left of the step."""
    strain: float
    rise1: Vector
    rise2: Vector
    rise3: Vector


class Here(NamedTuple):
    """The step that lane l takes within the buffered element."""

    buffer: Array
    inv_bend: Vector
    """1 / K_bt, as in `equations`."""
    inv_stretch: Vector
    added: float
    """Axial force added where the section answers, over K_se 3: of forced columns."""
    l: int


BY_TURN, BY_MOMENT, BY_FORCE, TIP_COLUMNS = 0, 3, 6, 9
"""Columns that start at the tip; forced ones come behind."""
THETA, DM, SHIFT, MEAN_STRAIN, WORK_BY = 0, 3, 6, 9, 10
"""What a column holds: theta, dm, p, mean of dv3 over the element so far, T of the element so far (BLOCK)."""
COLUMN = WORK_BY + BLOCK
STRETCH_BY = COLUMN
BUFFER = COLUMN_AT + COLUMN + 1
"""In the buffer behind the column: the axial force that forced columns add."""


@inline
def plus6(y: Change, h: float, k: Change) -> Change:
    """y + h k."""
    return (
        fused(h, k[0], y[0]),
        fused(h, k[1], y[1]),
        fused(h, k[2], y[2]),
        fused(h, k[3], y[3]),
        fused(h, k[4], y[4]),
        fused(h, k[5], y[5]),
    )


@inline
def response(full: Full, y: Change, here: Here, i: int) -> Response:
    """The answer to a change at stage i; see the top of the file. (`full` is an argument so that a None is pruned.)"""
    buffer, l, o = here.buffer, here.l, STAGES_AT + i * STAGE
    theta, dm = (y[0], y[1], y[2]), (y[3], y[4], y[5])
    m, n = vector_of(buffer, o + MOMENT, l), vector_of(buffer, o + FORCE, l)
    u, v = vector_of(buffer, o + CURVATURE, l), vector_of(buffer, o + STRAIN, l)
    dn = plus_cross(vector_of(buffer, o + DN_FIXED, l), n, theta)
    du, dv = times(here.inv_bend, dm), times(here.inv_stretch, (dn[0], dn[1], dn[2] + here.added))
    if full is not None:
        k = vector_of(buffer, o + SOFTNESS, l)
        total = 2.0 * (here.inv_bend[0] * m[0] * dm[0] + here.inv_bend[1] * m[1] * dm[1])
        first = number_of(buffer, o + SOFTNESS + 8, l) * total
        second = number_of(buffer, o + SOFTNESS + 9, l) * total - dv[2]
        d = number_of(buffer, o + SOFTNESS + 4, l) * first + number_of(buffer, o + SOFTNESS + 6, l) * second
        e = number_of(buffer, o + SOFTNESS + 5, l) * first + number_of(buffer, o + SOFTNESS + 7, l) * second
        du = ((du[0] - k[0] * d) * k[2], (du[1] - k[1] * d) * k[2], du[2])
        dv = (dv[0], dv[1], e)

    turns = plus_cross(scaled(-1.0, du), u, theta)
    bends = plus_cross(plus_cross(plus_cross(cross(u, dm), du, m), v, dn), dv, n)
    moved = plus_cross(dv, theta, v)
    dp = (
        -dot(vector_of(buffer, o + ROWS, l), moved),
        -dot(vector_of(buffer, o + ROWS + 3, l), moved),
        -dot(vector_of(buffer, o + ROWS + 6, l), moved),
    )
    return Response((*turns, *bends), dn, dp, dm, dv[2])


@inline
def no_work() -> Work:
    """Nothing collected yet."""
    none = (0.0, 0.0, 0.0)
    return Work(0.0, none, none, none, none, none, none, none, 0.0, none, none, none)


@inline
def add_work(t: Work, full: Full, a: Response, here: Here, i: int, at: Vector) -> Work:
    """T with what stage i adds; `at` are the weight B_i and the share C_i of the stage, and its place z in the element."""
    b, share, z = at
    buffer, l, o = here.buffer, here.l, STAGES_AT + i * STAGE
    dn, dm = scaled(b, a.dn), scaled(b, a.dm)
    # A mean strain is no longer for the element's length, but sees directly what stretches it.
    lengthens = dot(dm, vector_of(buffer, o + CURVATURE, l)) + dot(dn, vector_of(buffer, o + STRAIN, l))
    dn = (dn[0], dn[1], dn[2] + b * here.added)
    m, n = vector_of(buffer, o + MOMENT, l), vector_of(buffer, o + FORCE, l)
    bend, axial, terms = times(dm, m), times(dn, n), (0.0, 0.0, 0.0)
    if full is not None:
        k = vector_of(buffer, o + SOFTNESS, l)
        _, d1, e1 = vector_of(buffer, o + SOFTNESS + 3, l)
        d2, e2, by_total = vector_of(buffer, o + SOFTNESS + 6, l)
        coupled, by_root, by_a = vector_of(buffer, o + SOFTNESS + 9, l)
        x = (dm[0] * k[0] + dm[1] * k[1]) * k[2]
        first, second = dn[2] * e1 - x * d1, dn[2] * e2 - x * d2
        mixed = by_total * first + coupled * second
        bend = (
            bend[0] * k[2] + m[0] * m[0] * mixed + by_root / here.inv_bend[0] * first,
            bend[1] * k[2] + m[1] * m[1] * mixed + by_root / here.inv_bend[1] * first,
            bend[2],
        )
        axial = (axial[0], axial[1], number_of(buffer, o + SOFTNESS + 13, l) * second)
        by_b, by_c = number_of(buffer, o + SOFTNESS + 14, l), number_of(buffer, o + SOFTNESS + 15, l)
        terms = (by_a * first, number_of(buffer, o + SOFTNESS + 12, l) * second - by_b * first, by_c * second)
    dp, rise = scaled(b, a.dp), scaled(z, dm)
    return Work(
        t.length + lengthens,
        add(t.bend, bend),
        add(t.stretch, axial),
        add(t.rest_curvature, dm),
        add(t.rest_strain, dn),
        add(t.series, terms),
        add(t.dp, dp),
        along(t.dp_left, 1.0 - share, dp),
        t.strain + b * a.strain,
        add(t.rise1, rise),
        along(t.rise2, z, rise),
        along(t.rise3, z * z, rise),
    )


@inline
def add_number(x: Array, k: int, l: int, more: float) -> None:
    """Add to a quantity."""
    put_number(x, k * LANES + l, number_of(x, k, l) + more)


@inline
def add_to(x: Array, k: int, l: int, h: float, a: Vector) -> None:
    """Add h a to three quantities."""
    put(x, k, l, along(vector_of(x, k, l), h, a))


@inline
def step_column(full: Full, buffer: Array, z: float, dz: float, l: int) -> None:
    """Take the buffered column along the step that was saved in the buffer, and collect its T of the element."""
    dz = dz * number_of(buffer, STEP_SHARE, l)
    h = -dz * number_of(buffer, ELEMENT_AT, l)
    inv_bend, inv_stretch = vector_of(buffer, ELEMENT_AT + INV_BEND, l), vector_of(buffer, ELEMENT_AT + INV_STRETCH, l)
    here = Here(buffer, inv_bend, inv_stretch, number_of(buffer, COLUMN_AT + STRETCH_BY, l), l)
    theta, dm = vector_of(buffer, COLUMN_AT + THETA, l), vector_of(buffer, COLUMN_AT + DM, l)
    y = (theta[0], theta[1], theta[2], dm[0], dm[1], dm[2])
    # Whatever a stage adds is added at once, or all stages would have to be remembered to the end.
    a = response(full, y, here, 0)
    k1 = a.slope
    t = add_work(no_work(), full, a, here, 0, (B1, 0.0, z))
    a = response(full, plus6(y, A21 * h, k1), here, 1)
    k2 = a.slope
    a = response(full, plus6(y, A32 * h, k2), here, 2)
    k3 = a.slope
    t = add_work(t, full, a, here, 2, (B3, C3, z + C3 * dz))
    y4 = plus6(plus6(plus6(y, A41 * h, k1), A42 * h, k2), A43 * h, k3)
    a = response(full, y4, here, 3)
    k4 = a.slope
    t = add_work(t, full, a, here, 3, (B4, C4, z + C4 * dz))
    y5 = plus6(plus6(plus6(plus6(y, A51 * h, k1), A52 * h, k2), A53 * h, k3), A54 * h, k4)
    a = response(full, y5, here, 4)
    k5 = a.slope
    t = add_work(t, full, a, here, 4, (B5, C5, z + C5 * dz))
    y6 = plus6(plus6(plus6(plus6(y, A62 * h, k2), A63 * h, k3), A64 * h, k4), A65 * h, k5)
    a = response(full, y6, here, 5)
    k6 = a.slope
    t = add_work(t, full, a, here, 5, (B6, C6, z + C6 * dz))
    y7 = plus6(plus6(plus6(plus6(plus6(y, A71 * h, k1), A72 * h, k2), A73 * h, k3), A74 * h, k4), A76 * h, k6)
    y = plus6(plus6(plus6(plus6(plus6(y, B1 * h, k1), B3 * h, k3), B4 * h, k4), B5 * h, k5), B6 * h, k6)
    a = response(full, y7, here, 6)
    y = plus6(y, B7 * h, a.slope)
    t = add_work(t, full, a, here, 6, (B7, 1.0, z + dz))
    put(buffer, COLUMN_AT + THETA, l, (y[0], y[1], y[2]))
    put(buffer, COLUMN_AT + DM, l, (y[3], y[4], y[5]))
    write_work(full, t, here, h, -dz)


@inline
def write_work(full: Full, t: Work, here: Here, h: float, share: float) -> None:
    """Add T of a step of the length h (m), a share of the element, to the buffered column."""
    buffer, l, w = here.buffer, here.l, COLUMN_AT + WORK_BY
    # p feeds nothing back, so that its integral over the step needs its slopes alone.
    work_of_load = along(vector_of(buffer, COLUMN_AT + SHIFT, l), h, t.dp_left)
    add_to(buffer, COLUMN_AT + SHIFT, l, h, t.dp)
    add_number(buffer, COLUMN_AT + MEAN_STRAIN, l, share * t.strain)
    load = vector_of(buffer, ELEMENT_AT + F_LOAD, l)
    add_number(buffer, w + LENGTH, l, share * (t.length + dot(work_of_load, load)))
    add_to(buffer, w + BEND, l, -h, times(times(here.inv_bend, here.inv_bend), t.bend))
    add_to(buffer, w + STRETCH, l, -h, times(times(here.inv_stretch, here.inv_stretch), t.stretch))
    add_to(buffer, w + REST_CURVATURE, l, h, t.rest_curvature)
    add_to(buffer, w + REST_STRAIN, l, h, t.rest_strain)
    add_to(buffer, w + LOAD, l, h, work_of_load)
    if full is not None:
        add_to(buffer, w + SERIES, l, h, t.series)
        add_to(buffer, w + RISE, l, h, t.rise1)
        add_to(buffer, w + RISE + 3, l, h, t.rise2)
        add_to(buffer, w + RISE + 6, l, h, t.rise3)


@inline
def load_column(buffer: Array, x: Array, column: int, used: int, e: int) -> None:
    """Copy a column into the buffer, with R^T dN of all stages and the axial force that it adds to element e.

    R^T dN is a row of R for columns that begin with a force. Forced column TIP_COLUMNS + k belongs to element k.
    """
    for k in range(used * LANES):
        buffer[COLUMN_AT * LANES + k] = x[column, k]
    own = 1.0 if column - TIP_COLUMNS == e else 0.0
    for l in range(LANES):
        buffer[(COLUMN_AT + STRETCH_BY) * LANES + l] = own / max(buffer[ELEMENT_AT * LANES + l], LEAST_LENGTH)
    for i in range(STAGES):
        for k in range(3 * LANES):
            buffer[(STAGES_AT + i * STAGE + DN_FIXED) * LANES + k] = 0.0
    if BY_FORCE <= column < TIP_COLUMNS:
        for i in range(STAGES):
            for k in range(3 * LANES):
                row = buffer[(STAGES_AT + i * STAGE + ROWS + 3 * max(column - BY_FORCE, 0)) * LANES + k]
                buffer[(STAGES_AT + i * STAGE + DN_FIXED) * LANES + k] = row


@inline
def used_quantities(full: Full) -> int:
    """How many quantities of a column are in use."""
    return WORK_BY + (BLOCK if full is not None else SERIES)


@routine
def step_columns(group: Group, x: Array, e: int, z: float, dz: float) -> None:
    """`step_column` for all columns `x` (columns, COLUMN LANES) of all lanes within element e."""
    buffer, used = group.work, used_quantities(group.full)
    for j in range(len(x)):
        load_column(buffer, x, j, used, e)
        for l in range(LANES):
            step_column(group.full, buffer, z, dz, l)
        for k in range(used * LANES):
            x[j, k] = buffer[COLUMN_AT * LANES + k]


LEAST_LENGTH = 1e-9
"""m: the mean strain of an element without length has no meaning, but must not spoil the others."""
