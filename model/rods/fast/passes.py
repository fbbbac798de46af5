"""One pass of a group of rods from the tip to the base."""

from __future__ import annotations

import math
from typing import NamedTuple

from model.rods.fast.algebra import (
    Quaternion,
    Vector,
    add,
    along,
    conjugate,
    cross,
    dot,
    plus_cross,
    product,
    scaled,
    times,
    turned,
    turned_back,
)  # fmt: skip
from model.rods.fast.compiler import inline, routine
from model.rods.fast.equations import RodSection, RodState, Soft, slope, state_along, strains
from model.rods.fast.group import BasePoint, Rod, RodGroup, Spring, each_rod, section_of
from model.rods.fast.lanes import LANES
from model.rods.fast.runge_kutta import Stage, keep_stage, stage_of, step

WHOLE = 1.0
"""`dead` of a pass: the share of the dead loads that acts."""


@routine
def evaluate(group: RodGroup, springs: int, dead: float) -> None:
    """Shoot from the present unknowns, dead loads counting `dead` times, this many springs pulling, and read the residual."""
    start_at_tip(group, springs, dead)
    parts = group.parts
    for e in range(parts.size):
        for j in range(parts[e]):
            dz = -1.0 / parts[e]
            advance_group(group, e, 1.0 + j * dz, dz, dead)
    read_base(group)
    if springs > 0:
        read_gap(group)


@inline
def start_at_tip(group: RodGroup, springs: int, dead: float) -> None:
    """The state at the tip under the wrench there, springs included."""
    set_tip(group, dead)
    for j in range(springs):
        add_spring(group, j)


@each_rod
def set_tip(rod: Rod, dead: float) -> None:
    """The state at the tip under the wrench there, without springs."""
    q, share, here = rod.tip.turn, rod.load_share, rod.here
    moment = along(scaled(share, rod.tip_moment), share * dead, turned_back(q, rod.dead_moment))
    here.force = along(scaled(share, turned(q, rod.tip_force)), share * dead, rod.dead_force)
    here.q, here.m, here.r, here.peak = q, moment, (0.0, 0.0, 0.0), dot(moment, moment)


@inline
def spring_force(stretch: float, stiffness: float, softness: float) -> float:
    """Pull (N) of a spring stretched by `stretch` (m); one that only pushes one way starts over a width `softness`."""
    if softness > 0.0:
        return 0.5 * stiffness * (stretch + math.sqrt(stretch * stretch + softness * softness))
    return stiffness * stretch


@inline
def spring_stretch(rod: Rod, spring: Spring, arm: Vector) -> float:
    """e . (p - R a) - origin of a spring whose arm R a is `arm` in the mount frame."""
    return dot(spring.direction, rod.tip.place) - dot(spring.direction, arm) - spring.origin


@each_rod
def add_spring(rod: Rod, j: int) -> None:
    """Add a spring to the internal force and moment at the tip: -k (e . (p - R a) - origin) e, at p - R a."""
    spring, here = rod.springs[j], rod.here
    arm = turned(rod.tip.turn, spring.arm)
    stretch = spring_stretch(rod, spring, arm)
    size = rod.load_share * spring_force(stretch, spring.stiffness, spring.softness)
    here.force = along(here.force, -size, spring.direction)
    here.m = along(here.m, size, turned_back(rod.tip.turn, cross(arm, spring.direction)))


class Way(NamedTuple):
    """A step of a rod along an element."""

    section: RodSection
    linear: bool
    h: float
    """m along the rod."""
    z: float
    """Place within the element: 1 at its tip end, 0 at its base end."""
    dz: float
    """By how much z changes, negative."""
    force: Vector
    """N at the start."""
    load: Vector
    """N/m by which it grows on the way."""
    stages: list[Stage] | None
    """Where to keep what goes on, if anywhere."""


@inline
def rod_slope(y: RodState, i: int, share: float, weight: float, way: Way, near: Soft | None) -> tuple[RodState, Soft]:
    """dy/dt of the rod at stage i, and how soft it is there."""
    n = turned_back(y.q, along(way.force, share * way.h, way.load))
    s = strains(y.m, n, way.section, way.z + share * way.dz, near, way.linear)
    keep_stage(stage_of(way.stages, i), y, n, s, way.section)
    return slope(y, n, s), s.soft


