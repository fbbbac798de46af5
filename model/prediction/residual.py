"""What a robot's model still misses, as a Gaussian process over its inputs.

    r(p, L_s) ~ GP(0, a^2 exp(-|p - p'|^2 / (2 l_p^2) - (L_s - L_s')^2 / (2 l_L^2)))

along each axis of the base frame alike. p (Pa) holds the pressure of each chamber: what bends alike by the model may miss
differently. A learnt state j differs from r by what its trial (sd s_t, the same for all states of the trial) and its reading (sd
s_r) add. Given n of them,

    mean r = k^T C^-1 y,    var r = a^2 - k^T C^-1 k,    C_ij = k(i, j) + s_t^2 [same trial] + s_r^2 [i = j]

so that far from all of them the mean is zero and the variance a^2 (Rasmussen & Williams, Gaussian Processes, 2006, ch. 2).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from model.arrays import Array
from model.robot import Robot
from model.stated import Residual


def kernel(p: Array, length: Array, q: Array, other: Array, pressure_scale: float, length_scale: float) -> Array:
    """(n, m) correlation of states p (n, chambers) Pa, length (n,) m with states q (m, chambers), other (m,)."""
    squares = ((p**2).sum(axis=1)[:, None] + (q**2).sum(axis=1) - 2 * p @ q.T) / pressure_scale**2
    return np.asarray(np.exp(-0.5 * (np.maximum(squares, 0.0) + ((length[:, None] - other) / length_scale) ** 2)))


def covariance(amplitude: float, per_trial: float, reading: float, trial: NDArray[Any], correlation: Array) -> Array:
    """(n, n) m^2 of learnt states: what is common to them, to those of one trial, and to one reading (sd, m)."""
    same = trial[:, None] == trial
    return np.asarray(amplitude**2 * correlation + per_trial**2 * same + reading**2 * np.eye(len(trial)))


@dataclass(frozen=True)
class ExpectedResidual:
    """What the model is expected to miss in n states."""

    mean: Array
    """(n, 3) m, to be added to the tip."""
    variance: Array | None
    """(n, 1) m^2 along each axis."""
    by_pressure: Array | None
    """(n, 3, chambers) m/Pa."""
    by_length: Array | None
    """(n, 3) m/m."""


class LearntResidual:
    """The residual that a robot.yaml states, ready to be asked."""

    def __init__(self, own: Residual) -> None:
        self._own, table = own, np.array(own.learnt, float)
        self._pressure, self._length = table[:, 1:-4], table[:, -4]
        c = covariance(own.amplitude, own.trial, own.reading, table[:, 0], self._correlation(self._pressure, self._length))
        self._factor = cho_factor(c, lower=True)
        self._weights = own.amplitude**2 * cho_solve(self._factor, table[:, -3:])

    def _correlation(self, pressure: Array, length: Array) -> Array:
        own = self._own
        return kernel(pressure, length, self._pressure, self._length, own.pressure_scale, own.length_scale)

    def __call__(self, pressure: Array, length: Array, *, intervals: bool = False, gradient: bool = False) -> ExpectedResidual:
        """The mean at pressures (n, chambers) Pa and spine lengths (n,) m, with variance or slopes where asked for."""
        residual, k = self._own, self._correlation(pressure, length)
        mean = np.asarray(k @ self._weights)
        variance = by_pressure = by_length = None
        if intervals:
            covariance = residual.amplitude**2 * k
            explained = (covariance * cho_solve(self._factor, covariance.T).T).sum(axis=1)
            variance = np.asarray(np.maximum(residual.amplitude**2 - explained, 0.0)[:, None])
        if gradient:
            moved = np.einsum("nj,jd,ja->nad", k, self._pressure, self._weights) - np.einsum("na,nd->nad", mean, pressure)
            by_pressure = np.asarray(moved / residual.pressure_scale**2)
            by_length = np.asarray(((k * (self._length - length[:, None])) @ self._weights) / residual.length_scale**2)
        return ExpectedResidual(mean, variance, by_pressure, by_length)


def residual_of(robot: Robot) -> LearntResidual | None:
    """The residual of a robot, if it has one."""
    return None if robot.residual is None else LearntResidual(robot.residual)
