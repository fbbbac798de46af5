"""From the quantities to rods: sections, actuation, loads and boundary as rows of the solver.

The baseline is that of `model.section`: volume-mixed modulus over the spine, chamber forces and moments at the tip alone.
Equation numbers are those of docs/explanations/model.md.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from model.arrays import Array, Ints
from model.body import annulus_second_moment
from model.effects import layout as at
from model.effects.quantities import Quantities
from model.effects.spine import ShearSpine, SpineModuli, moduli
from model.rods import columns as col

Complex = NDArray[np.complex128]
ZERO = np.zeros((1, 1))

FAR_AWAY = 1e4
"""m from the base to the origin of a spring that pulls with the same force wherever the tip is, to 1 in 10^4."""


class RodColumns:
    """Rods of n states, one array (v or 1, n or 1) for each column of a row that is not 0, v variants.

    A column that no variant changes is computed once; tied ones come with their leader. `rows` adds `col.ACTIVE` to rest strains.
    """

    def __init__(self, layout: at.Layout) -> None:
        self.layout = layout
        self._of: dict[int, Array] = {}

    def __getitem__(self, column: int) -> Array:
        leader, factor = self.layout.follows.get(column, (column, 1.0))
        values = self._of.get(leader, ZERO)
        return values if factor == 1.0 else factor * values

    def __setitem__(self, column: int, values: Array | float) -> None:
        self._of[column] = values if isinstance(values, np.ndarray) and values.ndim == 2 else np.atleast_2d(values)

    def add(self, column: int, values: Array) -> None:
        """Add to a column, never in place: arrays are shared with the quantities."""
        self._of[column] = self[column] + values

    def only(self, columns: Iterable[int]) -> RodColumns:
        """Some of the columns; of many variants all of them take much memory."""
        out = RodColumns(self.layout)
        out._of = {column: self._of[column] for column in columns if column in self._of}
        return out

    def rows(self, states: int, variants: int = 1) -> Array:
        """(variants * states, layout.width), one variant after the other."""
        out = np.zeros((variants, states, self.layout.width))
        for column, values in self._of.items():
            out[:, :, column] += values
            for other, factor in self.layout.moved.get(column, {}).items():
                out[:, :, other] += factor * values
        return out.reshape(-1, self.layout.width)

    def changes(self, base: RodColumns, by: Array) -> dict[int, tuple[Ints, Array]]:
        """By column in which rods differ from `base`, one variant: k variants that do, and (k, n) by how much per unit of `by`
        (v, n)."""
        differences = {c: values - base[c] for c, values in self._of.items() if len(values) == len(by)}
        changed = {c: np.flatnonzero(difference.any(axis=1)) for c, difference in differences.items()}
        return {c: (rows, differences[c][rows] / by[rows]) for c, rows in changed.items() if rows.size}

    def length(self, part: int) -> Array:
        """(v or 1, n or 1) m of one part of the body."""
        return np.asarray(sum(self[self.layout.elements[e] + col.LENGTH] for e in self.layout.of_part[part]))

    def mean(self, part: int, column: int) -> Array:
        """A stiffness (v or 1, n or 1) of a part: of a uniform one as compliant; where the part is empty, its first element's."""
        starts = [self.layout.elements[e] for e in self.layout.of_part[part]]
        if len(starts) == 1:
            return self[starts[0] + column]
        long = self.length(part)
        compliant = sum(self[e + col.LENGTH] / self[e + column] for e in starts)
        return np.where(long > 0, long / np.where(long > 0, compliant, 1.0), self[starts[0] + column])


def directions(layout: at.Layout, changed: Sequence[int]) -> Array:
    """(a, layout.width) rods whose columns `changed` grow by 1 each, with what follows them."""
    out = np.zeros((len(changed), layout.width))
    for row, column in zip(out, changed, strict=True):
        row[column] = 1.0
        for other, factor in layout.moved.get(column, {}).items():
            row[other] = factor
    return out


def rod_columns(q: Quantities, shear: ShearSpine) -> RodColumns:
    """Rods of all states and variants."""
    out = RodColumns(q.layout)
    _sections(q, shear, out)
    _actuation(q, out)
    _loads(q, out)
    _boundary(q, out)
    return out


