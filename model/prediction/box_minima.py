"""Many small convex quadratics, each minimised within bounds of its own, side by side."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from model.arrays import Array, Mask

STEPS, SUFFICIENT, LEAST_SHARE = 100, 1e-4, 1e-9
"""Most steps; share of the decrease by the gradient alone from which a bent step is taken; least share of a step."""


def box_minima(curve: Array, slope: Array, low: Array, high: Array) -> Array:
    """The x (n, k) within low .. high that minimise x.curve.x / 2 + slope.x, for n positive definite curves (n, k, k)."""

    def solved(free: Mask, downhill: Array) -> Array:
        both_free = free[:, :, None] & free[:, None, :]
        return np.asarray(np.linalg.solve(np.where(both_free, curve, np.eye(slope.shape[1])), downhill[..., None])[..., 0])

    return projected(lambda x: (curve @ x[..., None])[..., 0], solved, slope, low, high)


def projected(
    product: Callable[[Array], Array], solved: Callable[[Mask, Array], Array], slope: Array, low: Array, high: Array
) -> Array:
    """The same of curves that are given by their `product` with x (n, k), and by what they are `solved` for: the x that is zero
    where not `free` (n, k), and whose product is elsewhere `downhill` (n, k), zero where not free.

    Projected Newton by faces (Bertsekas 1982, Moré and Toraldo 1991): the step to the minimum of all that are free, bent at the
    bounds, is halved until it leads down; what it brings to a bound is held. At the minimum of a face, what would go downhill
    from its bound is freed. No face is met twice.
    """
    x = np.clip(np.zeros_like(slope), low, high)
    gradient = product(x) + slope
    free = _downhill(x, gradient, low, high)
    for _ in range(STEPS):
        step, share = solved(free, np.where(free, -gradient, 0.0)), np.ones((len(x), 1))
        whole = np.asarray(((x + step >= low) & (x + step <= high)).all(axis=1))
        bent = ~whole
        while bent.any():
            moved = np.clip(x + share * step, low, high) - x
            by_gradient = -(gradient * moved).sum(axis=1)
            decrease = by_gradient - 0.5 * (product(moved) * moved).sum(axis=1)
            bent &= (decrease < SUFFICIENT * by_gradient) & (share[:, 0] > LEAST_SHARE)
            share[bent] /= 2
        x = np.clip(x + share * step, low, high)
        gradient = product(x) + slope
        left = np.where(whole[:, None], _downhill(x, gradient, low, high), free & (x > low) & (x < high))
        if (whole & (left == free).all(axis=1)).all():
            break
        free = left
    return x


def _downhill(x: Array, gradient: Array, low: Array, high: Array) -> Mask:
    """(n, k) which can move downhill, or lie between their bounds."""
    return ~((x <= low) & (gradient > 0) | (x >= high) & (gradient < 0))
