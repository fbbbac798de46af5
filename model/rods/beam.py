"""The limit of small deflections: a cantilever by beam theory with shear (Timoshenko), in closed form.

With loads on the undeformed rod, n(s) = F + int_s^L f,  m(s) = M + int_s^L e3 x n,  and to first order in the turn phi
    phi' = K_bt^-1 m + u*   p' = K_se^-1 n + v* + phi x e3
F and M are all forces (N) and moments (N m) at the tip, f the load (N/m). It is what the other methods come to under
small loads (the error grows with the second power of the turn), and what stiffness trials are read by: eq. 8 and 9.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from model.errors import BadCondition
from model.rods.description import Rods
from model.rods.solution import Solution, Status, assembled
from model.rotation import from_vector

Array = NDArray[np.float64]
E3 = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Beam:
    """Beam theory; every rod is SOLVED, there being no buckling in it, and `margin` is NaN.

    Raises `BadCondition` for supports, springs and hyperelastic or graded sections, which it does not know, and for a
    start, since there is nothing to iterate.
    """

    def solve(self, rods: Rods, arcs: Array | None = None, start: Solution | None = None) -> Solution:
        """See `model.rods.solver.solve`."""
        rods.refuse_terms("Beam", "rest_strain")
        if start is not None:
            raise BadCondition("start: the method Beam is a closed form and takes no start; leave it out")
        n, length = len(rods), rods.field("length")
        ends = np.cumsum(length, axis=1)
        places = np.concatenate([np.zeros((n, 0)) if arcs is None else arcs, ends[:, -1:]], axis=1)
        force, moment = _wrenches(rods)
        turn, position = np.zeros((n, 3)), np.zeros((n, 3))
        shape = np.zeros((n, places.shape[1], 3))
        for e in range(rods.form.elements):
            bottom = ends[:, e] - length[:, e]
            within = _Element(rods, e, force[:, e + 1], moment[:, e + 1])
            t = np.clip(places - bottom[:, None], 0.0, length[:, e, None])
            here = position[:, None] + within.shift(t) + t[..., None] * np.cross(turn, E3)[:, None]
            shape = np.where((places >= bottom[:, None])[..., None], here, shape)
            position = position + within.shift(length[:, e, None])[:, 0] + length[:, e, None] * np.cross(turn, E3)
            turn = turn + within.turn(length[:, e, None])[:, 0]
        tip = from_vector(turn)
        orientation = np.where(tip[:, :1] < 0, -tip, tip)
        status = np.full(n, Status.SOLVED, np.int8)
        return assembled(shape[:, -1], orientation, force[:, 0], moment[:, 0], status, shape[:, :-1])


BEAM = Beam()


class _Element:
    """An element under the force and moment (n, 3) at its tip end; t (n, k) m is the distance from its base end."""

    def __init__(self, rods: Rods, e: int, force: Array, moment: Array) -> None:
        self.length = rods.field("length")[:, e, None, None]
        self.force, self.moment, self.load = force[:, None], moment[:, None], rods.field("load")[:, e, None]
        self.bend = rods.field("bend_stiffness")[:, e, None]
        self.stretch = rods.field("stretch_stiffness")[:, e, None]
        self.curvature = rods.field("rest_curvature")[:, e, None]
        self.strain = rods.field("rest_strain")[:, e, None]

    def turn(self, t: Array) -> Array:
        """int_0^t u, (n, k, 3) rad."""
        t, l = t[..., None], self.length
        lever = self.force * (l * t - t**2 / 2) + self.load * (l**2 * t - l * t**2 + t**3 / 3) / 2
        return np.asarray((self.moment * t + np.cross(E3, lever)) / self.bend + self.curvature * t)

    def shift(self, t: Array) -> Array:
        """int_0^t (v + phi x e3), phi counted from the element's base end, (n, k, 3) m."""
        t, l = t[..., None], self.length
        lever = self.force * (l * t**2 / 2 - t**3 / 6) + self.load * (l**2 * t**2 / 2 - l * t**3 / 3 + t**4 / 12) / 2
        turned = (self.moment * t**2 / 2 + np.cross(E3, lever)) / self.bend + self.curvature * t**2 / 2
        stretched = (self.force * t + self.load * (l * t - t**2 / 2)) / self.stretch
        return np.asarray(self.strain * t + stretched + np.cross(turned, E3))


def _wrenches(rods: Rods) -> tuple[Array, Array]:
    """n and m (n, elements + 1, 3) at the base and at the tip end of every element."""
    count, length = rods.form.elements, rods.field("length")
    force, moment = (np.zeros((len(rods), count + 1, 3)) for _ in range(2))
    force[:, -1] = rods.field("tip_force") + rods.field("dead_force")
    moment[:, -1] = rods.field("tip_moment") + rods.field("dead_moment")
    for e in range(count - 1, -1, -1):
        long, load = length[:, e, None], rods.field("load")[:, e]
        force[:, e] = force[:, e + 1] + long * load
        moment[:, e] = moment[:, e + 1] + np.cross(E3, long * force[:, e + 1] + long**2 / 2 * load)
    return force, moment


def bar_deflection(length: float, load_at: float, bend_stiffness: float) -> float:
    """y(L) / F (m/N) of a uniform bar of `length` L (m), clamped at 0 and pushed at x = `load_at` (m); eq. 8, at x = L eq. 9:

    y = F (3 L - x) x^2 / (6 E I), with E I = `bend_stiffness` (N m^2).
    """
    return (3 * length - load_at) * load_at**2 / (6 * bend_stiffness)


def bending_compliance(edges: Sequence[ArrayLike], bend_stiffness: Sequence[ArrayLike]) -> Array:
    """Deflection by bending per force at the tip (m/N) of a bar of parts: sum ((L - s_e)^3 - (L - s_e+1)^3) / (3 E I_e).

    `edges` are the arc lengths s_0 = 0, ..., L (m) where the parts begin and end, `bend_stiffness` E I of each (N m^2), of
    any shapes that broadcast.
    """
    tip = np.asarray(edges[-1], float)
    reach = [(tip - s) ** 3 for s in edges]
    return np.asarray(
        sum((a - b) / (3 * np.asarray(k)) for a, b, k in zip(reach[:-1], reach[1:], bend_stiffness, strict=True))
    )


def shear_compliance(edges: Sequence[ArrayLike], shear_stiffness: Sequence[ArrayLike]) -> Array:
    """Deflection by shear per force at the tip (m/N): sum (s_e+1 - s_e) / (G A_e), see `bending_compliance`; G A in N."""
    return np.asarray(
        sum((np.asarray(b) - a) / np.asarray(k) for a, b, k in zip(edges[:-1], edges[1:], shear_stiffness, strict=True))
    )
