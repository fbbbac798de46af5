"""What a rod solver takes and gives: n rods at once, plain arrays, no knowledge of chambers or spines.

Every rod has two parts of constant stiffness: the inner part from the base to `joint` (where the spine ends) and
the outer part from there to the tip. Any solver of this shape can stand in for another.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from model.errors import BadCondition, SolveFailed

Array = NDArray[np.float64]
INNER, OUTER = 0, 1
"""Index of the part: base to joint, joint to tip."""


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
class RodBatch:
    """n rods and their loads, in the base frame unless said otherwise."""

    length: Array
    """(n,) m."""
    joint: Array
    """(n,) m, arc length where the inner part ends, 0..length."""
    stretch_stiffness: Array
    """(n, 2, 3) N: GA, GA, EA of the inner and outer part (K_se)."""
    bend_stiffness: Array
    """(n, 2, 3) N m^2: EIxx, EIyy, EIzz of the inner and outer part (K_bt)."""
    tip_force: Array
    """(n, 3) N, follower force in the tip frame."""
    tip_moment: Array
    """(n, 3) N m, follower moment in the tip frame."""
    dead_force: Array
    """(n, 3) N, fixed in the base frame, at the tip."""
    weight: Array
    """(n, 3) N/m, fixed in the base frame, spread over the unstretched length."""
    rest_curvature: Array
    """(n, 3) 1/m, u* in the body frame."""

    def __post_init__(self) -> None:
        n = len(self.length)
        for field in fields(self):
            value: Array = getattr(self, field.name)
            parts = (2, 3) if field.name.endswith("_stiffness") else (3,)
            shape = (n,) if field.name in ("length", "joint") else (n, *parts)
            if value.shape != shape:
                raise BadCondition(f"{field.name}: shape {value.shape}, must be {shape}")
            if not np.isfinite(value).all():
                raise BadCondition(f"{field.name}: holds values that are not finite")
        if (self.stretch_stiffness <= 0).any() or (self.bend_stiffness <= 0).any():
            raise BadCondition("stretch_stiffness and bend_stiffness must be positive")
        if (self.joint < 0).any() or (self.joint > self.length * (1 + 1e-9)).any():
            raise BadCondition("joint must lie between 0 and length")

    def __len__(self) -> int:
        return len(self.length)

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_] | slice) -> RodBatch:
        """The rods picked by a mask, index array or slice."""
        return RodBatch(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})

    def loaded(self, share: float) -> RodBatch:
        """The same rods under a share (0..1) of all their loads."""
        return replace(
            self,
            tip_force=share * self.tip_force,
            tip_moment=share * self.tip_moment,
            dead_force=share * self.dead_force,
            weight=share * self.weight,
        )


@dataclass(frozen=True)
class RodResult:
    """Equilibria of n rods, base frame; rows whose `ok` is False hold NaN."""

    tip: Array
    """(n, 3) m."""
    orientation: Array
    """(n, 4) unit quaternion w, x, y, z of the tip frame, w >= 0."""
    base_force: Array
    """(n, 3) N, n(0): internal force at the base."""
    base_moment: Array
    """(n, 3) N m, m(0): internal moment at the base."""
    status: NDArray[np.int8]
    """(n,) `Status`."""
    shape: Array
    """(n, k, 3) m, positions at the k arc lengths that were asked for."""

    @property
    def ok(self) -> NDArray[np.bool_]:
        """(n,) True where the tip can be trusted."""
        return self.status <= Status.SOLVED_IN_STEPS

    def trusted(self) -> RodResult:
        """Itself when every rod was solved; raises `SolveFailed` naming the states that were not."""
        bad = np.flatnonzero(~self.ok)
        if bad.size:
            listed = ", ".join(f"{i} ({Status(self.status[i]).name})" for i in bad[:8])
            raise SolveFailed(
                f"{bad.size} of {len(self.status)} states have no trusted equilibrium: {listed}"
                f"{', ...' if bad.size > 8 else ''}; lower the pressure, or check the stiffness and the area factor"
            )
        return self