def _sections(q: Quantities, shear: ShearSpine, out: RodColumns) -> None:
    """Length, stiffnesses and hyperelastic terms of every element: inner ones hold the spine, outer ones lie beyond its end."""
    ratio = q.robot.shear_modulus / q.robot.youngs_modulus
    spine = np.clip(q.spine_length, 0.0, q.length)
    edges, of_spine = q.body.edges / q.robot.length, moduli(q, shear)
    for element, piece, part in zip(q.layout.elements, q.layout.pieces, q.layout.parts, strict=True):
        low, high = edges[piece] * q.length, edges[piece + 1] * q.length
        within = np.clip(spine, low, high) - low if len(q.body) > 1 else spine
        out[element + col.LENGTH] = within if part == at.INNER else high - low - within
        area, second = q.body.area[piece], q.body.second[piece]
        softening = q.bend_softening * q.body.outer_radius[piece] ** 2
        if part == at.INNER:
            bend, axial, lateral = with_spine(q, of_spine, area, second)
            silicone = silicone_share(q, area, second, bend)
            # The silicone's share of the section softens, the spine's stays linear or does so in part.
            soft = silicone + q.spine_softening * (1 - silicone)
        elif element + col.BEND in q.layout.follows:
            continue
        else:
            axial, lateral, bend = q.body_modulus * area, ratio * q.body_modulus * area, q.bending * q.body_modulus * second
            soft = np.ones((1, 1))
        out[element + col.BEND] = bend
        out[element + col.STRETCH] = lateral
        out[element + col.STRETCH + 2] = q.stretching * axial
        out[element + col.SERIES] = soft * softening
        out[element + col.SERIES + 1] = soft * q.strain_softening


def with_spine(q: Quantities, of_spine: SpineModuli, area: float, second: float) -> tuple[Array, Array, Array]:
    """Bending (N m^2), axial and lateral stiffness (N), (v, n) of v variants of n states, of a section of the body (m^2, m^4)
    with the spine, if the robot has one.

    The paper gives the body's section one modulus, mixed by volume (`area_moments` = 0); with `area_moments` = 1 body and spine
    have their own areas and moments, and a sliding spine takes less of the stretch (`spine_sliding`).
    """
    body, ratio = q.body_modulus, q.robot.shear_modulus / q.robot.youngs_modulus
    if q.robot.spine is None:
        return body * second, body * area, ratio * body * area
    spine, spine_shear, _ = of_spine
    spine_area = math.pi * q.robot.spine.radius**2
    spine_second = annulus_second_moment(q.robot.spine.radius)
    modulus = (area * body + spine_area * spine) / (area + spine_area)
    sideways = (area * ratio * body + spine_area * spine_shear) / (area + spine_area)

    def between(mixed: Array, apart: Array) -> Array:
        return mixed + q.area_moments * (apart - mixed)

    bend = between(modulus * second, body * second + spine * spine_second)
    axial = between(modulus * area, body * area + (1 - q.spine_sliding) * spine * spine_area)
    lateral = between(sideways * area, ratio * body * area + spine_shear * spine_area)
    return bend, axial, lateral


def silicone_share(q: Quantities, area: float, second: float, bend: Array) -> Array:
    """(v, n) share of the bending stiffness `bend` (N m^2) of a section with spine that is the silicone's.

    Mixed by volume, silicone brings in its share of the volume; as a composite all of itself.
    """
    if q.robot.spine is None:
        return np.ones((1, 1))
    volume = area / (area + math.pi * q.robot.spine.radius**2)
    return np.asarray((volume + q.area_moments * (1 - volume)) * q.body_modulus * second / bend)


def _actuation(q: Quantities, out: RodColumns) -> None:
    """Force P A e3 and moment of the actuators at the tip (eq. 4), and what sections elsewhere have more or less of either.

    The rod carries force and moment of the tip's section all along; what another section has more or less of either is a rest
    strain or a rest curvature there. So it is where chambers are wider or farther off the axis than at the tip, or end, and for
    all that tendons do: the guides they press on keep their pull along the arc.

    Gas in a bent chamber also presses on its longer outer wall, with P A kappa per length, away from the centre of the bend.
    Where the body takes that up (share w = `thrust_on_walls`), the gas in any part of it pushes with P A e3(s) at its ends: each
    section is stretched along its own tangent and bent about its own axes, as by a rest strain w P A / EA and a rest curvature
    w m / EI, and neither thrust nor moment at the tip does it: a body bent sideways is then twisted by what hangs from it, as
    m' = -p' x n has it of external loads alone. Share b (`thrust_borne`) of the stretch is missing.
    """
    push = q.pressure * q.area_factor
    azimuth = q.azimuth + (q.twist * q.length * (1 + q.twist_growth))[..., None]  # at the tip
    unit_moments = (np.sin(azimuth) - 1j * np.cos(azimuth)) * (q.lever[..., None] * q.body.levers)
    force, moment = _wrench(push, unit_moments, q.body.tip_area, q.body.path_radius[-1])
    out[col.TIP_FORCE + 2] = (1 - q.thrust_on_walls) * force
    at_tip = (1 - q.thrust_on_walls) * moment
    out[col.TIP_MOMENT], out[col.TIP_MOMENT + 1] = at_tip.real, at_tip.imag
    uneven = bool((q.body.chamber_area != q.body.tip_area).any() or np.ptp(q.body.path_radius))
    if not (uneven or q.twist.any() or q.thrust_on_walls.any()):
        return
    own = [_wrench(push, unit_moments, a, r) for a, r in zip(q.body.chamber_area, q.body.path_radius, strict=True)]
    if uneven or q.thrust_on_walls.any():
        for element, piece in zip(q.layout.elements, q.layout.pieces, strict=True):
            stretching = (1 - q.thrust_on_walls * q.thrust_borne) * own[piece][0] - (1 - q.thrust_on_walls) * force
            out[element + col.ACTIVE + 2] = stretching / out[element + col.STRETCH + 2]
    _rest_of_moments(q, out, [m for _, m in own], at_tip)


