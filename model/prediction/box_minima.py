"""Many small convex quadratics, each minimised within bounds of its own, side by side."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from model.arrays import Array, Mask

PATIENCE, PIVOTS = 3, 100
"""Exchanges of a whole active set without progress before single ones; most exchanges."""


def box_minima(curve: Array, slope: Array, low: Array, high: Array) -> Array:
    """The x (n, k) within low .. high that minimise x.curve.x / 2 + slope.x, for n positive definite curves (n, k, k)."""

    def solved(free: Mask, downhill: Array) -> Array:
        both_free = free[:, :, None] & free[:, None, :]
        return np.asarray(np.linalg.solve(np.where(both_free, curve, np.eye(slope.shape[1])), downhill[..., None])[..., 0])

    return pivoted(lambda x: (curve @ x[..., None])[..., 0], solved, slope, low, high)


def pivoted(
    product: Callable[[Array], Array], solved: Callable[[Mask, Array], Array], slope: Array, low: Array, high: Array
) -> Array:
    """The same of curves that are given by their `product` with x (n, k), and by what they are `solved` for: the x that is zero
    where not `free` (n, k), and whose product is elsewhere `downhill` (n, k), zero where not free.

    Block principal pivoting (Kim and Park 2011, for two-sided bounds): a variable beyond its bound is held there, a held one
    whose gradient points inwards is freed. All at once while that helps, else one by one, which ends after finitely many steps.
    """
    n, k = slope.shape
    held = np.zeros((n, k), np.int64)  # -1 at the lower bound, 1 at the upper, 0 free
    fewest, patience = np.full(n, k + 1), np.full(n, PATIENCE)
    x = np.zeros((n, k))
    for _ in range(PIVOTS):
        free = held == 0
        x = np.where(held < 0, low, np.where(held > 0, high, 0.0))
        x = x + solved(free, np.where(free, -slope - product(x), 0.0))
        gradient = product(x) + slope
        target = np.where(free, (x > high).astype(np.int64) - (x < low), np.where(held * gradient > 0, 0, held))
        wrong = target != held
        count = wrong.sum(axis=1)
        if not count.any():
            break
        patience = np.where(count < fewest, PATIENCE, patience - 1)
        fewest = np.minimum(fewest, count)
        is_last = np.arange(k) == (k - 1 - np.argmax(wrong[:, ::-1], axis=1))[:, None]
        held = np.where(wrong & (is_last | (patience >= 0)[:, None]), target, held)
    return np.clip(x, low, high)
