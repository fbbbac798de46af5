"""Noise components from repeats: what differs between readings of the same state, and how much of it belongs to a trial.

Only differences between repeats enter (orthonormal contrasts within each condition), so errors of the model do not. The
components are standard deviations: white noise of each kind of channel, the error of the pressure reading (which moves all
channels of a state together), and parameters of each trial. A share of an error lasts from reading to reading (`noise`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import block_diag, helmert

from model.effects.scales import STANDARD

from ..arrays import Array, Ints, Mask, rows_by
from ..judgement import MEMORY

PRESSURE = "pressure"
"""The lasting error of the pressure readings."""


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
    """Component -> parameters drawn anew with each trial or repeat."""
    resting: Mask
    """(n,) states read at rest: they are averaged for longer than those read while ramping."""
    drift: Array
    """(n, c, d) d(prediction)/d(parameters that drift over the campaign): deterministic, so no noise."""
    block: Ints
    """(n,) readings among which errors last (`noise.blocks`), -1 where none does."""
    time: Array
    """(n,) s."""


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
    trial: Mapping[str, float] = field(default_factory=dict)
    """Component -> its unit."""
    rest: float = 1.0
    """White noise of states read at rest, as a factor on that of states read while ramping."""
    contrasts: int = 0
    """Independent differences between repeats behind the estimate; 0: defaults, nothing was repeated."""
    excess: Mapping[str, float] = field(default_factory=dict)
    """Component of the trials, and `pressure` -> its standard deviation as a factor on the default."""
    lasting: Mapping[str, float] = field(default_factory=dict)
    """Kind of channel, and `pressure` -> share of its variance that lasts from reading to reading; of others nothing does."""
    memory: float = MEMORY * STANDARD.time
    """s over which that is forgotten."""

    @property
    def excess_scatter(self) -> float:
        """The largest `excess`."""
        return max(self.excess.values(), default=1.0)


def reading_rms(data: Repeated, channels: Mask) -> float:
    """Root mean square distance of a single reading from the average of its condition, squares summed over `channels` (c,): the
    noise floor of the tip when these are x, y, z. Drift is fitted and removed if there are enough differences.
    NaN when nothing was repeated."""
    contrast = contrasts(data.condition)
    if not len(contrast):
        return float("nan")
    differences = contrast @ data.residual[:, channels]
    drift = np.einsum("kn,ncd->kcd", contrast, data.drift[:, channels]).reshape(differences.size, -1)
    drift /= np.maximum(np.linalg.norm(drift, axis=0), 1e-300)
    coefficients, _, rank, _ = np.linalg.lstsq(drift, differences.ravel(), rcond=1e-9)
    if rank > differences.size / 2:
        coefficients, rank = 0.0 * coefficients, 0
    remainder = differences.ravel() - drift @ coefficients
    return float(np.sqrt(differences.shape[1] * (remainder @ remainder) / (differences.size - rank)))


def contrasts(condition: Ints) -> Array:
    """(k, n) orthonormal rows, each a difference between repeats of one condition."""
    each = (-helmert(own.size) for own in rows_by(condition))
    return np.asarray(block_diag(np.zeros((0, 0)), *each)[:, np.argsort(np.argsort(condition, kind="stable"))])