def _rest_of_moments(q: Quantities, out: RodColumns, moments: Sequence[Complex], at_tip: Complex) -> None:
    """Make (m(s) - `at_tip`) / EI the actuators' rest curvature, m the actuators' moment (x + i y, N m) at s.

    With azimuth az + c s (1 + g s / L), m(s) is the moment of the piece (`moments`, as if aligned like at the tip) turned back by
    what the chambers wind from s to L, times 1 + w h (3 (s / L)^2 - 1), h = `thrust_growth`; to third order in s over an element.
    A cut across the body meets the pressure at right angles however the chambers lean, so there is no torque.
    """
    uneven = q.thrust_on_walls * q.thrust_growth
    bottom = np.zeros((1, 1))  # m, arc length at which the element begins
    for element, piece in zip(q.layout.elements, q.layout.pieces, strict=True):
        length = out[element + col.LENGTH]
        growth = q.twist_growth / q.length
        a0 = q.twist * (bottom * (1 + growth * bottom) - q.length * (1 + q.twist_growth))
        a1, a2 = q.twist * length * (1 + 2 * growth * bottom), q.twist * growth * length**2
        bend = out[element + col.BEND]
        # exp(i (a0 + a1 x + a2 x^2)) about a0, times b0 + b1 x + b2 x^2, to third order in x = 0..1 along the element
        curvature = np.exp(1j * a0) * moments[piece] / bend
        c1, c2, c3 = 1j * a1, 1j * a2 - a1**2 / 2, -a1 * a2 - 1j * a1**3 / 6
        b0, b1, b2 = (1 + uneven * (3 * (bottom / q.length) ** 2 - 1), uneven * 6 * bottom * length / q.length**2,
                      uneven * 3 * (length / q.length) ** 2)  # fmt: skip
        powers = (
            curvature * b0 - at_tip / bend,
            curvature * (b0 * c1 + b1),
            curvature * (b0 * c2 + b1 * c1 + b2),
            curvature * (b0 * c3 + b1 * c2 + b2 * c1),
        )
        for power, rise in enumerate(powers):
            out[element + col.ACTIVE + 3 * power], out[element + col.ACTIVE + 3 * power + 1] = rise.real, rise.imag
        bottom = bottom + length


def _wrench(push: Array, unit_moments: Complex, area: Array, path_radius: float) -> tuple[Array, Complex]:
    """Force (v, n) N and moment x + i y (v, n) N m of pressures times area factors (v, n, actuators) on areas, m^2;
    `unit_moments` are those of a unit force at a unit distance."""
    pushes = push * area
    return pushes.sum(axis=-1), path_radius * (unit_moments * pushes).sum(axis=-1)


def _loads(q: Quantities, out: RodColumns) -> None:
    """Dead loads, and the four springs at the tip: two of the tether, the obstacle and the payload."""
    for k in range(3):
        gravity = q.gravity[..., k]
        of_mass = q.design.tip_mass * gravity * (q.robot.tip_mass_place == 0)
        out[col.DEAD_FORCE + k] = of_mass + q.design.force[:, k] + q.tip_force[..., k]
        out[col.DEAD_MOMENT + k] = q.design.moment[:, k] + q.tip_moment[..., k]
        for element, piece in zip(q.layout.elements, q.layout.pieces, strict=True):
            if element + col.LOAD + k not in q.layout.follows:
                out[element + col.LOAD + k] = q.density * q.body.weight_area[piece] * gravity
    for j in range(2):
        spring = at.SPRINGS + j * at.SPRING_WIDTH
        out[spring + j] = 1.0
        out[spring + col.SPRING_STIFFNESS] = q.tether
    _obstacle(q, out)
    _payload(q, out)


