"""The one place where the forward model asks for equilibria: rows in, results and their derivatives out.

Another solver takes over by offering `solve` and `differentiate` on rows laid out as in `layout`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.effects import layout as at
from model.effects.shooting import sensitivities, solve_rows

Array = NDArray[np.float64]

STEP = 0.03
"""m, longest Runge-Kutta step: keeps a 0.4 m rod within 0.01 mm up to a bend of two radians."""
PROBE = 1e-3
"""Share of a direction by which a pass is probed; directions are a prior width long, so this is small in all units."""


@dataclass(frozen=True)
class Solved:
    """Equilibria of n rows."""

    rows: Array
    arcs: Array
    steps: NDArray[np.int64]
    result: Array
    """(n, columns) as in `layout`; NaN where no equilibrium was found."""
    ok: NDArray[np.bool_]
    unknowns: Array
    """(n, 7) tip quaternion and position: where a solve nearby starts."""
    slopes: Array
    """(n, 6, columns + 6) derivatives of a pass by the unknowns."""
    sprung: bool

    def take(self, keep: slice) -> Solved:
        """Some of the rows."""
        return Solved(
            self.rows[keep],
            self.arcs,
            self.steps[keep],
            self.result[keep],
            self.ok[keep],
            self.unknowns[keep],
            self.slopes[keep],
            self.sprung,
        )


def integration_steps(rows: Array) -> NDArray[np.int64]:
    """(n, 2) Runge-Kutta steps of the elements of nominal rows.

    They stay the same while parameters change, so that results are smooth in the parameters.
    """
    length = rows[:, [at.ELEMENTS + at.LENGTH, at.ELEMENTS + at.ELEMENT_WIDTH + at.LENGTH]]
    return np.maximum(1, np.ceil(length / STEP - 1e-6)).astype(np.int64)


def solve(
    rows: Array, arcs: Array, steps: NDArray[np.int64], start: Array | None = None, sprung: bool = False
) -> Solved:
    """Solve rows (n, WIDTH); `arcs` (k,) m get positions, `start` (n, 7) is where to begin.

    `sprung` keeps the springs at the tip among the unknowns although they have no stiffness, which a later
    derivative by their stiffness needs.
    """
    n, wide = len(rows), at.MARKERS + 3 * len(arcs)
    out, slopes, unknowns = np.zeros((n, wide + 6)), np.zeros((n, 6, wide + 6)), np.zeros((n, 7))
    springs = rows[:, at.SPRINGS : at.ELEMENTS].reshape(n, at.SPRING_COUNT, at.SPRING_WIDTH)
    held = sprung or bool(springs[..., at.SPRING_STIFFNESS].any())
    warm = start is not None
    given: Array = np.zeros((n, 7)) if start is None else np.ascontiguousarray(start)
    ok = solve_rows(np.ascontiguousarray(rows), held, arcs, steps, given, warm, out, slopes, unknowns)
    return Solved(rows, arcs, steps, out[:, :wide], ok, unknowns, slopes, held)


def differentiate(solved: Solved, directions: Array) -> Array:
    """(p, n, columns) change of the results along `directions` (p, n, WIDTH)."""
    out = np.zeros((len(directions), *solved.result.shape))
    sensitivities(
        np.ascontiguousarray(solved.rows), solved.sprung, solved.arcs, solved.steps, solved.unknowns, solved.slopes,
        np.ascontiguousarray(directions), PROBE, out,
    )  # fmt: skip
    return out
