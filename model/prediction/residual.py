"""What a robot's model still misses, as a Gaussian process over its inputs.

    r(u, L_s) ~ GP(0, a^2 exp(-|u - u'|^2 / (2 l_p^2) - (L_s - L_s')^2 / (2 l_L^2))),    u = sum_i p_i (cos az_i, sin az_i, 1)

along each axis of the base frame alike. u (Pa) is what the pressures p_i of the chambers at azimuths az_i do to the
cross-section: two bending moments and a thrust, up to a factor. A learnt state j differs from r by what its trial (sd s_t, the
same for all states of the trial) and its reading (sd s_r) add. Given n of them,

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


def section_sums(robot: Robot, pressure: Array) -> Array:
    """(n, 3) Pa: the sums u of pressures (n, chambers)."""
    return np.asarray(pressure @ _directions(robot))


def kernel(u: Array, length: Array, v: Array, other: Array, pressure_scale: float, length_scale: float) -> Array:
    """(n, m) correlation of states u (n, 3) Pa, length (n,) m with states v (m, 3), other (m,)."""
    squares = ((u**2).sum(axis=1)[:, None] + (v**2).sum(axis=1) - 2 * u @ v.T) / pressure_scale**2
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

    def __init__(self, robot: Robot, own: Residual) -> None:
        self._robot, self._own = robot, own
        table = np.array(own.states, float)
        self._u, self._length = table[:, 1:4], table[:, 4]
        c = covariance(own.amplitude, own.trial, own.reading, table[:, 0], self._correlation(self._u, self._length))
        self._factor = cho_factor(c, lower=True)
        self._weights = own.amplitude**2 * cho_solve(self._factor, table[:, 5:8])

    def _correlation(self, u: Array, length: Array) -> Array:
        own = self._own
        return kernel(u, length, self._u, self._length, own.pressure_scale, own.length_scale)

    def __call__(self, pressure: Array, length: Array, *, intervals: bool = False, gradient: bool = False) -> ExpectedResidual:
        """The mean at pressures (n, chambers) Pa and spine lengths (n,) m, with variance or slopes where asked for."""
        residual, u = self._own, section_sums(self._robot, pressure)
        k = self._correlation(u, length)
        mean = np.asarray(k @ self._weights)
        variance = by_pressure = by_length = None
        if intervals:
            covariance = residual.amplitude**2 * k
            explained = (covariance * cho_solve(self._factor, covariance.T).T).sum(axis=1)
            variance = np.asarray(np.maximum(residual.amplitude**2 - explained, 0.0)[:, None])
        if gradient:
            by_u = np.einsum("nj,jd,ja->nad", k, self._u, self._weights) - np.einsum("na,nd->nad", mean, u)
            by_pressure = np.asarray(by_u / residual.pressure_scale**2 @ _directions(self._robot).T)
            by_length = np.asarray(((k * (self._length - length[:, None])) @ self._weights) / residual.length_scale**2)
        return ExpectedResidual(mean, variance, by_pressure, by_length)


def residual_of(robot: Robot) -> LearntResidual | None:
    """The residual of a robot, if it has one."""
    return None if robot.residual is None else LearntResidual(robot, robot.residual)


def _directions(robot: Robot) -> Array:
    azimuth = np.radians(robot.actuators.azimuths_deg)
    return np.column_stack([np.cos(azimuth), np.sin(azimuth), np.ones(len(azimuth))])
