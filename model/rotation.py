"""Rotations in batches, just what the solvers need: unit quaternions (w, x, y, z), and the turn between two sets of points."""

from __future__ import annotations

import numpy as np

from model.arrays import Array


def multiply(a: Array, b: Array) -> Array:
    """a b for (..., 4): first b, then a."""
    aw, ax, ay, az = a[..., 0], a[..., 1], a[..., 2], a[..., 3]
    bw, bx, by, bz = b[..., 0], b[..., 1], b[..., 2], b[..., 3]
    w = aw * bw - ax * bx - ay * by - az * bz
    out = np.empty((*w.shape, 4))
    out[..., 0] = w
    out[..., 1] = aw * bx + ax * bw + ay * bz - az * by
    out[..., 2] = aw * by - ax * bz + ay * bw + az * bx
    out[..., 3] = aw * bz + ax * by - ay * bx + az * bw
    return out


def cross(a: Array, b: Array) -> Array:
    """a x b of vectors (..., 3): as numpy's, without what that costs for other axes."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    x = ay * bz - az * by
    out = np.empty((*x.shape, 3))
    out[..., 0] = x
    out[..., 1] = az * bx - ax * bz
    out[..., 2] = ax * by - ay * bx
    return out


def from_vector(vector: Array) -> Array:
    """The quaternion (..., 4) of a rotation vector (..., 3) in rad."""
    half = 0.5 * np.linalg.norm(vector, axis=-1, keepdims=True)
    # sin(h) / (2 h), finite at h = 0
    return np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * vector], axis=-1)


def unit(q: Array) -> Array:
    """q (..., 4) scaled to norm 1."""
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def to_base(q: Array, vector: Array) -> Array:
    """R(q) v: vectors (..., 3) in the frame of q (..., 4) in the base frame."""
    w, r = q[..., :1], q[..., 1:]
    t = 2 * cross(r, vector)
    return vector + w * t + cross(r, t)


def turn_onto(seen: Array, places: Array) -> Array:
    """(.., 3, 3) the rotation that brings `places` (.., n, 3) nearest to `seen`; of points on a line, one of those that do."""
    u, _, v = np.linalg.svd(np.swapaxes(seen, -1, -2) @ places)
    u[..., 2] *= np.linalg.det(u @ v)[..., None]  # no mirror
    return np.asarray(u @ v)


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
