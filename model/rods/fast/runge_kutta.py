"""A step by Butcher's sixth-order Runge-Kutta method with seven stages, for rods and for changes of them.

y_i = y + h sum_j A_ij k_j,   k_i = slope(y_i) at the share C_i of the step,   y' = y + h sum_i B_i k_i
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, TypeVar

from model.rods.fast.algebra import Vector
from model.rods.fast.compiler import inline
from model.rods.fast.equations import RodSection, RodState, Strains, balance, law_of
from model.rods.fast.lanes import LaneRecord, record

Y = TypeVar("Y")
Here = TypeVar("Here")
Near = TypeVar("Near")

STAGES = 7
C2, C3, C4, C5, C6 = 1 / 3, 2 / 3, 1 / 3, 1 / 2, 1 / 2
A21 = 1 / 3
A32 = 2 / 3
A41, A42, A43 = 1 / 12, 1 / 3, -1 / 12
A51, A52, A53, A54 = -1 / 16, 9 / 8, -3 / 16, -3 / 8
A62, A63, A64, A65 = 9 / 8, -3 / 8, -3 / 4, 1 / 2
A71, A72, A73, A74, A76 = 9 / 44, -9 / 11, 63 / 44, 18 / 11, -16 / 11
B1, B3, B4, B5, B6, B7 = 11 / 120, 27 / 40, 27 / 40, -4 / 15, -4 / 15, 11 / 120


@inline
def step(
    slope: Callable[[Y, int, float, float, Here, Near | None], tuple[Y, Near]],
    along: Callable[[Y, float, Y], Y],
    y: Y,
    h: float,
    here: Here,
) -> Y:
    """y', h behind y. `slope`(y_i, i, C_i, B_i, here, near) returns k_i and what the next stage takes as `near`; `along`(y, h, k)
    is y + h k; `here` is handed on to `slope`."""
    k1, near = slope(y, 0, 0.0, B1, here, None)
    k2, near = slope(along(y, A21 * h, k1), 1, C2, 0.0, here, near)
    k3, near = slope(along(y, A32 * h, k2), 2, C3, B3, here, near)
    y4 = along(along(along(y, A41 * h, k1), A42 * h, k2), A43 * h, k3)
    k4, near = slope(y4, 3, C4, B4, here, near)
    y5 = along(along(along(along(y, A51 * h, k1), A52 * h, k2), A53 * h, k3), A54 * h, k4)
    k5, near = slope(y5, 4, C5, B5, here, near)
    y6 = along(along(along(along(y, A62 * h, k2), A63 * h, k3), A64 * h, k4), A65 * h, k5)
    k6, near = slope(y6, 5, C6, B6, here, near)
    y7 = along(along(along(along(along(y, A71 * h, k1), A72 * h, k2), A73 * h, k3), A74 * h, k4), A76 * h, k6)
    y = along(along(along(along(along(y, B1 * h, k1), B3 * h, k3), B4 * h, k4), B5 * h, k5), B6 * h, k6)
    return along(y, B7 * h, slope(y7, 6, 1.0, B7, here, near)[0])


@record
class Softening(LaneRecord):
    """How D and e answer where F1 and F2 of `equations.balance` change, and by what these change with the section, Q / D^2 at
    the same load being T = EI1 k1^2 + EI2 k2^2 of a linear section's k."""

    k: Vector
    """Elastic bending curvatures (2), and 1 / D."""
    d_by_f1: float
    d_by_f2: float
    e_by_f1: float
    e_by_f2: float
    f1_by_total: float
    f2_by_total: float
    """By T."""
    f1_by_root: float
    """By ln EI1 and ln EI2, through B."""
    f1_by_a: float
    f1_by_b: float
    f2_by_b: float
    f2_by_c: float
    f2_by_axial: float
    """By 1 / EA."""


@record
class Stage(LaneRecord):
    """What goes on at a stage."""

    rows: Annotated[list[Vector], 3]
    """Of R."""
    m: Vector
    n: Vector
    u: Vector
    v: Vector
    pull: Vector
    """R^T dN of the change that follows."""
    softening: Softening


@inline
def stage_of(stages: list[Stage] | None, i: int) -> Stage | None:
    """Stage i, where stages are kept."""
    if stages is None:
        return None
    return stages[i]


@inline
def keep_stage(stage: Stage | None, y: RodState, n: Vector, s: Strains, section: RodSection) -> None:
    """Keep what goes on, where there is room for it."""
    if stage is not None:
        w, a, b, c = y.q
        stage.rows[0] = (1.0 - 2.0 * (b * b + c * c), 2.0 * (a * b - w * c), 2.0 * (a * c + w * b))
        stage.rows[1] = (2.0 * (a * b + w * c), 1.0 - 2.0 * (a * a + c * c), 2.0 * (b * c - w * a))
        stage.rows[2] = (2.0 * (a * c - w * b), 2.0 * (b * c + w * a), 1.0 - 2.0 * (a * a + b * b))
        stage.m, stage.n, stage.u, stage.v = y.m, n, s.u, s.v
        keep_softening(stage.softening, n, s, section)


@inline
def keep_softening(to: Softening, n: Vector, s: Strains, section: RodSection) -> None:
    """Keep how D and e of a hyperelastic section answer at its solution F1 = F2 = 0: d(D, e) = -J^-1 d(F1, F2) with
    J = d(F1, F2) / d(D, e), and the derivatives of F1 and F2 by the numbers of the section at the same D and e."""
    law = law_of(s.free, section)
    f = balance(law, s.soft)
    d, e = s.soft
    ix, iy, _ = section.inv_bend
    total = s.free[0] * s.free[0] / ix + s.free[1] * s.free[1] / iy
    scale = -1.0 / (f.f1_by_d * f.f2_by_e - f.f1_by_e * f.f2_by_d)
    to.k = (s.free[0] / d, s.free[1] / d, 1.0 / d)
    to.d_by_f1, to.d_by_f2 = scale * f.f2_by_e, -scale * f.f1_by_e
    to.e_by_f1, to.e_by_f2 = -scale * f.f2_by_d, scale * f.f1_by_d
    root, w = (ix * iy) ** 0.5, 1.0 / (d * d)  # 1 / B, and Q / (Q for D = 1)
    half = 0.5 * w * law.b * f.rise
    to.f1_by_total = -f.steep * w * section.terms.law[0] * root
    to.f2_by_total = half * section.inv_stretch[2]
    to.f1_by_root = -0.5 * f.steep * f.x
    to.f1_by_a = -f.steep * w * root * total
    to.f1_by_b = -f.rise * e
    to.f2_by_b = law.coupled * w * (f.rise + law.b * e * f.curl)
    to.f2_by_c = f.relief * f.relief * e * e
    to.f2_by_axial = half * total - n[2]
