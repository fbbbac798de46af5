"""Whether the readings drift from trial to trial: a rigid motion of all points that grows with the order of the trials.

Readings y_i of a point in repeats of a setting c, in trial k at u = k / (K - 1) of the campaign, K trials, follow

    y_i = mean of c + (u a_1 + u^2 a_2) + (u w_1 + u^2 w_2) x r_i + e_i,

r_i the point's place, a (m) and w (rad) a translation and a turn of the cameras or the base. Rests count as one setting
whatever is inflated next. How far the fit's squares come by chance is known from the same fit with the trials in other orders.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .. import judgement
from ..arrays import Array, Ints, rms
from ..findings import Finding, finding
from .campaign import Campaign
from .levels import distinct


def drift(states: Campaign) -> Iterator[Finding]:
    """A finding if tip and markers of states of the robot move over the trials beyond chance and beyond what repeats differ by
    besides."""
    trial, order = np.unique(states.trial, return_inverse=True)
    count = len(trial)
    if count < judgement.DRIFT_TRIALS:
        return
    rest = states.highest <= states.pressure_gap
    at = distinct(states.spine_length, states.branch.astype(np.int64), states.roll)
    setting = np.where(rest, -1 - at, states.condition)
    fits = _Fits(np.concatenate([states.tip[:, None], states.trials.markers], axis=1), setting)
    u = np.linspace(0.0, 1.0, count)
    found, rng = fits.of(u[order]), np.random.default_rng(0)
    others = [fits.of(u[rng.permutation(count)][order])[1] for _ in range(judgement.DRIFT_ORDERS)]
    if np.mean(np.array(others) >= found[1]) > judgement.DRIFT_CHANCE:
        return
    apart = np.array([fits.of(u[order], order != k)[0] for k in range(count)])
    sd = np.sqrt((count - 1) / count * ((apart - apart.mean(axis=0)) ** 2).sum(axis=0))  # jackknife
    moved, size = found[0], float(np.linalg.norm(found[0], axis=1).max())
    if size < judgement.DRIFT_SCATTERS * found[2]:
        return
    first, last = (states.time[order == k].min() for k in (0, count - 1))
    hours = f" in {(last - first) / 3600:.1f} h" if last - first > 0 else ""
    names = ["the tip", *(f"marker {k}" for k in range(1, len(moved)))]
    each = [
        f"{name} by ({', '.join(f'{1e3 * x:.1f} ± {1e3 * s:.1f}' for x, s in zip(v, d, strict=True))}) mm"
        for name, v, d in zip(names, moved, sd, strict=True)
    ]
    together = (
        len(moved) > 1 and float(np.linalg.norm(moved - moved.mean(axis=0), axis=1).max()) < judgement.DRIFT_TOGETHER * size
    )
    what = (
        "all points move together, so cameras or base drift rather than the body"
        if together
        else "points move differently: cameras or base turn, or the body creeps or softens"
        if len(moved) > 1
        else "without markers the table cannot tell cameras or base from a body that creeps or softens"
    )
    yield finding("drift", mm=1e3 * size, trials=count, hours=hours, points=each, what=what)


class _Fits:
    """Least squares of the motion above, each setting's mean removed."""

    def __init__(self, points: Array, setting: Ints) -> None:
        self._points, self._setting = points, setting

    def of(self, u: Array, kept: Array | None = None) -> tuple[Array, float, float]:
        """How far each point moves (p, 3) m over all trials, the squares that fit, and the rms distance that is left, m."""
        n, p, _ = self._points.shape
        basis, motions = np.column_stack([u, u**2]), _motions(self._points)
        columns = np.einsum("nb,npcg->npcbg", basis, motions).reshape(n * p, 3, -1)
        place, group = self._points.reshape(n * p, 3), (self._setting[:, None] * p + np.arange(p)).ravel()
        used = np.isfinite(place).all(axis=1) & np.repeat(True if kept is None else kept, n * p if kept is None else p)
        columns, place, group = columns[used], place[used], np.unique(group[used], return_inverse=True)[1]
        every = np.concatenate([columns, place[..., None]], axis=2)
        total = np.zeros((group.max() + 1, *every.shape[1:]))
        np.add.at(total, group, every)
        every = every - (total / np.bincount(group)[:, None, None])[group]
        a, y = every[..., :-1].reshape(-1, columns.shape[2]), every[..., -1].ravel()
        theta = np.linalg.lstsq(a, y, rcond=1e-6)[0]
        fitted = a @ theta
        mean = np.nanmean(self._points, axis=0)
        moved = _motions(mean[None])[0] @ theta.reshape(2, 6).sum(axis=0)
        return moved, float(fitted @ fitted), rms((y - fitted).reshape(-1, 3))


def _motions(points: Array) -> Array:
    """(n, p, 3, 6) what a translation along and a turn about each axis does to points (n, p, 3)."""
    n, p, _ = points.shape
    turned = np.cross(np.eye(3)[:, None, None, :], points[None]).transpose(1, 2, 3, 0)
    return np.concatenate([np.broadcast_to(np.eye(3), (n, p, 3, 3)), turned], axis=3)
