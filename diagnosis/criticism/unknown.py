"""Signs that no effect of the catalogue explains the data.

A cause outside the catalogue is absorbed by whatever comes nearest to it, and what is absorbed does not show in the
residual. It shows in what had to give way: tolerances, other effects and errors of the laws that are further from where
they may be than their priors allow (strain), a kind of experiment that all others do not predict (transport), a single
trial that needs a spine of its own, a trend over time, repeats that differ by more than instruments and spines grown anew
do, the evidence for a large smooth discrepancy. What each is worth
was found on a bench (see probability_calibration).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from ..inference.evidence import KNOWN, LARGE, weigh
from ..inference.linear import Linear, Prior
from ..inference.problem import Parameters, Problem
from ..inference.search import Candidate

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]


LEAST_DISCREPANCY = 0.1
"""Size of the discrepancy that is always allowed for when values are predicted from others."""
LARGE_SHARE = 0.1
"""Prior share of a large discrepancy beside a named effect."""
SEEN = 0.05
"""Directions in which the data take away less than this share of the prior's variance tell nothing of strain."""
OF_SPINE = ("spine_length", "spine_stiffness")
"""What trials have of their own because the spine is grown and jammed anew."""
STRAINED = 4.0
"""Standard deviations from its prior at which a parameter is named as strained."""


@dataclass(frozen=True)
class Signs:
    """Signs of a cause outside the catalogue."""

    discrepancy_gain: float
    """Log evidence that a large discrepancy adds to the best hypothesis."""
    discrepancy_size: float
    """Expected size of the discrepancy, in units of the noise floor."""
    lack_of_fit: float
    """Squared misfit per degree of freedom after the fit, without discrepancy; 1 where the model holds."""
    strain: float
    """How much further all that the priors hold lies from them than it should, in standard deviations; about 0 where the
    model holds."""
    strained: str
    """The tolerance, effect or shape that lies furthest from its prior; empty when none lies far."""
    transport: float | None
    """Largest squared surprise per value of a kind of experiment that is predicted from all others; None where all
    states are of one kind."""
    named: int
    """How many effects the best hypothesis takes."""
    odd_spine: float
    """Standard deviations from its prior of the strangest spine that a single trial needs; 0 without spines."""
    beyond: float
    """Factor by which repeats differ more than usual, see `floor.Components`."""
    outlier_trial: int | None
    """The trial that fits least with the others, when its surprise has a probability below 0.001 over all trials."""
    outlier_surprise: float
    """Squared surprise per value of the least fitting trial."""


def signs(problem: Problem, best: Candidate, trial: Ints, kind: Ints, beyond: float) -> Signs:
    """Look for all of them around the best hypothesis; `trial`, `kind` (n,) of each measured value, `beyond` of the floor."""
    linear, p = best.fit.linear, problem.parameters
    large = LARGE.part(best.loose)
    beside = weigh(linear, large, p, [best.named])[0]
    cells = [np.logaddexp.reduce(w.cells, axis=2) for w in (best.weighed, beside)]
    both = np.concatenate([cells[0], cells[1] + np.log(LARGE_SHARE)], axis=1)
    weight = np.exp(both - both.max())
    sizes = np.concatenate([KNOWN.sizes, LARGE.sizes])
    expected = float((weight.sum(axis=0) * sizes).sum() / weight.sum())
    prior = best.prior(p)
    form = best.cell.form
    plain = _Gaussian(linear, prior, 0.0, form)
    within = _Gaussian(linear, prior, max(best.cell.size, LEAST_DISCREPANCY), form)
    own = _Gaussian(linear, prior, best.cell.size, form)
    surprise, numbers, probability = [], np.unique(trial), []
    for t in numbers:
        value, n = within.surprise(trial == t)
        surprise.append(value / n)
        probability.append(float(chi2.sf(value, n)))
    worst = int(np.argmin(probability))
    odd = probability[worst] * len(numbers) < 1e-3
    kinds = np.unique(kind)
    transport = [value / n for value, n in (within.surprise(kind == k) for k in kinds)] if len(kinds) > 1 else []
    strain, strained, odd_spine = _strain(own, p, best.named)
    return Signs(
        discrepancy_gain=beside.log_evidence - best.log_evidence,
        discrepancy_size=expected,
        lack_of_fit=plain.misfit_per_dof(),
        strain=strain,
        strained=strained,
        transport=max(transport) if transport else None,
        named=len(best.named),
        odd_spine=odd_spine,
        beyond=beyond,
        outlier_trial=int(numbers[worst]) if odd else None,
        outlier_surprise=float(surprise[worst]),
    )


