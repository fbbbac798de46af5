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

from model.rods.columns import BLOCK, SERIES
from model.rods.fast.algebra import Vector, cross, plus_cross, scaled, times
from model.rods.fast.derivatives.collect import collect
from model.rods.fast.derivatives.column_layout import (
    ANSWER,
    ANSWERS_AT,
    BY_FORCE,
    DM,
    DM_HERE,
    DN_HERE,
    MEAN_STRAIN,
    MOVED,
    STRETCH_BY,
    THETA,
    TIP_COLUMNS,
    WORK_BY,
    add_number,
    step_of,
)
from model.rods.fast.instructions import fused
from model.rods.fast.jit import inline, routine
from model.rods.fast.lanes import INV_BEND, INV_STRETCH, LANES, Full, Group, number_of, put, vector_of
from model.rods.fast.passes import advance
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
    buffered_group,
)

Array = NDArray[np.float64]
Change = tuple[float, float, float, float, float, float]
"""theta and dm."""


class Response(NamedTuple):
    """How a section answers to a change."""

    slope: Change
    """d(theta, dm)/dt."""
    dn: Vector
    dm: Vector
    moved: Vector
    """-R^T dp/dt."""
    strain: float
    """dv3."""


class Here(NamedTuple):
    """The step that lane l takes within the buffered element."""

    buffer: Array
    inv_bend: Vector
    """1 / K_bt, as in `equations`."""
    inv_stretch: Vector
    added: float
    """Axial force added where the section answers, over K_se 3: of forced columns."""
    l: int


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
    return Response((*turns, *bends), dn, dm, plus_cross(dv, theta, v), dv[2])


@inline
def keep(a: Response, i: int, weight: float, here: Here) -> None:
    """Save what a section answers at stage i."""
    o = ANSWERS_AT + i * ANSWER
    put(here.buffer, o + DM_HERE, here.l, scaled(weight, a.dm))
    put(here.buffer, o + DN_HERE, here.l, scaled(weight, a.dn))
    put(here.buffer, o + MOVED, here.l, scaled(weight, a.moved))


@inline
def step_column(full: Full, buffer: Array, dz: float, l: int) -> None:
    """Take theta and dm of the buffered column along the step that was saved in the buffer, and keep what its stages answer."""
    share, h = step_of(buffer, dz, l)
    inv_bend, inv_stretch = vector_of(buffer, ELEMENT_AT + INV_BEND, l), vector_of(buffer, ELEMENT_AT + INV_STRETCH, l)
    here = Here(buffer, inv_bend, inv_stretch, number_of(buffer, COLUMN_AT + STRETCH_BY, l), l)
    y = (*vector_of(buffer, COLUMN_AT + THETA, l), *vector_of(buffer, COLUMN_AT + DM, l))
    a = response(full, y, here, 0)
    keep(a, 0, B1, here)
    k1, strain = a.slope, B1 * a.strain
    k2 = response(full, plus6(y, A21 * h, k1), here, 1).slope
    a = response(full, plus6(y, A32 * h, k2), here, 2)
    keep(a, 2, B3, here)
    k3, strain = a.slope, fused(B3, a.strain, strain)
    y4 = plus6(plus6(plus6(y, A41 * h, k1), A42 * h, k2), A43 * h, k3)
    a = response(full, y4, here, 3)
    keep(a, 3, B4, here)
    k4, strain = a.slope, fused(B4, a.strain, strain)
    y5 = plus6(plus6(plus6(plus6(y, A51 * h, k1), A52 * h, k2), A53 * h, k3), A54 * h, k4)
    a = response(full, y5, here, 4)
    keep(a, 4, B5, here)
    k5, strain = a.slope, fused(B5, a.strain, strain)
    y6 = plus6(plus6(plus6(plus6(y, A62 * h, k2), A63 * h, k3), A64 * h, k4), A65 * h, k5)
    a = response(full, y6, here, 5)
    keep(a, 5, B6, here)
    k6, strain = a.slope, fused(B6, a.strain, strain)
    y7 = plus6(plus6(plus6(plus6(plus6(y, A71 * h, k1), A72 * h, k2), A73 * h, k3), A74 * h, k4), A76 * h, k6)
    y = plus6(plus6(plus6(plus6(plus6(y, B1 * h, k1), B3 * h, k3), B4 * h, k4), B5 * h, k5), B6 * h, k6)
    a = response(full, y7, here, 6)
    keep(a, 6, B7, here)
    y = plus6(y, B7 * h, a.slope)
    put(buffer, COLUMN_AT + THETA, l, (y[0], y[1], y[2]))
    put(buffer, COLUMN_AT + DM, l, (y[3], y[4], y[5]))
    add_number(buffer, COLUMN_AT + MEAN_STRAIN, l, share * fused(B7, a.strain, strain))


@inline
def load_column(buffer: Array, x: Array, column: int, used: tuple[int, int], e: int) -> None:
    """Copy a column into the buffer, with R^T dN of all stages and the axial force that it adds to element e; of the quantities
    in use the first are copied, the others begin with nothing.

    R^T dN is a row of R for columns that begin with a force. Forced column TIP_COLUMNS + k belongs to element k.
    """
    for k in range(used[0] * LANES):
        buffer[COLUMN_AT * LANES + k] = x[column, k]
    for k in range(used[0] * LANES, used[1] * LANES):
        buffer[COLUMN_AT * LANES + k] = 0.0
    own = 1.0 if column - TIP_COLUMNS == e else 0.0
    for l in range(LANES):
        buffer[(COLUMN_AT + STRETCH_BY) * LANES + l] = own / max(buffer[ELEMENT_AT * LANES + l], LEAST_LENGTH)
    if column in (0, TIP_COLUMNS):
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
def step_all(group: Group, start: Array, x: Array, step: tuple[int, int, int]) -> None:
    """Step j of `pieces` of element e of all lanes, of each the share that the buffer says, and of all columns (columns, COLUMN
    LANES) with them: from `start` to `x`."""
    buffer, used, (e, j, pieces) = group.work, used_quantities(group.full), step
    buffered, z, dz = buffered_group(group), 1.0 - j / pieces, -1.0 / pieces
    for l in range(LANES):
        advance(buffered, ELEMENT_AT, z, dz * number_of(buffer, STEP_SHARE, l), l, 1.0, buffer)
    for c in range(len(x)):
        load_column(buffer, start, c, (used if j > 0 else MEAN_STRAIN, used), e)
        for l in range(LANES):
            step_column(group.full, buffer, dz, l)
        collect(group.full, buffer, z, dz)
        for k in range(used * LANES):
            x[c, k] = buffer[COLUMN_AT * LANES + k]


LEAST_LENGTH = 1e-9
"""m: the mean strain of an element without length has no meaning, but must not spoil the others."""
