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

import numpy as np
from numpy.typing import NDArray

from model.statics.algebra import Vector, add, along, cross, dot, scaled, times
from model.statics.jit import inline, routine
from model.statics.lanes import LANES, put, vector_of
from model.statics.layout import BEND, BLOCK, LENGTH, LOAD, REST_CURVATURE, REST_STRAIN, RISE, SERIES, STRETCH
from model.statics.record import (
    AT,
    COLUMN,
    CURVATURE,
    FORCE,
    MOMENT,
    ON_DESK,
    PULLED,
    ROWS,
    SIZE,
    STAGES,
    STEP_ON_DESK,
    STRAIN,
)
from model.statics.record import SERIES as KEPT
from model.statics.runge_kutta import (
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

Array = NDArray[np.float64]
Change = tuple[float, float, float, float, float, float]
"""theta and dm."""
Answer = tuple[Change, Vector, Vector, Vector, float]
"""Slope of the change, dn, dp/dt (mount frame), dm, and the stretch that belongs to it."""
Work = tuple[float, ...]
"""What the stages of a step add up: T in the order of an element up to its series (16), slope of p (3), the same by what
is left of the step (3), stretch (1), T of the graded terms (9)."""
NO_WORK: Work = (0.0,) * 32

BY_TURN, BY_MOMENT, BY_FORCE, FREE = 0, 3, 6, 9
"""Columns that start at the tip; forced ones come behind."""
THETA, DM, SHIFT, STRETCHED, WORKS = 0, 3, 6, 9, 10
"""What a column holds: theta, dm, p, mean of dv3 over the element so far, T of the element so far (BLOCK)."""
CELL = WORKS + BLOCK
STRETCH_BY = CELL
DESK = COLUMN + CELL + 1
"""On the desk behind the column: what it stretches the element by."""


@inline
def more(y: Change, h: float, k: Change) -> Change:
    """y + h k."""
    return (y[0] + h * k[0], y[1] + h * k[1], y[2] + h * k[2], y[3] + h * k[3], y[4] + h * k[4], y[5] + h * k[5])


@inline
def answer(
    y: Change, desk: Array, i: int, stretch: float,
    flex: Vector, give: Vector, series: Array | None, l: int,
) -> Answer:  # fmt: skip
    """The slope of a change at stage i of a step of lane l; see the top of the file.

    `stretch` is added to dn3 where the section answers.
    """
    o = AT + i * SIZE
    theta, dm = (y[0], y[1], y[2]), (y[3], y[4], y[5])
    m, n = vector_of(desk, o + MOMENT, l), vector_of(desk, o + FORCE, l)
    u, v = vector_of(desk, o + CURVATURE, l), vector_of(desk, o + STRAIN, l)
    dn = add(cross(n, theta), vector_of(desk, o + PULLED, l))
    du, dv = times(flex, dm), times(give, (dn[0], dn[1], dn[2] + stretch))
    if series is not None:
        k = vector_of(desk, o + KEPT, l)
        total = 2.0 * (flex[0] * m[0] * dm[0] + flex[1] * m[1] * dm[1])
        first = desk[(o + KEPT + 8) * LANES + l] * total
        second = desk[(o + KEPT + 9) * LANES + l] * total - dv[2]
        d = desk[(o + KEPT + 4) * LANES + l] * first + desk[(o + KEPT + 6) * LANES + l] * second
        e = desk[(o + KEPT + 5) * LANES + l] * first + desk[(o + KEPT + 7) * LANES + l] * second
        du = ((du[0] - k[0] * d) * k[2], (du[1] - k[1] * d) * k[2], du[2])
        dv = (dv[0], dv[1], e)

    turns = cross(u, theta)
    bends = add(add(cross(u, dm), cross(du, m)), add(cross(v, dn), cross(dv, n)))
    moved = add(cross(theta, v), dv)
    dp = (
        -dot(vector_of(desk, o + ROWS, l), moved),
        -dot(vector_of(desk, o + ROWS + 3, l), moved),
        -dot(vector_of(desk, o + ROWS + 6, l), moved),
    )
    slope = (turns[0] - du[0], turns[1] - du[1], turns[2] - du[2], bends[0], bends[1], bends[2])
    return slope, dn, dp, dm, dv[2]


@inline
def collect(
    t: Work, b: float, share: float, a: Answer, desk: Array, i: int, stretch: float, flex: Vector,
    series: Array | None, rises: Array | None, z: float, l: int,
) -> Work:  # fmt: skip
    """T with b times what stage i adds: length, bend (3), stretch (3), rest curvature (3), rest strain (3), series (3)."""
    o = AT + i * SIZE
    dn, dm = scaled(b, a[1]), scaled(b, a[3])
    # A mean strain is no longer for the element's length, but sees directly what stretches it.
    lengthens = dot(dm, vector_of(desk, o + CURVATURE, l)) + dot(dn, vector_of(desk, o + STRAIN, l))
    dn = (dn[0], dn[1], dn[2] + b * stretch)
    m, n = vector_of(desk, o + MOMENT, l), vector_of(desk, o + FORCE, l)
    bend, axial, terms = times(dm, m), times(dn, n), (0.0, 0.0, 0.0)
    if series is not None:
        k = vector_of(desk, o + KEPT, l)
        _, d1, e1 = vector_of(desk, o + KEPT + 3, l)
        d2, e2, by_total = vector_of(desk, o + KEPT + 6, l)
        coupled, by_root, by_a = vector_of(desk, o + KEPT + 9, l)
        x = (dm[0] * k[0] + dm[1] * k[1]) * k[2]
        first, second = dn[2] * e1 - x * d1, dn[2] * e2 - x * d2
        mixed = by_total * first + coupled * second
        bend = (
            bend[0] * k[2] + m[0] * m[0] * mixed + by_root / flex[0] * first,
            bend[1] * k[2] + m[1] * m[1] * mixed + by_root / flex[1] * first,
            bend[2],
        )
        axial = (axial[0], axial[1], desk[(o + KEPT + 13) * LANES + l] * second)
        by_b, by_c = desk[(o + KEPT + 14) * LANES + l], desk[(o + KEPT + 15) * LANES + l]
        terms = (by_a * first, desk[(o + KEPT + 12) * LANES + l] * second - by_b * first, by_c * second)
    dp, left = scaled(b, a[2]), 1.0 - share
    rise = (0.0, 0.0, 0.0)
    if rises is not None:
        rise = scaled(z, dm)
    return (
        t[0] + lengthens,
        t[1] + bend[0], t[2] + bend[1], t[3] + bend[2],
        t[4] + axial[0], t[5] + axial[1], t[6] + axial[2],
        t[7] + dm[0], t[8] + dm[1], t[9] + dm[2],
        t[10] + dn[0], t[11] + dn[1], t[12] + dn[2],
        t[13] + terms[0], t[14] + terms[1], t[15] + terms[2],
        t[16] + dp[0], t[17] + dp[1], t[18] + dp[2],
        t[19] + left * dp[0], t[20] + left * dp[1], t[21] + left * dp[2],
        t[22] + b * a[4],
        t[23] + rise[0], t[24] + rise[1], t[25] + rise[2],
        t[26] + z * rise[0], t[27] + z * rise[1], t[28] + z * rise[2],
        t[29] + z * z * rise[0], t[30] + z * z * rise[1], t[31] + z * z * rise[2],
    )  # fmt: skip


@inline
def into(x: Array, k: int, l: int, h: float, a: Vector) -> None:
    """Add h a to three quantities."""
    put(x, k, l, along(vector_of(x, k, l), h, a))


@inline
def column_step(desk: Array, rises: Array | None, series: Array | None, z: float, dz: float, l: int) -> None:
    """Take the column on the desk along the step that is written down there, and collect its T of the element."""
    dz = dz * desk[STEP_ON_DESK * LANES + l]
    share = -dz
    h = share * desk[ON_DESK * LANES + l]
    flex, give, load = (
        vector_of(desk, ON_DESK + 1, l),
        vector_of(desk, ON_DESK + 4, l),
        vector_of(desk, ON_DESK + 13, l),
    )
    stretch = desk[(COLUMN + STRETCH_BY) * LANES + l]
    theta, dm = vector_of(desk, COLUMN + THETA, l), vector_of(desk, COLUMN + DM, l)
    y = (theta[0], theta[1], theta[2], dm[0], dm[1], dm[2])
    # Whatever a stage adds is added at once, or all stages would have to be remembered to the end.
    a = answer(y, desk, 0, stretch, flex, give, series, l)
    k1 = a[0]
    t = collect(NO_WORK, B1, 0.0, a, desk, 0, stretch, flex, series, rises, z, l)
    a = answer(more(y, A21 * h, k1), desk, 1, stretch, flex, give, series, l)
    k2 = a[0]
    a = answer(more(y, A32 * h, k2), desk, 2, stretch, flex, give, series, l)
    k3 = a[0]
    t = collect(t, B3, C3, a, desk, 2, stretch, flex, series, rises, z + C3 * dz, l)
    y4 = more(more(more(y, A41 * h, k1), A42 * h, k2), A43 * h, k3)
    a = answer(y4, desk, 3, stretch, flex, give, series, l)
    k4 = a[0]
    t = collect(t, B4, C4, a, desk, 3, stretch, flex, series, rises, z + C4 * dz, l)
    y5 = more(more(more(more(y, A51 * h, k1), A52 * h, k2), A53 * h, k3), A54 * h, k4)
    a = answer(y5, desk, 4, stretch, flex, give, series, l)
    k5 = a[0]
    t = collect(t, B5, C5, a, desk, 4, stretch, flex, series, rises, z + C5 * dz, l)
    y6 = more(more(more(more(y, A62 * h, k2), A63 * h, k3), A64 * h, k4), A65 * h, k5)
    a = answer(y6, desk, 5, stretch, flex, give, series, l)
    k6 = a[0]
    t = collect(t, B6, C6, a, desk, 5, stretch, flex, series, rises, z + C6 * dz, l)
    y7 = more(more(more(more(more(y, A71 * h, k1), A72 * h, k2), A73 * h, k3), A74 * h, k4), A76 * h, k6)
    y = more(more(more(more(more(y, B1 * h, k1), B3 * h, k3), B4 * h, k4), B5 * h, k5), B6 * h, k6)
    a = answer(y7, desk, 6, stretch, flex, give, series, l)
    y = more(y, B7 * h, a[0])
    t = collect(t, B7, 1.0, a, desk, 6, stretch, flex, series, rises, z + dz, l)
    put(desk, COLUMN + THETA, l, (y[0], y[1], y[2]))
    put(desk, COLUMN + DM, l, (y[3], y[4], y[5]))
    # p feeds nothing back, so that its integral over the step needs its slopes alone.
    work_of_load = along(vector_of(desk, COLUMN + SHIFT, l), h, (t[19], t[20], t[21]))
    into(desk, COLUMN + SHIFT, l, h, (t[16], t[17], t[18]))
    desk[(COLUMN + STRETCHED) * LANES + l] += share * t[22]
    w = COLUMN + WORKS
    desk[(w + LENGTH) * LANES + l] += share * (t[0] + dot(work_of_load, load))
    into(desk, w + BEND, l, -h, times(times(flex, flex), (t[1], t[2], t[3])))
    into(desk, w + STRETCH, l, -h, times(times(give, give), (t[4], t[5], t[6])))
    into(desk, w + REST_CURVATURE, l, h, (t[7], t[8], t[9]))
    into(desk, w + REST_STRAIN, l, h, (t[10], t[11], t[12]))
    into(desk, w + LOAD, l, h, work_of_load)
    if series is not None:
        into(desk, w + SERIES, l, h, (t[13], t[14], t[15]))
    if rises is not None:
        into(desk, w + RISE, l, h, (t[23], t[24], t[25]))
        into(desk, w + RISE + 3, l, h, (t[26], t[27], t[28]))
        into(desk, w + RISE + 6, l, h, (t[29], t[30], t[31]))


@inline
def fetch(desk: Array, x: Array, column: int, used: int, e: int) -> None:
    """Put a column on the desk, with R^T dN into all stages and what stretches element e.

    R^T dN is a row of R for columns that begin with a force. Forced column FREE + k belongs to element k.
    """
    for k in range(used * LANES):
        desk[COLUMN * LANES + k] = x[column, k]
    own = 1.0 if column - FREE == e else 0.0
    for l in range(LANES):
        desk[(COLUMN + STRETCH_BY) * LANES + l] = own / max(desk[ON_DESK * LANES + l], LEAST_LENGTH)
    for i in range(STAGES):
        for k in range(3 * LANES):
            desk[(AT + i * SIZE + PULLED) * LANES + k] = 0.0
    if BY_FORCE <= column < FREE:
        for i in range(STAGES):
            for k in range(3 * LANES):
                row = desk[(AT + i * SIZE + ROWS + 3 * max(column - BY_FORCE, 0)) * LANES + k]
                desk[(AT + i * SIZE + PULLED) * LANES + k] = row


@inline
def collected_by(rises: Array | None, series: Array | None) -> int:
    """How many quantities of a column are in use."""
    return WORKS + (BLOCK if rises is not None else RISE if series is not None else SERIES)


@routine
def columns_step(desk: Array, x: Array, rises: Array | None, series: Array | None, e: int, z: float, dz: float) -> None:
    """`column_step` for all columns `x` (columns, CELL LANES) of all lanes within element e."""
    used = collected_by(rises, series)
    for j in range(len(x)):
        fetch(desk, x, j, used, e)
        for l in range(LANES):
            column_step(desk, rises, series, z, dz, l)
        for k in range(used * LANES):
            x[j, k] = desk[COLUMN * LANES + k]


LEAST_LENGTH = 1e-9
"""m: the mean strain of an element without length has no meaning, but must not spoil the others."""
