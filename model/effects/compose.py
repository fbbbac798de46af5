"""From the quantities to rods: sections, actuation, loads and boundary as rows of the solver.

The baseline is that of `model.section`: volume-mixed modulus over the spine, second moments of the annulus, chamber
forces and moments at the tip alone. Equation numbers in docs/explanations/effects.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from model.effects import layout as at
from model.effects.quantities import Quantities
from model.effects.spine import ShearSpine, moduli
from model.section import annulus_second_moment, body_area, body_second_moment

Array = NDArray[np.float64]
ZERO = np.zeros((1, 1))

CONTACT_WIDTH = 2e-3
"""m over which the obstacle's force sets in: skin and mounting give a little."""
INNER, OUTER = at.ELEMENTS, at.ELEMENTS + at.ELEMENT_WIDTH
_TIED = {at.BEND: {1: 1.0, 2: 2.0}, at.STRETCH: {1: 1.0}, at.SERIES + 1: {1: 0.5}}
TIED = {
    **{
        part + column: {part + column + k: factor for k, factor in others.items()}
        for part in (INNER, OUTER)
        for column, others in _TIED.items()
    },
    at.BASE_COMPLIANCE: {at.BASE_COMPLIANCE + 1: 1.0},
}
"""Column -> columns that are always so many times as large: sections are round, G J is 2 G I with the modulus of bending."""


class RodColumns:
    """Rods of n states, one array (v or 1, n or 1) for each column of a row that is not 0, v variants.

    A column that no variant changes is computed once for all of them; those of `TIED` come with the one that they follow.
    """

    def __init__(self) -> None:
        self._of: dict[int, Array] = {}

    def __getitem__(self, column: int) -> Array:
        return self._of.get(column, ZERO)

    def __setitem__(self, column: int, values: Array | float) -> None:
        self._of[column] = np.atleast_2d(values)

    def add(self, column: int, values: Array) -> None:
        """Add to a column, never in place: arrays are shared with the quantities."""
        self._of[column] = self[column] + values

    def rows(self, states: int) -> Array:
        """(states, WIDTH) of a single variant."""
        out = np.zeros((states, at.WIDTH))
        for column, values in self._of.items():
            out[:, column] = values[0]
            for other, factor in TIED.get(column, {}).items():
                out[:, other] = factor * values[0]
        return out

    def changes(self, base: RodColumns, by: Array) -> tuple[list[int], Array]:
        """Columns (a) in which rods differ from `base`, one variant, and (n, v, a) by how much per unit of `by` (v, n)."""
        differences = {c: values - base[c] for c, values in self._of.items() if len(values) == len(by)}
        changed = [c for c, difference in differences.items() if difference.any()]
        out = np.empty((by.shape[1], len(by), len(changed)))
        for i, column in enumerate(changed):
            out[:, :, i] = (differences[column] / by).T
        return changed, out


def directions(changed: Sequence[int]) -> Array:
    """(a, WIDTH) rods whose columns `changed` grow by 1 each, with what follows them."""
    out = np.zeros((len(changed), at.WIDTH))
    for row, column in zip(out, changed, strict=True):
        row[column] = 1.0
        for other, factor in TIED.get(column, {}).items():
            row[other] = factor
    return out


def rod_columns(q: Quantities, shear: ShearSpine) -> RodColumns:
    """Rods of all states and variants."""
    out = RodColumns()
    _sections(q, shear, out)
    _actuation(q, out)
    _loads(q, out)
    _boundary(q, out)
    return out


