"""The same rods solved by SciPy's collocation, and by PyElastica and SoRoMoX (extra `peers`) through `model.simulators`.

Each function of a simulator prepares rods and returns what solves them: a call without arguments that gives tips (n, 3) m, NaN
where the simulator finds none. It raises ImportError where the simulator is not installed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_bvp

from model.rods import Rods

Array = NDArray[np.float64]
Solver = Callable[[], Array]

GRAVITY = 9.81
STABLE = 20
"""Elements of PyElastica up to which its usual time step is short enough; more want a step shorter by as much."""


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

    def slopes(self, y: Array, part: int) -> Array:
        """d(p, R, n, m)/ds at many places, y (18, k)."""
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


def collocation(rods: Rods, tolerance: float) -> Array:
    """Tips (n, 3) m by SciPy's collocation, both elements side by side over 0..1, all places of a mesh at once."""
    tips = np.empty((len(rods), 3))
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
    return tips


def pyelastica(rods: Rods, elements: int, at_rest: float) -> Solver:
    """Rods of equal elements, damped until no node is faster than `at_rest` m/s."""
    from model.simulators import pyelastica as own

    step = own.TIME_STEP * min(1.0, STABLE / elements)
    density = np.linalg.norm(rods.field("load")[:, 0], axis=1) / GRAVITY / (np.pi * own.RADIUS**2)

    def solve() -> Array:
        return np.array([own.relaxed(rods, i, density[i], elements, step, at_rest) for i in range(len(rods))])

    return solve


def soromox_constant(rods: Rods, segments: int) -> Solver:
    """Strain constant in equal segments: `lab diagnose --simulator soromox`."""
    from model.simulators.soromox import tips_of

    models: dict[bytes, Any] = {}
    return lambda: tips_of(rods, segments, models)


def soromox_polynomial(rods: Rods, order: int, points: int) -> Solver:
    """Strain a polynomial of that order in each element, integrated at this many Gauss points; two segments a rod."""
    import jax.numpy as jnp

    from model.simulators.soromox import AT_REST, ORDER, equilibrium

    axes = list(ORDER)
    models = [_polynomial(rods, i, order, points) for i in range(len(rods))]
    follower = np.hstack([rods.field(name)[:, axes] for name in ("tip_moment", "tip_force")])
    dead, length = rods.field("dead_force"), rods.whole_length

    def solve() -> Array:
        tips = np.full((len(rods), 3), np.nan)
        for i, model in enumerate(models):
            tip, left = equilibrium(model, *(jnp.asarray(each[i]) for each in (follower, dead, length)))
            if float(left) < AT_REST:
                tips[i] = tip
        return tips

    return solve


def _polynomial(rods: Rods, i: int, order: int, points: int) -> Any:
    """Rod `i` with Legendre polynomials of all six strains; a rod without a first element is halved, so that all compile once."""
    import jax.numpy as jnp
    from soromox.systems import GVS, GVSSegment, JointSpec, LinkSpec, StrainBasisSpec

    from model.simulators.soromox import ORDER, RADIUS, UPRIGHT

    axes, lengths, which = list(ORDER), rods.field("length")[i], (0, 1)
    if lengths[0] == 0.0:
        lengths, which = np.full(2, 0.5 * lengths[1]), (1, 1)
    load = rods.field("load")[i, 0]
    weight = float(np.linalg.norm(load))
    norms = 2.0 * np.arange(order + 1) + 1.0
    segments = []
    for length, e in zip(lengths, which, strict=True):
        section = np.hstack([rods.field(name)[i, e][axes] for name in ("bend_stiffness", "stretch_stiffness")])
        link = LinkSpec.circular(
            length=float(length), radius=RADIUS, density=weight / (np.pi * RADIUS**2), reference_strain=[0, 0, 0, 1, 0, 0],
            stiffness=jnp.diag(jnp.asarray((length * section[:, None] / norms).ravel())),
        )  # fmt: skip
        basis = StrainBasisSpec("legendre", [1] * 6, order)
        segments.append(GVSSegment(link, JointSpec(type="fixed"), basis, points))
    return GVS.from_segments(segments, gravity=jnp.asarray(load / weight), base_pose=jnp.asarray(UPRIGHT))
