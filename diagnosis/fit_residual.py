"""What a fitted robot still misses, learnt: the Gaussian process of `model.prediction.residual`, its scales by their evidence.

The most probable scales maximise

    log N(y_x) + log N(y_y) + log N(y_z) + log p(scales),    y ~ N(0, C),

y the distances missed along the three axes, C their covariance, p a wide log-normal prior about the range of the campaign. With
Q = C^-1, the residual of states b learnt from the others alone is Q_bb^-1 (Q y)_b (Rasmussen & Williams, 2006, ch. 5).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist

from model.prediction.residual import covariance, kernel
from model.stated import Residual

from .arrays import Array, Ints, Mask, rms, rounded, rows_by
from .data.levels import PRESSURE_GAP, REST, SPINE_GAP
from .errors import BadCase

LEAST_STATES = 6
SCALE_RANGE, SCALE_SD = 0.7, 1.0
"""Prior of both scales: log-normal about this share of the campaign's range, its standard deviation in ln."""
LOW, HIGH = 0.05, 20.0
"""Bounds of both scales, in ranges."""
STARTS = ((1.0, 0.7, 0.7, 0.3, 0.3), (1.0, 0.3, 0.3, 0.1, 0.3), (0.5, 1.5, 1.5, 0.7, 0.7))
"""Amplitude, scales, trial and reading, in units of the rms and of the ranges."""


def learn_residual(trial: Ints, pressure: Array, length: Array, missed: Array) -> tuple[Residual, float]:
    """From n states: pressures (n, chambers) Pa, spine lengths (n,) m, and measured - predicted tips `missed` (n, 3) m.

    Returns the residual, and how far the tip is off with it (m, rms), the `alike` left out of it (not of the fit of the robot).
    Raises `BadCase` for fewer states than scales need.
    """
    finite = np.flatnonzero(np.isfinite(missed).all(axis=1))
    trials = len(np.unique(trial[finite]))
    if len(finite) < LEAST_STATES or trials < 2:
        raise BadCase(
            f"residual: {len(finite)} states with a tip in {trials} trial(s), it needs at least {LEAST_STATES} states in "
            "two trials: record more, or leave --residual out"
        )
    # robot.yaml holds this many; of more, whole trials evenly
    chosen = finite[_some(trial[finite], 1000)]
    trial, pressure, length, missed = trial[chosen], pressure[chosen], length[chosen], missed[chosen]
    ranges = tuple(max(float(np.max(np.abs(v))), 1e-6) for v in (np.linalg.norm(pressure, axis=1), length))
    few = _some(trial, 400)
    scales = _scales(pressure[few], length[few], trial[few], missed[few], ranges)
    learnt = Residual(
        **dict(zip(("amplitude", "pressure_scale", "length_scale", "trial", "reading"), scales, strict=True)),
        learnt=[[rounded(v) for v in row] for row in np.column_stack([trial, pressure, length, missed]).tolist()],
    )
    correlation = kernel(pressure, length, pressure, length, learnt.pressure_scale, learnt.length_scale)
    inverse = np.linalg.inv(covariance(learnt.amplitude, learnt.trial, learnt.reading, trial, correlation))
    weights, parts = inverse @ missed, rows_by(alike(trial, pressure, length))
    return learnt, rms(np.concatenate([np.linalg.solve(inverse[np.ix_(b, b)], weights[b]) for b in parts]))


def alike(trial: Ints, pressure: Array, length: Array) -> Ints:
    """(n,) number of the part of the campaign to which each state belongs: trials that share a setting other than rest, in
    which every trial begins, are of one part; where that is the whole campaign, each setting is a part."""
    same = (cdist(pressure, pressure, "chebyshev") < PRESSURE_GAP) & (np.abs(length[:, None] - length) < SPINE_GAP)
    inflated = np.abs(pressure).max(axis=1) > REST
    joins = inflated | ~np.isin(trial, trial[inflated])
    parts, part = connected_components((same & joins[:, None] & joins) | (trial[:, None] == trial), directed=False)
    return np.asarray(part if parts > 1 else connected_components(same, directed=False)[1], np.int64)


def _scales(pressure: Array, length: Array, trial: Ints, missed: Array, ranges: tuple[float, ...]) -> list[float]:
    """Most probable scales: amplitude (m), pressure (Pa), spine length (m), standard deviations of trials and readings (m)."""
    size = max(rms(missed) / np.sqrt(3), 1e-9)  # m, of one axis
    log_usual = np.log([size, *ranges, size, size])

    def cost(x: Array) -> float:
        """Minus the logarithm that is maximised, up to a constant; x (5,): logarithms of the scales over usual values."""
        amplitude, pressure_scale, length_scale, per_trial, reading = np.exp(x + log_usual)
        correlation = kernel(pressure, length, pressure, length, pressure_scale, length_scale)
        c = covariance(amplitude, per_trial, reading, trial, correlation)
        factor = cho_factor(c / size**2, lower=True)
        chi_square = float((missed * cho_solve(factor, missed)).sum()) / size**2  # sum over axes of y^T C^-1 y
        log_det = 2 * float(np.log(np.diag(factor[0])).sum())  # of C, the same for each of the three axes
        prior = (((x[1:3] - np.log(SCALE_RANGE)) / SCALE_SD) ** 2).sum()
        return 0.5 * (chi_square + 3 * log_det + float(prior))

    # below 1e-3 of the rms, two equal states would be one
    bounds = np.log([(1e-2, 1e2), *[(LOW, HIGH)] * 2, *[(1e-3, 10.0)] * 2])
    minima = (minimize(cost, np.log(start), method="L-BFGS-B", bounds=bounds) for start in STARTS)
    best = min(minima, key=lambda f: float(f.fun))
    return [rounded(v) for v in np.exp(best.x + log_usual).tolist()]


def _some(trial: Ints, most: int) -> Mask:
    """States of this many whole trials, evenly, that about `most` remain, and no more."""
    chosen = np.isin(trial, np.unique(trial)[:: int(np.ceil(len(trial) / most))])
    return chosen & (np.cumsum(chosen) <= most)
