"""A rod as a chain of rigid frames joined by deformable segments: shape, strain and the loads it can carry.

Node i has a position r_i and an orientation q_i (unit quaternion); segment k joins nodes k and k+1. With the middle
frame R of the two and d = r_(k+1) - r_k, the segment's strain is constant:

    shear, stretch = R^T d / h,    curvature, twist = log(q_k^* q_(k+1)) / h

Conditions of balance: balance.py.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .blocks import kernel, rotation

Array = NDArray[np.float64]


class Chain(NamedTuple):
    """Shape of the rod."""

    r: Array
    """(n+1, 3) Node positions, m."""
    q: Array
    """(n+1, 4) Node orientations, unit quaternions w, x, y, z."""
    h: Array
    """(n) Segment lengths without load, m."""


class ChainLoads(NamedTuple):
    """What acts on the nodes."""

    force: Array
    """(n+1, 3) Dead forces, N, world."""
    follower_force: Array
    """(3) Force on the last node that turns with it, N."""
    follower_moment: Array
    """(n+1, 3) Moments that turn with their nodes, N m."""
    spring: Array
    """(4) Spring at the last node: stiffness (N/m) and anchor (m, world)."""
    contacts: Array
    """(c, 9) One-sided contacts: node k, weight w of node k+1, direction (3), level (m), soft depth (m), soft
    stiffness, stiffness (N/m). The point p = (1-w) r_k + w r_(k+1) is pressed along the direction once it falls short
    of the level."""
    base: Array
    """(4) Orientation of the base (quaternion)."""


def straight(h: Array) -> Chain:
    """A straight, unloaded chain along +z from the origin."""
    n = len(h)
    r = np.zeros((n + 1, 3))
    r[1:, 2] = np.cumsum(h)
    q = np.zeros((n + 1, 4))
    q[:, 0] = 1.0
    return Chain(r, q, np.ascontiguousarray(h))


@kernel
def relative_rotation(p: Array, q: Array, out: Array) -> None:
    """Rotation vector (rad) of p^* q, for rotations below pi."""
    w = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3]
    x = p[0] * q[1] - p[1] * q[0] - p[2] * q[3] + p[3] * q[2]
    y = p[0] * q[2] - p[2] * q[0] - p[3] * q[1] + p[1] * q[3]
    z = p[0] * q[3] - p[3] * q[0] - p[1] * q[2] + p[2] * q[1]
    s = np.sqrt(x * x + y * y + z * z)
    f = 2.0 + s * s / 3.0 if s < 1e-4 else 2.0 * np.arctan2(s, abs(w)) / s
    if w < 0.0:
        f = -f
    out[0] = f * x
    out[1] = f * y
    out[2] = f * z


@kernel
def segment_strain(chain: Chain, k: int, mid: Array, frame: Array, d: Array, strain: Array) -> None:
    """Middle frame, chord and strain of segment k."""
    h = chain.h[k]
    dot = 0.0
    for i in range(4):
        dot += chain.q[k, i] * chain.q[k + 1, i]
    sign = -1.0 if dot < 0.0 else 1.0
    norm = 0.0
    for i in range(4):
        mid[i] = chain.q[k, i] + sign * chain.q[k + 1, i]
        norm += mid[i] * mid[i]
    norm = 1.0 / np.sqrt(norm)
    for i in range(4):
        mid[i] *= norm
    rotation(mid, frame)
    relative_rotation(chain.q[k], chain.q[k + 1], strain[3:])
    for i in range(3):
        strain[3 + i] /= h
        d[i] = chain.r[k + 1, i] - chain.r[k, i]
    for i in range(3):
        strain[i] = (frame[0, i] * d[0] + frame[1, i] * d[1] + frame[2, i] * d[2]) / h
    strain[2] -= 1.0
