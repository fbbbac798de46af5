"""Vectors (3 numbers), quaternions (w, x, y, z) and lists of numbers as tuples, for use inside kernels."""

from __future__ import annotations

from model.rods.fast.compiler import fused, inline

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


@inline
def cross(a: Vector, b: Vector) -> Vector:
    """a x b."""
    return (fused(a[1], b[2], -(a[2] * b[1])), fused(a[2], b[0], -(a[0] * b[2])), fused(a[0], b[1], -(a[1] * b[0])))


@inline
def plus_cross(c: Vector, a: Vector, b: Vector) -> Vector:
    """c + a x b."""
    return (
        fused(a[1], b[2], fused(-a[2], b[1], c[0])),
        fused(a[2], b[0], fused(-a[0], b[2], c[1])),
        fused(a[0], b[1], fused(-a[1], b[0], c[2])),
    )


@inline
def add(a: Vector, b: Vector) -> Vector:
    """a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@inline
def minus(a: Vector, b: Vector) -> Vector:
    """a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@inline
def times(a: Vector, b: Vector) -> Vector:
    """a b, entry by entry."""
    return (a[0] * b[0], a[1] * b[1], a[2] * b[2])


@inline
def along(a: Vector, h: float, b: Vector) -> Vector:
    """a + h b."""
    return (fused(h, b[0], a[0]), fused(h, b[1], a[1]), fused(h, b[2], a[2]))


@inline
def plus_times(c: Vector, a: Vector, b: Vector) -> Vector:
    """c + a b, entry by entry."""
    return (fused(a[0], b[0], c[0]), fused(a[1], b[1], c[1]), fused(a[2], b[2], c[2]))


@inline
def scaled(h: float, a: Vector) -> Vector:
    """h a."""
    return (h * a[0], h * a[1], h * a[2])


@inline
def unit(k: int) -> Vector:
    """Along axis k."""
    return (1.0 if k == 0 else 0.0, 1.0 if k == 1 else 0.0, 1.0 if k == 2 else 0.0)


@inline
def dot(a: Vector, b: Vector) -> float:
    """a . b."""
    return fused(a[0], b[0], fused(a[1], b[1], a[2] * b[2]))


@inline
def turned(q: Quaternion, a: Vector) -> Vector:
    """R(q) a."""
    r = (q[1], q[2], q[3])
    t = scaled(2.0, cross(r, a))
    return plus_cross(along(a, q[0], t), r, t)


@inline
def conjugate(q: Quaternion) -> Quaternion:
    """The way back."""
    return (q[0], -q[1], -q[2], -q[3])


@inline
def turned_back(q: Quaternion, a: Vector) -> Vector:
    """R(q)^T a."""
    return turned(conjugate(q), a)


@inline
def product(a: Quaternion, b: Quaternion) -> Quaternion:
    """a b: first b, then a."""
    v, w = (a[1], a[2], a[3]), (b[1], b[2], b[3])
    x, y, z = plus_cross(along(scaled(b[0], v), a[0], w), v, w)
    return (fused(a[0], b[0], -dot(v, w)), x, y, z)
