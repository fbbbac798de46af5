"""A group of rods in lanes: what kernels know of each, and how rows of `Rods` come in."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Any, Concatenate, NamedTuple, ParamSpec, cast

import numpy as np

from model.arrays import Array, Ints
from model.rods import columns
from model.rods.description import MOST_SPRINGS
from model.rods.fast.algebra import Quaternion, Vector, dot
from model.rods.fast.compiler import allocating, inline, routine
from model.rods.fast.equations import RodSection, Terms
from model.rods.fast.lanes import LANES, LaneRecord, new_numbers, record

More = ParamSpec("More")


@record
class Spring(LaneRecord):
    """A spring at the tip, in the order of `columns`."""

    direction: Vector
    stiffness: float
    origin: float
    softness: float
    arm: Vector


@record
class BasePoint(LaneRecord):
    """A point that the walk has come to."""

    q: Quaternion
    m: Vector
    r: Vector
    """As in `equations`."""
    force: Vector
    """N of `equations`."""
    peak: float
    """The largest m^2 met so far at the ends of steps, N^2 m^2."""


@record
class RodPose(LaneRecord):
    """The unknowns of the tip."""

    turn: Quaternion
    """Its orientation."""
    place: Vector
    """With springs: where they take the tip to be (m, mount frame)."""


@record
class Six(LaneRecord):
    """By how much a pose changes or is missed."""

    turn: Vector
    """Rotation, rad, mount frame."""
    shift: Vector
    """Place over the rod's length; nothing without springs."""


@record
class FoundTip(LaneRecord):
    """What comes of a tip."""

    residual: Six
    """By how much the base misses its pose."""
    seen: Vector
    """The tip as seen from the base, m, mount frame."""


@record
class Matrix(LaneRecord):
    """d residual / d change, row by row."""

    turn: Annotated[list[Six], 3]
    shift: Annotated[list[Six], 3]


@record
class Rod(LaneRecord):
    """A rod that is being solved."""

    here: BasePoint
    """Where the walk stands."""
    beside: BasePoint
    """A point within the step that it takes next."""
    share: float
    """Of that step, up to there; negative where there is none."""
    tip: RodPose
    found: FoundTip
    change: Six
    """The last change of the tip's pose."""
    tip_before: RodPose
    found_before: FoundTip
    """As they were before it."""
    jacobian: Matrix
    """Its first three by three numbers only, without springs."""
    seen_by: Annotated[list[Six], 3]
    """d seen / d change."""
    pivots: Annotated[list[Six], 7]
    """Room for elimination."""
    tip_force: Vector
    tip_moment: Vector
    dead_force: Vector
    dead_moment: Vector
    base: Quaternion
    """Orientation of the unloaded base."""
    compliance: Vector
    relief: float
    stiffening: float
    """As `columns` names them."""
    load_share: float
    """Share of all loads that is on."""
    length: float
    """m."""
    largest_moment: float
    """Of the coarse solution, N m."""
    thrust: float
    """About the largest force, N."""
    springs: Annotated[list[Spring], MOST_SPRINGS]


# Numba takes sizes as constants of a module.
ROD, SECTION, TERMS, SPRING = Rod.size, RodSection.size, Terms.size, Spring.size
POSE, SIX, FOUND = RodPose.size, Six.size, FoundTip.size
BLOCK = columns.BLOCK


class RodGroup(NamedTuple):
    """Rods side by side, and how they are cut."""

    work: Array
    """Of `Rod`."""
    elements: Array
    """(count) of `RodSection`, tip first."""
    parts: Ints
    """(count,) steps of each element."""
    springs: int
    linear: bool
    """Whether no section of any rod is hyperelastic."""
    active: int
    """Lanes in use."""


def each_rod(of_one: Callable[Concatenate[Rod, More], None]) -> Callable[Concatenate[RodGroup, More], None]:
    """Make what is done with one rod something that is done with all of a group."""
    one: Any = inline(of_one)

    def each(group: RodGroup, *more: Any) -> None:
        for l in range(group.active):
            one(Rod(group.work, l), *more)

    return cast(Callable[Concatenate[RodGroup, More], None], inline(each))


@inline
def section_of(group: RodGroup, e: int, l: int) -> RodSection:
    """Element e, counted from the tip, of lane l."""
    return RodSection(group.elements, l, e * SECTION)


@inline
def elements_of(rods: Array, springs: int) -> int:
    """Elements of a row."""
    return (rods.shape[1] - columns.HEAD - SPRING * springs) // BLOCK


@inline
def three(rods: Array, row: int, column: int) -> Vector:
    """Three numbers of a row."""
    return (rods[row, column], rods[row, column + 1], rods[row, column + 2])


