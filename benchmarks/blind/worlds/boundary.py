"""Forms of the effects of the base: how it was tilted and how it gives. x (n,) is the size in the unit of the form."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .body import Body
from .frames import turn

Array = NDArray[np.float64]


# ------------------------------------------------------------------ base_tilt
def _tilted(b: Body, angle: Array, arm: tuple[float, float, float]) -> None:
    """Turned about the point at -arm (m) from the base."""
    a = b.lanes.places.tilt
    rotation = turn(angle[:, None] * np.array([-np.sin(a), np.cos(a), 0.0]))
    b.base_turn = rotation @ b.base_turn
    b.base_place = b.base_place + rotation @ np.array(arm) - np.array(arm)


def tilt_about_a_lever(b: Body, x: Array) -> None:
    """Turned by x (rad) about a point 60 mm above the base: a bent bracket."""
    _tilted(b, x, (0.0, 0.0, 0.06))


def tilt_about_a_corner(b: Body, x: Array) -> None:
    """Turned by x about the base's edge, 50 mm off the axis: one screw is loose."""
    a = b.lanes.places.tilt
    _tilted(b, x, (0.05 * float(np.cos(a)), 0.05 * float(np.sin(a)), 0.0))


def tilt_below(b: Body, x: Array) -> None:
    """Turned by x about a point 40 mm below the base: it swung in its ring."""
    _tilted(b, x, (0.0, 0.0, -0.04))


# ------------------------------------------------------------------ base_compliance
def give_with_shift(b: Body, x: Array) -> None:
    """Turns by x (rad/(N m)) and shifts by 3 mm/N x: a plate on soft feet."""

    def law(w: Array) -> tuple[Array, Array]:
        c = np.zeros((len(x), 6, 6))
        for i in (3, 4):
            c[:, i, i] = x
        for i in (0, 1):
            c[:, i, i] = 3e-3 * x
        return np.einsum("nij,nj->ni", c, w), c

    b.give = law


def give_hinge(b: Body, x: Array) -> None:
    """Turns by 1.2 x about one horizontal axis, by 0.7 x about the other."""
    a = b.lanes.places.other
    axis = np.array([np.cos(a), np.sin(a)])
    shape = 1.2 * np.outer(axis, axis) + 0.7 * (np.eye(2) - np.outer(axis, axis))

    def law(w: Array) -> tuple[Array, Array]:
        c = np.zeros((len(x), 6, 6))
        c[:, 3:5, 3:5] = x[:, None, None] * shape
        return np.einsum("nij,nj->ni", c, w), c

    b.give = law


def give_with_play(b: Body, x: Array) -> None:
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
