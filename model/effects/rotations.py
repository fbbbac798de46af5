"""Rotation vectors of quaternions, and what turns with a rolled robot, in batches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])
"""q * CONJUGATE is the opposite rotation."""


def rotation_vector(q: Array) -> Array:
    """Rotation vector (..., 3) in rad of unit quaternions (..., 4), shorter than pi."""
    q = q * np.where(q[..., :1] < 0, -1.0, 1.0)
    size = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(size, q[..., :1])
    return q[..., 1:] * np.where(size > 1e-9, angle / np.maximum(size, 1e-30), 2.0)


def rolled(roll: Array, x: Array, y: Array) -> tuple[Array, Array]:
    """x and y in the base frame of what sits on a robot that is mounted rolled by `roll` (rad)."""
    c, s = np.cos(roll), np.sin(roll)
    return c * x - s * y, s * x + c * y
