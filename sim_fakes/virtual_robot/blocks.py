"""Small dense blocks and the block-tridiagonal elimination of a chain."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import numba
import numpy as np
from llvmlite import binding
from numba.core import config
from numba.core.codegen import get_host_cpu_features
from numpy.typing import NDArray

# Numba asks for the processor's features once, at the first decorator of a process, and machine code on disk is good for those
# only. As in the rod kernels: else a process with both compiles one of them anew, depending on which was imported first.
_numba: Any = config
if _numba.CPU_FEATURES is None and binding.get_host_cpu_features().get("avx512f", False):
    _numba.CPU_FEATURES = get_host_cpu_features() + ",-prefer-256-bit"

kernel = numba.njit(cache=True, nogil=True, error_model="numpy")
"""Decorator: compiled once and cached, runs without the interpreter lock; strictly rounded, so that bits repeat."""


def forget_stale_cache(folder: Path) -> None:
    """Delete the cache indices in `folder` that are older than any of its sources: Numba watches a function's own file only."""
    newest = max(source.stat().st_mtime for source in folder.glob("*.py"))
    for index in (folder / "__pycache__").glob("*.nbi"):
        with suppress(FileNotFoundError):  # another process has deleted it
            if index.stat().st_mtime < newest:
                index.unlink()


forget_stale_cache(Path(__file__).parent)

Array = NDArray[np.float64]


@kernel
def rotation(q: Array, out: Array) -> None:
    """Rotation matrix of a unit quaternion (w, x, y, z)."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    out[0, 0] = 1 - 2 * (y * y + z * z)
    out[0, 1] = 2 * (x * y - w * z)
    out[0, 2] = 2 * (x * z + w * y)
    out[1, 0] = 2 * (x * y + w * z)
    out[1, 1] = 1 - 2 * (x * x + z * z)
    out[1, 2] = 2 * (y * z - w * x)
    out[2, 0] = 2 * (x * z - w * y)
    out[2, 1] = 2 * (y * z + w * x)
    out[2, 2] = 1 - 2 * (x * x + y * y)


@kernel
def turn(q: Array, dx: float, dy: float, dz: float) -> None:
    """q <- exp(d) q for a rotation vector d (rad) in the world frame."""
    angle = np.sqrt(dx * dx + dy * dy + dz * dz)
    half = 0.5 - angle * angle / 48 if angle < 1e-3 else np.sin(angle / 2) / angle
    c = np.cos(angle / 2)
    x, y, z = half * dx, half * dy, half * dz
    w0, x0, y0, z0 = q[0], q[1], q[2], q[3]
    q[0] = c * w0 - x * x0 - y * y0 - z * z0
    q[1] = c * x0 + x * w0 + y * z0 - z * y0
    q[2] = c * y0 + y * w0 + z * x0 - x * z0
    q[3] = c * z0 + z * w0 + x * y0 - y * x0
    norm = np.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
    for i in range(4):
        q[i] /= norm


@kernel
def cross_matrix(v: Array, m: Array, factor: float, out: Array) -> None:
    """out = factor * [v]x m for 3 x 3 matrices."""
    for j in range(3):
        out[0, j] = factor * (v[1] * m[2, j] - v[2] * m[1, j])
        out[1, j] = factor * (v[2] * m[0, j] - v[0] * m[2, j])
        out[2, j] = factor * (v[0] * m[1, j] - v[1] * m[0, j])


@kernel
def matrix_cross(m: Array, v: Array, factor: float, out: Array) -> None:
    """out = factor * m [v]x for 3 x 3 matrices."""
    for i in range(3):
        a, b, c = m[i, 0], m[i, 1], m[i, 2]
        out[i, 0] = factor * (b * v[2] - c * v[1])
        out[i, 1] = factor * (c * v[0] - a * v[2])
        out[i, 2] = factor * (a * v[1] - b * v[0])


@kernel
def add_skew(v: Array, factor: float, out: Array) -> None:
    """out += factor * [v]x."""
    out[0, 1] -= factor * v[2]
    out[0, 2] += factor * v[1]
    out[1, 0] += factor * v[2]
    out[1, 2] -= factor * v[0]
    out[2, 0] -= factor * v[1]
    out[2, 1] += factor * v[0]


@kernel
def _divide(b: Array, a: Array, g: Array) -> None:
    """a <- b^-1 a and g <- b^-1 g by elimination in place (b 6 x 6, destroyed), without pivots: b is far from singular."""
    for p in range(6):
        inv = 1.0 / b[p, p]
        for i in range(p + 1, 6):
            f = b[i, p] * inv
            if f != 0.0:
                for j in range(p + 1, 6):
                    b[i, j] -= f * b[p, j]
                for j in range(6):
                    a[i, j] -= f * a[p, j]
                g[i] -= f * g[p]
    for p in range(5, -1, -1):
        inv = 1.0 / b[p, p]
        for i in range(p + 1, 6):
            f = b[p, i]
            for j in range(6):
                a[p, j] -= f * a[i, j]
            g[p] -= f * g[i]
        for j in range(6):
            a[p, j] *= inv
        g[p] *= inv


@kernel
def solve_chain(low: Array, diag: Array, up: Array, g: Array) -> None:
    """Solve low_i x_(i-1) + diag_i x_i + up_i x_(i+1) = g_i, blocks of 6; x replaces g, the matrix is destroyed.

    Eliminated from the free end towards the base, which is fixed: x_0 is zero and row 0 is not used.
    """
    n = diag.shape[0]
    for i in range(n - 1, 0, -1):
        _divide(diag[i], low[i], g[i])
        c = up[i - 1]
        d = diag[i - 1]
        a = low[i]
        for p in range(6):
            for k in range(6):
                f = c[p, k]
                for j in range(6):
                    d[p, j] -= f * a[k, j]
                g[i - 1, p] -= f * g[i, k]
    g[0, :] = 0.0
    for i in range(1, n):
        for p in range(6):
            for j in range(6):
                g[i, p] -= low[i, p, j] * g[i - 1, j]
