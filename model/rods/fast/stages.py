"""What a step tells of its stages, so that changes of the rod can follow it (`derivatives.tangent`)."""

from __future__ import annotations

from typing import Annotated

from model.rods.fast.algebra import Vector
from model.rods.fast.compiler import inline
from model.rods.fast.equations import Section, State, Strains, balance, law_of
from model.rods.fast.lanes import Record, record


@record
class Softening(Record):
    """How D and e answer where F1 and F2 of `equations.balance` change, and by what these change with the section, Q / D^2 at
    the same load being T = m1^2 / EI1 + m2^2 / EI2."""

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
class Stage(Record):
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
def keep_stage(stage: Stage | None, y: State, n: Vector, s: Strains, section: Section) -> None:
    """Keep what goes on, where there is room for it."""
    if stage is not None:
        w, a, b, c = y.q
        stage.rows[0] = (1.0 - 2.0 * (b * b + c * c), 2.0 * (a * b - w * c), 2.0 * (a * c + w * b))
        stage.rows[1] = (2.0 * (a * b + w * c), 1.0 - 2.0 * (a * a + c * c), 2.0 * (b * c - w * a))
        stage.rows[2] = (2.0 * (a * c - w * b), 2.0 * (b * c + w * a), 1.0 - 2.0 * (a * a + b * b))
        stage.m, stage.n, stage.u, stage.v = y.m, n, s.u, s.v
        keep_softening(stage.softening, y.m, n, s, section)


@inline
def keep_softening(to: Softening, m: Vector, n: Vector, s: Strains, section: Section) -> None:
    """Keep how D and e of a hyperelastic section answer at its solution F1 = F2 = 0: d(D, e) = -J^-1 d(F1, F2) with
    J = d(F1, F2) / d(D, e), and the derivatives of F1 and F2 by the numbers of the section at the same D and e."""
    law = law_of(m, n, section)
    f = balance(law, s.soft)
    d, e = s.soft
    ix, iy, _ = section.inv_bend
    total = ix * m[0] * m[0] + iy * m[1] * m[1]
    scale = -1.0 / (f.f1_by_d * f.f2_by_e - f.f1_by_e * f.f2_by_d)
    to.k = (ix * m[0] / d, iy * m[1] / d, 1.0 / d)
    to.d_by_f1, to.d_by_f2 = scale * f.f2_by_e, -scale * f.f1_by_e
    to.e_by_f1, to.e_by_f2 = -scale * f.f2_by_d, scale * f.f1_by_d
    root, w = (ix * iy) ** 0.5, 1.0 / (d * d)
    half = 0.5 * w * law.b * f.rise
    to.f1_by_total = -f.steep * w * section.terms.law[0] * root
    to.f2_by_total = half * section.inv_stretch[2]
    to.f1_by_root = -0.5 * f.steep * f.x
    to.f1_by_a = -f.steep * w * root * total
    to.f1_by_b = -f.rise * e
    to.f2_by_b = law.coupled * w * (f.rise + law.b * e * f.curl)
    to.f2_by_c = f.relief * f.relief * e * e
    to.f2_by_axial = half * total - n[2]
