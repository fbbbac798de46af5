"""The one place where the forward model asks for equilibria: rows in, results and their derivatives out.

Another solver takes over by offering `solve` and `differentiate` on rows laid out as in `layout`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.effects.shooting import layout as at
from model.effects.shooting import sensitivities, solve_rows

Array = NDArray[np.float64]

DIVISIONS = 5.0
"""Integration steps along a whole rod: keeps one of 0.4 m within 0.01 mm up to a bend of two radians."""
PROBE = 1e-6
"""Share of a direction by which a pass is probed; directions are a prior width long, so this is small in all units."""


@dataclass(frozen=True)
class Solved:
    """Equilibria of n rows."""

    rows: Array
    arcs: Array
    steps: NDArray[np.int64]
    shot: Array
    """(n, columns + 6) results and, behind them, what is left of the misses; NaN where no equilibrium was found."""
    ok: NDArray[np.bool_]
    unknowns: Array
    """(n, 43) quaternion and position of the tip and the Jacobian of the misses: where a solve nearby starts."""

    @property
    def result(self) -> Array:
        """(n, columns) as in `layout`."""
        return self.shot[:, :-6]

    def take(self, keep: slice) -> Solved:
        """Some of the rows."""
        return Solved(self.rows[keep], self.arcs, self.steps[keep], self.shot[keep], self.ok[keep], self.unknowns[keep])


def integration_steps(rows: Array) -> NDArray[np.int64]:
    """(n, 2) integration steps of the elements of nominal rows.

    They stay the same while parameters change, so that results are smooth in the parameters.
    """
    length = rows[:, [at.ELEMENTS + at.LENGTH, at.ELEMENTS + at.ELEMENT_WIDTH + at.LENGTH]]
    share = length / length.sum(axis=1, keepdims=True)
    return np.maximum(1, np.ceil(DIVISIONS * share - 1e-6)).astype(np.int64)


def solve(rows: Array, arcs: Array, steps: NDArray[np.int64], start: Array | None = None) -> Solved:
    """Solve rows (n, WIDTH); `arcs` (k,) m get positions, `start` is `unknowns` of a solution nearby."""
    n = len(rows)
    shot, unknowns = np.zeros((n, at.MARKERS + 3 * len(arcs) + 6)), np.zeros((n, 43))
    given: Array = unknowns if start is None else np.ascontiguousarray(start)
    kept = np.ascontiguousarray(rows)
    ok = solve_rows(kept, arcs, steps, given.copy(), start is not None, shot, unknowns)
    return Solved(kept, arcs, steps, shot, ok, unknowns)


def differentiate(solved: Solved, directions: Array) -> Array:
    """(p, n, columns) change of the results along `directions` (p, n, WIDTH)."""
    out = np.zeros((len(directions), *solved.result.shape))
    along = np.ascontiguousarray(directions)
    sensitivities(solved.rows, solved.arcs, solved.steps, solved.shot, solved.unknowns, along, PROBE, out)
    return out


def straight(length: float) -> Array:
    """(43,) where to begin with a rod of which nothing is known."""
    return np.concatenate([[1.0, 0.0, 0.0, 0.0, 0.0, 0.0, length], np.eye(6).ravel()])
