"""The paper's own method: explicit Euler from the base, shooting on n(0) and m(0) from zeros (equations 1-7, 10).

Kept as it is on purpose, inexact integrator included: it shows how much of a published gap is the method's own. N
is the number of steps of length L / N; a step takes the element in which it starts. The rotation matrix is stepped like
everything else and drifts off orthogonality.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
import scipy

from model.arrays import Array
from model.errors import BadCondition
from model.rods.description import Rods
from model.rods.solution import Solution, Status, assembled

STRETCH, BEND, LOAD, REST = 0, 3, 6, 9
"""Columns of the sections: diagonal of K_se (N) and K_bt (N m^2), f (N/m), u* (1/m)."""


@dataclass(frozen=True)
class Paper:
    """Explicit Euler and fsolve. Converged means that fsolve closed eq. 7 to 1e-6 N and N m; buckling is not noticed.

    Raises `BadCondition` for springs, supports and hyperelastic or graded sections, which it does not know, for a start
    (it always starts from zeros), and for a number of steps out of range.
    """

    steps: int = 100
    """Steps along the rod. A usual choice for this method; the paper does not give its own."""

    def __post_init__(self) -> None:
        if not 2 <= self.steps <= 1_000_000:
            raise BadCondition(f"steps: {self.steps}, must be from 2 to 1000000")

    def solve(self, rods: Rods, arcs: Array | None = None, start: Solution | None = None) -> Solution:
        """See `model.rods.solver.solve`; positions between two steps are interpolated."""
        rods.refuse_terms("Paper")
        if start is not None:
            raise BadCondition("start: the method Paper starts from zeros; leave it out")
        n = len(rods)
        tip, orientation = np.full((n, 3), np.nan), np.full((n, 4), np.nan)
        wrench = np.full((n, 6), np.nan)
        shape = np.full((n, 0 if arcs is None else arcs.shape[1], 3), np.nan)
        status = np.full(n, Status.FAILED, np.int8)
        for i in range(n):
            rod = _EulerRod(rods, i, self.steps)
            wrench[i], _, flag, _ = scipy.optimize.fsolve(rod.error, np.zeros(6), full_output=True)
            path = np.zeros((self.steps + 1, 3))
            _, rotation, _, _ = rod.integrate(wrench[i], path)
            if flag == 1 and np.abs(rod.error(wrench[i])).max() < 1e-6:  # N, N m
                status[i] = Status.SOLVED
                nearest = scipy.spatial.transform.Rotation.from_matrix(rotation)
                tip[i], orientation[i] = path[-1], nearest.as_quat(canonical=True, scalar_first=True)
                grid = np.linspace(0.0, rod.length, self.steps + 1)
                for k in range(3 if arcs is not None else 0):
                    shape[i, :, k] = np.interp(arcs[i], grid, path[:, k])  # type: ignore[index]
        return assembled(tip, orientation, wrench[:, :3], wrench[:, 3:], status, shape)


PAPER = Paper()


class _EulerRod:
    """One rod: the residual of eq. 7 at the tip for guessed n(0), m(0)."""

    def __init__(self, rods: Rods, i: int, steps: int) -> None:
        self.steps, self.length = steps, float(rods.whole_length[i])
        self._tip = [rods.field(name)[i] for name in ("tip_force", "dead_force", "tip_moment", "dead_moment")]
        self._ends = np.cumsum(rods.field("length")[i])
        names = ("stretch_stiffness", "bend_stiffness", "load", "rest_curvature")
        self._sections = np.concatenate([rods.field(name)[i] for name in names], axis=1)

    def integrate(self, start: Array, path: Array) -> tuple[Array, Array, Array, Array]:
        """p, R, n, m at the tip; `path` (steps + 1 or 0, 3) is filled with p."""
        return _march(start, self.length, self.steps, self._ends, self._sections, path)

    def error(self, start: Array) -> Array:
        """[E^F, E^M]: what the tip has minus the load it should carry (eq. 4 and 5)."""
        follower, dead, follower_moment, dead_moment = self._tip
        _, rotation, force, moment = self.integrate(start, _NO_PATH)
        return np.concatenate([force - rotation @ follower - dead, moment - rotation @ follower_moment - dead_moment])


_NO_PATH = np.zeros((0, 3))


@numba.njit(cache=True, error_model="numpy")
def _march(
    start: Array, length: float, steps: int, ends: Array, sections: Array, path: Array
) -> tuple[Array, Array, Array, Array]:
    """p (m), R, n (N) and m (N m) at the tip: eq. 6 applied to eq. 1 and 2, point after point from n, m at the base (`start`).

    `ends` (elements,) m: where elements end; `sections` (elements, 12) by the columns above; `path` takes p where it has rows.
    """
    ds = length / steps
    p, rotation = np.zeros(3), np.eye(3)
    n, m = np.empty(3), np.empty(3)
    for k in range(3):
        n[k], m[k] = start[k], start[3 + k]
    v, u, slope = np.empty(3), np.empty(3), np.empty(3)
    turn = np.zeros((3, 3))
    element = 0
    for i in range(steps):
        # A step that starts at the end of an element is beyond it, whatever the last bit of i * ds says.
        while element + 1 < ends.size and i * ds >= ends[element] - 1e-9 * length:
            element += 1
        for k in range(3):
            local_n = rotation[0, k] * n[0] + rotation[1, k] * n[1] + rotation[2, k] * n[2]
            local_m = rotation[0, k] * m[0] + rotation[1, k] * m[1] + rotation[2, k] * m[2]
            v[k] = local_n / sections[element, STRETCH + k] + (1.0 if k == 2 else 0.0)
            u[k] = local_m / sections[element, BEND + k] + sections[element, REST + k]
        for k in range(3):
            slope[k] = rotation[k, 0] * v[0] + rotation[k, 1] * v[1] + rotation[k, 2] * v[2]
            turn[k, 0] = rotation[k, 1] * u[2] - rotation[k, 2] * u[1]
            turn[k, 1] = rotation[k, 2] * u[0] - rotation[k, 0] * u[2]
            turn[k, 2] = rotation[k, 0] * u[1] - rotation[k, 1] * u[0]
        m[0] -= ds * (slope[1] * n[2] - slope[2] * n[1])
        m[1] -= ds * (slope[2] * n[0] - slope[0] * n[2])
        m[2] -= ds * (slope[0] * n[1] - slope[1] * n[0])
        for k in range(3):
            p[k] += ds * slope[k]
            n[k] -= ds * sections[element, LOAD + k]
            for j in range(3):
                rotation[k, j] += ds * turn[k, j]
        for k in range(3 if path.shape[0] > 0 else 0):
            path[i + 1, k] = p[k]
    return p, rotation, n, m
