"""Kinematics of the UR5: where the flange is for given joint angles, and back.

Poses are 4x4 matrices or (x, y, z [m], rotation vector [rad]); joint angles rad; everything in the arm's base frame.
The Denavit-Hartenberg parameters are the nominal ones that Universal Robots publishes for the UR5 (CB3) and the UR5e; a
real arm deviates (`TrueArm`), and its controller knows nothing of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Geometry:
    """Denavit-Hartenberg parameters of the six joints: a, d in m, alpha in rad; beta (rad): a turn about y behind alpha."""

    a: tuple[float, ...]
    d: tuple[float, ...]
    alpha: tuple[float, ...] = (math.pi / 2, 0.0, 0.0, math.pi / 2, -math.pi / 2, 0.0)
    beta: tuple[float, ...] = (0.0,) * 6


UR5_CB3 = Geometry(a=(0.0, -0.425, -0.39225, 0.0, 0.0, 0.0), d=(0.089159, 0.0, 0.0, 0.10915, 0.09465, 0.0823))
UR5E = Geometry(a=(0.0, -0.425, -0.3922, 0.0, 0.0, 0.0), d=(0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996))


def rotation_matrix(vector: Sequence[float] | Array) -> Array:
    """Rotation matrix of a rotation vector (rad), by Rodrigues' formula."""
    v = np.asarray(vector, float)
    angle = float(np.linalg.norm(v))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = v / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross


def rotation_vector(matrix: Array) -> Array:
    """Rotation vector (rad, length 0..pi) of a rotation matrix; stable near 0 and near pi."""
    axis_sin = 0.5 * np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])
    sine = float(np.linalg.norm(axis_sin))
    cosine = 0.5 * (float(np.trace(matrix)) - 1.0)
    angle = math.atan2(sine, cosine)
    if sine > 1e-6:
        return axis_sin * (angle / sine)
    if cosine > 0.0:
        return axis_sin
    # Near pi the antisymmetric part vanishes: take the axis from the symmetric part.
    outer = 0.25 * (matrix + matrix.T) + 0.5 * np.eye(3)
    column = int(np.argmax(np.diag(outer)))
    axis = outer[:, column] / math.sqrt(outer[column, column])
    if float(axis @ axis_sin) < 0.0:
        axis = -axis
    return axis * angle


def pose_matrix(pose: Sequence[float] | Array) -> Array:
    """4x4 matrix of (x, y, z, rotation vector)."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_matrix(pose[3:6])
    matrix[:3, 3] = pose[:3]
    return matrix


def pose_vector(matrix: Array) -> Array:
    """(x, y, z, rotation vector) of a 4x4 matrix, shape (6,)."""
    return np.concatenate([matrix[:3, 3], rotation_vector(matrix[:3, :3])])


def forward(geometry: Geometry, joints: Array, tool: Array) -> tuple[Array, Array]:
    """TCP pose (4x4) and geometric Jacobian (6x6, m and rad per rad); `tool` = TCP in the flange frame (4x4)."""
    # Joint by joint: turned by theta about z, along z by d and the new x by a, turned by alpha about that x. In plain
    # numbers, because an array of three takes ten times longer, and a controller does this in each of its cycles.
    ax, ay, az, bx, by, bz, cx, cy, cz = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0  # x, y and z axis
    px = py = pz = 0.0
    screws = []
    for theta, a, d, alpha, beta in zip(joints.tolist(), geometry.a, geometry.d, geometry.alpha, geometry.beta, strict=True):
        screws.append((cx, cy, cz, px, py, pz))
        ct, st, ca, sa = math.cos(theta), math.sin(theta), math.cos(alpha), math.sin(alpha)
        sx, sy, sz = ct * bx - st * ax, ct * by - st * ay, ct * bz - st * az
        ax, ay, az = ct * ax + st * bx, ct * ay + st * by, ct * az + st * bz
        px, py, pz = px + d * cx + a * ax, py + d * cy + a * ay, pz + d * cz + a * az
        bx, by, bz = ca * sx + sa * cx, ca * sy + sa * cy, ca * sz + sa * cz
        cx, cy, cz = ca * cx - sa * sx, ca * cy - sa * sy, ca * cz - sa * sz
        if beta:
            cb, sb, (sx, sy, sz) = math.cos(beta), math.sin(beta), (ax, ay, az)
            ax, ay, az = cb * ax - sb * cx, cb * ay - sb * cy, cb * az - sb * cz
            cx, cy, cz = sb * sx + cb * cx, sb * sy + cb * cy, sb * sz + cb * cz
    pose = np.array([[ax, bx, cx, px], [ay, by, cy, py], [az, bz, cz, pz], [0.0, 0.0, 0.0, 1.0]]) @ tool
    x, y, z = pose[:3, 3].tolist()
    columns = [
        (v * (z - r) - w * (y - q), w * (x - p) - u * (z - r), u * (y - q) - v * (x - p), u, v, w) for u, v, w, p, q, r in screws
    ]
    return pose, np.array(columns).T


def inverse(geometry: Geometry, target: Array, start: Array, tool: Array) -> Array | None:
    """Joint angles nearest to `start` that put the TCP at `target` (4x4), or None when there are none.

    Damped Newton (Levenberg-Marquardt): q += J^T (J J^T + mu I)^-1 e, where e is the pose error and mu shrinks with it,
    so that the step is bounded near a singularity and convergence is quadratic near the solution.
    """
    joints = np.array(start, float)
    for _ in range(80):
        pose, jacobian = forward(geometry, joints, tool)
        error = np.concatenate([target[:3, 3] - pose[:3, 3], rotation_vector(target[:3, :3] @ pose[:3, :3].T)])
        size = float(np.linalg.norm(error))
        if size < 1e-10:
            return joints
        damping = min(1e-2 * size, 1e-3) * size + 1e-14
        step = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + damping * np.eye(6), error)
        joints = joints + step * min(1.0, 0.5 / max(float(np.max(np.abs(step))), 1e-12))
    return joints if size < 1e-7 else None  # the error before the last step


ZERO, LENGTH, TWIST = 1e-3, 0.5e-3, 1e-3
"""rad, m, rad: standard deviations of a built arm's joint zeros, link lengths and twists of its axes."""
WEIGHT, YIELD = 60.0, 15e-6
"""N of an arm's weight, as at its flange; most that a joint turns under a torque, rad/(N m): 0.6 mrad of the stretched arm."""


class TrueArm:
    """A UR5 as it is built, with errors `size` times as large as usual, drawn from a seed. Parallel axes turn about y, too."""

    def __init__(self, seed: int, size: float) -> None:
        rng, g = np.random.default_rng(seed), UR5_CB3
        zero, d, a, alpha, beta = size * np.array([[ZERO], [LENGTH], [LENGTH], [TWIST], [TWIST]]) * rng.standard_normal((5, 6))
        self.geometry = Geometry(tuple(g.a + a), tuple(g.d + d), tuple(g.alpha + alpha), tuple(beta * (np.cos(g.alpha) > 0.5)))
        self._zero, self._compliance = zero, size * YIELD * rng.uniform(0.3, 1.0, 6)

    def flange(self, joints: Array) -> Array:
        """Where the flange is (4x4) when the controller reports these joint angles: they yield under gravity's torques."""
        joints = joints + self._zero
        torques = -WEIGHT * forward(self.geometry, joints, np.eye(4))[1][2]  # N m: by the height that each joint lifts
        return forward(self.geometry, joints + self._compliance * torques, np.eye(4))[0]
