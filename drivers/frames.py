"""Rigid transforms: unit quaternions (w, x, y, z), rotation matrices, rotation vectors, poses.

A pose (position, orientation) of frame B in frame A takes coordinates in B to coordinates in A: p_A = R p_B + position.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .interfaces import Quaternion, Vector3

Array = NDArray[np.float64]


def matrix_from_quaternion(q: Quaternion) -> Array:
    """Rotation matrix, shape (3, 3), of a quaternion of any length but 0; without scipy, which no guard waits for."""
    w, x, y, z = (part / math.hypot(*q) for part in q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_from_matrix(matrix: Array) -> Quaternion:
    """Unit quaternion with w >= 0 of a rotation matrix."""
    x, y, z, w = _rotations().from_matrix(matrix).as_quat(canonical=True).tolist()
    return (w, x, y, z)


def rotation_from_vector(vector: Sequence[float] | Array) -> Array:
    """Rotation matrix of a rotation by |vector| rad about the vector's direction; (n, 3, 3) of several vectors (n, 3)."""
    return np.asarray(_rotations().from_rotvec(vector).as_matrix())


def vector_from_rotation(matrix: Array) -> Array:
    """Rotation vector, shape (3,), of length 0..pi, of a rotation matrix."""
    return np.asarray(_rotations().from_matrix(matrix).as_rotvec())


def _rotations() -> Any:
    from scipy.spatial.transform import Rotation  # a quarter of a second, which a plan without poses does not need

    return Rotation


def compose(a: Quaternion, b: Quaternion) -> Quaternion:
    """The rotation b followed by a, as the matrix product A B."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def apply(position: Vector3, rotation: Array, point: Vector3) -> Vector3:
    """`rotation` (3, 3) times `point`, plus `position`, m."""
    x, y, z = rotation @ np.asarray(point) + np.asarray(position)
    return (float(x), float(y), float(z))


@dataclass(frozen=True)
class Alignment:
    """A point fixed in a moving frame, seen from another frame: seen_i = rotation (position_i + R_i point) + shift + residual_i.

    m; R_i turns the moving frame's coordinates into those of the frame in which `position_i` is given.
    """

    rotation: Array
    shift: Array
    point: Array
    residuals: Array
    """(n, 3)"""

    @property
    def rmse(self) -> float:
        """Root of the mean squared distance of the residuals, m."""
        return float(np.sqrt(np.mean(np.sum(self.residuals**2, axis=1))))

    def back(self, seen: Array) -> Array:
        """Points (n, 3) m of the other frame in that of the poses."""
        return np.asarray((seen - self.shift) @ self.rotation)


def alignment(poses: Array, seen: Array) -> Alignment:
    """Fit an alignment to poses (n, 6), m and rotation vectors, and points (n, 3) seen meanwhile, m, by least squares.

    rotation^T seen_i = position_i + R_i point + b is linear in the entries of the matrix, point and b; the nearest rotation is
    taken, then point and b are fitted again.
    """
    turns, n = rotation_from_vector(poses[:, 3:]), len(poses)
    free = np.concatenate([turns, np.broadcast_to(np.eye(3), (n, 3, 3))], axis=2)  # of point and b
    linear = np.concatenate([free, *(-seen[:, k, None, None] * np.eye(3) for k in range(3))], axis=2)
    fitted = np.linalg.lstsq(linear.reshape(3 * n, -1), -poses[:, :3].ravel(), rcond=None)[0]
    u, _, v = np.linalg.svd(fitted[6:].reshape(3, 3))
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    offsets = seen @ rotation - poses[:, :3]
    point_and_b = np.linalg.lstsq(free.reshape(3 * n, -1), offsets.ravel(), rcond=None)[0]
    residuals = (offsets - free @ point_and_b) @ rotation.T
    return Alignment(rotation, rotation @ point_and_b[3:], point_and_b[:3], residuals)