@inline
def advance(
    rod: Rod, section: RodSection, linear: bool, z: float, dz: float, dead: float, stages: list[Stage] | None, to: BasePoint
) -> None:
    """One step of a rod within an element, from the place z by dz (a negative share of the element), and where it leads."""
    here, h = rod.here, -dz * section.length
    load = scaled(dead * rod.load_share, section.load)
    way = Way(section, linear, h, z, dz, here.force, load, stages)
    y = step(rod_slope, state_along, RodState(here.q, here.m, here.r), h, way)
    to.force, to.peak = along(here.force, h, load), max(here.peak, y.m[0] * y.m[0] + y.m[1] * y.m[1] + y.m[2] * y.m[2])
    to.q, to.m, to.r = y.q, y.m, y.r


@inline
def advance_group(group: RodGroup, e: int, z: float, dz: float, dead: float) -> None:
    """One step of all lanes within element e."""
    if group.active == LANES:
        for l in range(LANES):
            rod = Rod(group.work, l)
            advance(rod, section_of(group, e, l), group.linear, z, dz, dead, None, rod.here)
    else:
        for l in range(group.active):
            advance_alone(group, e, z, dz, l, dead)


@routine
def advance_alone(group: RodGroup, e: int, z: float, dz: float, l: int, dead: float) -> None:
    """`advance` compiled once by itself, for where lanes are not side by side."""
    rod = Rod(group.work, l)
    advance(rod, section_of(group, e, l), group.linear, z, dz, dead, None, rod.here)


@inline
def orientation(at: BasePoint) -> Quaternion:
    """The orientation, freed from the drift of its norm."""
    a, b, c, d = at.q
    size = 1.0 / math.sqrt(a * a + b * b + c * c + d * d)
    return (size * a, size * b, size * c, size * d)


@inline
def read_base(group: RodGroup) -> None:
    """By which rotation the base misses its place, and where the tip is seen from it."""
    miss_base(group)
    for l in range(group.active):
        rod = Rod(group.work, l)
        if rod.relief != 0.0 or rod.stiffening != 0.0:
            relieve(rod)


@each_rod
def miss_base(rod: Rod) -> None:
    """`read_base` where the base feels all of the moment and does not stiffen."""
    q = orientation(rod.here)
    v = times(turned(q, rod.here.m), rod.compliance)
    e = product(q, conjugate(rod.base))
    # Four times the tangent of a quarter of the angle: the rotation vector to third order, regular up to 2 pi.
    scale = math.copysign(4.0 / (1.0 + abs(e[0])), e[0])
    rod.found.residual.turn = (scale * e[1] - v[0], scale * e[2] - v[1], scale * e[3] - v[2])
    rod.found.seen = turned(q, rod.here.r)


@routine
def relieve(rod: Rod) -> None:
    """Take back the share `relief` of what the compliance made of the moment of the follower loads about the base, and what
    a base that stiffens does not turn."""
    q = rod.tip.turn
    follower = plus_cross(turned(q, rod.tip_moment), rod.found.seen, turned(q, rod.tip_force))
    whole = times(turned(orientation(rod.here), rod.here.m), rod.compliance)
    left = along(whole, -rod.relief * rod.load_share, times(follower, rod.compliance))
    yielded = (1.0 + rod.stiffening * dot(left, left)) ** (-1.0 / 3.0)
    rod.found.residual.turn = along(add(rod.found.residual.turn, whole), -yielded, left)


@each_rod
def read_gap(rod: Rod) -> None:
    """How far the tip is from where the springs take it to be, over the rod's length."""
    rod.found.residual.shift = scaled(1.0 / rod.length, along(rod.tip.place, -1.0, rod.found.seen))


@inline
def change_tip(group: RodGroup) -> None:
    """Turn the tips by `change`; with springs move them, too."""
    turn_tip(group)
    if group.springs > 0:
        shift_tip(group)


@each_rod
def turn_tip(rod: Rod) -> None:
    """Turn the tip by `change.turn`: the quaternion of x is (1, x / 2) / sqrt(1 + |x|^2 / 4), to second order in |x|."""
    x, y, z = rod.change.turn
    size = 1.0 / math.sqrt(1.0 + 0.25 * (x * x + y * y + z * z))
    half = 0.5 * size
    rod.tip.turn = product((size, half * x, half * y, half * z), rod.tip.turn)


@each_rod
def shift_tip(rod: Rod) -> None:
    """Shift the tip by `change.shift` rod lengths."""
    rod.tip.place = along(rod.tip.place, rod.length, rod.change.shift)
