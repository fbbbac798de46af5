"""The one place where the forward model asks for equilibria: rows in, results and their derivatives out.

Rows and columns of results are laid out as in `layout`; the work is done by `model.rods`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from model import rods as rod
from model.effects import layout as at
from model.rotation import multiply

Array = NDArray[np.float64]
Steps = NDArray[np.int64]

DIVISIONS = 5.0
"""Integration steps along a whole rod: keeps one of 0.4 m within 0.01 mm up to a bend of two radians."""
METHOD = rod.Fast(divisions=DIVISIONS, close=1e-10, remember=True)
STRAIN_POINTS = 3
"""An element; strains change little along it."""
NEAR_MARGIN = 0.02
"""Margin to buckling with which a solution is trusted that began at a trusted one close by."""
FAR = math.cos(0.5 * 0.8)
"""Cosine of half the angle (0.8 rad) by which its tip may have turned since."""


@dataclass(frozen=True)
class Solved:
    """Equilibria of n rows."""

    rows: Array
    """(n, WIDTH)."""
    arcs: Array
    """(k,) m."""
    steps: Steps
    solution: rod.Solution
    """Where a solve nearby starts."""
    result: Array
    """(n, columns); NaN where no equilibrium was found."""
    inside: bool
    """Whether the result tells of base, spine's end and strains; else these are NaN, and cost nothing."""

    @property
    def converged(self) -> NDArray[np.bool_]:
        """(n,) see `Solution.converged`."""
        return self.solution.converged

    def take(self, keep: slice) -> Solved:
        """Some of the rows, of which no more is asked than tip and markers."""
        part = self.solution.take(keep)
        return Solved(self.rows[keep], self.arcs, self.steps[keep], part, self.result[keep], False)


def integration_steps(rows: Array) -> Steps:
    """(n, 2) integration steps of the elements of nominal rows.

    They stay the same while parameters change, so that results are smooth in the parameters.
    """
    length = rows[:, [at.ELEMENTS + at.LENGTH, at.ELEMENTS + at.ELEMENT_WIDTH + at.LENGTH]]
    share = length / length.sum(axis=1, keepdims=True)
    return np.maximum(1, np.ceil(DIVISIONS * share - 1e-6)).astype(np.int64)


def solve(rows: Array, arcs: Array, steps: Steps, start: rod.Solution | None = None, inside: bool = True) -> Solved:
    """Solve rows (n, WIDTH); `arcs` (k,) m get positions, `start` is the solution of rows nearby."""
    rods = _rods(rows)
    method = replace(METHOD, steps=steps)
    solution = rod.solve(rods, method) if start is None else _go_on(rods, steps, start)
    result = np.full((len(rows), at.MARKERS + 3 * len(arcs)), np.nan)
    result[:, at.TIP : at.TIP + 3] = solution.tip
    result[:, at.ORIENTATION : at.ORIENTATION + 4] = solution.orientation
    if inside or len(arcs):
        places = _places(rods, arcs, base=True)
        marked = places.shape[1]
        if inside:  # in the same pass
            within, weights = rod.gauss_points(rods, STRAIN_POINTS)
            places = np.concatenate([places, within], axis=1)
        found = rod.stations(rods, solution, places, method)
        result[:, at.BASE : at.BASE + 4] = found.orientation[:, 0]
        result[:, at.JOINT : at.JOINT + 4] = found.orientation[:, 1]
        result[:, at.MARKERS :] = found.position[:, 2:marked].reshape(len(rows), 3 * len(arcs))
        if inside:
            strain = found.strain[:, marked:].reshape(len(rows), at.FORM.elements, STRAIN_POINTS)
            result[:, at.STRAIN : at.STRAIN + 2] = strain @ weights
    return Solved(rows, arcs, steps, solution, result, inside)


def _go_on(rods: rod.Rods, steps: Steps, start: rod.Solution) -> rod.Solution:
    """Solve from a solution close by; a tip that turned far may have snapped, and is solved from nothing."""
    found = rod.solve(rods, replace(METHOD, steps=steps, least_margin=NEAR_MARGIN), start=start)
    turned = np.abs(np.sum(found.orientation * start.orientation, axis=1)) < FAR
    if not turned.any():
        return found
    again = rod.solve(rods[turned], replace(METHOD, steps=steps[turned]))
    found.values[turned], found.memory[turned] = again.values, again.memory
    status = found.status.copy()
    status[turned] = again.status
    return replace(found, status=status)


def differentiate(solved: Solved, directions: Array) -> Array:
    """(p, n, columns) change of the results along `directions` (p, n, WIDTH)."""
    rods, result = _rods(solved.rows), solved.result
    along = np.ascontiguousarray(directions.transpose(1, 0, 2))
    places = _places(rods, solved.arcs, base=False)
    method = replace(METHOD, steps=solved.steps)
    d = rod.sensitivities(rods, solved.solution, along, method, arc_lengths=places, strain=solved.inside, attached=1)
    out = np.full((len(directions), *result.shape), np.nan)
    out[..., at.TIP : at.TIP + 3] = d.tip.swapaxes(0, 1)
    for column, turn in ((at.ORIENTATION, d.rotation), (at.JOINT, d.turn[:, :, 0]), (at.BASE, d.base_rotation)):
        out[..., column : column + 4] = _turned(result[:, column : column + 4], turn.swapaxes(0, 1))
    if solved.inside:
        out[..., at.STRAIN : at.STRAIN + 2] = d.strain.swapaxes(0, 1)
    out[..., at.MARKERS :] = d.position[:, :, 1:].swapaxes(0, 1).reshape(*out.shape[:2], 3 * len(solved.arcs))
    return out


def _turned(q: Array, turn: Array) -> Array:
    """Change of quaternions q (n, 4) with small turns (p, n, 3) from the left."""
    whole = np.concatenate([np.zeros((*turn.shape[:-1], 1)), 0.5 * turn], axis=-1)
    return multiply(whole, np.broadcast_to(q, whole.shape))


def _rods(rows: Array) -> rod.Rods:
    values = np.array(rows, order="C")
    for element in range(at.FORM.elements):
        values[:, at.ELEMENTS + element * at.ELEMENT_WIDTH + at.REST_STRAIN + 2] += 1.0
    return rod.Rods(at.FORM, values)


def _places(rods: rod.Rods, arcs: Array, base: bool) -> Array:
    """(n, 1 + k or 2 + k) m: the base, the spine's end and the arc lengths, these no farther than the tip."""
    inner = rods.field("length")[:, :1]
    given = np.minimum(arcs[None, :], rods.whole_length[:, None])
    return np.concatenate([np.zeros_like(inner), inner, given] if base else [inner, given], axis=1)
