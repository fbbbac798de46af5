"""Noise components estimated by maximum a posteriori, with log-normal priors at the instruments' defaults.

By Newton's method within bounds, damped. Second derivatives are the average information and, close to the end, symmetric updates
of rank one of what the gradients differ by from it (as Dennis, Gay and Welsch 1981 do for least squares).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh

from model.prediction.box_minima import box_minima

from ..arrays import Array
from .noise_components import NoiseComponents, Repeated, contrasts
from .noise_likelihood import Loss, Point

STEPS, ENOUGH = 100, 1e-9
"""Most steps, and the promised decrease of the loss below which no step is taken."""
LEAST, HELD = 0.1, 0.1
"""Least curvature along any way, and first damping, relative to the average information."""


def estimate_noise(data: Repeated, default: NoiseComponents) -> NoiseComponents:
    """Components at the maximum of their posterior density; `default`, the centre of their priors, where nothing was repeated."""
    contrast = contrasts(data.condition)
    if not len(contrast):
        return default
    loss = Loss(data, contrast, default)
    return loss.components(lowest(loss))


def lowest(loss: Loss) -> Array:
    """The point (x,) of least loss (minus the log posterior density) within its bounds, from 0, the centre of the priors.

    The curvature is the average information at each point (`Point.curve`) plus a `remainder` (x, x) learnt on the way.
    """
    x = np.zeros(len(loss.centre))
    here, remainder, damping = loss(x), np.zeros((len(x), len(x))), 0.0
    for _ in range(STEPS):
        step, promised = _step(here, here.curve + remainder, damping, loss.low - x, loss.high - x)
        if promised < ENOUGH:
            break
        there = loss(x + step)
        if promised < 1.0:  # close to the end
            remainder = _learnt(remainder, there.slope - here.slope - there.curve @ step, step)
        if here.value - there.value > 0.1 * promised:
            x, here, damping = x + step, there, damping / 4 if damping > HELD else 0.0
        else:
            damping = max(4 * damping, HELD)
    return x


def _learnt(remainder: Array, change: Array, step: Array) -> Array:
    """Symmetric rank-one update of the remainder R of the curvature, so that R step = `change`, unless ill-conditioned."""
    missed = change - remainder @ step
    along = float(missed @ step)
    if abs(along) <= 1e-8 * float(np.linalg.norm(missed) * np.linalg.norm(step)):
        return remainder
    return remainder + np.outer(missed, missed) / along


def _step(here: Point, curve: Array, damping: float, low: Array, high: Array) -> tuple[Array, float]:
    """The step (x,) to the minimum within bounds of slope . s + s . H s / 2, and how much lower that is there.

    H is `curve` with its eigenvalues relative to the average information A (curve v = e A v, v^T A v = 1) raised to LEAST, and
    `damping` added: H = sum_v (max(e, LEAST) + damping) (A v) (A v)^T.
    """
    size, way = eigh(curve, here.curve)
    way = here.curve @ way
    curve = (way * (np.maximum(size, LEAST) + damping)) @ way.T
    # the longest step in each logarithm or logit
    low, high = np.maximum(low, -1.0), np.minimum(high, 1.0)
    (step,) = box_minima(curve[None], here.slope[None], low[None], high[None])
    return step, -float(here.slope @ step + 0.5 * step @ curve @ step)
