"""What changes at the two ends of a rod: the wrench at the tip by unknowns and parameters, the residual at the base by both.

Unknowns are the turn of the tip and, with springs, its shift (rad, m; mount frame). With f, g the follower loads in the
mount frame, P the tip seen from the base and M the moment there,
    dN = phi x f + R dF + dF_dead - d(springs),   dM = phi x g + R dM_tip + dM_dead      at the tip,
    chi(base turned back by base_turn) = v / (1 + h |v|^2)^(1/3), v = K (M - relief (g + P x f))    at the base,
chi being four times the tangent of a quarter of the angle, along its axis. A direction in parameter space is
read as the rod itself is, by the names of its numbers.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from model.rods.description import MOST_SPRINGS
from model.rods.fast.algebra import (
    Vector,
    add,
    along,
    conjugate,
    cross,
    dot,
    minus,
    plus_cross,
    product,
    scaled,
    times,
    turned,
    unit,
)  # fmt: skip
from model.rods.fast.compiler import inline, routine
from model.rods.fast.derivatives.columns_walk import SectionChange
from model.rods.fast.derivatives.tangent import NOTHING
from model.rods.fast.group import Rod, Spring
from model.rods.fast.lanes import LaneRecord, record
from model.rods.fast.passes import orientation, spring_stretch


@record
class EndParameters(LaneRecord):
    """A direction in parameter space: how the numbers at the ends of a rod change, in the order of `model.rods.columns`."""

    tip_force: Vector
    tip_moment: Vector
    dead_force: Vector
    dead_moment: Vector
    base_turn: Vector
    base_compliance: Vector
    base_relief: float
    base_stiffening: float
    springs: Annotated[list[Spring], MOST_SPRINGS]


@record
class Ends(LaneRecord):
    """A solved rod at its ends, mount frame."""

    force: Vector
    moment: Vector
    """f and g."""
    chi_by_turn: Annotated[list[Vector], 3]
    """Columns of d chi / d turn of the base."""
    turn_by_tilt: Annotated[list[Vector], 3]
    """Columns of d turn / d base_turn."""
    felt: Vector
    """M - relief (g + P x f)."""


ENDS = Ends.size


@routine
def linearise_ends(rod: Rod, ends: Ends, tilt: Vector) -> None:
    """Fill `ends` of a rod that was walked to the base, whose base_turn is `tilt` (rad)."""
    ends.force, ends.moment = turned(rod.tip.turn, rod.tip_force), turned(rod.tip.turn, rod.tip_moment)
    base = orientation(rod.here)
    w, x, y, z = product(base, conjugate(rod.base))
    e = (-w, -x, -y, -z) if w < 0.0 else (w, x, y, z)
    for k in range(3):
        ends.chi_by_turn[k] = chi_rate(e, unit(k))
        ends.turn_by_tilt[k] = turned(e, turn_rate(tilt, unit(k)))
    carried = plus_cross(ends.moment, rod.found.seen, ends.force)
    ends.felt = along(turned(base, rod.here.m), -rod.relief, carried)


@inline
def chi_rate(e: tuple[float, float, float, float], turn: Vector) -> Vector:
    """By how much chi of the rotation e changes when that turns: de = (0, turn) e / 2."""
    scale, axis = 4.0 / (1.0 + e[0]), (e[1], e[2], e[3])
    moved = scaled(0.5 * scale, along(cross(turn, axis), e[0], turn))
    return along(moved, 0.125 * scale * scale * dot(turn, axis), axis)


@inline
def turn_rate(x: Vector, change: Vector) -> Vector:
    """J c, J the left Jacobian of rotations: by which turn (rad) from the left R(x) changes when x (rad) changes by c.

    With x = t a: J c = (sin t / t) c + (1 - sin t / t) (a . c) a + ((1 - cos t) / t) a x c.
    """
    angle = math.sqrt(dot(x, x))
    if angle < 1e-4:
        return along(change, 0.5, cross(x, change))
    a = scaled(1.0 / angle, x)
    sine = math.sin(angle) / angle
    found = along(scaled(sine, change), (1.0 - sine) * dot(a, change), a)
    return along(found, (1.0 - math.cos(angle)) / angle, cross(a, change))


class Pull(NamedTuple):
    """Derivatives of the pull (N) of a spring, see `spring_force`."""

    arm: Vector
    """R a, m, mount frame."""
    by_stiffness: float
    """m; times the stiffness this is the pull itself."""
    by_stretch: float
    by_softness: float
    """N/m each."""


@inline
def pull_of(rod: Rod, spring: Spring) -> Pull:
    """Derivatives of the pull of a spring."""
    arm = turned(rod.tip.turn, spring.arm)
    stretch, stiffness, softness = spring_stretch(rod, spring, arm), spring.stiffness, spring.softness
    if softness > 0.0:
        root = math.sqrt(stretch * stretch + softness * softness)
        half = 0.5 * stiffness
        return Pull(arm, 0.5 * (stretch + root), half * (1.0 + stretch / root), half * softness / root)
    return Pull(arm, stretch, stiffness, 0.0)


@inline
def springs_by_motion(rod: Rod, springs: int, turn: Vector, shift: Vector) -> tuple[Vector, Vector]:
    """Change of the springs' force (N) and moment (N m) at the tip, mount frame, when it turns (rad) and shifts (m)."""
    force, moment = NOTHING, NOTHING
    for j in range(springs):
        spring, e = rod.springs[j], rod.springs[j].direction
        pull = pull_of(rod, spring)
        swung = cross(turn, pull.arm)
        pulled = scaled(pull.by_stretch * (dot(e, swung) - dot(e, shift)), e)
        held = scaled(-spring.stiffness * pull.by_stiffness, e)
        force = add(force, pulled)
        moment = minus(moment, add(cross(swung, held), cross(pull.arm, pulled)))
    return force, moment


