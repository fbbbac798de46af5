"""A step by Butcher's sixth-order Runge-Kutta method with seven stages, for rods and for changes of them.

y_i = y + h sum_j A_ij k_j,   k_i = slope(y_i) at the share C_i of the step,   y' = y + h sum_i B_i k_i
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from model.rods.fast.compiler import inline

Y = TypeVar("Y")
Here = TypeVar("Here")
Near = TypeVar("Near")

STAGES = 7
C2, C3, C4, C5, C6 = 1 / 3, 2 / 3, 1 / 3, 1 / 2, 1 / 2
A21 = 1 / 3
A32 = 2 / 3
A41, A42, A43 = 1 / 12, 1 / 3, -1 / 12
A51, A52, A53, A54 = -1 / 16, 9 / 8, -3 / 16, -3 / 8
A62, A63, A64, A65 = 9 / 8, -3 / 8, -3 / 4, 1 / 2
A71, A72, A73, A74, A76 = 9 / 44, -9 / 11, 63 / 44, 18 / 11, -16 / 11
B1, B3, B4, B5, B6, B7 = 11 / 120, 27 / 40, 27 / 40, -4 / 15, -4 / 15, 11 / 120


@inline
def step(
    slope: Callable[[Y, int, float, float, Here, Near | None], tuple[Y, Near]],
    along: Callable[[Y, float, Y], Y],
    y: Y,
    h: float,
    here: Here,
) -> Y:
    """y' of `slope`(y_i, i, C_i, B_i, here, near), which also says what it found for the next stage, `near`; `along` adds."""
    k1, near = slope(y, 0, 0.0, B1, here, None)
    k2, near = slope(along(y, A21 * h, k1), 1, C2, 0.0, here, near)
    k3, near = slope(along(y, A32 * h, k2), 2, C3, B3, here, near)
    y4 = along(along(along(y, A41 * h, k1), A42 * h, k2), A43 * h, k3)
    k4, near = slope(y4, 3, C4, B4, here, near)
    y5 = along(along(along(along(y, A51 * h, k1), A52 * h, k2), A53 * h, k3), A54 * h, k4)
    k5, near = slope(y5, 4, C5, B5, here, near)
    y6 = along(along(along(along(y, A62 * h, k2), A63 * h, k3), A64 * h, k4), A65 * h, k5)
    k6, near = slope(y6, 5, C6, B6, here, near)
    y7 = along(along(along(along(along(y, A71 * h, k1), A72 * h, k2), A73 * h, k3), A74 * h, k4), A76 * h, k6)
    y = along(along(along(along(along(y, B1 * h, k1), B3 * h, k3), B4 * h, k4), B5 * h, k5), B6 * h, k6)
    return along(y, B7 * h, slope(y7, 6, 1.0, B7, here, near)[0])
