"""How probable the data are under each hypothesis: marginal likelihoods of a joint spike-and-slab model.

Every effect of the catalogue is always in the model: narrow ("spike", a share of its plausible scale) unless the hypothesis
names it, wide ("slab", its whole scale) when it does. Width of the spike, size of the smooth discrepancy and size of the
model-form error are averaged over a small grid, the same for every hypothesis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_ndtr, logsumexp

from ..arrays import Array
from ..judgement import DISCREPANCY_SIZES, DISCREPANCY_WEIGHTS, LARGEST_TOLERATED_SIZE, LAW_ERRORS, LOAD_SIZES, TOLERATED_SIZES
from .linear import Linear, SizePrior
from .problem import FitParameters

Hypothesis = tuple[str, ...]
"""Ids of the effects that are named; empty for none."""
NONE: Hypothesis = ()


@dataclass(frozen=True)
class Grid:
    """What is averaged over, with weights that sum to one."""

    spikes: Array
    """(s,) prior standard deviation of effects that are not named, as a share of their scale."""
    slabs: Array
    """(s,) prior standard deviation of the loads among what is named, in units of their scale."""
    spike_weights: Array
    """(s,) of each pair of both."""
    sizes: Array
    """(g,) size of the discrepancy, of the unit in the problem's columns."""
    size_weights: Array
    form_errors: Array
    """(f,) standard deviation of the model-form error, as a share of what the named effect does; equally probable."""

    @property
    def log_weights(self) -> Array:
        """(s, g, f)."""
        of_both = np.log(self.spike_weights)[:, None, None] + np.log(self.size_weights)[:, None]
        return np.asarray(of_both - np.full(len(self.form_errors), np.log(len(self.form_errors))))

    def part(self, with_tolerances: bool) -> Grid:
        """The half in which all other effects are free within their tolerance, or the half in which they are absent.

        The weights of both sum to one together.
        """
        kept = (self.spikes > 0) == with_tolerances
        return replace(self, spikes=self.spikes[kept], slabs=self.slabs[kept], spike_weights=self.spike_weights[kept])


@dataclass(frozen=True)
class GridPoint:
    """One point of the grid."""

    spike: float
    slab: float
    size: float
    form_error: float


PAIRS = np.array([(spike, slab) for spike in TOLERATED_SIZES for slab in LOAD_SIZES])
EQUAL = np.full(len(PAIRS), 1 / len(PAIRS))
KNOWN = Grid(PAIRS[:, 0], PAIRS[:, 1], EQUAL, DISCREPANCY_SIZES, DISCREPANCY_WEIGHTS, LAW_ERRORS)
"""For hypotheses of the catalogue, none included; sizes in units of the noise floor."""


@dataclass(frozen=True)
class Weighed:
    """Log evidence of a hypothesis in one linear problem."""

    log_evidence: float
    log_terms: Array
    """(s, g, f) log evidence with the weights of the grid, before they are summed."""
    mean: Array
    """(p,) of the effects' parameters at the most probable point of the grid, in units of their scale."""
    covariance: Array
    """(p, p) of the same."""
    averaged_mean: Array
    """(p,) of the same, averaged over the grid."""
    averaged_sd: Array
    """(p,)."""
    peak: GridPoint
    """The most probable point of the grid."""

    @property
    def law_error_gain(self) -> float:
        """Log evidence that the largest share of model-form error adds to the least; 0 without any."""
        by_share = logsumexp(self.log_terms, axis=(0, 1))  # all shares are equally probable before
        return float(by_share[-1] - by_share[0])


