"""Other ways to solve the same rods: the paper's own, and a collocation solver."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_bvp
from scipy.optimize import fsolve

from model.rods import Rods

Array = NDArray[np.float64]
Peer = tuple[float, Array]
"""Processor seconds for all rods and their tips (n, 3) m."""

EULER_STEPS = 100
TOLERANCE = 1e-3


class Equations:
    """p' = R v, R' = R u^, n' = -f, m' = -p' x n of one rod of two elements, in the mount frame."""

    def __init__(self, rods: Rods, i: int) -> None:
        self.length, self.joint = float(rods.whole_length[i]), float(rods.field("length")[i, 0])
        self.stretch, self.bend = rods.field("stretch_stiffness")[i], rods.field("bend_stiffness")[i]
        self.load, self.force, self.moment = (
            rods.field("load")[i, 0],
            rods.field("tip_force")[i],
            rods.field("tip_moment")[i],
        )
        self.dead = rods.field("dead_force")[i]

    def slope(self, y: Array, part: int) -> Array:
        """d(p, R, n, m)/ds."""
        turn, n = y[3:12].reshape(3, 3), y[12:15]
        v = turn.T @ n / self.stretch[part] + (0.0, 0.0, 1.0)
        u = turn.T @ y[15:18] / self.bend[part]
        hat = np.array([[0, -u[2], u[1]], [u[2], 0, -u[0]], [-u[1], u[0], 0]])
        moved = turn @ v
        return np.concatenate([moved, (turn @ hat).ravel(), -self.load, -np.cross(moved, n)])

    def slopes(self, y: Array, part: int) -> Array:
        """The same at many places, y (18, k)."""
        turn, n = y[3:12].reshape(3, 3, -1), y[12:15]
        v = np.einsum("jik,jk->ik", turn, n) / self.stretch[part][:, None] + np.array([[0.0], [0.0], [1.0]])
        u = np.einsum("jik,jk->ik", turn, y[15:18]) / self.bend[part][:, None]
        turned = np.cross(turn, u, axisa=1, axisb=0).transpose(0, 2, 1)
        moved = np.einsum("ijk,jk->ik", turn, v)
        load = np.broadcast_to(-self.load[:, None], n.shape)
        return np.concatenate([moved, turned.reshape(9, -1), load, -np.cross(moved, n, axis=0)])

    def open_tip(self, y: Array) -> Array:
        """What the tip carries minus what it should, [E^F, E^M]."""
        turn = y[3:12].reshape(3, 3)
        return np.concatenate([y[12:15] - turn @ self.force - self.dead, y[15:18] - turn @ self.moment])


def paper_peer(rods: Rods, steps: int = EULER_STEPS) -> Peer:
    """NumPy Euler with this many steps and fsolve from zeros."""

    def integrate(rod: Equations, guess: Array) -> Array:
        y = np.concatenate([np.zeros(3), np.eye(3).ravel(), guess])
        ds = rod.length / steps
        for k in range(steps):
            y = y + ds * rod.slope(y, 0 if k * ds < rod.joint else 1)
        return y

    start, tips = time.thread_time(), np.empty((len(rods), 3))
    for i in range(len(rods)):
        rod = Equations(rods, i)
        found = fsolve(lambda x, rod=rod: rod.open_tip(integrate(rod, x)), np.zeros(6))
        tips[i] = integrate(rod, found)[:3]
    return time.thread_time() - start, tips


def solve_bvp_peer(rods: Rods, tolerance: float = TOLERANCE) -> Peer:
    """SciPy's collocation, both elements side by side over 0..1, all places of a mesh at once."""
    start, tips = time.thread_time(), np.empty((len(rods), 3))
    for i in range(len(rods)):
        rod = Equations(rods, i)
        ends = (rod.joint, rod.length - rod.joint)
        straight = np.concatenate([np.zeros(3), np.eye(3).ravel(), rod.force + rod.dead + rod.load * rod.length, rod.moment])

        def slope(_: Array, y: Array, rod: Equations = rod, ends: tuple[float, float] = ends) -> Array:
            return np.concatenate([ends[0] * rod.slopes(y[:18], 0), ends[1] * rod.slopes(y[18:], 1)])

        def closed(a: Array, b: Array, rod: Equations = rod) -> Array:
            return np.concatenate(
                [a[:12] - np.concatenate([np.zeros(3), np.eye(3).ravel()]), b[:18] - a[18:], rod.open_tip(b[18:])]
            )

        x = np.linspace(0, 1, 9)
        guess = np.tile(np.concatenate([straight, straight])[:, None], x.size)
        guess[2], guess[20] = ends[0] * x, ends[0] + ends[1] * x
        tips[i] = solve_bvp(slope, closed, x, guess, tol=tolerance).y[18:21, -1]
    return time.thread_time() - start, tips
