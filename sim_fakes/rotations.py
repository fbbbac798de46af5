"""Rotations as the fakes need them: quaternions x, y, z, w."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def rotation_matrix(q: tuple[float, float, float, float]) -> Array:
    """Of a unit quaternion w, x, y, z: (w^2 - v.v) 1 + 2 v v^T + 2 w [v]."""
    w, v = q[0], np.array(q[1:])
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return (w * w - v @ v) * np.eye(3) + 2 * np.outer(v, v) + 2 * w * cross


def quaternion_xyzw(rotation: Array) -> Array:
    """Unit quaternion x, y, z, w with w >= 0: the eigenvector of Bar-Itzhack's matrix with the largest eigenvalue."""
    (a, b, c), (d, e, f), (g, h, i) = rotation
    k = np.array(
        [
            [a - e - i, b + d, c + g, h - f],
            [b + d, e - a - i, f + h, c - g],
            [c + g, f + h, i - a - e, d - b],
            [h - f, c - g, d - b, a + e + i],
        ]
    )
    q: Array = np.linalg.eigh(k)[1][:, 3]
    return q if q[3] >= 0 else -q


def shaken(q: Array, half: Array) -> Array:
    """Quaternion x, y, z, w (w >= 0) turned about its own axes by the small rotation vector 2 `half` (rad)."""
    x, y, z, w = q.tolist()
    a, b, c = half.tolist()
    scale = 1 / math.sqrt(1 + a * a + b * b + c * c)
    real = w - x * a - y * b - z * c
    scale = math.copysign(scale, real)
    turned = (x + w * a + y * c - z * b, y + w * b + z * a - x * c, z + w * c + x * b - y * a, real)
    return scale * np.array(turned)
