"""Noise components from repeats: what differs between readings of the same state, and how much of it belongs to a trial.

Only differences between repeats enter (orthonormal contrasts within each condition), so errors of the model do not. The
components are standard deviations: white noise of each kind of channel, the error of the pressure reading (which moves all
channels of a state together), and parameters of each trial (spine length, stiffness of the re-jammed spine, ..). They are
estimated by maximum a posteriori with log-normal priors at the instruments' defaults.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from .noise import Noise

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

LOG_PRIOR_SD = 0.7
"""Prior standard deviation of the logarithm of each component, a factor of two either way."""
WIDE = 1.0
"""Standard deviation of what drifts, relative: far more than it ever does."""
LEAST_SHARE = 0.05
"""Least value of a component, as a share of its default."""


@dataclass(frozen=True)
class Repeated:
    """Measured minus predicted for states that were meant to be the same."""

    residual: Array
    """(n, c) of complete states, in the unit of each channel."""
    condition: Ints
    """(n,)"""
    group: tuple[str, ...]
    """(c,) kind of each channel: channels of a kind share their white noise."""
    pressure_response: Array
    """(n, c, r) d(prediction)/d(pressure reading) of each regulator, per Pa."""
    scatter: Mapping[str, Scatter]
    """Component -> what is drawn anew with each trial or repeat."""
    resting: NDArray[np.bool_]
    """(n,) states read at rest: they are averaged for longer than those read while ramping."""
    drift: Array
    """(n, c, d) d(prediction)/d(what drifts over the campaign): regular, so no noise."""


@dataclass(frozen=True)
class Scatter:
    """Parameters that are drawn anew with each trial, or with each repeat of the sweep."""

    response: Array
    """(n, c, a) d(prediction)/d(parameter), a parameters of one standard deviation."""
    part: Ints
    """(n,) trial or repeat."""


@dataclass(frozen=True)
class NoiseComponents:
    """Estimated standard deviations of the noise."""

    channel: Mapping[str, float]
    """Kind of channel -> unit of the channel."""
    pressure: float
    """Pa."""
    trial: Mapping[str, float]
    """Component -> its unit."""
    rest: float
    """White noise of states read at rest, as a factor on that of states read while ramping."""
    contrasts: int
    """Independent differences between repeats behind the estimate; 0: defaults, nothing was repeated."""
    excess_scatter: float = 1.0
    """Largest factor by which the pressure reading or a parameter of the trials scatters more than its default."""


def estimate_noise(data: Repeated, default: NoiseComponents) -> NoiseComponents:
    """Maximum a posteriori; `default` holds the centre of the priors and is returned where nothing was repeated."""
    contrast = _contrasts(data.condition)
    if not len(contrast):
        return default
    groups = list(default.channel)
    member = np.array([groups.index(g) for g in data.group])
    names = list(data.scatter)
    centre = np.log([*default.channel.values(), default.pressure, default.rest, *(default.trial[k] for k in names)])
    loss = _Loss(data, contrast, member, len(groups), names, centre)
    # Components that no contrast depends on stay at their defaults.
    found = minimize(loss, np.zeros(len(centre)), method="L-BFGS-B", bounds=[(np.log(LEAST_SHARE), 3.0)] * len(centre))
    value = np.exp(centre + found.x)
    g = len(groups)
    return NoiseComponents(
        channel=dict(zip(groups, value[:g].tolist(), strict=True)),
        pressure=float(value[g]),
        trial=dict(zip(names, value[g + 2 :].tolist(), strict=True)),
        rest=float(value[g + 1]),
        contrasts=len(contrast),
        excess_scatter=float(np.exp(np.max(np.append(found.x[g + 2 :], found.x[g])))),
    )


def reading_rms(data: Repeated, channels: NDArray[np.bool_]) -> float:
    """Root mean square distance of a single reading from what its condition would give on average.

    Over the channels marked (c,), summed in squares: the noise floor of the tip when these are x, y, z. NaN when
    nothing was repeated.
    """
    contrast = _contrasts(data.condition)
    if not len(contrast):
        return float("nan")
    apart = contrast @ data.residual[:, channels]
    drift = np.einsum("kn,ncd->kcd", contrast, data.drift[:, channels]).reshape(apart.size, -1)
    regular = drift @ np.linalg.lstsq(drift, apart.ravel(), rcond=None)[0]
    return float(np.sqrt(((apart - regular.reshape(apart.shape)) ** 2).sum(axis=1).mean()))


def _contrasts(condition: Ints) -> Array:
    """(k, n) orthonormal rows, each a difference between repeats of one condition."""
    rows = []
    for c in np.unique(condition):
        own = np.flatnonzero(condition == c)
        for k in range(1, own.size):
            row = np.zeros(len(condition))
            row[own[:k]], row[own[k]] = -1.0, k
            rows.append(row / np.sqrt(k * (k + 1)))
    return np.array(rows).reshape(len(rows), len(condition))


class _Loss:
    """Minus the log posterior of the components' logarithms, relative to the centre of their priors."""

    def __init__(
        self, data: Repeated, contrast: Array, member: Ints, groups: int, names: list[str], centre: Array
    ) -> None:
        k, c = len(contrast), data.residual.shape[1]
        self._centre, self._groups = centre, groups
        self._value = (contrast @ data.residual).ravel()
        self._state = np.repeat(np.arange(k), c)
        self._member = np.tile(member, k)
        # A contrast's weights squared sum to one: the response of its states, averaged.
        self._resting = np.repeat(contrast**2 @ data.resting, c)
        self._pressure = np.einsum("kn,ncr->kcr", contrast**2, data.pressure_response).reshape(k * c, -1)
        self._drift = WIDE * np.einsum("kn,ncd->kcd", contrast, data.drift).reshape(k * c, -1)
        self._trial = [self._parted(contrast, data.scatter[name]) for name in names]

    def _parted(self, contrast: Array, scatter: Scatter) -> Array:
        """(contrasts, columns) of a component: one column for each parameter of each trial or repeat."""
        own = (scatter.part[:, None] == np.unique(scatter.part)[None, :]).astype(float)
        made = np.einsum("kn,nca,nt->kcta", contrast, scatter.response, own, optimize=True)
        return np.asarray(made.reshape(len(self._value), -1))

    def __call__(self, shift: Array) -> float:
        value = np.exp(self._centre + shift)
        g = self._groups
        quiet = np.sqrt(1 + (value[g + 1] ** 2 - 1) * self._resting)
        noise = Noise(self._state, value[:g][self._member] * quiet, value[g] * self._pressure)
        white = noise.whiten(self._value)
        prior = 0.5 * float(((shift / LOG_PRIOR_SD) ** 2).sum())
        total = noise.log_sd + 0.5 * float(white @ white) + prior
        if self._trial or self._drift.shape[1]:
            scaled = [sd * block for sd, block in zip(value[g + 2 :], self._trial, strict=True)]
            columns = noise.whiten(np.hstack([*scaled, self._drift]))
            factor = cho_factor(np.eye(columns.shape[1]) + columns.T @ columns, lower=True)
            pulled = columns.T @ white
            total += float(np.log(np.diag(factor[0])).sum()) - 0.5 * float(pulled @ cho_solve(factor, pulled))
        return total
