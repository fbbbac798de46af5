"""Box-constrained least squares: the minimum of a convex quadratic within bounds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PATIENCE, PIVOTS = 3, 100
"""Exchanges of the whole active set without progress before single exchanges; most exchanges."""


def box_constrained_minimum(curve: Array, score: Array, low: Array, high: Array) -> Array:
    """Minimum of x.curve.x / 2 - score.x with low <= x <= high.

    By block principal pivoting (Kim and Park 2011, for two-sided bounds): variables outside their bounds join the active
    set, those whose multiplier has the wrong sign leave it, all at once while that helps, else one at a time, which is finite.
    """
    n = len(score)
    side = np.zeros(n, np.int64)  # -1 held at its lower bound, 1 at its upper, 0 free
    fewest, patience = n + 1, PATIENCE
    for _ in range(PIVOTS):
        free = side == 0
        x = np.where(side < 0, low, high)
        x[free] = 0.0
        x[free] = np.linalg.solve(curve[np.ix_(free, free)], score[free] - curve[np.ix_(free, ~free)] @ x[~free])
        uphill = curve @ x - score
        wanted = np.where(free, (x > high).astype(int) - (x < low), np.where(side * uphill > 0, 0, side))
        wrong = np.flatnonzero(wanted != side)
        if not wrong.size:
            break
        if wrong.size < fewest:
            fewest, patience = wrong.size, PATIENCE
        else:
            patience -= 1
        if patience < 0:
            wrong = wrong[-1:]
        side[wrong] = wanted[wrong]
    return np.clip(x, low, high)
