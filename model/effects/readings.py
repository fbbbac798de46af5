"""What the instruments read of solved rods, and the force of stiffness trials."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.condition import States
from model.effects import layout as at
from model.effects.push import cantilever_force
from model.effects.quantities import Quantities
from model.effects.spine import ShearSpine
from model.rotation import from_vector, multiply, to_base

Array = NDArray[np.float64]


@dataclass(slots=True)
class Readings:
    """Arrays (v or 1, n, ...) in the base frame; replace them, never write into them."""

    design: States
    length: float
    """m, of the robot."""
    tip: Array
    """(v, n, 3) m."""
    orientation: Array
    """(v, n, 4) quaternion."""
    markers: Array
    """(v, n, k, 3) m."""
    force: Array
    """(v, n) N, stiffness rows; 0 elsewhere."""

    def first(self, n: int) -> Readings:
        """The readings of the first n states."""
        return Readings(
            self.design, self.length, self.tip[:, :n], self.orientation[:, :n], self.markers[:, :n], self.force[:, :n]
        )

    def turn(self, vector: Array) -> None:
        """Turn the frame of all readings by a rotation vector (v, n or 1, 3) rad."""
        q = from_vector(vector)
        self.tip = to_base(q, self.tip)
        self.orientation = multiply(np.broadcast_to(q, np.broadcast_shapes(q.shape, self.orientation.shape)), self.orientation)
        if self.markers.shape[2]:
            self.markers = to_base(q[..., None, :], self.markers)


def readings(q: Quantities, shear: ShearSpine, solved: Array) -> Readings:
    """Readings of perfect instruments from results (v, n, columns) of the solver."""
    v, n, wide = solved.shape
    markers = solved[..., at.MARKERS :].reshape(v, n, (wide - at.MARKERS) // 3, 3)
    force = np.zeros((v, n))
    if q.design.stiffness.any():
        force = force + cantilever_force(q, shear)
    tip, turn = solved[..., :3].copy(), solved[..., at.ORIENTATION : at.ORIENTATION + 4].copy()
    return Readings(q.design, q.robot.length, tip, turn, markers.copy(), force)
