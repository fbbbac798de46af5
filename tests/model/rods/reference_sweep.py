"""Rod equations integrated from the tip to the base, many rods at once, by SciPy's DOP853.

With the tip's orientation guessed, the loads there are known, so this is an initial value problem. Everything is
bounded on the way (forces only turn and collect weight), which makes it far better behaved than shooting from the
base.

Body frame, arc length s (equations 1 and 2 of the paper, n and m written in the turning frame):
    p' = R v,  q' = q (0, u) / 2,  n' = -u x n - R^T f,  m' = -u x m - v x n,  v = n / K_se + e3,  u = m / K_bt + u*
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from model.errors import SolveFailed
from model.rods.description import Rods
from model.rotation import cross

Array = NDArray[np.float64]
WIDTH = 13
"""Numbers of one rod's state: p (3), q (4), n (3), m (3)."""


@dataclass(frozen=True)
class Swept:
    """States at the base after integrating from a tip at the origin, and positions at the arc lengths asked for."""

    position: Array
    """(n, 3) m, base relative to the tip."""
    orientation: Array
    """(n, 4) quaternion at the base; the identity when the guess was right."""
    force: Array
    """(n, 3) N, body frame at the base."""
    moment: Array
    """(n, 3) N m, body frame at the base."""
    shape: Array
    """(n, k, 3) m, relative to the tip."""


def sweep(rods: Rods, tip_orientation: Array, tolerance: float, arcs: Array | None = None) -> Swept:
    """Integrate all rods from the tip, where the orientation (n, 4) is given, to the base.

    `tolerance` is the relative one of the integrator (RMS over the batch); `arcs` (n, k) in m fill `shape`.
    """
    n, tops = len(rods), np.cumsum(rods.field("length"), axis=1)
    wanted = np.zeros((n, 0)) if arcs is None else arcs
    joints = tops[:, :-1]
    stops = np.concatenate([joints, np.zeros((n, 1)), wanted], axis=1)
    # Each rod stops at its own arc lengths, tip first, so that no step crosses a joint and shape points are nodes.
    order = np.argsort(-stops, axis=1, kind="stable")
    stops = np.take_along_axis(stops, order, axis=1)

    state = np.zeros((n, WIDTH))
    state[:, 3:7] = tip_orientation
    state[:, 7:10] = rods.field("tip_force") + to_local(tip_orientation, rods.field("dead_force"))
    state[:, 10:13] = rods.field("tip_moment") + to_local(tip_orientation, rods.field("dead_moment"))
    passed = np.empty((n, stops.shape[1], 3))
    start = rods.whole_length
    for column in range(stops.shape[1]):
        end = stops[:, column]
        element = (0.5 * (start + end)[:, None] >= joints).sum(axis=1)
        state = _advance(rods, state, element, start - end, tolerance)
        passed[:, column] = state[:, :3]
        start = end
    shape = np.empty((n, wanted.shape[1], 3))
    rows, columns = np.nonzero(order >= rods.form.elements)
    shape[rows, order[rows, columns] - rods.form.elements] = passed[rows, columns]
    return Swept(state[:, :3], state[:, 3:7], state[:, 7:10], state[:, 10:13], shape)


def _advance(rods: Rods, state: Array, element: NDArray[np.intp], distance: Array, tolerance: float) -> Array:
    if not distance.any():
        return state
    row = np.arange(len(rods))
    solution = solve_ivp(
        _slope,
        (0.0, 1.0),
        state.ravel(),
        method="DOP853",
        t_eval=(1.0,),
        rtol=tolerance,
        atol=0.01 * tolerance,
        args=(
            distance,
            1.0 / rods.field("stretch_stiffness")[row, element],
            1.0 / rods.field("bend_stiffness")[row, element],
            rods.field("load")[row, element],
            rods.field("rest_curvature")[row, element],
        ),
    )
    if not solution.success:
        raise SolveFailed(f"integration along the rod stopped: {solution.message}; check stiffness and loads")
    return np.ascontiguousarray(solution.y[:, -1]).reshape(len(rods), WIDTH)


@numba.njit(cache=True)
def _slope(_share: float, flat: Array, distance: Array, give: Array, bend: Array, weight: Array, rest: Array) -> Array:
    """d(state) / d(share of the distance travelled towards the base) of all rods, flattened."""
    out = np.empty_like(flat)
    for i in range(distance.size):
        y, d = flat[WIDTH * i : WIDTH * (i + 1)], out[WIDTH * i : WIDTH * (i + 1)]
        w, a, b, c = y[3], y[4], y[5], y[6]
        n0, n1, n2, m0, m1, m2 = y[7], y[8], y[9], y[10], y[11], y[12]
        v0, v1, v2 = n0 * give[i, 0], n1 * give[i, 1], n2 * give[i, 2] + 1.0
        u0, u1, u2 = m0 * bend[i, 0] + rest[i, 0], m1 * bend[i, 1] + rest[i, 1], m2 * bend[i, 2] + rest[i, 2]
        r00, r01, r02 = 1 - 2 * (b * b + c * c), 2 * (a * b - w * c), 2 * (a * c + w * b)
        r10, r11, r12 = 2 * (a * b + w * c), 1 - 2 * (a * a + c * c), 2 * (b * c - w * a)
        r20, r21, r22 = 2 * (a * c - w * b), 2 * (b * c + w * a), 1 - 2 * (a * a + b * b)
        f0, f1, f2 = weight[i, 0], weight[i, 1], weight[i, 2]
        h = -distance[i]
        d[0] = h * (r00 * v0 + r01 * v1 + r02 * v2)
        d[1] = h * (r10 * v0 + r11 * v1 + r12 * v2)
        d[2] = h * (r20 * v0 + r21 * v1 + r22 * v2)
        d[3] = h * 0.5 * (-a * u0 - b * u1 - c * u2)
        d[4] = h * 0.5 * (w * u0 + b * u2 - c * u1)
        d[5] = h * 0.5 * (w * u1 + c * u0 - a * u2)
        d[6] = h * 0.5 * (w * u2 + a * u1 - b * u0)
        d[7] = -h * (u1 * n2 - u2 * n1 + r00 * f0 + r10 * f1 + r20 * f2)
        d[8] = -h * (u2 * n0 - u0 * n2 + r01 * f0 + r11 * f1 + r21 * f2)
        d[9] = -h * (u0 * n1 - u1 * n0 + r02 * f0 + r12 * f1 + r22 * f2)
        d[10] = -h * (u1 * m2 - u2 * m1 + v1 * n2 - v2 * n1)
        d[11] = -h * (u2 * m0 - u0 * m2 + v2 * n0 - v0 * n2)
        d[12] = -h * (u0 * m1 - u1 * m0 + v0 * n1 - v1 * n0)
    return out


def to_local(q: Array, vector: Array) -> Array:
    """R(q)^T v: base-frame vectors (..., 3) in the frame of q (..., 4)."""
    w, r = q[..., :1], -q[..., 1:]
    t = 2 * cross(r, vector)
    return vector + w * t + cross(r, t)
