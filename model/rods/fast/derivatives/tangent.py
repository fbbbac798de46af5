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
stiffness), so that each column collects T for every number of an element (`collect`).
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

from model.arrays import Array
from model.rods.fast.algebra import Vector, along, cross, plus_cross, scaled, times
from model.rods.fast.compiler import inline
from model.rods.fast.equations import RodSection
from model.rods.fast.group import Rod
from model.rods.fast.lanes import LANES, LaneRecord, copy_lanes, record
from model.rods.fast.runge_kutta import STAGES, Softening, Stage, step

NOTHING = (0.0, 0.0, 0.0)


@record
class Work(LaneRecord):
    """T of an element by each of its numbers, in the order of `model.rods.columns`."""

    length: float
    bend: Vector
    stretch: Vector
    rest_curvature: Vector
    rest_strain: Vector
    load: Vector
    series: Vector
    rise1: Vector
    rise2: Vector
    rise3: Vector
    active: Vector
    active1: Vector
    active2: Vector
    active3: Vector


@record
class TangentColumn(LaneRecord):
    """A change that walks along the rod."""

    theta: Vector
    dm: Vector
    p: Vector
    mean_strain: float
    """Of dv3 over the element so far."""
    work: Work
    """T of the element so far."""


@record
class SectionAnswer(LaneRecord):
    """What a section answers at a stage, by the stage's weight. Sums over the stages are made from these afterwards, few at a
    time: there are more of them than a processor has registers."""

    dm: Vector
    dn: Vector
    moved: Vector
    """-R^T dp/dt."""
    strain: float
    """dv3."""


@record
class ColumnWalk(LaneRecord):
    """A rod, and the change that follows it along one step. All is in one array, at places known to the compiler: between several
    it would have to check for overlap, and gives up on making vectors."""

    rod: Rod
    section: RodSection
    """Of the element that is being walked."""
    stages: Annotated[list[Stage], STAGES]
    column: TangentColumn
    added: float
    """Axial force that a forced column adds to the element."""
    answers: Annotated[list[SectionAnswer], STAGES]
    tip_moment: Vector
    """M at the tip, mount frame."""


WALK, COLUMN = ColumnWalk.size, TangentColumn.size
PLACED = 9
"""Quantities of a column that go on from one element to the next: theta, dm and p."""
TURNS, MOMENTS, FORCES, TIP_COLUMNS = 0, 3, 6, 9
"""Columns that start at the tip with a turn, a moment, a force; forced ones come behind."""
LEAST_LENGTH = 1e-9
"""m: the mean strain of an element without length has no meaning, but must not spoil the others."""


class AddedChange(NamedTuple):
    """The part of a column that feeds back."""

    theta: Vector
    dm: Vector


class Here(NamedTuple):
    """The step of a rod that a change follows."""

    walk: ColumnWalk
    inv_bend: Vector
    inv_stretch: Vector
    added: float


@inline
def change_along(y: AddedChange, h: float, k: AddedChange) -> AddedChange:
    """y + h k."""
    return AddedChange(along(y.theta, h, k.theta), along(y.dm, h, k.dm))


@inline
def compliance(dm: Vector, dn: Vector, here: Here, s: Softening) -> tuple[Vector, Vector]:
    """(du, dv) = C (dm, dn) of a section."""
    du, dv = times(here.inv_bend, dm), times(here.inv_stretch, dn)
    k1, k2, inverse = s.k
    total = 2.0 * (k1 * dm[0] + k2 * dm[1]) / inverse
    f1, f2 = s.f1_by_total * total, s.f2_by_total * total - dv[2]
    d, e = s.d_by_f1 * f1 + s.d_by_f2 * f2, s.e_by_f1 * f1 + s.e_by_f2 * f2
    return ((du[0] - k1 * d) * inverse, (du[1] - k2 * d) * inverse, du[2]), (dv[0], dv[1], e)


@inline
def change_slope(y: AddedChange, i: int, share: float, weight: float, here: Here, near: None) -> tuple[AddedChange, None]:
    """d(theta, dm)/dt at stage i; see the top of the file. What the section answers is kept."""
    stage, answer = here.walk.stages[i], here.walk.answers[i]
    u, v, n = stage.u, stage.v, stage.n
    dn = plus_cross(stage.pull, n, y.theta)
    pulled = (dn[0], dn[1], dn[2] + here.added)
    du, dv = compliance(y.dm, pulled, here, stage.softening)
    if weight != 0.0:
        answer.dm, answer.dn, answer.strain = scaled(weight, y.dm), scaled(weight, dn), weight * dv[2]
        answer.moved = scaled(weight, plus_cross(dv, y.theta, v))
    turns = plus_cross(scaled(-1.0, du), u, y.theta)
    return AddedChange(turns, plus_cross(plus_cross(plus_cross(cross(u, y.dm), du, stage.m), v, dn), dv, n)), None


@inline
def step_column(walk: ColumnWalk, dz: float) -> None:
    """Take the column of a rod along the step that its stages tell of."""
    column, section = walk.column, walk.section
    here = Here(walk, section.inv_bend, section.inv_stretch, walk.added)
    y = step(change_slope, change_along, AddedChange(column.theta, column.dm), step_of(walk, dz)[1], here)
    column.theta, column.dm = y.theta, y.dm


@inline
def step_of(walk: ColumnWalk, dz: float) -> tuple[float, float]:
    """Share of the element that a rod passes in a step by dz, and its length (m)."""
    share = -dz * walk.rod.share
    return share, share * walk.section.length


@inline
def load_column(work: Array, x: Array, c: int, carried: int, e: int) -> None:
    """Copy column c of `x` to where the walk takes it, with R^T dN of all stages and the axial force that it adds to element e;
    the first `carried` quantities are copied, the others begin with nothing.

    R^T dN is a row of R for columns that begin with a force. Forced column TIP_COLUMNS + k belongs to element k.
    """
    copy_lanes(TangentColumn(x, 0, c * COLUMN), ColumnWalk(work, 0).column, carried)
    for k in range(carried, COLUMN):
        for l in range(LANES):
            ColumnWalk(work, l).column[k] = 0.0
    force = 1.0 if c - TIP_COLUMNS == e else 0.0  # N times the element's length
    for l in range(LANES):
        walk = ColumnWalk(work, l)
        walk.added = force / max(walk.section.length, LEAST_LENGTH)
    # Rows are constants for the compiler. Turns, moments (from column 0) and forced columns have no pull: the first clears it.
    if c == FORCES:
        pull_all(work, 0)
    elif c == FORCES + 1:
        pull_all(work, 1)
    elif c == FORCES + 2:
        pull_all(work, 2)
    elif c in (0, TIP_COLUMNS):
        for i in range(STAGES):
            for l in range(LANES):
                ColumnWalk(work, l).stages[i].pull = NOTHING


@inline
def pull_all(work: Array, k: int) -> None:
    """R^T dN of a unit force along axis k, a row of R, at all stages."""
    for i in range(STAGES):
        for l in range(LANES):
            stage = ColumnWalk(work, l).stages[i]
            stage.pull = stage.rows[k]
