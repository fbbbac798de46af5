"""What solving rods gives, whatever the method: equilibria of n rods in the mount frame, and how each was found."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from model.arrays import Array, Mask
from model.errors import SolveFailed

AT_TIP, AT_ORIENTATION, AT_FORCE, AT_MOMENT = 0, 3, 7, 10
"""Columns of `Solution.values`: m, quaternion, N, N m; all in the mount frame."""
AT_RESIDUAL, AT_MARGIN, AT_LARGEST, AT_LOAD = 13, 14, 15, 16
"""Residual expected after the last correction (rad, lengths), margin to buckling, largest moment (N m), share of load."""
RESULT = 17


class Status(IntEnum):
    """How the solution of a rod came about."""

    SOLVED = 0
    """Converged, on the near side of every buckling point."""
    SOLVED_IN_STEPS = 1
    """Same, after following the load from zero in steps."""
    OTHER_BRANCH = 2
    """An equilibrium was found, but the rod buckles or snaps before it gets there: no tip is given."""
    FAILED = 3
    """No equilibrium was found: no tip is given."""


@dataclass(frozen=True)
class Solution:
    """Equilibria of n rods. A rod that did not converge holds NaN in `tip`, `orientation`, `base_force`, `base_moment`
    and `shape`; no doubtful number is ever returned.

    The mount frame has its origin at the rod's base; z points from base to tip while the rod is straight and the base not
    turned. What a method does not know (the paper's has no margin to buckling) is NaN.
    """

    values: Array
    """(n, RESULT): what the properties below show, by the columns AT_..."""
    status: NDArray[np.int8]
    """(n,) `Status`: how each solution came about, or why there is none."""
    shape: Array
    """(n, k, 3) m: positions at the k arc lengths that were asked for, in their order."""
    memory: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """What a later solve of nearly the same rods starts from (`Fast.remember`), or no rows."""

    @property
    def tip(self) -> Array:
        """(n, 3) m, p(L)."""
        return self.values[:, AT_TIP : AT_TIP + 3]

    @property
    def orientation(self) -> Array:
        """(n, 4) unit quaternion w, x, y, z of the tip frame in the mount frame, w >= 0: R(L)."""
        return self.values[:, AT_ORIENTATION : AT_ORIENTATION + 4]

    @property
    def base_force(self) -> Array:
        """(n, 3) N, n(0): internal force at the base."""
        return self.values[:, AT_FORCE : AT_FORCE + 3]

    @property
    def base_moment(self) -> Array:
        """(n, 3) N m, m(0): internal moment at the base."""
        return self.values[:, AT_MOMENT : AT_MOMENT + 3]

    @property
    def margin(self) -> Array:
        """(n,) 1: smallest of Routh's conditions on the shooting Jacobian; 1 without dead loads, 0 at buckling."""
        return self.values[:, AT_MARGIN]

    @property
    def load_reached(self) -> Array:
        """(n,) share 0..1 of all loads up to which the rod's own equilibrium was followed."""
        return self.values[:, AT_LOAD]

    @property
    def converged(self) -> Mask:
        """(n,) True where the rod is in equilibrium to the method's tolerance *and* on its own branch: it was solved
        directly with a margin to buckling, or its loads were followed from zero without a snap. Converged says nothing of
        the error of the discretisation, which each method states."""
        return self.status <= Status.SOLVED_IN_STEPS

    def trusted(self) -> Solution:
        """Itself when every rod converged; raises `SolveFailed` with the others, how far their load was followed, a remedy."""
        bad = np.flatnonzero(~self.converged)
        if bad.size:
            reached = ["" if np.isnan(x) else f" at {x:.3g} of the load" for x in self.load_reached[bad[:8]]]
            listed = ", ".join(f"{i} ({Status(self.status[i]).name}{x})" for i, x in zip(bad, reached, strict=False))
            raise SolveFailed(
                f"{bad.size} of {len(self.status)} rods have no trusted equilibrium: {listed}"
                f"{', ...' if bad.size > 8 else ''}; lower the pressure or load, or check stiffness, length and area factor"
            )
        return self

    def take(self, rows: slice | Mask | NDArray[np.intp]) -> Solution:
        """The rods picked by a slice, mask or index array."""
        memory = self.memory[rows] if len(self.memory) else self.memory
        return Solution(self.values[rows], self.status[rows], self.shape[rows], memory)


def assembled(
    tip: Array, orientation: Array, base_force: Array, base_moment: Array, status: NDArray[np.int8], shape: Array
) -> Solution:
    """A solution from its parts; rods that `status` does not call solved become NaN."""
    values = np.full((len(status), RESULT), np.nan)
    values[:, AT_TIP : AT_TIP + 3], values[:, AT_ORIENTATION : AT_ORIENTATION + 4] = tip, orientation
    values[:, AT_FORCE : AT_FORCE + 3], values[:, AT_MOMENT : AT_MOMENT + 3] = base_force, base_moment
    lost = status > Status.SOLVED_IN_STEPS
    values[lost] = np.nan
    values[~lost, AT_LOAD] = 1.0
    return Solution(values, status, np.where(lost[:, None, None], np.nan, shape))
