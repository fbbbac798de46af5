"""The same rods in simulators of others: PyElastica and SoRoMoX (extra `peers`), through `model.simulators`.

Each function prepares rods and returns what solves them: a call without arguments that gives tips (n, 3) m, NaN where the
simulator finds none. It raises ImportError where the simulator is not installed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from model.rods import Rods

Array = NDArray[np.float64]
Solver = Callable[[], Array]

GRAVITY = 9.81
STABLE = 20
"""Elements of PyElastica up to which its usual time step is short enough; more want a step shorter by as much."""


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
