"""One step of the rod's equations: Butcher's sixth-order Runge-Kutta method with seven stages.

y_i = y + h sum_j A_ij k_j,   k_i = slope(y_i) at the share C_i of the step,   y' = y + h sum_i B_i k_i
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from model.rods.fast.algebra import State, Vector, along, plus
from model.rods.fast.equations import Section, slope
from model.rods.fast.jit import inline

Array = NDArray[np.float64]

C2, C3, C4, C5, C6 = 1 / 3, 2 / 3, 1 / 3, 1 / 2, 1 / 2
A21 = 1 / 3
A32 = 2 / 3
A41, A42, A43 = 1 / 12, 1 / 3, -1 / 12
A51, A52, A53, A54 = -1 / 16, 9 / 8, -3 / 16, -3 / 8
A62, A63, A64, A65 = 9 / 8, -3 / 8, -3 / 4, 1 / 2
A71, A72, A73, A74, A76 = 9 / 44, -9 / 11, 63 / 44, 18 / 11, -16 / 11
B1, B3, B4, B5, B6, B7 = 11 / 120, 27 / 40, 27 / 40, -4 / 15, -4 / 15, 11 / 120


class Step(NamedTuple):
    """From where to where, towards the base."""

    h: float
    """m along the rod."""
    z: float
    """Place within the element: 1 at its tip end, 0 at its base end."""
    dz: float
    """By how much z changes, negative."""
    force: Vector
    """N at the start (N, mount frame)."""
    load: Vector
    """N/m by which it grows on the way."""


@inline
def step(y: State, s: Step, section: Section, l: int, stages: Array | None) -> State:
    """The state a distance h nearer to the base. Stages are saved where there is room for them in `stages`."""
    h, z, dz = s.h, s.z, s.dz
    z2, z3, z5, z7 = z + C2 * dz, z + C3 * dz, z + C5 * dz, z + dz
    f2, f3, f5, f7 = (
        along(s.force, C2 * h, s.load),
        along(s.force, C3 * h, s.load),
        along(s.force, C5 * h, s.load),
        along(s.force, h, s.load),
    )
    k1, near = slope(y, s.force, section, z, l, stages, 0, None)
    k2, near = slope(plus(y, A21 * h, k1), f2, section, z2, l, stages, 1, near)
    k3, near = slope(plus(y, A32 * h, k2), f3, section, z3, l, stages, 2, near)
    y4 = plus(plus(plus(y, A41 * h, k1), A42 * h, k2), A43 * h, k3)
    k4, near = slope(y4, f2, section, z2, l, stages, 3, near)
    y5 = plus(plus(plus(plus(y, A51 * h, k1), A52 * h, k2), A53 * h, k3), A54 * h, k4)
    k5, near = slope(y5, f5, section, z5, l, stages, 4, near)
    y6 = plus(plus(plus(plus(y, A62 * h, k2), A63 * h, k3), A64 * h, k4), A65 * h, k5)
    k6, near = slope(y6, f5, section, z5, l, stages, 5, near)
    y7 = plus(plus(plus(plus(plus(y, A71 * h, k1), A72 * h, k2), A73 * h, k3), A74 * h, k4), A76 * h, k6)
    k7, _ = slope(y7, f7, section, z7, l, stages, 6, near)
    y = plus(plus(plus(y, B1 * h, k1), B3 * h, k3), B4 * h, k4)
    return plus(plus(plus(y, B5 * h, k5), B6 * h, k6), B7 * h, k7)
