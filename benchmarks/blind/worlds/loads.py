"""Forms of the effects that load the body or hold its base. x (n,) is the size in the unit of the form."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from .body import WorldBody
from .equilibrium import Shape
from .frames import turn
from .robot import AREA, DENSITY

Array = NDArray[np.float64]

PER_LENGTH = DENSITY * AREA
"""kg/m of the body."""


# ------------------------------------------------------------------ self_weight
def hose_on_the_base(b: WorldBody, x: Array) -> None:
    """Weight (1 + 1.6 x) over the first 60 %: hoses are tied there."""
    b.line += PER_LENGTH * 1.6 * x[:, None] * np.clip((0.65 - b.along()) / 0.1, 0, 1)


def weight_of_the_spine(b: WorldBody, x: Array) -> None:
    """Weight (1 + x), and as much again where the spine is: granules weigh."""
    b.line += PER_LENGTH * x[:, None] * (0.8 + 0.6 * b.cover)


def weight_of_fittings(b: WorldBody, x: Array) -> None:
    """Half of the extra weight spread, half as a clamp at two thirds."""
    b.line += PER_LENGTH * 0.5 * x[:, None]
    whole = PER_LENGTH * 0.5 * x * b.lanes.length
    b.node_mass += whole[:, None] * _hat(b, 0.667)


def weight_to_the_tip(b: WorldBody, x: Array) -> None:
    """Weight (1 + 1.5 x a^0.5)."""
    b.line += PER_LENGTH * 1.5 * x[:, None] * np.sqrt(b.along())


def _hat(b: WorldBody, place: float) -> Array:
    """(n, N + 1) shares that put a point at this part of the body onto its two nearest frames."""
    nodes = b.nodes()
    at = np.minimum(place * b.lanes.length[:, None], nodes[:, -1:])
    right = np.clip((at - nodes[:, :-1]) / b.h, 0, 1)
    inside = (nodes[:, :-1] < at) & (at <= nodes[:, 1:])
    out = np.zeros_like(nodes)
    out[:, 1:] += np.where(inside, right, 0.0)
    out[:, :-1] += np.where(inside, 1 - right, 0.0)
    return out


# ------------------------------------------------------------------ tether_load
def _direction(b: WorldBody) -> Array:
    a = b.lanes.places.tether
    return np.array([np.cos(a), np.sin(a), 0.0])


def tether_to_a_point(b: WorldBody, x: Array) -> None:
    """x N from the tip towards a point 0.7 m aside and 0.1 m above it: a hose over a pulley."""
    end = 0.7 * _direction(b) + np.array([0.0, 0.0, 0.3])
    sign = np.sign(x)[:, None]

    def force(shape: Shape) -> tuple[Array, Array]:
        out = np.zeros_like(shape.r)
        way = end * sign - shape.r[:, -1]
        out[:, -1] = np.abs(x)[:, None] * way / np.linalg.norm(way, axis=1, keepdims=True)
        return out, np.zeros((*shape.r.shape, 3))

    b.fields.append(force)


def tether_spread(b: WorldBody, x: Array) -> None:
    """x N in all, evenly over the last quarter: a ribbon cable hangs on it."""
    weights = np.clip((b.nodes() / b.lanes.length[:, None] - 0.72) / 0.06, 0, 1)
    weights /= weights.sum(axis=1, keepdims=True)
    pull = 1.1 * x[:, None, None] * weights[..., None] * _direction(b)
    b.fields.append(lambda shape: (pull, np.zeros((*shape.r.shape, 3))))


def tether_stiffening(b: WorldBody, x: Array) -> None:
    """x (1 + d / 0.15 m)^2 at the tip, d its way against the pull: a loop that tightens."""
    direction = _direction(b)

    def force(shape: Shape) -> tuple[Array, Array]:
        out = np.zeros_like(shape.r)
        away = -shape.r[:, -1] @ direction * np.sign(x)
        stretch = np.maximum(1 + away / 0.15, 0.0)
        out[:, -1] = (0.6 * x * stretch**2)[:, None] * direction
        slope = np.zeros((*shape.r.shape, 3))
        slope[:, -1] = (-np.abs(x) * 1.2 * stretch / 0.15)[:, None, None] * np.outer(direction, direction)
        return out, slope

    b.fields.append(force)


# ------------------------------------------------------------------ contact
def _obstacle(
    b: WorldBody, law: Callable[[Array], tuple[Array, Array]], x: Array, weights: Array, normal: Array, further: float = 0.0
) -> None:  # fmt: skip
    """Force x law(depth) along `normal` on frames by `weights`; the face is met at the place of the robot."""
    gap = b.lanes.places.obstacle + further

    def force(shape: Shape) -> tuple[Array, Array]:
        depth = -gap - shape.r @ normal
        size, slope = law(np.maximum(depth, 0.0))
        scaled = x[:, None] * weights
        out = (scaled * size)[..., None] * normal
        stiff = -(scaled * np.where(depth > 0, slope, 0.0))[..., None, None] * np.outer(normal, normal)
        return out, stiff

    b.fields.append(force)


def contact_hertz(b: WorldBody, x: Array) -> None:
    """x N/m times d (d / 20 mm)^0.5 at nine tenths of the body: round against flat."""

    def law(d: Array) -> tuple[Array, Array]:
        return d * np.sqrt(d / 0.02), 1.5 * np.sqrt(d / 0.02)

    _obstacle(b, law, x, _hat(b, 0.9), np.array([1.0, 0.0, 0.0]))


def contact_slanted(b: WorldBody, x: Array) -> None:
    """A wall that leans 25 degrees, x N/m on each of the outer frames that it meets."""
    normal = np.array([np.cos(np.radians(25.0)), 0.0, -np.sin(np.radians(25.0))])
    weights = np.clip((b.nodes() / b.lanes.length[:, None] - 0.7) / 0.1, 0, 1) * 0.35

    def law(d: Array) -> tuple[Array, Array]:
        return d, np.ones_like(d)

    _obstacle(b, law, x, weights, normal, 0.169)


def contact_foam(b: WorldBody, x: Array) -> None:
    """x N/m at first, half of it beyond 25 mm: foam, at the tip."""

    def law(d: Array) -> tuple[Array, Array]:
        return 0.5 * d + 0.0125 * (1 - np.exp(-d / 0.025)), 0.5 + 0.5 * np.exp(-d / 0.025)

    _obstacle(b, law, x, _hat(b, 1.0), np.array([1.0, 0.0, 0.0]))


# ------------------------------------------------------------------ tip_payload
def payload_on_a_rod(b: WorldBody, x: Array) -> None:
    """x kg, 45 mm beyond the tip on a rod that goes on as the last segment does: two forces on its frames."""
    weight = x[:, None] * b.gravity
    share = (0.045 / b.h[:, -1])[:, None]
    force = np.zeros((*b.nodes().shape, 3))
    force[:, -1], force[:, -2] = (1 + share) * weight, -share * weight
    b.fields.append(lambda shape: (force, np.zeros((*shape.r.shape, 3))))


# ------------------------------------------------------------------ base_tilt
def _tilted(b: WorldBody, angle: Array, arm: tuple[float, float, float]) -> None:
    """Turned about the point at -arm (m) from the base."""
    a = b.lanes.places.tilt
    rotation = turn(angle[:, None] * np.array([-np.sin(a), np.cos(a), 0.0]))
    b.base_turn = rotation @ b.base_turn
    b.base_place = b.base_place + rotation @ np.array(arm) - np.array(arm)


def tilt_about_a_lever(b: WorldBody, x: Array) -> None:
    """Turned by x (rad) about a point 60 mm above the base: a bent bracket."""
    _tilted(b, x, (0.0, 0.0, 0.06))


def tilt_about_a_corner(b: WorldBody, x: Array) -> None:
    """Turned by x about the base's edge, 50 mm off the axis: one screw is loose."""
    a = b.lanes.places.tilt
    _tilted(b, x, (0.05 * float(np.cos(a)), 0.05 * float(np.sin(a)), 0.0))


