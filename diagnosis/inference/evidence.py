"""How probable the data are under each hypothesis: marginal likelihoods of a joint spike-and-slab model.

Every effect of the catalogue is always in the model: narrow ("spike", a share of its plausible scale: no robot is
otherwise perfect) unless the hypothesis names it, wide ("slab", its whole scale) when it does. Width of the spike, size
of the smooth discrepancy and how far the named laws may be wrong are not known and are averaged over a small grid, the
same for every hypothesis. The hypothesis `unknown` names no effect but lets the discrepancy be large.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr, logsumexp

from .linear import Linear, Prior, Reduced
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
    forms: Array
    """(f,) share of what a named effect does that its law may get wrong."""
    form_weights: Array

    @property
    def log_weights(self) -> Array:
        """(s, g, f)."""
        s, g, f = (np.log(w) for w in (self.spike_weights, self.size_weights, self.form_weights))
        out: Array = s[:, None, None] + g[None, :, None] + f[None, None, :]
        return out

    def part(self, loose: bool) -> Grid:
        """The part in which all other effects are present within their tolerance, or the one in which they are absent.

        The weights of both sum to one together.
        """
        kept = (self.spikes > 0) == loose
        return replace(self, spikes=self.spikes[kept], spike_weights=self.spike_weights[kept])


@dataclass(frozen=True)
class Cell:
    """One point of the grid."""

    spike: float
    size: float
    form: float


SPIKES = np.array([0.0, 0.08, 0.16])
SPIKE_WEIGHTS = np.array([1, 1, 1]) / 3
FORMS, FORM_WEIGHTS = np.array([0.0, 0.03, 0.1]), np.array([0.4, 0.35, 0.25])
KNOWN = Grid(SPIKES, SPIKE_WEIGHTS, np.array([0.0, 0.1, 0.25]), np.array([0.5, 0.3, 0.2]), FORMS, FORM_WEIGHTS)
"""For hypotheses of the catalogue, none included; sizes in units of the noise floor."""
LARGE = Grid(
    SPIKES, SPIKE_WEIGHTS, np.array([0.35, 0.7, 1.4, 2.8]), np.array([1, 1, 1, 1]) / 4, np.array([0.0]), np.array([1.0])
)
"""For the hypothesis that something outside the catalogue is at work."""


DOMINANT = 0.35
"""Share of its scale that an effect must have to be named: less, twice the widest spike, is what the tolerances of all
effects stand for."""
TOLERABLE = 0.5
"""Share of its scale above which an effect that is there must be named."""
LEAST = 1e-12
"""Share below which a normal counts as lying wholly among the small sizes."""


@dataclass(frozen=True)
class Weighed:
    """A hypothesis in the linear problem it was weighed in."""

    log_evidence: float
    cells: Array
    """(s, g, f) log evidence with the weights of the grid, before they are summed."""

    def peak(self, grid: Grid) -> Cell:
        """The most probable point of the grid it was weighed on."""
        i, j, k = np.unravel_index(int(np.argmax(self.cells)), self.cells.shape)
        return Cell(float(grid.spikes[i]), float(grid.sizes[j]), float(grid.forms[k]))


def weigh(linear: Linear, grid: Grid, parameters: Parameters, named: Sequence[Hypothesis]) -> list[Weighed]:
    """Log evidence of hypotheses in one linear problem.

    A named parameter's prior is a normal cut at its bounds, and a named effect has at least one size of `DOMINANT`; sizes
    that are tolerated are below `TOLERABLE`.
    """
    masks = np.array([parameters.mask(h) for h in named])
    if not linear.form.shape[1]:
        grid = replace(grid, forms=np.zeros(1), form_weights=np.ones(1))
    cells = np.empty((len(masks), *grid.log_weights.shape))
    reduced = linear.reductions(grid.sizes, grid.forms)
    for i, spike in enumerate(grid.spikes):
        prior = parameters.prior(masks, float(spike), linear.reach)
        for j, row in enumerate(reduced):
            for k, problem in enumerate(row):
                cells[:, i, j, k] = problem.log_evidence(prior) + _cut(problem, prior, parameters)
    cells += grid.log_weights
    return [Weighed(float(logsumexp(c)), c) for c in cells]


def _cut(problem: Reduced, prior: Prior, parameters: Parameters) -> Array:
    """What the bounds of the named parameters, that a named effect is no small one and that a tolerated one is, add to the
    log evidence (h,).

    Each parameter is taken by itself.
    """
    mean, covariance = problem.posterior(prior)
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    return _allowed(mean, variance, prior, parameters) - _allowed(prior.mean, prior.variance, prior, parameters)


def _allowed(mean: Array, variance: Array, prior: Prior, parameters: Parameters) -> Array:
    """log of the share (h,) of a normal (h, p) that lies within the bounds and off the small sizes of what is named, and
    within the bounds and the small sizes of what is tolerated."""
    sd = np.sqrt(np.maximum(variance, 1e-300))
    low, high = parameters.low, parameters.high
    within = _log_mass(mean, sd, low, high)
    total = np.where(prior.wide, within, 0.0).sum(axis=1)
    small = _log_mass(mean, sd, np.maximum(low, -DOMINANT), np.minimum(high, DOMINANT)) - within
    # An effect is small only where all its sizes are.
    all_small = np.minimum(np.where(parameters.sizes, small, 0.0) @ parameters.members, 0.0)
    outside = np.log(np.maximum(1 - np.exp(all_small), LEAST))
    named = (prior.wide @ parameters.members) > 0
    least, most = np.where(low < 0, -TOLERABLE, -np.inf), np.where(high > 0, TOLERABLE, np.inf)
    held = np.where(parameters.sizes, _log_mass(mean, sd, least, most), within)
    total += np.where(~prior.wide & (prior.variance > 0), held, 0.0).sum(axis=1)
    return np.asarray(total + np.where(named, outside, 0.0).sum(axis=1))


def _log_mass(mean: Array, sd: Array, low: Array, high: Array) -> Array:
    """log of the share of a normal between low and high."""
    a, b = (low - mean) / sd, (high - mean) / sd
    # Mirrored where both ends lie above the mean, so that the difference is taken where it keeps its digits.
    flip = a > 0
    a, b = np.where(flip, -b, a), np.where(flip, -a, b)
    upper, lower = log_ndtr(b), log_ndtr(a)
    out: Array = upper + np.log1p(-np.exp(np.minimum(lower - upper, -1e-12)))
    return out
