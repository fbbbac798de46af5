"""What a solved rod does between base and tip: position, orientation, internal wrench and axial strain."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from model.arrays import Array
from model.rods.description import Rods
from model.rods.fast.method import FAST, Fast, steps_of
from model.rods.fast.walk import AT_FORCE, AT_MOMENT, AT_PLACE, AT_STRAIN, AT_TURN, states_at
from model.rods.solution import Solution


@dataclass(frozen=True)
class Stations:
    """k stations of n rods, mount frame; NaN where the rod was not solved."""

    values: Array
    """(n, k, WIDTH)."""

    @property
    def position(self) -> Array:
        """(n, k, 3) m."""
        return self.values[..., AT_PLACE : AT_PLACE + 3]

    @property
    def orientation(self) -> Array:
        """(n, k, 4) unit quaternion w, x, y, z of the section frame."""
        return self.values[..., AT_TURN : AT_TURN + 4]

    @property
    def force(self) -> Array:
        """(n, k, 3) N, internal force."""
        return self.values[..., AT_FORCE : AT_FORCE + 3]

    @property
    def moment(self) -> Array:
        """(n, k, 3) N m, internal moment."""
        return self.values[..., AT_MOMENT : AT_MOMENT + 3]

    @property
    def strain(self) -> Array:
        """(n, k) 1: axial strain v3 - 1."""
        return self.values[..., AT_STRAIN]


def stations(rods: Rods, solution: Solution, arc_lengths: ArrayLike, method: Fast = FAST) -> Stations:
    """The rods at arc lengths (k,) or (n, k) in m from the base, by the method of the solution; one pass a rod, nothing is
    solved. Raises `BadCondition` for arc lengths that are not on the rod."""
    arcs = rods.arcs(arc_lengths)
    return Stations(states_at(rods, solution, arcs, method.divisions, steps_of(rods, method.steps)))


_gauss = lru_cache(np.polynomial.legendre.leggauss)


def gauss_points(rods: Rods, points: int = 8) -> tuple[Array, Array]:
    """Arc lengths (n, elements points) in m, element by element, and weights (points,), of sum 1, of Gauss's rule."""
    places, weights = _gauss(points)
    length = rods.field("length")
    ends = np.cumsum(length, axis=1)
    arcs = (ends - length)[:, :, None] + length[:, :, None] * (0.5 * (1 + places))
    return np.minimum(arcs, ends[:, -1:, None]).reshape(len(rods), length.shape[1] * points), 0.5 * weights
