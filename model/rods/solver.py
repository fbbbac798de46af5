"""Solving rods: one call for every method.

    from model.rods import FINE, PAPER, Form, rods, solve
    batch = rods(Form(elements=2), n, length=..., bend_stiffness=..., stretch_stiffness=..., tip_force=..., load=...)
    found = solve(batch)                               # fast, within 0.01 mm
    found = solve(batch, FINE, arc_lengths=[0.1, 0.2])  # fast, within 1e-5 mm; positions in found.shape
    found = solve(batch, PAPER)                        # explicit Euler and fsolve, as published
    found.tip, found.orientation, found.converged

All methods solve the same static Cosserat rod (docs/explanations/model.md and `fast.equations`; eq. 1, 2, 4, 5 of the paper).
"""

from __future__ import annotations

from typing import Protocol

from numpy.typing import ArrayLike

from model.arrays import Array
from model.rods.description import Rods
from model.rods.fast.method import FAST
from model.rods.solution import Solution


class Method(Protocol):
    """A way to solve rods: `Fast`, `Paper`, or one of your own."""

    def solve(self, rods: Rods, arcs: Array | None, start: Solution | None) -> Solution:
        """Equilibria of checked rods; positions at `arcs` (n, k) m, where given, in `shape`. Raises `BadCondition` for rods
        with terms, or a start, that the method does not know."""
        ...


def solve(rods: Rods, method: Method = FAST, *, arc_lengths: ArrayLike | None = None, start: Solution | None = None) -> Solution:
    """Equilibrium of every rod of a checked batch, by the method asked for.

    `arc_lengths` (k,) or (n, k), m from the base, get positions in `Solution.shape`. `start` is a solution of nearly the
    same rods (`Fast` with remember=True). A rod without a trusted equilibrium is no error: its `status` says why and its
    numbers are NaN; `Solution.trusted` raises. Raises `BadCondition` for arc lengths that are not on the rod, and for rods
    that the method cannot solve. The rods are not checked again: `Rods.check` does.

    >>> from model.rods import Form, rods, solve
    >>> one = rods(Form(elements=1), 1, length=0.4, bend_stiffness=2.0, stretch_stiffness=800.0, dead_force=[0.1, 0, 0])
    >>> solve(one).tip.round(4).tolist()
    [[0.0011, 0.0, 0.4]]
    """
    return method.solve(rods, None if arc_lengths is None else rods.arcs(arc_lengths), start)
