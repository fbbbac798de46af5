"""Rigid motions of section frames, for many at once: exponential, logarithm and the derivatives of the logarithm.

A motion has a translation p (..., 3) and a rotation R (..., 3, 3); a twist x = (v, u) is a translation and a rotation vector
in the moving frame. exp(x) is the screw motion along a segment whose strain is constant.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def hat(v: Array) -> Array:
    """Matrix of v x: (..., 3) -> (..., 3, 3)."""
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def cross(a: Array, b: Array) -> Array:
    """a x b for (..., 3); faster than numpy's for short vectors."""
    return np.stack(
        [
            a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
            a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
            a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
        ],
        axis=-1,
    )


def apply(matrix: Array, v: Array) -> Array:
    """Matrix times vector, (..., m, n) with (..., n)."""
    return np.asarray((matrix @ v[..., None])[..., 0])


def transposed(matrix: Array) -> Array:
    """The last two axes swapped."""
    return np.swapaxes(matrix, -1, -2)


def turn(u: Array) -> Array:
    """Rotation matrix of a rotation vector (rad), Rodrigues' formula."""
    square = np.sum(u * u, axis=-1)
    angle = np.sqrt(square)
    a = np.sinc(angle / np.pi)
    b = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    w = hat(u)
    return np.asarray(np.eye(3) + a[..., None, None] * w + b[..., None, None] * (w @ w))


def rotation_vector(r: Array) -> Array:
    """Rotation vector (rad) of a rotation by less than a quarter turn."""
    w = 0.5 * np.stack([r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0], r[..., 1, 0] - r[..., 0, 1]], axis=-1)
    sine = np.linalg.norm(w, axis=-1)
    cosine = 0.5 * (np.trace(r, axis1=-2, axis2=-1) - 1)
    angle = np.arctan2(sine, cosine)
    return np.asarray(w / np.sinc(angle / np.pi)[..., None])


def screw(x: Array) -> tuple[Array, Array]:
    """Translation and rotation of exp(x)."""
    v, u = x[..., :3], x[..., 3:]
    square = np.sum(u * u, axis=-1)
    angle = np.sqrt(square)
    b = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    # (angle - sin) / angle^3; its series where the quotient loses digits
    small = angle < 1e-2
    safe = np.where(small, 1.0, angle)
    c = np.where(small, 1 / 6 - square / 120, (safe - np.sin(safe)) / safe**3)
    uv = cross(u, v)
    return v + b[..., None] * uv + c[..., None] * cross(u, uv), turn(u)


def twist(p: Array, r: Array) -> Array:
    """The twist whose `screw` is (p, r)."""
    u = rotation_vector(r)
    square = np.sum(u * u, axis=-1)
    c = 1 / 12 + square / 720 + square**2 / 30240
    up = cross(u, p)
    return np.concatenate([p - 0.5 * up + c[..., None] * cross(u, up), u], axis=-1)


def adjoint(x: Array) -> Array:
    """ad(x), 6 x 6: ad(x) y = (u x y_v + v x y_u, u x y_u)."""
    out = np.zeros((*x.shape, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = hat(x[..., 3:])
    out[..., :3, 3:] = hat(x[..., :3])
    return out


def log_derivatives(x: Array) -> tuple[Array, Array]:
    """(behind, front) with log(exp(-a) exp(x) exp(b)) = x - behind a + front b to first order.

    Bernoulli series to the fourth order: exact to 1e-9 for segments that turn by less than 0.3 rad.
    """
    ad = adjoint(x)
    square = ad @ ad
    even = np.eye(6) + square / 12 - square @ square / 720
    return even - 0.5 * ad, even + 0.5 * ad
