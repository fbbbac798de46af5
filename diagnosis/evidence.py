"""How probable the data are under each hypothesis: marginal likelihoods of a joint spike-and-slab model.

Every effect of the catalogue is always in the model: narrow ("spike", a share of its plausible scale: no robot is
otherwise perfect) unless the hypothesis names it, wide ("slab", its whole scale) when it does. Width of the spike and
size of the smooth discrepancy are not known and are averaged over a small grid, the same for every hypothesis. The
hypothesis `unknown` names no effect but lets the discrepancy be large.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr, logsumexp

from .linear import Linear, Reduced
from .problem import Parameters

Array = NDArray[np.float64]

Hypothesis = tuple[str, ...]
"""Ids of the effects that are named; empty for none."""
NONE: Hypothesis = ()


@dataclass(frozen=True)
class Grid:
    """What is averaged over, with weights that sum to one."""

    spikes: Array
    """(s,) share of each effect's scale that it may have without being named."""
    spike_weights: Array
    sizes: Array
    """(g,) size of the discrepancy, of the unit in the problem's columns."""
    size_weights: Array

    @property
    def log_weights(self) -> Array:
        """(s, g)."""
        return np.log(self.spike_weights)[:, None] + np.log(self.size_weights)[None, :]


SPIKES = np.array([0.0, 0.1, 0.25])
SPIKE_WEIGHTS = np.array([1, 1, 1]) / 3
KNOWN = Grid(SPIKES, SPIKE_WEIGHTS, np.array([0.0, 0.1, 0.25, 0.5]), np.array([0.4, 0.3, 0.2, 0.1]))
"""For hypotheses of the catalogue, none included; sizes in units of the noise floor."""
LARGE = Grid(SPIKES, SPIKE_WEIGHTS, np.array([0.5, 1.0, 2.0, 4.0]), np.array([0.25, 0.25, 0.25, 0.25]))
"""For the hypothesis that something outside the catalogue is at work."""


@dataclass(frozen=True)
class Weighed:
    """A hypothesis in the linear problem it was weighed in."""

    log_evidence: float
    cells: Array
    """(s, g) log evidence with the weights of the grid, before they are summed."""

    @property
    def share(self) -> Array:
        """(s, g) posterior over the grid."""
        out: Array = np.exp(self.cells - self.log_evidence)
        return out


def weigh(reduced: Sequence[Reduced], grid: Grid, parameters: Parameters, named: Sequence[Hypothesis]) -> list[Weighed]:
    """Log evidence of hypotheses.

    `reduced` holds one problem for each size of the grid. A named parameter's prior is a normal cut at its bounds; the
    spikes are left uncut (they are narrow and stand for small errors of either sign).
    """
    masks = np.array([parameters.mask(h) for h in named])
    low, high = parameters.low, parameters.high
    cells = np.empty((len(masks), len(grid.spikes), len(grid.sizes)))
    for i, spike in enumerate(grid.spikes):
        variance = np.where(masks, 1.0, spike**2 * parameters.sizes)
        for j, problem in enumerate(reduced):
            cells[:, i, j] = problem.log_evidence(variance) + _cut(problem, variance, masks, low, high)
    cells += grid.log_weights
    return [Weighed(float(logsumexp(c)), c) for c in cells]


def _cut(problem: Reduced, variance: Array, masks: NDArray[np.bool_], low: Array, high: Array) -> Array:
    """What the bounds of the named parameters add to the log evidence (h,), each parameter taken by itself."""
    bounded = np.isfinite(low) | np.isfinite(high)
    added = np.zeros(len(masks))
    rows = np.flatnonzero((masks & bounded).any(axis=1))
    if not rows.size:
        return added
    prior = _log_mass(np.zeros_like(low), np.ones_like(low), low, high)
    root = np.sqrt(variance[rows])
    inner = np.eye(len(low)) + root[:, :, None] * problem.information * root[:, None, :]
    covariance = root[:, :, None] * np.linalg.inv(inner) * root[:, None, :]
    mean = covariance @ problem.score
    sd = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 1e-300))
    gain = _log_mass(mean, sd, low, high) - prior
    added[rows] = np.where(masks[rows] & bounded, gain, 0.0).sum(axis=1)
    return added


def _log_mass(mean: Array, sd: Array, low: Array, high: Array) -> Array:
    """log of the share of a normal between low and high."""
    a, b = (low - mean) / sd, (high - mean) / sd
    # Mirrored where both ends lie above the mean, so that the difference is taken where it keeps its digits.
    flip = a > 0
    a, b = np.where(flip, -b, a), np.where(flip, -a, b)
    upper, lower = log_ndtr(b), log_ndtr(a)
    out: Array = upper + np.log1p(-np.exp(np.minimum(lower - upper, -1e-12)))
    return out


def weigh_at(linear: Linear, grid: Grid, parameters: Parameters, named: Sequence[Hypothesis]) -> list[Weighed]:
    """The same, starting from a linear problem."""
    return weigh(linear.reductions(grid.sizes), grid, parameters, named)
