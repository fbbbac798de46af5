"""Noise components estimated by maximum a posteriori, with log-normal priors at the instruments' defaults.

By Newton's method within bounds. Second derivatives are the average information and, close to the end, what gradients met on
the way differ by from it, learnt by symmetric updates of rank one (as Dennis, Gay and Welsch 1981 do for least squares). A step
that does not bring what it promised is damped and taken anew.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from model.prediction.box_minima import box_minima

from .noise_components import NoiseComponents, Repeated, contrasts
from .noise_likelihood import Loss, Point

Array = NDArray[np.float64]

STEPS, ENOUGH = 100, 1e-9
"""Points looked at at most, and the decrease foreseen below which none is looked for."""
LEAST, HELD = 0.1, 0.1
"""Least curvature along any way, and first damping, relative to the average information."""


def estimate_noise(data: Repeated, default: NoiseComponents) -> NoiseComponents:
    """Maximum a posteriori; `default` holds the centre of the priors and is returned where nothing was repeated."""
    contrast = contrasts(data.condition)
    if not len(contrast):
        return default
    loss = Loss(data, contrast, default)
    # Components that no contrast depends on stay at their defaults.
    x = lowest(loss)
    sds = x[: loss.sds]
    return replace(
        loss.components(x),
        contrasts=len(contrast),
        excess_scatter=float(np.exp(max(sds[len(default.channel)], *sds[len(default.channel) + 2 :], -np.inf))),
    )


def lowest(loss: Loss) -> Array:
    """Where the loss is least within its bounds, from the centre of the priors on."""
    x = np.zeros(len(loss.centre))
    here, rest, damping = loss(x), np.zeros((len(x), len(x))), 0.0
    for _ in range(STEPS):
        step, foreseen = _step(here, here.curve + rest, damping, loss.low - x, loss.high - x)
        if foreseen < ENOUGH:
            break
        there = loss(x + step)
        # close to the end, the rest of the curvature is learnt
        if foreseen < 1.0:
            rest = _learnt(rest, there.slope - here.slope - there.curve @ step, step)
        if here.value - there.value > 0.1 * foreseen:
            x, here, damping = x + step, there, damping / 4 if damping > HELD else 0.0
        else:
            damping = max(4 * damping, HELD)
    return x


def _learnt(rest: Array, change: Array, step: Array) -> Array:
    """The symmetric matrix of rank one more that turns the step into the change of slope that average information leaves."""
    missed = change - rest @ step
    along = float(missed @ step)
    if abs(along) <= 1e-8 * float(np.linalg.norm(missed) * np.linalg.norm(step)):
        return rest
    return rest + np.outer(missed, missed) / along


def _step(here: Point, curve: Array, damping: float, low: Array, high: Array) -> tuple[Array, float]:
    """The step within bounds, and how much lower the quadratic is there."""
    size, way = eigh(curve, here.curve)
    way = here.curve @ way
    curve = (way * (np.maximum(size, LEAST) + damping)) @ way.T
    # the longest step in each logarithm or logit
    low, high = np.maximum(low, -1.0), np.minimum(high, 1.0)
    (step,) = box_minima(curve[None], here.slope[None], low[None], high[None])
    return step, -float(here.slope @ step + 0.5 * step @ curve @ step)