def _obstacle(q: Quantities, out: RodColumns) -> None:
    """A plane that pushes on the body at arc length b = `plane_lever` before the tip: a one-sided spring with an arm.

    The arm a (m, tip frame) leads from that point to the tip. From the tip back the axis turns from it by t (complex, x, y) and
    goes aside by y: t' = k + F y / EI, y' = t, with the curvature k = M / EI + u* of the moment M in each section, the thrust F
    at the tip, lengths stretched by 1 + F / EA + v*. So, to second order in t (Simpson's rule),
        a_side = int t (1 - |t|^2 / 6) ds,     a_axis = int (1 - |t|^2 / 2) ds.
    """
    wall = at.SPRINGS + 2 * at.SPRING_WIDTH
    out[wall], out[wall + 1] = q.plane_direction
    out[wall + col.SPRING_STIFFNESS] = q.plane_stiffness
    out[wall + col.SPRING_ORIGIN] = q.plane_distance
    # skin and mounting give a little
    out[wall + col.SPRING_SOFTNESS] = q.robot.length / 200
    if not q.plane_lever.any():
        return
    thrust, left, axis, turn, aside = out[col.TIP_FORCE + 2], q.plane_lever, ZERO, ZERO * 1j, ZERO * 1j
    for element in reversed(q.layout.elements):
        rest = [sum(out[element + c + k] for c in range(col.ACTIVE, col.BLOCK, 3)) for k in range(2)]
        bend = out[element + col.BEND]
        curvature = 1j * (out[col.TIP_MOMENT] / bend + rest[0]) - (out[col.TIP_MOMENT + 1] / bend + rest[1])
        curvature = curvature + thrust / bend * aside
        here = np.clip(left, 0.0, out[element + col.LENGTH] if element != q.layout.elements[0] else np.inf)
        step = here * (1 + thrust / out[element + col.STRETCH + 2] + out[element + col.ACTIVE + 2])
        x = thrust / bend * step**2
        odd = step * (1 + x / 6 + x**2 / 120)
        end = turn * (1 + x / 2 + x**2 / 24) + curvature * odd
        aside = aside + turn * odd + curvature * step**2 * (1 / 2 + x / 24 + x**2 / 720)
        for t, weight in ((turn, 1 / 6), ((turn + end) / 2, 4 / 6), (end, 1 / 6)):
            aside = aside - weight * step * t * np.abs(t) ** 2 / 6
            axis = axis + weight * step * (1 - np.abs(t) ** 2 / 2)
        turn, left = end, left - here
    for k, arm in enumerate((np.real(aside), np.imag(aside), axis), wall + col.SPRING_ARM):
        out[k] = arm


def _payload(q: Quantities, out: RodColumns) -> None:
    """Weight m g of `payload` at `payload_place` (m, tip frame), whose moment about the tip turns with the tip, and of the mass
    of the states where it hangs beyond the tip: both at their common centre.

    Dead forces have no arm, springs have: one of stiffness m g / FAR_AWAY whose origin lies FAR_AWAY (m) down from the base pulls
    with -k (e . p - FAR_AWAY) e, which is m g e for e along gravity, wherever its point p is.
    """
    spring = at.SPRINGS + 3 * at.SPRING_WIDTH
    g = np.linalg.norm(q.gravity, axis=-1)
    down = np.where(g[..., None] > 0, q.gravity / np.maximum(g, 1e-30)[..., None], [0.0, 0.0, 1.0])
    hung = q.design.tip_mass * (q.robot.tip_mass_place != 0)
    mass = q.payload + hung
    share = np.where(hung == 0, 1.0, q.payload / np.where(mass == 0, 1.0, mass))
    for k, place in enumerate((0.0, 0.0, q.robot.tip_mass_place)):
        out[spring + k] = down[..., k]
        # from the point that is pulled to the tip
        out[spring + col.SPRING_ARM + k] = -(share * q.payload_place[..., k] + (1 - share) * place)
    out[spring + col.SPRING_STIFFNESS] = mass * g / FAR_AWAY
    out[spring + col.SPRING_ORIGIN] = FAR_AWAY


def _boundary(q: Quantities, out: RodColumns) -> None:
    """The base, and rest curvature that is linear along the arc: u*(s) = u* (1 + growth (2 s / L - 1))."""
    for k in range(3):
        out[col.BASE_TURN + k] = q.base_turn[..., k]
    out[col.BASE_COMPLIANCE] = q.base_compliance
    out[col.BASE_RELIEF] = q.base_relief
    out[col.BASE_STIFFENING] = q.base_stiffening
    if not q.rest_curvature.any():
        return
    begin = np.zeros((1, 1))  # arc length m at which the element begins
    for element in q.layout.elements:
        length = out[element + col.LENGTH]
        for k in range(3):
            factor_at_begin = 1 + q.rest_growth * (2 * begin / q.length - 1)
            out.add(element + col.REST_CURVATURE + k, q.rest_curvature[..., k] * factor_at_begin)
            out.add(element + col.RISE + k, q.rest_curvature[..., k] * q.rest_growth * 2 * length / q.length)
        begin = begin + length
