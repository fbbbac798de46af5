"""Predicting data that a fit did not see: a share of the values is left out, the model refitted, the rest predicted.

A refit solves the linear problem of the other values around a fit to all of them. Where that diverges, because
the model is far from linear there or hardly any value constrains a parameter, the full non-linear fit is made. The
parameters found then predict with the non-linear model. The discrepancy weighs the fit but takes no part in the prediction,
unless it is asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .fit import Fit, fit
from .linear import Prior
from .problem import Forward, Problem

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


DIVERGED = 10.0
"""A linear refit with so many times the squared misfit of the fit to all values has diverged."""


@dataclass(frozen=True)
class Model:
    """A model that is refitted to parts of the data: prior of the effects, size of the discrepancy, a start."""

    prior: Prior
    """A variance of 0 leaves an effect as it is in the fit."""
    size: float
    around: Fit
    """A fit to all values, around which the refits are linear."""
    smooth: bool = False
    """Whether the discrepancy predicts too."""


def cross_validated_residuals(problem: Problem, model: Model, fold: Ints) -> Array:
    """Measured minus predicted (n,) for each value, predicted by a fit to all values of the other folds.

    `fold` (n,) numbers the parts; values of fold -1 are in every fit and are not predicted (NaN).
    """
    missed = np.full(len(problem.observed), np.nan)
    for part in np.unique(fold[fold >= 0]):
        seen, own = fold != part, fold == part
        missed[own] = (problem.observed - _predicted(problem, model, seen))[own]
    return missed


def _predicted(problem: Problem, model: Model, seen: NDArray[np.bool_]) -> Array:
    """What a fit to the values marked `seen` predicts (n,)."""
    theta, discrepancy = _refitted(problem, model, seen)
    predicted = problem.forward.predict(theta) + discrepancy
    noise = problem.noise.take(seen)
    after, before = (noise.whiten((problem.observed - y)[seen]) for y in (predicted, model.around.predicted))
    if np.isfinite(predicted).all() and float(after @ after) <= DIVERGED * float(before @ before):
        return predicted
    rest = replace(
        problem, forward=_Part(problem.forward, seen), observed=problem.observed[seen], noise=problem.noise.take(seen),
        discrepancy=problem.discrepancy[seen], shared_basis=problem.shared_basis[seen], channel_basis=problem.channel_basis[seen],
    )  # fmt: skip
    return problem.forward.predict(fit(rest, model.prior, model.size, model.around.theta).theta)


class _Part:
    """A forward model of which only some values are looked at."""

    def __init__(self, forward: Forward, seen: NDArray[np.bool_]) -> None:
        self._forward, self._seen = forward, seen

    def predict(self, theta: Array) -> Array:
        """Predicted values that are looked at."""
        return self._forward.predict(theta)[self._seen]

    def linearise(self, theta: Array, columns: Sequence[int] | None = None) -> tuple[Array, Array]:
        """The same, and their derivatives."""
        predicted, slope = self._forward.linearise(theta, columns)
        return predicted[self._seen], slope[self._seen]


def _refitted(problem: Problem, model: Model, seen: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Parameters (k,) that fit the values marked `seen`, and the discrepancy that is predicted with them (n,)."""
    at, predicted, slope = model.around.theta, model.around.predicted, model.around.slope
    p = problem.parameters
    scale, mean = p.scaled(model.prior)
    noise = problem.noise.take(seen)
    free = np.flatnonzero(scale > 0)
    columns = [noise.whiten(slope[np.ix_(seen, free)] * scale[free])]
    smooth = model.size * problem.discrepancy if model.size else np.zeros((len(predicted), 0))
    columns.append(noise.whiten(smooth[seen]))
    x = np.hstack(columns)
    here = np.zeros(x.shape[1])
    here[: free.size] = (at - mean)[free] / scale[free]
    missed = noise.whiten((problem.observed - predicted)[seen]) + x @ here
    found = np.linalg.solve(np.eye(x.shape[1]) + x.T @ x, x.T @ missed)
    theta = at.copy()
    theta[free] = mean[free] + scale[free] * found[: free.size]
    discrepancy = smooth @ found[free.size :] if model.smooth else np.zeros(len(predicted))
    return np.clip(theta, p.lower, p.upper), np.asarray(discrepancy)