@inline
def springs_by_parameters(rod: Rod, springs: int, change: list[Spring]) -> tuple[Vector, Vector]:
    """Change of the springs' force F (N) and moment M (N m) at the tip, mount frame, when their numbers change by `change`, the
    tip held still. Each spring, attached at p - R a, adds F = -P e and M = -(R a) x F, P its pull (see `spring_force`):

        dF = -dP e - P de,   dM = -(R da) x F - (R a) x dF,
        dP = dP/dk dk + dP/dsoftness dsoftness + dP/dstretch (de . (p - R a) - e . (R da) - dorigin).
    """
    force, moment = NOTHING, NOTHING
    for j in range(springs):
        spring, d, e = rod.springs[j], change[j], rod.springs[j].direction
        pull = pull_of(rod, spring)
        arm_change, minus_pull = turned(rod.tip.turn, d.arm), -spring.stiffness * pull.by_stiffness
        pull_change = d.stiffness * pull.by_stiffness + d.softness * pull.by_softness
        pull_change += pull.by_stretch * (dot(d.direction, minus(rod.tip.place, pull.arm)) - dot(e, arm_change) - d.origin)
        force_change = along(scaled(-pull_change, e), minus_pull, d.direction)
        force = add(force, force_change)
        moment = minus(moment, add(cross(arm_change, scaled(minus_pull, e)), cross(pull.arm, force_change)))
    return force, moment


@inline
def tip_wrench_change(rod: Rod, springs: int, d: EndParameters) -> tuple[Vector, Vector]:
    """dN and dM at the tip along a direction, the tip held still."""
    force, moment = springs_by_parameters(rod, springs, d.springs)
    force = add(add(turned(rod.tip.turn, d.tip_force), d.dead_force), force)
    return force, add(add(turned(rod.tip.turn, d.tip_moment), d.dead_moment), moment)


@inline
def compliant_turn(rod: Rod, ends: Ends, dv: Vector, dh: float) -> Vector:
    """Change dw (rad) of the turn w = f v that the base gives way by, v = K felt, when v changes by dv (rad), h by dh (1/rad^2).

    dw = f dv - f / (3 b) (2 h v . dv + |v|^2 dh) v,   f = b^(-1/3),   b = 1 + h |v|^2.
    """
    h = rod.stiffening
    if h == 0.0 and dh == 0.0:
        return dv
    v = times(rod.compliance, ends.felt)
    squared = dot(v, v)
    b = 1.0 + h * squared
    f = b ** (-1.0 / 3.0)
    return along(scaled(f, dv), -f / (3.0 * b) * (2.0 * h * dot(v, dv) + dh * squared), v)


@inline
def weighed(columns: list[Vector], by: Vector) -> Vector:
    """A matrix, of which these are the columns, times a vector."""
    return along(along(scaled(by[0], columns[0]), by[1], columns[1]), by[2], columns[2])


@inline
def base_residual_change(rod: Rod, ends: Ends, change: SectionChange, force: Vector, twist: Vector) -> Vector:
    """Change (rad) of the base's residual chi - w when the section there changes, f by `force` (N) and g by `twist` (N m)."""
    follower = plus_cross(cross(ends.force, change.shift), rod.found.seen, force)
    moment = along(change.moment, -rod.relief, add(twist, follower))
    return minus(weighed(ends.chi_by_turn, change.turn), compliant_turn(rod, ends, times(rod.compliance, moment), 0.0))


@inline
def base_parameter_change(rod: Rod, ends: Ends, d: EndParameters) -> Vector:
    """Change (rad) of the base's residual with the base's own parameters: its turn, compliance, relief and stiffening."""
    tilted = weighed(ends.turn_by_tilt, scaled(-1.0, d.base_turn))
    follower = plus_cross(ends.moment, rod.found.seen, ends.force)
    v = along(times(d.base_compliance, ends.felt), -d.base_relief, times(rod.compliance, follower))
    return minus(weighed(ends.chi_by_turn, tilted), compliant_turn(rod, ends, v, d.base_stiffening))
