"""What a fitted robot still misses, learnt: the Gaussian process of `model.prediction.residual`, its scales by their evidence.

The most probable scales maximise

    log N(y_x) + log N(y_y) + log N(y_z) + log p(scales),    y ~ N(0, C),

y the distances missed along the three axes, C their covariance, p a wide log-normal prior about the range of the campaign. With
Q = C^-1, the residual of trial b without its own states is Q_bb^-1 (Q y)_b (Rasmussen & Williams, 2006, ch. 5).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from model.prediction.residual import covariance, kernel, section_sums
from model.robot import Robot
from model.stated import Residual

from .arrays import Array, Ints, Mask, rms, rounded, rows_by
from .errors import BadCase

LEAST_STATES = 6
SCALE_RANGE, SCALE_SD = 0.7, 1.0
"""Prior of both scales: log-normal about this share of the campaign's range, its standard deviation in ln."""
LOW, HIGH = 0.05, 20.0
"""Bounds of both scales, in ranges."""
STARTS = ((1.0, 0.7, 0.7, 0.3, 0.3), (1.0, 0.3, 0.3, 0.1, 0.3), (0.5, 1.5, 1.5, 0.7, 0.7))
"""Amplitude, scales, trial and reading, in units of the rms and of the ranges."""


def learn_residual(robot: Robot, trial: Ints, pressure: Array, length: Array, missed: Array) -> tuple[Residual, float]:
    """From n states: pressures (n, chambers) Pa, spine lengths (n,) m, and measured - predicted tips `missed` (n, 3) m.

    Returns the residual, and how far the tip is off with it (m, rms), each trial left out of it (not of the fit of the robot).
    Raises `BadCase` for fewer states than scales need.
    """
    finite = np.isfinite(missed).all(axis=1)
    trial, pressure, length, missed = trial[finite], pressure[finite], length[finite], missed[finite]
    trials = len(np.unique(trial))
    if len(missed) < LEAST_STATES or trials < 2:
        raise BadCase(
            f"residual: {len(missed)} states with a tip in {trials} trial(s), it needs at least {LEAST_STATES} states in "
            "two trials: record more, or leave --residual out"
        )
    # robot.yaml holds this many; of more, whole trials evenly
    chosen = _some(trial, 1000)
    trial, pressure, length, missed = trial[chosen], pressure[chosen], length[chosen], missed[chosen]
    u = section_sums(robot, pressure)
    ranges = tuple(max(float(np.max(np.abs(v))), 1e-6) for v in (np.linalg.norm(u, axis=1), length))
    chosen = _some(trial, 400)
    scales = _scales(u[chosen], length[chosen], trial[chosen], missed[chosen], ranges)
    learnt = Residual(
        **dict(zip(("amplitude", "pressure_scale", "length_scale", "trial", "reading"), scales, strict=True)),
        states=[[rounded(v) for v in row] for row in np.column_stack([trial, u, length, missed]).tolist()],
    )
    return learnt, rms(_left_out(learnt, u, length, trial, missed))


def _scales(u: Array, length: Array, trial: Ints, missed: Array, ranges: tuple[float, ...]) -> list[float]:
    """Most probable scales: amplitude (m), pressure (Pa), spine length (m), standard deviations of trials and readings (m)."""
    size = max(rms(missed) / np.sqrt(3), 1e-9)  # m, of one axis
    log_usual = np.log([size, *ranges, size, size])

    def cost(x: Array) -> float:
        """Minus the logarithm that is maximised, up to a constant; x (5,): logarithms of the scales over usual values."""
        amplitude, pressure_scale, length_scale, per_trial, reading = np.exp(x + log_usual)
        correlation = kernel(u, length, u, length, pressure_scale, length_scale)
        factor = cho_factor(covariance(amplitude, per_trial, reading, trial, correlation) / size**2, lower=True)
        chi_square = float((missed * cho_solve(factor, missed)).sum()) / size**2  # sum over axes of y^T C^-1 y
        log_det = 2 * float(np.log(np.diag(factor[0])).sum())  # of C, the same for each of the three axes
        prior = (((x[1:3] - np.log(SCALE_RANGE)) / SCALE_SD) ** 2).sum()
        return 0.5 * (chi_square + 3 * log_det + float(prior))

    # below 1e-3 of the rms, two equal states would be one
    bounds = np.log([(1e-2, 1e2), *[(LOW, HIGH)] * 2, *[(1e-3, 10.0)] * 2])
    minima = [minimize(cost, np.log(start), method="L-BFGS-B", bounds=bounds) for start in STARTS]
    best = min(minima, key=lambda f: float(f.fun))
    return [rounded(v) for v in np.exp(best.x + log_usual).tolist()]


def _left_out(own: Residual, u: Array, length: Array, trial: Ints, missed: Array) -> Array:
    """(n, 3) m that are missed with a residual that each state's trial had no part in."""
    correlation = kernel(u, length, u, length, own.pressure_scale, own.length_scale)
    inverse = np.linalg.inv(covariance(own.amplitude, own.trial, own.reading, trial, correlation))
    weights = inverse @ missed
    out = np.empty_like(missed)
    for rows in rows_by(trial):
        out[rows] = np.linalg.solve(inverse[np.ix_(rows, rows)], weights[rows])
    return out


def _some(trial: Ints, most: int) -> Mask:
    """States of this many whole trials, evenly, that about `most` remain, and no more."""
    step = int(np.ceil(len(trial) / most))
    chosen = np.isin(trial, np.unique(trial)[::step])
    return chosen & (np.cumsum(chosen) <= most)