def weigh(linear: Linear, grid: Grid, parameters: FitParameters, named: Sequence[Hypothesis]) -> list[Weighed]:
    """Log evidence of hypotheses in one linear problem.

    A named parameter's prior is a normal cut at its bounds, and a named effect has at least one size of `least_named`; sizes
    that are tolerated are below `LARGEST_TOLERATED_SIZE`.
    """
    masks = np.array([parameters.mask(h) for h in named])
    axes = grid.spikes, grid.slabs, grid.sizes, grid.form_errors
    if not linear.form_error.shape[1]:
        grid = replace(grid, form_errors=np.zeros(1))
    loaded = np.flatnonzero((masks & parameters.loads).any(axis=1))
    present = masks.any(axis=0) | bool((grid.spikes > 0).any())  # without tolerances what is not named is absent
    used = np.flatnonzero(present) if present.any() else np.zeros(1, np.int64)  # one at least, absent too
    effect_size = None if linear.effect_size is None else linear.effect_size[used]
    if not present.all():
        linear, parameters = replace(linear, effects=linear.effects[:, used]), parameters.of(used)
    reduced, log_weights = linear.reductions(grid.sizes, grid.form_errors), grid.log_weights
    log_terms = np.empty((len(masks), *log_weights.shape))
    first, second = np.empty((2, *log_terms.shape, used.size))
    for i, (spike, slab) in enumerate(zip(grid.spikes.tolist(), grid.slabs.tolist(), strict=True)):
        rows = np.arange(len(masks))
        if i and spike == grid.spikes[i - 1]:  # where no load is named, its size changes nothing
            rows, log_terms[:, i] = loaded, log_terms[:, i - 1] - log_weights[i - 1] + log_weights[i]
            first[:, i], second[:, i] = first[:, i - 1], second[:, i - 1]
        prior = parameters.prior(masks[rows[:, None, None, None], used], spike, slab, effect_size)
        log_evidence, mean, root = reduced.update(prior)
        variance = (root**2).sum(axis=-2)
        # Each parameter is cut by itself.
        cut = log_allowed_share(mean, variance, prior, parameters)
        cut -= log_allowed_share(prior.mean, prior.variance, prior, parameters)
        log_terms[rows, i] = log_evidence + cut + log_weights[i]
        first[rows, i], second[rows, i] = mean, variance + mean**2
    total = logsumexp(log_terms, axis=(1, 2, 3))
    weights = np.exp(log_terms - total[:, None, None, None])
    place, out = np.eye(masks.shape[1])[used], []
    averaged, square = (np.einsum("hsgfp,hsgf->hp", moment, weights) @ place for moment in (first, second))
    sds = np.sqrt(np.maximum(square - averaged**2, 0.0))
    for h, terms in enumerate(log_terms):
        i, j, k = map(int, np.unravel_index(int(terms.argmax()), terms.shape))
        peak = GridPoint(*(float(values[at]) for values, at in zip(axes, (i, i, j, k), strict=True)))
        _, mean, root = reduced[j, k].update(parameters.prior(masks[h, used], peak.spike, peak.slab, effect_size))
        out.append(Weighed(float(total[h]), terms, mean @ place, place.T @ (root.T @ root) @ place, averaged[h], sds[h], peak))
    return out


def log_allowed_share(mean: Array, variance: Array, prior: SizePrior, parameters: FitParameters) -> Array:
    """log of the share (...) of a normal (..., p) that lies within the bounds and off the small sizes of what is named, and
    within the bounds and the small sizes of what is tolerated."""
    sd = np.sqrt(np.maximum(variance, 1e-300))
    low, high, least = parameters.low, parameters.high, parameters.least_named
    tolerated = parameters.sizes & ~prior.wide
    below = np.where(tolerated, np.where(low < 0, -LARGEST_TOLERATED_SIZE, -np.inf), low)
    above = np.where(tolerated, np.where(high > 0, LARGEST_TOLERATED_SIZE, np.inf), high)
    within = log_mass(mean, sd, below, above)
    total = np.where(prior.wide | (prior.variance > 0), within, 0.0).sum(axis=-1)
    own = np.flatnonzero(prior.wide.reshape(-1, len(low)).any(axis=0))
    wide, members = prior.wide[..., own], parameters.members[own]
    small = log_mass(mean[..., own], sd[..., own], np.maximum(low, -least)[own], np.minimum(high, least)[own]) - within[..., own]
    # An effect is small only where all its sizes are.
    all_small = np.minimum(np.where(wide & parameters.sizes[own], small, 0.0) @ members, 0.0)
    # a normal whose share outside is smaller lies wholly among the small sizes
    outside = np.log(np.maximum(1 - np.exp(all_small), 1e-12))
    return np.asarray(total + np.where(wide @ members > 0, outside, 0.0).sum(axis=-1))


def log_mass(mean: Array, sd: Array, low: Array, high: Array) -> Array:
    """log of the share of a normal between low and high."""
    a, b = (low - mean) / sd, (high - mean) / sd
    # Mirrored where both ends lie above the mean, so that the difference is taken where it keeps its digits.
    flip = a > 0
    a, b = np.where(flip, -b, a), np.where(flip, -a, b)
    upper, lower = log_ndtr(b), log_ndtr(a)
    return np.asarray(upper + np.log1p(-np.exp(np.minimum(lower - upper, -1e-12))))