@routine
def gather_rod(rods: Array, row: int, group: RodGroup, l: int) -> None:
    """Copy rod `row` into lane l, ends and elements (tip first), and estimate what `cut` sizes steps by: thrust and moment."""
    rod = Rod(group.work, l)
    gather_ends(rods, row, rod)
    for j in range(group.springs):
        for k in range(SPRING):
            rod.springs[j][k] = rods[row, columns.HEAD + SPRING * j + k]
    # about the largest force in the rod (N): both forces at the tip and half of the distributed loads
    total_length, thrust = 0.0, math.sqrt(dot(rod.tip_force, rod.tip_force)) + math.sqrt(dot(rod.dead_force, rod.dead_force))
    for column in range(columns.HEAD + SPRING * group.springs, rods.shape[1], BLOCK):
        length, load = rods[row, column + columns.LENGTH], three(rods, row, column + columns.LOAD)
        total_length += length
        thrust += 0.5 * length * math.sqrt(load[0] * load[0] + load[1] * load[1] + load[2] * load[2])
    rod.length, rod.thrust = total_length, thrust
    # N m, for the coarse steps alone: follower loads at the tip, whose force has an arm once the rod bends; others are left out.
    arm = 0.125 * total_length
    follower_moment = math.sqrt(dot(rod.tip_moment, rod.tip_moment))
    rod.largest_moment = max(follower_moment, arm * math.sqrt(dot(rod.tip_force, rod.tip_force)))
    for e in range(group.parts.size):
        gather_section(rods, row, rods.shape[1] - (e + 1) * BLOCK, section_of(group, e, l))


@inline
def gather_ends(rods: Array, row: int, rod: Rod) -> None:
    """Copy what belongs to the ends of a rod."""
    rod.tip_force, rod.tip_moment = three(rods, row, columns.TIP_FORCE), three(rods, row, columns.TIP_MOMENT)
    rod.dead_force, rod.dead_moment = three(rods, row, columns.DEAD_FORCE), three(rods, row, columns.DEAD_MOMENT)
    x, y, z = three(rods, row, columns.BASE_TURN)
    angle = math.sqrt(x * x + y * y + z * z)
    w, half = 1.0, 0.5
    if angle > 0.0:
        w, half = math.cos(0.5 * angle), math.sin(0.5 * angle) / angle
    rod.base = (w, half * x, half * y, half * z)
    rod.compliance = three(rods, row, columns.BASE_COMPLIANCE)
    rod.relief, rod.stiffening = rods[row, columns.BASE_RELIEF], rods[row, columns.BASE_STIFFENING]
    rod.load_share = 1.0


@inline
def gather_section(rods: Array, row: int, o: int, section: RodSection) -> None:
    """Copy the element that begins at column o."""
    section.length = rods[row, o + columns.LENGTH]
    x, y, z = three(rods, row, o + columns.BEND)
    section.inv_bend = (1.0 / x, 1.0 / y, 1.0 / z)
    x, y, z = three(rods, row, o + columns.STRETCH)
    section.inv_stretch = (1.0 / x, 1.0 / y, 1.0 / z)
    section.u_rest, section.v_rest = (three(rods, row, o + columns.REST_CURVATURE), three(rods, row, o + columns.REST_STRAIN))
    section.load = three(rods, row, o + columns.LOAD)
    section.u_rest_norm = math.sqrt(dot(section.u_rest, section.u_rest))
    for k in range(TERMS):
        section.terms[k] = rods[row, o + columns.SERIES + k]


@allocating
def new_group(rods: Array, springs: int, size: int) -> RodGroup:
    """Room for a group of such rods, `size` quantities for each besides its elements; all lanes in use."""
    count = elements_of(rods, springs)
    parts = np.empty(count, np.int64)
    linear = True
    for o in range(rods.shape[1] - count * BLOCK + columns.SERIES, rods.shape[1], BLOCK):
        linear = linear and not rods[:, o : o + 3].any()
    return RodGroup(new_numbers(size * LANES), new_numbers(count * SECTION * LANES), parts, springs, linear, LANES)


@inline
def gather(rods: Array, group: RodGroup, first: int) -> None:
    """The rods from row `first` on into the lanes in use; those without a rod hold the last one."""
    for l in range(group.active):
        gather_rod(rods, min(first + l, len(rods) - 1), group, l)


@routine
def fixed_cut(group: RodGroup, steps: Ints, first: int) -> None:
    """Cut as `steps` (n, elements base to tip) says, where it has rows: the most that any rod of the group is to have."""
    if steps.shape[0] == 0:
        return
    parts = group.parts
    for e in range(parts.size):
        most = 1
        for l in range(group.active):
            most = max(most, steps[min(first + l, steps.shape[0] - 1), parts.size - 1 - e])
        parts[e] = most


FINEST = 5.0
"""By how much steps are refined at most."""


@routine
def cut(group: RodGroup, divisions: float) -> None:
    """Set into how many steps each element (tip first) of the group is cut.

    No step is longer than the rod's length over `divisions`. Where the largest moment would bend a whole rod of the element's
    section by more than b = 1.4 rad, or by less with a thrust t = |N| L^2 / EI above 8, steps are finer: chosen by experiment so
    that the tip's error stays level. Lanes share the cuts: an element that is empty in one rod has steps of no length there.
    """
    for e in range(group.parts.size):
        for l in range(group.active):
            rod, section = Rod(group.work, l), section_of(group, e, l)
            flexible = max(section.inv_bend[0], section.inv_bend[1])
            b = rod.length * (rod.largest_moment * flexible + section.u_rest_norm)
            t = rod.thrust * rod.length * rod.length * flexible
            finer = 0.3 + 0.5 * b * max(1.0, t / 8.0)
            # A pass that went astray may have met any moment, or none that is a number.
            finer = max(1.0, finer) if finer < FINEST else FINEST
            section.parts = section.length / rod.length * divisions * finer
        most_steps = 0.0
        for l in range(group.active):
            most_steps = max(most_steps, section_of(group, e, l).parts)
        group.parts[e] = int(math.ceil(most_steps - 1e-9))