def _sections(q: Quantities, shear: ShearSpine, out: RodColumns) -> None:
    robot = q.robot
    area, second = body_area(robot), body_second_moment(robot)
    ratio = robot.shear_modulus / robot.youngs_modulus
    body = q.body_modulus
    inner = np.clip(q.spine_length, 0.0, q.length)
    out[INNER + at.LENGTH] = inner
    out[OUTER + at.LENGTH] = q.length - inner
    modulus, sideways = body, ratio * body
    bend, axial, lateral = body * second, body * area, ratio * body * area
    if robot.spine is not None:
        spine, spine_shear, _ = moduli(q, shear)
        core = math.pi * robot.spine.radius**2
        core_second = annulus_second_moment(robot.spine.radius)
        modulus = (area * body + core * spine) / (area + core)
        sideways = (area * ratio * body + core * spine_shear) / (area + core)
        blend = q.area_moments
        bend = modulus * second + blend * (body * second + spine * core_second - modulus * second)
        axial = modulus * area + blend * (body * area + (1 - q.spine_sliding) * spine * core - modulus * area)
        lateral = sideways * area + blend * (ratio * body * area + spine_shear * core - sideways * area)
    share = silicone_share(q, bend)
    for element, parts in ((INNER, (bend, axial, lateral, share)), (OUTER, (body * second, body * area, None, 1.0))):
        stiff, pull, side, silicone = parts
        across = ratio * body * area if side is None else side
        out[element + at.BEND] = stiff
        out[element + at.STRETCH] = across
        out[element + at.STRETCH + 2] = pull
        # The silicone's share of the section softens, the spine's stays linear or does so in part.
        soft = silicone + q.spine_softening * (1 - silicone)
        out[element + at.SERIES] = soft * q.bend_softening * robot.outer_radius**2
        out[element + at.SERIES + 1] = soft * q.strain_softening


def silicone_share(q: Quantities, bend: Array) -> Array:
    """(v, n) share of the bending stiffness `bend` (N m^2) of the part with spine that is the silicone's.

    Mixed by volume, silicone brings in its share of the volume; as a composite all of itself.
    """
    if q.robot.spine is None:
        return np.ones((1, 1))
    area, core = body_area(q.robot), math.pi * q.robot.spine.radius**2
    volume = area / (area + core)
    out: Array = (volume + q.area_moments * (1 - volume)) * q.body_modulus * body_second_moment(q.robot) / bend
    return out


def _actuation(q: Quantities, out: RodColumns) -> None:
    """Forces P A e3 at the tip (eq. 4); where the chambers wind, the moment turns with them along the arc.

    With azimuth az + c s (1 + g s / L) the internal moment of actuation at s is the one at the base turned so far. The
    tip carries that at s = L, and the difference is a rest curvature, expanded to third order in s over an element.
    A cut across the body meets the pressure at right angles however the chambers lean, so there is no torque.

    Gas in a bent chamber also presses on its longer outer wall, with P A kappa a length, away from the centre of the bend.
    Where the body takes that up (share w), what is left of the gas on any part of it is P A e3(s) at its ends: each section
    is stretched by P A along its own tangent, as by a rest strain w P A / EA, and no thrust at the tip bends it.
    """
    push = q.pressure * q.area_factor * q.robot.chambers.area
    arm = q.robot.chambers.path_radius
    azimuth = q.azimuth + (q.twist * q.length * (1 + q.twist_growth))[..., None]
    total = push.sum(axis=-1)
    mx, my = arm * (np.sin(azimuth) * push).sum(-1), -arm * (np.cos(azimuth) * push).sum(-1)
    out[at.TIP_FORCE + 2] = (1 - q.thrust_on_walls) * total
    if q.thrust_on_walls.any():
        for element in (INNER, OUTER):
            out.add(element + at.REST_STRAIN + 2, q.thrust_on_walls * total / out[element + at.STRETCH + 2])
    out[at.TIP_MOMENT] = mx
    out[at.TIP_MOMENT + 1] = my
    if not q.twist.any():
        return
    bottom = np.zeros((1, 1))
    for element in (INNER, OUTER):
        long = out[element + at.LENGTH]
        stiff = out[element + at.BEND]
        growth = q.twist_growth / q.length
        a0 = q.twist * (bottom * (1 + growth * bottom) - q.length * (1 + q.twist_growth))
        a1, a2 = q.twist * long * (1 + 2 * growth * bottom), q.twist * growth * long**2
        # cos(a0 + a1 x + a2 x^2) - 1 and the sine about a0 to third order in x.
        c, s = np.cos(a0), np.sin(a0)
        cosine = (c - 1, -s * a1, -s * a2 - c * a1**2 / 2, -c * a1 * a2 + s * a1**3 / 6)
        sine = (s, c * a1, c * a2 - s * a1**2 / 2, -s * a1 * a2 - c * a1**3 / 6)
        for power in range(4):
            column = element + (at.REST_CURVATURE if power == 0 else at.RISE + 3 * (power - 1))
            out.add(column, (cosine[power] * mx - sine[power] * my) / stiff)
            out.add(column + 1, (sine[power] * mx + cosine[power] * my) / stiff)
        bottom = bottom + long


