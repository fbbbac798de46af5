"""What a solved rod does between base and tip: position, orientation, internal wrench and stored energy."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from model.errors import BadCondition
from model.statics.algebra import Vector, dot, times, turned, turned_back
from model.statics.equations import softened
from model.statics.group import AT_LARGEST, AT_ORIENTATION, AT_TIP, new_elements
from model.statics.jit import inline, kernel, routine
from model.statics.lanes import (
    ELEMENT,
    HELD,
    LANES,
    LARGEST,
    TIP,
    Counts,
    M,
    N,
    R,
    cut,
    fixed_cut,
    gather_elements,
    gather_ends,
    new_work,
    vector_of,
)
from model.statics.passes import advance_alone, pull, set_tip, unit_quaternion
from model.statics.problem import Rods
from model.statics.solver import DEFAULT, Accuracy, Solution, Steps, room_for_terms, steps_of

Array = NDArray[np.float64]

PLACE, TURN, FORCE, MOMENT, ENERGY, STRETCH = 0, 3, 7, 10, 13, 14
WIDTH = 15
STATE = 14
"""Quantities of the state, copied while a station inside a step is visited."""
GAUSS = 8
"""Points an element for the energy and the mean strain."""


@dataclass(frozen=True)
class Stations:
    """k stations of n rods, mount frame; NaN where the rod was not solved."""

    values: Array
    """(n, k, WIDTH)."""

    @property
    def position(self) -> Array:
        """(n, k, 3) m."""
        return self.values[..., PLACE : PLACE + 3]

    @property
    def orientation(self) -> Array:
        """(n, k, 4) unit quaternion w, x, y, z of the section frame."""
        return self.values[..., TURN : TURN + 4]

    @property
    def force(self) -> Array:
        """(n, k, 3) N, internal force."""
        return self.values[..., FORCE : FORCE + 3]

    @property
    def moment(self) -> Array:
        """(n, k, 3) N m, internal moment."""
        return self.values[..., MOMENT : MOMENT + 3]

    @property
    def energy_density(self) -> Array:
        """(n, k) J/m stored in the section."""
        return self.values[..., ENERGY]

    @property
    def strain(self) -> Array:
        """(n, k) 1: axial strain v3 - 1."""
        return self.values[..., STRETCH]


def stations(
    rods: Rods,
    solution: Solution,
    arc_lengths: ArrayLike,
    accuracy: Accuracy = DEFAULT,
    steps: Steps | None = None,
) -> Stations:
    """The rods at arc lengths (k,) or (n, k) in m from the base; one pass a rod, nothing is solved."""
    form, arcs = rods.form, arcs_of(rods, arc_lengths)
    out = np.full((*arcs.shape, WIDTH), np.nan)
    walk(
        rods.values,
        form.head,
        form.block,
        *room_for_terms(form),
        form.springs,
        accuracy.divisions,
        steps_of(rods, steps),
        solution.values,
        arcs,
        out,
    )
    out[~solution.ok] = np.nan
    return Stations(out)


def arcs_of(rods: Rods, arc_lengths: ArrayLike) -> Array:
    """(n, k) m: arc lengths (k,) or (n, k) for every rod; raises `BadCondition` for those that are not on it."""
    n = len(rods)
    arcs = np.atleast_1d(np.asarray(arc_lengths, dtype=np.float64))
    arcs = np.broadcast_to(arcs, (n, arcs.shape[-1]))
    beyond = (arcs < 0) | (arcs > rods.whole_length[:, None] * (1 + 1e-9)) | ~np.isfinite(arcs)
    if beyond.any():
        i, j = (int(x) for x in np.argwhere(beyond)[0])
        raise BadCondition(
            f"arc_lengths: {arcs[i, j]:g} m of rod {i} must lie between 0 and its length {rods.whole_length[i]:g} m"
        )
    return np.ascontiguousarray(arcs)


def energy(rods: Rods, solution: Solution, accuracy: Accuracy = DEFAULT) -> Array:
    """(n,) J stored by bending, shear and stretch, by Gauss's rule over each element."""
    found, weights = _at_points(rods, solution, accuracy)
    return np.asarray(np.einsum("nek,ne,k->n", found[..., ENERGY], rods.field("length"), weights))


def strains(rods: Rods, solution: Solution, accuracy: Accuracy = DEFAULT, steps: Steps | None = None) -> Array:
    """(n, elements) mean axial strain v3 - 1 of each element, by Gauss's rule."""
    found, weights = _at_points(rods, solution, accuracy, steps)
    return np.asarray(found[..., STRETCH] @ weights)


def gauss_points(rods: Rods, points: int = GAUSS) -> tuple[Array, Array]:
    """Arc lengths (n, elements points) in m, element by element, and weights (points,), of sum 1, of Gauss's rule."""
    places, weights = np.polynomial.legendre.leggauss(points)
    length = rods.field("length")
    ends = np.cumsum(length, axis=1)
    arcs = (ends - length)[:, :, None] + length[:, :, None] * (0.5 * (1 + places))
    return np.minimum(arcs, ends[:, -1:, None]).reshape(len(rods), length.shape[1] * points), 0.5 * weights


def _at_points(rods: Rods, solution: Solution, accuracy: Accuracy, steps: Steps | None = None) -> tuple[Array, Array]:
    """Stations (n, elements, points, WIDTH) at Gauss's points and their weights."""
    arcs, weights = gauss_points(rods)
    found = stations(rods, solution, arcs, accuracy, steps)
    return found.values.reshape(len(rods), rods.form.elements, GAUSS, WIDTH), weights


