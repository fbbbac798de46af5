"""The one place where the forward model asks for equilibria: rows in, results and their derivatives out.

Rows and columns of results are laid out as in `layout`; the work is done by `model.statics`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from model import statics
from model.effects import layout as at
from model.rotation import multiply

Array = NDArray[np.float64]
Steps = NDArray[np.int64]

DIVISIONS = 5.0
"""Integration steps along a whole rod: keeps one of 0.4 m within 0.01 mm up to a bend of two radians."""
ACCURACY = statics.Accuracy(divisions=DIVISIONS, close=1e-10)
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
    solution: statics.Solution
    """Where a solve nearby starts."""
    result: Array
    """(n, columns); NaN where no equilibrium was found."""
    inside: bool
    """Whether the result tells of base, spine's end and strains; else these are NaN, and cost nothing."""

    @property
    def ok(self) -> NDArray[np.bool_]:
        """(n,) which were solved."""
        return self.solution.ok

    def take(self, keep: slice) -> Solved:
        """Some of the rows, of which no more is asked than tip and markers."""
        s = self.solution
        part = statics.Solution(s.values[keep], s.status[keep], s.memory[keep])
        return Solved(self.rows[keep], self.arcs, self.steps[keep], part, self.result[keep], False)


def integration_steps(rows: Array) -> Steps:
    """(n, 2) integration steps of the elements of nominal rows.

    They stay the same while parameters change, so that results are smooth in the parameters.
    """
    length = rows[:, [at.ELEMENTS + at.LENGTH, at.ELEMENTS + at.ELEMENT_WIDTH + at.LENGTH]]
    share = length / length.sum(axis=1, keepdims=True)
    return np.maximum(1, np.ceil(DIVISIONS * share - 1e-6)).astype(np.int64)


def solve(rows: Array, arcs: Array, steps: Steps, start: statics.Solution | None = None, inside: bool = True) -> Solved:
    """Solve rows (n, WIDTH); `arcs` (k,) m get positions, `start` is the solution of rows nearby."""
    rods = _rods(rows)
    solution = (
        statics.solve(rods, ACCURACY, remember=True, steps=steps) if start is None else _go_on(rods, steps, start)
    )
    result = np.full((len(rows), at.MARKERS + 3 * len(arcs)), np.nan)
    result[:, at.TIP : at.TIP + 3] = solution.tip
    result[:, at.ORIENTATION : at.ORIENTATION + 4] = solution.orientation
    if inside or len(arcs):
        places = _places(rods, arcs, base=True)
        marked = places.shape[1]
        if inside:  # in the same pass
            within, weights = statics.gauss_points(rods, STRAIN_POINTS)
            places = np.concatenate([places, within], axis=1)
        found = statics.stations(rods, solution, places, ACCURACY, steps)
        result[:, at.BASE : at.BASE + 4] = found.orientation[:, 0]
        result[:, at.JOINT : at.JOINT + 4] = found.orientation[:, 1]
        result[:, at.MARKERS :] = found.position[:, 2:marked].reshape(len(rows), 3 * len(arcs))
        if inside:
            strain = found.strain[:, marked:].reshape(len(rows), at.FORM.elements, STRAIN_POINTS)
            result[:, at.STRAIN : at.STRAIN + 2] = strain @ weights
    return Solved(rows, arcs, steps, solution, result, inside)


def _go_on(rods: statics.Rods, steps: Steps, start: statics.Solution) -> statics.Solution:
    """Solve from a solution close by; a tip that turned far may have snapped, and is solved from nothing."""
    found = statics.solve(rods, ACCURACY, start=start, remember=True, steps=steps, least_margin=NEAR_MARGIN)
    turned = np.abs(np.sum(found.orientation * start.orientation, axis=1)) < FAR
    if not turned.any():
        return found
    again = statics.solve(rods[turned], ACCURACY, remember=True, steps=steps[turned])
    found.values[turned], found.memory[turned] = again.values, again.memory
    status = found.status.copy()
    status[turned] = again.status
    return replace(found, status=status)


def differentiate(solved: Solved, directions: Array) -> Array:
    """(p, n, columns) change of the results along `directions` (p, n, WIDTH)."""
    rods, result = _rods(solved.rows), solved.result
    along = np.ascontiguousarray(directions.transpose(1, 0, 2))
    places = _places(rods, solved.arcs, base=False)
    d = statics.sensitivities(
        rods, solved.solution, along, ACCURACY, arc_lengths=places, strain=solved.inside, attached=1, steps=solved.steps
    )
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


def _rods(rows: Array) -> statics.Rods:
    values = np.array(rows, order="C")
    for element in range(at.FORM.elements):
        values[:, at.ELEMENTS + element * at.ELEMENT_WIDTH + at.REST_STRAIN + 2] += 1.0
    return statics.Rods(at.FORM, values)


def _places(rods: statics.Rods, arcs: Array, base: bool) -> Array:
    """(n, 1 + k or 2 + k) m: the base, the spine's end and the arc lengths, these no farther than the tip."""
    inner = rods.field("length")[:, :1]
    given = np.minimum(arcs[None, :], rods.whole_length[:, None])
    return np.concatenate([np.zeros_like(inner), inner, given] if base else [inner, given], axis=1)
