"""PyElastica (extra `pyelastica`) as a simulator of the robot: a Cosserat rod in time, damped until it rests.

The robot's rod has N equal elements; stretch K_se and bend K_bt of each are those of the rod of robot.yaml at its middle, an
element that the spine's end divides having both in series. It bends at the N - 1 places between elements, so K_bt is taken (N -
1) / N times. The chambers press on the tip with n_P and m_P, which turn with it (paper, eq. 4); weight and tip mass act at the
nodes. Mass and damping decide how the robot comes to rest, not where. PyElastica's own law lets an element that is stretched bend
more easily (its section keeps its volume), so that it does not agree with the rod to the last digit.

N. Naughton et al., "Elastica: A compliant mechanics environment for soft robotic control", RA-L 2021.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import elastica as ea
import numpy as np

from model.arrays import Array
from model.robot import Robot
from model.rods import Rods
from model.section import body_mass
from model.simulators import Readings, States, rods_at

ELEMENTS = 20
TIME_STEP = 1e-4
"""s."""
RADIUS = 0.02
"""m of the elements in PyElastica; it sets their rotary inertia alone, as the stiffness is given."""


class PyElastica:
    """The robot of robot.yaml in PyElastica."""

    parameters = ("area.excess",)

    def __init__(self, robot: Robot, elements: int = ELEMENTS) -> None:
        self._robot, self._elements = robot, elements

    def predict(self, states: States, parameters: Mapping[str, float]) -> Readings:
        """One relaxation a state; NaN for a state that does not come to rest."""
        rods = rods_at(self._robot, states, parameters)
        density = body_mass(self._robot) / self._robot.length / (np.pi * RADIUS**2)
        return Readings(np.array([relaxed(rods, i, density, self._elements) for i in range(len(states))]))


class _PointLoads(ea.NoForces):  # type: ignore[misc]
    """Weight at the nodes, a force and moment that turn with the tip, and a moment that does not."""

    def __init__(self, weight: Array, force: Array, moment: Array, dead_moment: Array) -> None:
        super().__init__()
        self._weight, self._force, self._moment, self._dead_moment = weight, force, moment, dead_moment

    def apply_forces(self, system: Any, time: float = 0.0) -> None:
        """Forces in the base frame."""
        system.external_forces += self._weight
        system.external_forces[:, -1] += system.director_collection[:, :, -1].T @ self._force

    def apply_torques(self, system: Any, time: float = 0.0) -> None:
        """Torques in the element's own frame."""
        system.external_torques[:, -1] += self._moment + system.director_collection[:, :, -1] @ self._dead_moment


class _System(ea.BaseSystemCollection, ea.Constraints, ea.Forcing, ea.Damping):  # type: ignore[misc]
    """A clamped rod with loads and damping."""


def relaxed(
    rods: Rods, i: int, density: float, elements: int = ELEMENTS, time_step: float = TIME_STEP, at_rest: float = 1e-4
) -> Array:
    """(3,) m, tip of rod `i` when no node is faster than `at_rest` (m/s), NaN: never. Many elements: short `time_step` (s)."""
    length = float(rods.whole_length[i])
    rod = ea.CosseratRod.straight_rod(
        elements, np.zeros(3), np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]), length, RADIUS, density,
        youngs_modulus=1e6, shear_modulus=1e6 / 3,
    )  # fmt: skip
    edges = np.linspace(0.0, length, elements + 1)
    element_shares = rods.shares(i, edges)
    joint_shares = rods.shares(i, 0.5 * (edges[1:] + edges[:-1]))
    for k in range(3):
        rod.shear_matrix[k, k] = 1.0 / (element_shares @ (1.0 / rods.field("stretch_stiffness")[i, :, k]))
        bend = 1.0 / (joint_shares @ (1.0 / rods.field("bend_stiffness")[i, :, k]))
        rod.bend_matrix[k, k] = (elements - 1) / elements * bend
        rod.rest_kappa[k] = elements / (elements - 1) * (joint_shares @ rods.field("rest_curvature")[i, :, k])
        rod.rest_sigma[k] = element_shares @ (rods.field("rest_strain")[i, :, k] - (k == 2))
    weight = np.zeros((3, elements + 1))
    element_weight = length / elements * (element_shares @ rods.field("load")[i]).T
    weight[:, :-1] += 0.5 * element_weight
    weight[:, 1:] += 0.5 * element_weight
    weight[:, -1] += rods.field("dead_force")[i]
    system = _System()
    system.append(rod)
    system.constrain(rod).using(ea.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,))
    loads = [rods.field(name)[i] for name in ("tip_force", "tip_moment", "dead_moment")]
    system.add_forcing_to(rod).using(_PointLoads, weight, *loads)
    # 1/s; near critical for the first bending mode of a robot of half a metre of silicone
    system.dampen(rod).using(ea.AnalyticalLinearDamper, uniform_damping_constant=25.0, time_step=time_step)
    system.finalize()
    stepper = ea.PositionVerlet()
    time = 0.0
    for step in range(100_000):
        time = float(stepper.step(system, time, time_step))
        # rest is tested every 200 steps
        if step % 200 == 199:
            speed = float(np.abs(rod.velocity_collection).max())
            if not np.isfinite(speed):
                break
            if speed < at_rest:
                return np.asarray(rod.position_collection[:, -1].copy())
    return np.full(3, np.nan)