def _loads(q: Quantities, out: RodColumns) -> None:
    gravity = np.array(q.robot.gravity)
    area = body_area(q.robot)
    for k in range(3):
        out[at.DEAD_FORCE + k] = q.design.tip_mass * gravity[k] + q.design.tip_load[:, k] + q.tip_force[..., k]
        for element in (INNER, OUTER):
            out[element + at.LOAD + k] = q.density * area * gravity[k]
    for j in range(2):
        spring = at.SPRINGS + j * at.SPRING_WIDTH
        out[spring + j] = 1.0
        out[spring + at.SPRING_STIFFNESS] = q.tether
    wall = at.SPRINGS + 2 * at.SPRING_WIDTH
    c, s = np.cos(q.plane_turn), np.sin(q.plane_turn)
    out[wall] = c * q.plane_direction[0] - s * q.plane_direction[1]
    out[wall + 1] = s * q.plane_direction[0] + c * q.plane_direction[1]
    out[wall + at.SPRING_STIFFNESS] = q.plane_stiffness
    out[wall + at.SPRING_ORIGIN] = q.plane_distance
    out[wall + at.SPRING_SOFTNESS] = CONTACT_WIDTH
    # Back along the body from the tip, which the chambers stretch and bend: y'' = k + F y / EI, k = M / EI.
    bent = [out[at.TIP_MOMENT + k] / out[OUTER + at.BEND] for k in range(2)]
    push = out[at.TIP_FORCE + 2]
    back = q.plane_lever * (1 + push / out[OUTER + at.STRETCH + 2])
    turned = (bent[0] ** 2 + bent[1] ** 2) * back**2
    x = push / out[OUTER + at.BEND] * back**2
    side = back**2 * (1 / 2 + x / 24 + x**2 / 720) * (1 - turned / 12)
    out[wall + at.SPRING_ARM] = -side * bent[1]
    out[wall + at.SPRING_ARM + 1] = side * bent[0]
    out[wall + at.SPRING_ARM + 2] = back * (1 - turned / 6)


def _boundary(q: Quantities, out: RodColumns) -> None:
    for k in range(3):
        out[at.BASE_TURN + k] = q.base_turn[..., k]
    out[at.BASE_COMPLIANCE] = q.base_compliance
    out[at.BASE_RELIEF] = q.base_relief
    out[at.BASE_STIFFENING] = q.base_stiffening
    bottom = np.zeros((1, 1))
    for element in (INNER, OUTER):
        long = out[element + at.LENGTH]
        for k in range(3):
            # Linear along the arc: 1 at mid-length, 1 + growth at the tip.
            start = 1 + q.rest_growth * (2 * bottom / q.length - 1)
            out.add(element + at.REST_CURVATURE + k, q.rest_curvature[..., k] * start)
            out.add(element + at.RISE + k, q.rest_curvature[..., k] * q.rest_growth * 2 * long / q.length)
        bottom = bottom + long
