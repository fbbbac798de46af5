"""Where the flange of a UR5 really is: it is built a little differently from its drawing, and yields under its own weight.

Joint k turns by q_k + zero_k + yield_k tau_k about z; d along z, a along x, alpha about x and beta about y lead to the next one.
tau_k: torque of gravity about joint k, with the mass of each link half way along it. The controller knows nothing of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from .kinematics import UR5_CB3, Array, Geometry

MASSES = (3.7, 8.393, 2.275, 1.219, 1.219, 0.1879)
"""kg, of the links of a UR5."""
ZERO, LENGTH, TWIST, YIELD = 1e-3, 0.5e-3, 1e-3, 6e-6
"""Standard deviations of what is drawn: rad, m, rad; and largest yield of a joint, rad/(N m): 0.5 mrad of a stretched arm."""


@dataclass(frozen=True)
class TrueArm:
    """One arm as it is built: a, d and alpha by joint in `geometry`, the others (6,) in rad and rad/(N m)."""

    geometry: Geometry
    zero: Array
    beta: Array
    compliance: Array

    def frames(self, angles: Array) -> list[Array]:
        """Poses (4, 4) of the frames 0 to 6 in the base frame, without gravity, for angles of the joints (6,), rad."""
        g, poses = self.geometry, [np.eye(4)]
        turns = Rotation.from_euler("ZXY", np.column_stack([angles + self.zero, g.alpha, self.beta])).as_matrix()
        for turn, theta, d, a in zip(turns, angles + self.zero, g.d, g.a, strict=True):
            shift = [a * math.cos(theta), a * math.sin(theta), d]
            poses.append(poses[-1] @ np.vstack([np.column_stack([turn, shift]), [0.0, 0.0, 0.0, 1.0]]))
        return poses

    def flange(self, joints: Array) -> Array:
        """Pose (4, 4) of the flange in the base frame, for the joint angles (6,) that the controller reports, rad."""
        poses = self.frames(joints)
        places = np.array([pose[:3, 3] for pose in poses])
        carried = np.cumsum(MASSES[::-1])[::-1]  # kg, from each joint on
        moments = np.cumsum((np.array(MASSES)[:, None] * (places[1:] + places[:-1]) / 2)[::-1], axis=0)[::-1]  # kg m
        torques = []
        for pose, place, mass, moment in zip(poses, places, carried, moments, strict=False):
            x, y, _ = moment - mass * place
            torques.append(9.81 * (pose[1, 2] * x - pose[0, 2] * y))  # z . (r x m g)
        return self.frames(joints + self.compliance * torques)[-1]


def true_arm(seed: int, size: float) -> TrueArm:
    """The UR5 that belongs to a seed, with errors `size` times as large as usual; 0: as drawn."""
    rng = np.random.default_rng(seed)
    zero, d, a, alpha, beta = size * np.array([[ZERO], [LENGTH], [LENGTH], [TWIST], [TWIST]]) * rng.standard_normal((5, 6))
    compliance = size * YIELD * rng.uniform(0.3, 1.0, 6)
    g = UR5_CB3
    built = Geometry(tuple(g.a + a), tuple(g.d + d), tuple(g.alpha + alpha))
    return TrueArm(built, zero, beta * [abs(math.sin(x)) < 0.5 for x in g.alpha], compliance)
