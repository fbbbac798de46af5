"""Rods without memory, solved in the plainest form that holds them: springs and graded sections cost most of the time of a
solve, and are no burden to derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model import rods as rod
from model.effects import layout as at
from model.effects.compose import directions
from model.effects.solver import DIVISIONS, METHOD, full_rods, integration_steps
from model.rods.columns import BLOCK, HEAD
from model.rotation import from_vector, multiply

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Equilibria:
    """Solved rods, and their rows in the full layout."""

    layout: at.Layout
    rods: rod.Rods
    rows: Array
    """(n, layout.width)."""
    method: rod.Fast
    solution: rod.Solution

    def result(self, arcs: Array) -> Array:
        """(n, columns) as `layout` has them; base, spine's end and strains are NaN."""
        n = len(self.rods)
        out = np.full((n, at.MARKERS + 3 * len(arcs)), np.nan)
        out[:, at.TIP : at.TIP + 3] = self.solution.tip
        out[:, at.ORIENTATION : at.ORIENTATION + 4] = self.solution.orientation
        if len(arcs):
            found = rod.stations(self.rods, self.solution, self._places(arcs), self.method)
            out[:, at.MARKERS :] = found.position.reshape(n, 3 * len(arcs))
        return out

    def motion(self, arcs: Array, changed: Sequence[int], change: Array) -> Array:
        """(v, n, 6 + 3 k) shift and turn of the tip and shift of the arc lengths per unit of each of v inputs.

        `change` (n, v, a): by how much the columns `changed` grow with an input.
        """
        n = len(self.rods)
        if not changed:
            return np.zeros((change.shape[1], n, 6 + 3 * len(arcs)))
        along, places = directions(self.layout, changed)[None], self._places(arcs)
        # In the full form also where the rods have a plainer one: one kind of derivative to compile.
        d = rod.sensitivities(full_rods(self.layout, self.rows), self.solution, along, self.method, arc_lengths=places)
        marked = d.position.reshape(n, len(changed), 3 * len(arcs))
        return np.asarray((change @ np.concatenate([d.tip, d.rotation, marked], axis=-1)).swapaxes(0, 1))

    def _places(self, arcs: Array) -> Array:
        return np.minimum(arcs[None, :], self.rods.whole_length[:, None])


def solved(layout: at.Layout, rows: Array) -> Equilibria:
    """Solve rows (n, layout.width)."""
    used = set(np.flatnonzero(rows.any(axis=0)).tolist())
    stiffness = {at.SPRINGS + k * at.SPRING_WIDTH + at.SPRING_STIFFNESS for k in range(at.SPRING_COUNT)}
    # Columns of hyperelastic and graded sections.
    further = {element + k for element in layout.elements for k in range(at.SERIES, BLOCK)}
    springs, full = bool(used & stiffness), bool(used & further)
    form = rod.Form(layout.form.elements, at.SPRING_COUNT if springs else 0, full)
    dropped = {*(() if springs else range(HEAD, at.ELEMENTS)), *(() if full else further)}
    kept = np.array([k for k in range(layout.width) if k not in dropped])
    rods = rod.Rods(form, np.ascontiguousarray(rows[:, kept]))
    rods.field("rest_strain")[..., 2] += 1.0
    method = rod.Fast(DIVISIONS, METHOD.close, steps=integration_steps(layout, rows))
    return Equilibria(layout, rods, rows, method, rod.solve(rods, method))


def moved_by(result: Array, motion: Array) -> Array:
    """(v, n, columns) results (n, columns) moved by motions (v, n, 6 + 3 k), m and rad."""
    out = np.repeat(result[None], len(motion), axis=0)
    out[..., at.TIP : at.TIP + 3] += motion[..., :3]
    turned = multiply(
        from_vector(motion[..., 3:6]),
        np.broadcast_to(result[:, at.ORIENTATION : at.ORIENTATION + 4], (*motion.shape[:2], 4)),
    )
    out[..., at.ORIENTATION : at.ORIENTATION + 4] = turned
    out[..., at.MARKERS :] += motion[..., 6:]
    return out