def tilt_below(b: WorldBody, x: Array) -> None:
    """Turned by x about a point 40 mm below the base: it swung in its ring."""
    _tilted(b, x, (0.0, 0.0, -0.04))


# ------------------------------------------------------------------ base_compliance
def give_with_shift(b: WorldBody, x: Array) -> None:
    """Turns by x (rad/(N m)) and shifts by 3 mm/N x: a plate on soft feet."""

    def law(w: Array) -> tuple[Array, Array]:
        c = np.zeros((len(x), 6, 6))
        for i in (3, 4):
            c[:, i, i] = x
        for i in (0, 1):
            c[:, i, i] = 3e-3 * x
        return np.einsum("nij,nj->ni", c, w), c

    b.give = law


def give_hinge(b: WorldBody, x: Array) -> None:
    """Turns by 1.2 x about one horizontal axis, by 0.7 x about the other."""
    a = b.lanes.places.other
    axis = np.array([np.cos(a), np.sin(a)])
    shape = 1.2 * np.outer(axis, axis) + 0.7 * (np.eye(2) - np.outer(axis, axis))

    def law(w: Array) -> tuple[Array, Array]:
        c = np.zeros((len(x), 6, 6))
        c[:, 3:5, 3:5] = x[:, None, None] * shape
        return np.einsum("nij,nj->ni", c, w), c

    b.give = law


def give_with_play(b: WorldBody, x: Array) -> None:
    """x M0 (M / M0) / sqrt(1 + (M / M0)^2) beside x / 2 M, M0 = 1 N m: free at first, then tight."""

    def law(w: Array) -> tuple[Array, Array]:
        m = w[:, 3:5]
        size2 = np.sum(m * m, axis=1)
        root = np.sqrt(1 + size2)
        out = np.zeros_like(w)
        out[:, 3:5] = x[:, None] * m * (0.5 + 0.9 / root[:, None])
        c = np.zeros((len(x), 6, 6))
        along = m[:, :, None] * m[:, None, :]
        c[:, 3:5, 3:5] = x[:, None, None] * (
            (0.5 + 0.9 / root)[:, None, None] * np.eye(2) - 0.9 / root[:, None, None] ** 3 * along
        )
        return out, c

    b.give = law
