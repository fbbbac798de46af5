"""SoRoMoX (extra `soromox`) as a simulator of the robot: piecewise constant strain, in equilibrium.

N equal segments of constant strain q; stretch K_se and bend K_bt of each are those of the rod of robot.yaml, a segment that the
spine's end divides having both in series. At rest elasticity and weight, SoRoMoX's K q + G(q), balance the tip's loads,

    K q + G(q) = J(q)^T (m_P, n_P + R(q)^T F),

with its own Jacobian J and rotation R at the tip, n_P and m_P the chambers' force and moment, which turn with the tip (paper,
eq. 4), F the tip mass's weight. Solved by Newton's method with the derivative that JAX takes, the loads put on in steps.
SoRoMoX counts a rod's arc along its x axis: the robot's (z, x, y).

M. Stölzle et al., soromox: soft robot models in JAX; F. Renda et al., "Discrete Cosserat approach for multisection soft
manipulator dynamics", IEEE T-RO 34(6), 2018.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from soromox.systems import PCS, LinkSpec

from model.arrays import Array
from model.robot import Robot
from model.rods import Rods
from model.simulators import Readings, States, rods_at

jax.config.update("jax_enable_x64", True)

AT_REST = 1e-9
"""N m, of the residual."""
RADIUS = 0.02
"""m of the segments in SoRoMoX; it sets nothing here, as stiffness and weight are given."""
ORDER = (2, 0, 1)
"""SoRoMoX' x, y, z among the robot's axes."""
UPRIGHT = (-0.5, -0.5, -0.5, 0.5, 0.0, 0.0, 0.0)
"""Pose of the base: quaternion x, y, z, w and position; x of SoRoMoX along z of the robot."""


class SoRoMoX:
    """The robot of robot.yaml in SoRoMoX."""

    parameters = ("area.excess",)

    def __init__(self, robot: Robot, segments: int = 10) -> None:
        self._robot, self._segments = robot, segments
        self._models: dict[bytes, Any] = {}
        """SoRoMoX' rods by stiffness and weight: one for each spine length."""

    def predict(self, states: States, parameters: Mapping[str, float]) -> Readings:
        """Newton's method for each state; NaN where it finds no equilibrium."""
        rods = rods_at(self._robot, states, parameters)
        return Readings(np.array([_tip(rods, i, self._segments, self._models) for i in range(len(rods))]))


def _tip(rods: Rods, i: int, segments: int, models: dict[bytes, Any]) -> Array:
    """(3,) m, of rod `i`, NaN where it finds no equilibrium; `models` keeps SoRoMoX' rods for further calls."""
    total = float(rods.whole_length[i])
    within = rods.shares(i, np.linspace(0.0, total, segments + 1))
    compliance = [1.0 / rods.field(name)[i][:, list(ORDER)] for name in ("bend_stiffness", "stretch_stiffness")]
    stiffness, load = 1.0 / (within @ np.hstack(compliance)), within @ rods.field("load")[i]
    rest = within @ np.hstack([rods.field(name)[i][:, list(ORDER)] for name in ("rest_curvature", "rest_strain")])
    key = np.concatenate([stiffness.ravel(), load.ravel(), rest.ravel()]).tobytes()
    if key not in models:
        models[key] = _model(total, stiffness, load, rest)
    follower = np.concatenate([rods.field("tip_moment")[i][list(ORDER)], rods.field("tip_force")[i][list(ORDER)]])
    dead = jnp.asarray([rods.field("dead_moment")[i], rods.field("dead_force")[i]])
    tip, left = equilibrium(models[key], jnp.asarray(follower), dead, jnp.asarray(total))
    return np.asarray(tip) if float(left) < AT_REST else np.full(3, np.nan)


def _model(length: float, stiffness: Array, load: Array, rest: Array) -> Any:
    """SoRoMoX' rod of N segments with this stiffness and rest strain (N, 6), its density as heavy as `load` (N, 3) N/m."""
    heaviest = load[int(np.argmax(np.linalg.norm(load, axis=1)))]
    size = float(np.linalg.norm(heaviest))
    gravity = heaviest / size if size else np.array([0.0, 0.0, 1.0])
    segment_length = length / len(stiffness)
    links = [
        LinkSpec.circular(
            # SoRoMoX wants a density
            length=segment_length, radius=RADIUS, density=max(float(w @ gravity), 1e-9) / (np.pi * RADIUS**2),
            reference_strain=u.tolist(), stiffness=jnp.diag(jnp.asarray(segment_length * k)),
        )
        for k, w, u in zip(stiffness, load, rest, strict=True)
    ]  # fmt: skip
    return PCS.from_links(links, gravity=jnp.asarray(gravity), base_pose=jnp.asarray(UPRIGHT))


@eqx.filter_jit
def equilibrium(model: Any, follower: Any, dead: Any, length: Any) -> tuple[Any, Any]:
    """The tip (3,) m of SoRoMoX' rod of a `length` (m) in equilibrium, and the largest component of its residual (N m, N).

    At the tip act `follower` (6,) N m, N in SoRoMoX' axes, which turns with it, and `dead` (2, 3) N m, N in the robot's axes.
    """

    def residual(q: Any, share: Any) -> Any:
        turn = model.forward_kinematics(q, length)[:3, :3]
        wrench = share * follower + (dead @ turn).ravel()
        return model.potential_force(q) - model.jacobian_bodyframe(q, length).T @ wrench

    def balanced(q: Any, share: Any) -> tuple[Any, None]:
        def goes_on(state: Any) -> Any:
            return (state[2] > AT_REST) & (state[0] < 15)

        def step(state: Any) -> tuple[Any, Any, Any]:
            k, q, _ = state
            q = q - jnp.linalg.solve(jax.jacfwd(residual)(q, share), residual(q, share))
            return k + 1, q, jnp.abs(residual(q, share)).max()

        return jax.lax.while_loop(goes_on, step, (0, q, jnp.inf))[1], None

    # the loads are put on in four steps
    q, _ = jax.lax.scan(balanced, jnp.zeros(model.num_internal_dofs), jnp.linspace(1.0 / 4, 1.0, 4))
    return model.forward_kinematics(q, length)[:3, 3], jnp.abs(residual(q, 1.0)).max()
