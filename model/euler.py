"""The paper's own method: explicit Euler from the base, shooting on n(0) and m(0) from zeros (equations 1-7, 10).

Kept as it is on purpose, inexact integrator included: it shows how much of a published gap is the method's own. N
is the number of steps of length L / N; a step takes the combined modulus when its start lies within the spine. The
rotation matrix is stepped like everything else and drifts off orthogonality.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import fsolve

from model.batch import INNER, OUTER, RodBatch, RodResult, Status
from model.condition import Condition
from model.errors import BadCondition
from model.robot import Robot
from model.section import rods

Array = NDArray[np.float64]

PUBLISHED_STEPS = 100
"""A usual choice for this method; the paper does not give its own."""
CLOSED = 1e-6
"""Largest residual (N, N m) of a solved state."""


def solve_euler(robot: Robot, condition: Condition, steps: int = PUBLISHED_STEPS) -> RodResult:
    """Tip of every state by the paper's method; flags what fsolve did not close. Raises `BadCondition`."""
    if not 2 <= steps <= 1_000_000:
        raise BadCondition(f"steps: {steps}, must be from 2 to 1000000")
    batch = rods(robot, condition)
    n = len(batch)
    tip, orientation = np.full((n, 3), np.nan), np.full((n, 4), np.nan)
    force, moment = np.full((n, 3), np.nan), np.full((n, 3), np.nan)
    status = np.full(n, Status.FAILED, np.int8)
    for i in range(n):
        rod = _Rod(batch, i, steps)
        start, _, flag, _ = fsolve(rod.error, np.zeros(6), full_output=True)
        position, rotation, _, _ = rod.integrate(start)
        if flag == 1 and np.abs(rod.error(start)).max() < CLOSED:
            status[i] = Status.SOLVED
            tip[i], orientation[i] = position, _nearest_quaternion(rotation)
            force[i], moment[i] = start[:3], start[3:]
    return RodResult(tip, orientation, force, moment, status, np.zeros((n, 0, 3)))


class _Rod:
    """One state: the residual of eq. 7 at the tip for guessed n(0), m(0)."""

    def __init__(self, batch: RodBatch, i: int, steps: int) -> None:
        self._batch, self._i = batch, i
        self._constants = (
            batch.length[i],
            batch.joint[i],
            steps,
            batch.stretch_stiffness[i, INNER],
            batch.bend_stiffness[i, INNER],
            batch.stretch_stiffness[i, OUTER],
            batch.bend_stiffness[i, OUTER],
            batch.weight[i],
            batch.rest_curvature[i],
        )

    def integrate(self, start: Array) -> tuple[Array, Array, Array, Array]:
        """p, R, n, m at the tip."""
        return _march(start[:3], start[3:], *self._constants)

    def error(self, start: Array) -> Array:
        """[E^F, E^M]: what the tip has minus the load it should carry (eq. 4 and 5)."""
        _, rotation, force, moment = self.integrate(start)
        batch, i = self._batch, self._i
        return np.concatenate(
            [force - rotation @ batch.tip_force[i] - batch.dead_force[i], moment - rotation @ batch.tip_moment[i]]
        )


@numba.njit(cache=True)
def _march(
    n0: Array,
    m0: Array,
    length: float,
    joint: float,
    steps: int,
    stretch_in: Array,
    bend_in: Array,
    stretch_out: Array,
    bend_out: Array,
    weight: Array,
    rest: Array,
) -> tuple[Array, Array, Array, Array]:
    """Eq. 6 applied to eq. 1 and 2, point after point from the base."""
    ds = length / steps
    p, rotation = np.zeros(3), np.eye(3)
    n, m = n0.copy(), m0.copy()
    v, u, slope = np.empty(3), np.empty(3), np.empty(3)
    turn = np.zeros((3, 3))
    # A step that starts at the joint is outside, whatever the last bit of i * ds says.
    last = joint - 1e-9 * length
    for i in range(steps):
        inside = i * ds < last
        stretch = stretch_in if inside else stretch_out
        bend = bend_in if inside else bend_out
        for k in range(3):
            local_n = rotation[0, k] * n[0] + rotation[1, k] * n[1] + rotation[2, k] * n[2]
            local_m = rotation[0, k] * m[0] + rotation[1, k] * m[1] + rotation[2, k] * m[2]
            v[k] = local_n / stretch[k] + (1.0 if k == 2 else 0.0)
            u[k] = local_m / bend[k] + rest[k]
        for k in range(3):
            slope[k] = rotation[k, 0] * v[0] + rotation[k, 1] * v[1] + rotation[k, 2] * v[2]
            turn[k, 0] = rotation[k, 1] * u[2] - rotation[k, 2] * u[1]
            turn[k, 1] = rotation[k, 2] * u[0] - rotation[k, 0] * u[2]
            turn[k, 2] = rotation[k, 0] * u[1] - rotation[k, 1] * u[0]
        twist0 = slope[1] * n[2] - slope[2] * n[1]
        twist1 = slope[2] * n[0] - slope[0] * n[2]
        twist2 = slope[0] * n[1] - slope[1] * n[0]
        m[0] -= ds * twist0
        m[1] -= ds * twist1
        m[2] -= ds * twist2
        for k in range(3):
            p[k] += ds * slope[k]
            n[k] -= ds * weight[k]
            for j in range(3):
                rotation[k, j] += ds * turn[k, j]
    return p, rotation, n, m


def _nearest_quaternion(matrix: Array) -> Array:
    """Unit quaternion (w, x, y, z), w >= 0, of the rotation nearest to a 3 by 3 matrix."""
    r = matrix
    # Largest eigenvector of the quaternion's own quadratic form: works for matrices that are not quite rotations.
    form = np.array(
        [
            [r[0, 0] + r[1, 1] + r[2, 2], 0, 0, 0],
            [r[2, 1] - r[1, 2], r[0, 0] - r[1, 1] - r[2, 2], 0, 0],
            [r[0, 2] - r[2, 0], r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], 0],
            [r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1]],
        ]
    )
    q: Array = np.linalg.eigh(form)[1][:, -1]
    return q if q[0] >= 0 else -q