@routine
def write_station(
    work: Array, elements: Array, series: Array | None, e: int, solved: Array, row: int, out: Array, s: int
) -> None:
    """The state of lane 0 as station s of a rod."""
    q = unit_quaternion(work, 0)
    back = turned(q, vector_of(work, R, 0))
    force, m = vector_of(work, N, 0), vector_of(work, M, 0)
    moment = turned(q, m)
    out[row, s, TURN], out[row, s, TURN + 1], out[row, s, TURN + 2], out[row, s, TURN + 3] = q
    for k in range(3):
        out[row, s, FORCE + k] = work[(N + k) * LANES]
    out[row, s, PLACE] = solved[row, AT_TIP] - back[0]
    out[row, s, PLACE + 1] = solved[row, AT_TIP + 1] - back[1]
    out[row, s, PLACE + 2] = solved[row, AT_TIP + 2] - back[2]
    out[row, s, MOMENT], out[row, s, MOMENT + 1], out[row, s, MOMENT + 2] = moment
    n = turned_back(q, force)
    o = e * ELEMENT
    flex, give = vector_of(elements, o + 1, 0), vector_of(elements, o + 4, 0)
    u, v = times(flex, m), times(give, n)
    out[row, s, ENERGY] = stored(u, v, m, n, flex, give, series, e)
    strain = v[2]
    if series is not None:
        strain = softened(u, m, v[2], flex, give, vector_of(series, 3 * e, 0))[1]
    out[row, s, STRETCH] = strain + elements[(o + 12) * LANES] - 1.0


@inline
def stored(
    u: Vector, v: Vector, m: Vector, n: Vector, flex: Vector, give: Vector, series: Array | None, e: int
) -> float:
    """Energy per length (J/m) of a section with linear strains u, v under m, n; see `equations` for the terms."""
    if series is None:
        return 0.5 * (dot(u, m) + dot(v, n))
    terms = vector_of(series, 3 * e, 0)
    stiffer, strain = softened(u, m, v[2], flex, give, terms)
    bent = (m[0] * u[0] + m[1] * u[1]) / (stiffer * stiffer)
    x = terms[0] * bent * math.sqrt(flex[0] * flex[1])
    # The integral of g over x is half of x^2, or for a section that softens -x / 2 - ln(1 - 2 x) / 4.
    level = 0.5 * x if x >= 0.0 else -0.5 - 0.25 * math.log(1.0 - 2.0 * x) / x
    y, z = terms[1] * strain, terms[2] * strain
    bending = 0.5 * bent * (1.0 + level + y / (1.0 - min(y, 0.0)))
    # Next to nothing the integral of e / (1 - c e) would lose its digits.
    grown = 1.0 + z * (2.0 / 3.0 + 0.5 * min(z, 0.0)) if z > -1e-3 else -2.0 * (z + math.log(1.0 - z)) / (z * z)
    stretching = 0.5 * strain * strain * grown / give[2]
    return bending + stretching + 0.5 * (u[2] * m[2] + v[0] * n[0] + v[1] * n[1])


@kernel
def walk(
    rods: Array,
    head: int,
    block: int,
    rises: Array | None,
    series: Array | None,
    springs: int,
    divisions: float,
    steps: Counts,
    solved: Array,
    arcs: Array,
    out: Array,
) -> None:
    """Fill `out` (n, k, WIDTH) at arcs (n, k)."""
    work = new_work()
    parts = np.empty((rods.shape[1] - head) // block, np.int64)
    elements = new_elements(parts.size)
    kept = np.empty(STATE)
    for row in range(rods.shape[0]):
        gather_ends(rods, row, head, block, work, 0)
        gather_elements(rods, row, head, block, elements, rises, series, 0)
        work[LARGEST * LANES] = solved[row, AT_LARGEST]
        cut(work, elements, parts, divisions, 1)
        if steps.shape[0] > 0:
            fixed_cut(steps, row, parts, 1)
            for e in range(parts.size):
                parts[e] = parts[e] if elements[e * ELEMENT * LANES] > 0.0 else 0
        for k in range(4):
            work[(TIP + k) * LANES] = solved[row, AT_ORIENTATION + k]
        for k in range(3):
            work[(HELD + k) * LANES] = solved[row, AT_TIP + k]
        set_tip(work, 1.0, 1)
        pull(work, springs, 1)
        top = 0.0
        outermost, innermost = parts.size, -1  # of the elements that have a length
        for e in range(parts.size):
            top += elements[e * ELEMENT * LANES]
            if parts[e] > 0:
                outermost, innermost = min(outermost, e), e
        for e in range(parts.size):
            length = elements[e * ELEMENT * LANES]
            for j in range(parts[e]):
                dz = -1.0 / parts[e]
                z = 1.0 + j * dz
                start = top - j * length / parts[e]
                # The same expressions as the next step's start, or an arc length could fall between two steps.
                end = top - (j + 1) * length / parts[e] if j + 1 < parts[e] else top - length
                last = e == innermost and j == parts[e] - 1
                for k in range(STATE):
                    kept[k] = work[k * LANES]
                for s in range(arcs.shape[1]):
                    arc = arcs[row, s]
                    # A station on a boundary belongs to the element towards the base, the tip to the outermost one.
                    if (end < arc <= start) or (last and arc <= end) or (e == outermost and j == 0 and arc > start):
                        partial = dz * min(1.0, max(0.0, (start - arc) / (start - end)))
                        advance_alone(work, elements, rises, series, e, z, partial, 0, 1.0)
                        write_station(work, elements, series, e, solved, row, out, s)
                        for k in range(STATE):
                            work[k * LANES] = kept[k]
                advance_alone(work, elements, rises, series, e, z, dz, 0, 1.0)
            top -= length
