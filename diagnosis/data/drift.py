"""Whether a robot at rest moves from trial to trial, as cameras or base drift, or the body creeps.

Places y_i (m) of a point at rest under loads c, in trial k at u = k / (K - 1) of the campaign, K trials, follow

    y_i = mean of c + u a_1 + u^2 a_2 + e_i.

How far the fit's squares come by chance is known from the same fit with the trials in other orders.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .. import judgement
from ..arrays import Array, Ints, rms
from ..findings import Finding, finding
from .campaign import Campaign
from .levels import distinct, loads


def drift(states: Campaign) -> Iterator[Finding]:
    """A finding if tip or markers of a robot at rest move over the trials, beyond chance and beyond the scatter of repeats."""
    own = states.take(states.highest <= states.pressure_gap)
    trial, order = np.unique(own.trial, return_inverse=True)
    count = len(trial)
    if count < judgement.DRIFT_TRIALS:
        return
    setting = distinct(loads(own.trials), own.branch)
    places = np.concatenate([own.tip[:, None], own.trials.markers], axis=1)
    u = np.linspace(0.0, 1.0, count)
    (moved, squares, left), rng = _fit(places, setting, u[order]), np.random.default_rng(0)
    by_chance = max(_fit(places, setting, u[rng.permutation(count)][order])[1] for _ in range(judgement.DRIFT_ORDERS))
    size = float(np.linalg.norm(moved, axis=1).max())
    if by_chance >= squares or size < judgement.DRIFT_SCATTERS * left:
        return
    others_than = (order != k for k in range(count))
    apart = np.array([_fit(places[kept], setting[kept], u[order][kept])[0] for kept in others_than])
    sd = np.sqrt((count - 1) / count * ((apart - apart.mean(axis=0)) ** 2).sum(axis=0))  # jackknife
    first, last = (own.time[order == k].min() for k in (0, count - 1))
    hours = f" in {(last - first) / 3600:.1f} h" if last - first > 0 else ""
    names = ["the tip", *(f"marker {k}" for k in range(1, len(moved)))]
    each = [
        f"{name} by ({', '.join(f'{1e3 * x:.1f} ± {1e3 * s:.1f}' for x, s in zip(v, d, strict=True))}) mm"
        for name, v, d in zip(names, moved, sd, strict=True)
    ]
    if len(moved) == 1:
        what = "without markers the table cannot tell cameras or base from a body that creeps or softens"
    elif np.linalg.norm(moved - moved.mean(axis=0), axis=1).max() < judgement.DRIFT_TOGETHER * size:
        what = "all points move together, so cameras or base drift rather than the body"
    else:
        what = "points move differently: cameras or base turn, or the body creeps or softens"
    yield finding("drift", mm=1e3 * size, trials=count, hours=hours, points=each, what=what)


def _fit(places: Array, setting: Ints, u: Array) -> tuple[Array, float, float]:
    """How far each point (n, p, 3) moves (p, 3) m over all trials, the squares that fit, and the rms distance left, m."""
    moved, squares, left = [], 0.0, []
    for point in places.swapaxes(0, 1):
        seen = np.isfinite(point).all(axis=1)
        _, group, count = np.unique(setting[seen], return_inverse=True, return_counts=True)
        every = np.column_stack([u, u**2, point])[seen]
        every -= np.array([np.bincount(group, values) / count for values in every.T]).T[group]
        theta = np.linalg.lstsq(every[:, :2], every[:, 2:], rcond=1e-6)[0]
        fitted = every[:, :2] @ theta
        moved.append(theta.sum(axis=0))
        squares += float((fitted**2).sum())
        left.append(every[:, 2:] - fitted)
    return np.array(moved), squares, rms(np.concatenate(left))
