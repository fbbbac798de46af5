"""Vectors (3 numbers), quaternions (w, x, y, z) and lists of numbers as tuples, for use inside kernels."""

from __future__ import annotations

from model.rods.fast.jit import inline

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
State = tuple[float, float, float, float, float, float, float, float, float, float]


@inline
def cross(a: Vector, b: Vector) -> Vector:
    """a x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@inline
def add(a: Vector, b: Vector) -> Vector:
    """a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@inline
def times(a: Vector, b: Vector) -> Vector:
    """a b, entry by entry."""
    return (a[0] * b[0], a[1] * b[1], a[2] * b[2])


@inline
def along(a: Vector, h: float, b: Vector) -> Vector:
    """a + h b."""
    return (a[0] + h * b[0], a[1] + h * b[1], a[2] + h * b[2])


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
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inline
def turned(q: Quaternion, a: Vector) -> Vector:
    """R(q) a."""
    r = (q[1], q[2], q[3])
    t = cross(r, a)
    t = (2.0 * t[0], 2.0 * t[1], 2.0 * t[2])
    return add(along(a, q[0], t), cross(r, t))


@inline
def turned_back(q: Quaternion, a: Vector) -> Vector:
    """R(q)^T a."""
    return turned((q[0], -q[1], -q[2], -q[3]), a)


@inline
def product(a: Quaternion, b: Quaternion) -> Quaternion:
    """a b: first b, then a."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] + a[2] * b[0] + a[3] * b[1] - a[1] * b[3],
        a[0] * b[3] + a[3] * b[0] + a[1] * b[2] - a[2] * b[1],
    )


@inline
def plus(y: State, h: float, k: State) -> State:
    """y + h k for the ten numbers of a rod's state."""
    return (
        y[0] + h * k[0],
        y[1] + h * k[1],
        y[2] + h * k[2],
        y[3] + h * k[3],
        y[4] + h * k[4],
        y[5] + h * k[5],
        y[6] + h * k[6],
        y[7] + h * k[7],
        y[8] + h * k[8],
        y[9] + h * k[9],
    )