def _strain(g: _Gaussian, p: Parameters, named: tuple[str, ...]) -> tuple[float, str, float]:
    """Strain of all but the calibration and what trials have of their own, the furthest of it, the oddest trial's."""
    order = np.concatenate([np.flatnonzero(p.of_effect), np.flatnonzero(~p.of_effect)])
    names, sources = np.array(p.names)[order], np.array(p.sources or ("",) * len(p.names))[order]
    effects = int(p.of_effect.sum())
    free = np.zeros(len(names), bool)
    free[effects:] = p.calibrated
    by_trial = p.of_trial[order]
    mask = np.zeros(len(names), bool)
    mask[:effects] = p.mask(named)
    nuisance = np.arange(len(names)) >= effects
    form = np.arange(len(names), len(names) + g.form)
    groups = [np.flatnonzero(~nuisance & mask), np.flatnonzero(~nuisance & ~mask)]
    groups += [np.flatnonzero(nuisance & ~free & ~by_trial), form]
    found = [g.distance(own) for own in groups if own.size]
    squares, rank = (float(sum(x)) for x in zip(*found, strict=True)) if found else (0.0, 0.0)
    single = g.single()[: len(names)]
    held = np.where(free | by_trial, 0.0, single)
    furthest = int(np.argmax(held))
    return (
        (squares - rank) / np.sqrt(2 * max(rank, 1.0)),
        str(names[furthest]) if held[furthest] > STRAINED else "",
        float(np.max(single[by_trial & np.isin(sources, OF_SPINE)], initial=0.0)),
    )


class _Gaussian:
    """A linear problem with everything integrated out: y ~ N(0, I + X X^T)."""

    def __init__(self, linear: Linear, prior: Prior, size: float, form: float) -> None:
        blocks = [linear.effects * np.sqrt(prior.variance), linear.nuisance]
        self.form = linear.form.shape[1] if form else 0
        """How many columns belong to errors of the laws."""
        if form:
            blocks.append(form * linear.form)
        if large := linear.discrepancy_size(size, form):
            blocks.append(large * linear.discrepancy)
        self._x = np.hstack(blocks)
        self._inverse = np.linalg.inv(np.eye(self._x.shape[1]) + self._x.T @ self._x)
        missed = linear.observed - linear.effects @ prior.mean
        self._left = missed - self._x @ (self._inverse @ (self._x.T @ missed))

    def surprise(self, own: Flags) -> tuple[float, int]:
        """Squared Mahalanobis distance of some values from what all the others predict, and how many they are."""
        x, left = self._x[own], self._left[own]
        # The block of the inverse covariance is the inverse covariance of the prediction's error.
        block = np.eye(len(x)) - x @ self._inverse @ x.T
        return float(left @ np.linalg.solve(block, left)), len(x)

    def misfit_per_dof(self) -> float:
        """Squared residual after the fit per remaining degree of freedom."""
        spent = self._x.shape[1] - float(np.trace(self._inverse))
        return float(self._left @ self._left) / max(len(self._left) - spent, 1.0)

    def distance(self, own: Ints) -> tuple[float, int]:
        """Squared Mahalanobis distance of some coefficients' posterior mean from what their prior leads to expect of it,
        chi-square with as many degrees of freedom as are returned besides."""
        mean = self._x[:, own].T @ self._left
        value, vector = np.linalg.eigh(np.eye(own.size) - self._inverse[np.ix_(own, own)])
        seen = value > SEEN
        along = vector[:, seen].T @ mean
        return float((along**2 / value[seen]).sum()), int(seen.sum())

    def single(self) -> Array:
        """The same distance (not squared) for each coefficient by itself."""
        spread = 1 - np.diag(self._inverse)
        mean = np.abs(self._x.T @ self._left)
        return np.asarray(np.where(spread > SEEN, mean / np.sqrt(np.maximum(spread, SEEN)), 0.0))
