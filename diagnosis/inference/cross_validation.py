"""Predicting data that a fit did not see: a share of the values is left out, the model refitted, the rest predicted.

A refit begins at the fit to all values and keeps the derivatives there; if that does not reach the most probable point,
because the model is strongly non-linear there, they are recomputed. The parameters found then predict with the non-linear
model. The discrepancy weighs the fit, and is part of the prediction only on request.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..arrays import Array, Ints, Mask
from ..judgement import UNCONVERGED
from .executor import SINGLE_THREAD, DiagnosisStep, Executor
from .fit import Fit, fit, refit
from .jacobian import Jacobian
from .linear import SizePrior
from .problem import MaskedForward, Problem, derivatives


@dataclass(frozen=True)
class Model:
    """A model that is refitted to parts of the data: prior of the effects, size of the discrepancy, a start."""

    prior: SizePrior
    """A variance of 0 leaves an effect as it is in the fit."""
    size: float
    theta: Array
    """(k,) parameters fitted to all values, near which the refits are."""
    smooth: bool = False
    """Whether the discrepancy is part of the prediction."""


class CrossValidation:
    """One problem's values in parts, each of which is predicted by fits to the others."""

    def __init__(self, problem: Problem, fold: Ints, executor: Executor = SINGLE_THREAD) -> None:
        """`fold` (n,) numbers the parts; values of fold -1 are in every fit and are not predicted (NaN)."""
        self._problem, self._fold, self._executor = problem, fold, executor
        self._known: tuple[Model, Array, Jacobian] | None = None
        self._without: dict[int, Problem] = {}
        """Number of a part -> the problem of all values but its own."""

    def __getstate__(self) -> dict[str, Any]:
        """Without cached values."""
        return vars(self) | {"_known": None, "_without": {}}

    def residuals(self, models: Sequence[Model], step: DiagnosisStep | None = None) -> Callable[[], list[Array]]:
        """Start all refits; the returned function waits for them and returns measured minus predicted (n,) by model."""
        parts = [int(part) for part in np.unique(self._fold[self._fold >= 0])]
        left_out = self._executor.ahead(self._left_out, [(model, part) for model in models for part in parts], step)

        def residuals() -> list[Array]:
            missed = [np.full(len(self._problem.observed), np.nan) for _ in models]
            for k, residual in enumerate(left_out()):
                missed[k // len(parts)][self._fold == parts[k % len(parts)]] = residual
            return missed

        return residuals

    def _left_out(self, wanted: tuple[Model, int]) -> Array:
        """Measured minus predicted (r,) of the r values of one part, by a fit to all others; `wanted`: a model, and the number of
        the part."""
        model, part = wanted
        problem, seen = self._problem, self._fold != part
        if part not in self._without:
            self._without[part] = only(problem, seen)
        missed = problem.observed - _predicted(problem, self._without[part], model, self._linearised(model), seen)
        return np.asarray(missed[~seen])

    def _linearised(self, model: Model) -> tuple[Array, Jacobian]:
        """Prediction (n,) and derivatives (n, k) at the parameters of a model, by those that it leaves free."""
        known = self._known
        if known is None or not np.array_equal(known[0].theta, model.theta) or known[0].prior is not model.prior:
            free = np.flatnonzero(self._problem.parameters.scaled(model.prior)[0] > 0)
            predicted, columns = derivatives(self._problem.forward, model.theta, free.tolist())
            self._known = known = (model, predicted, Jacobian(len(model.theta), free, columns))
        return known[1:]


def only(problem: Problem, seen: Mask) -> Problem:
    """The problem of the values marked `seen` (n,) alone."""
    return replace(
        problem, forward=MaskedForward(problem.forward, seen), observed=problem.observed[seen], noise=problem.noise.take(seen),
        discrepancy=problem.discrepancy[seen], form_error_basis=problem.form_error_basis[seen],
    )  # fmt: skip


def _predicted(problem: Problem, rest: Problem, model: Model, around: tuple[Array, Jacobian], seen: Mask) -> Array:
    """Prediction (n,) of all values by a fit to those `seen`, begun at `around`: prediction and derivatives of the model."""
    predicted, slope = around
    own = Jacobian(slope.parameters, slope.at, slope.own.rows(seen))
    found = refit(rest, model.prior, model.size, Fit(model.theta, predicted[seen], own, np.nan, np.nan))
    if found.predicted_decrease > UNCONVERGED:
        found = fit(rest, model.prior, model.size, found.theta, least_promise=UNCONVERGED)
    everywhere = problem.forward.predict(found.theta)
    return everywhere + _discrepancy(problem, rest, model.size, found.predicted) if model.smooth else everywhere


def _discrepancy(problem: Problem, rest: Problem, size: float, predicted: Array) -> Array:
    """Most probable discrepancy of all values (n,), from a fit's residuals of the values it has seen."""
    columns = size * rest.whitened_discrepancy
    missed = rest.noise.whiten(rest.observed - predicted)
    weights = np.linalg.solve(np.eye(columns.shape[1]) + columns.T @ columns, columns.T @ missed)
    return np.asarray(size * problem.discrepancy @ weights)
