"""Predicting data that a fit did not see: a share of the values is left out, the model refitted, the rest predicted.

A refit begins at the fit to all values and keeps its derivatives; where that does not reach the most probable point, because
the model is far from linear there, derivatives are taken anew. The parameters found then predict with the non-linear model.
The discrepancy weighs the fit but takes no part in the prediction, unless it is asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from .executor import SINGLE_THREAD, Executor
from .fit import Fit, fit, refit
from .linear import Prior
from .problem import Forward, Problem

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


FAR_FROM_DONE = 0.5
"""A refit from which the cost should still decrease by more has not reached the most probable point."""


@dataclass(frozen=True)
class Model:
    """A model that is refitted to parts of the data: prior of the effects, size of the discrepancy, a start."""

    prior: Prior
    """A variance of 0 leaves an effect as it is in the fit."""
    size: float
    around: Fit
    """A fit to all values, near which the refits are."""
    smooth: bool = False
    """Whether the discrepancy predicts too."""


def cross_validated_residuals(
    problem: Problem,
    models: Sequence[Model],
    fold: Ints,
    executor: Executor = SINGLE_THREAD,
    shares: tuple[float, float] = (0.0, 1.0),
) -> list[Array]:
    """Measured minus predicted (n,) of each model, each value predicted by a fit to all values of the other folds.

    `fold` (n,) numbers the parts; values of fold -1 are in every fit and are not predicted (NaN). `shares` of the work are done
    before and after.
    """
    wanted = [(k, int(part)) for k in range(len(models)) for part in np.unique(fold[fold >= 0])]
    missed = [np.full(len(problem.observed), np.nan) for _ in models]
    left_out = executor.map(partial(_left_out, problem, tuple(models), fold), wanted, *shares)
    for (k, part), found in zip(wanted, left_out, strict=True):
        missed[k][fold == part] = found
    return missed


def _left_out(problem: Problem, models: tuple[Model, ...], fold: Ints, wanted: tuple[int, int]) -> Array:
    """Measured minus predicted for the values of one part, by a fit of one of the models to the others."""
    k, part = wanted
    return np.asarray((problem.observed - _predicted(problem, models[k], fold != part))[fold == part])


def _predicted(problem: Problem, model: Model, seen: NDArray[np.bool_]) -> Array:
    """What a fit to the values marked `seen` predicts (n,)."""
    rest = replace(
        problem, forward=_Part(problem.forward, seen), observed=problem.observed[seen], noise=problem.noise.take(seen),
        discrepancy=problem.discrepancy[seen], shared_basis=problem.shared_basis[seen], channel_basis=problem.channel_basis[seen],
    )  # fmt: skip
    around = replace(model.around, predicted=model.around.predicted[seen], slope=model.around.slope[seen])
    found = refit(rest, model.prior, model.size, around)
    if found.predicted_decrease > FAR_FROM_DONE:
        found = fit(rest, model.prior, model.size, found.theta)
    predicted = problem.forward.predict(found.theta)
    return predicted + _discrepancy(problem, rest, model.size, found.predicted) if model.smooth else predicted


def _discrepancy(problem: Problem, rest: Problem, size: float, predicted: Array) -> Array:
    """Most probable discrepancy of all values (n,), from what a fit leaves of those that it has seen."""
    columns = size * rest.whitened_discrepancy
    missed = rest.noise.whiten(rest.observed - predicted)
    weights = np.linalg.solve(np.eye(columns.shape[1]) + columns.T @ columns, columns.T @ missed)
    return np.asarray(size * problem.discrepancy @ weights)


class _Part:
    """A forward model of which only some values are looked at."""

    def __init__(self, forward: Forward, seen: NDArray[np.bool_]) -> None:
        self._forward, self._seen = forward, seen

    def predict(self, theta: Array, trial: bool = False) -> Array:
        """Predicted values that are looked at."""
        return self._forward.predict(theta, trial)[self._seen]

    def linearise(self, theta: Array, columns: Sequence[int] | None = None) -> tuple[Array, Array]:
        """The same, and their derivatives."""
        predicted, slope = self._forward.linearise(theta, columns)
        return predicted[self._seen], slope[self._seen]

    def near(self, theta: Array) -> _Part:
        """The same, made quicker close to parameters (k,)."""
        return _Part(self._forward.near(theta), self._seen)
