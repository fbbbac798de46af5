"""Predicting data that a fit did not see: a share of the values is left out, the model refitted, the rest predicted.

A refit begins at the fit to all values and keeps the derivatives there; if that does not reach the most probable point,
because the model is strongly non-linear there, they are recomputed. The parameters found then predict with the non-linear
model. The discrepancy weighs the fit, and is part of the prediction only on request.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import Array, Ints, Mask
from ..judgement import UNCONVERGED
from .executor import SINGLE_THREAD, DiagnosisStep, Executor
from .fit import Fit, fit, refit
from .jacobian import Columns, Jacobian
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
        self._known: dict[tuple[bytes, bytes], tuple[Array, Ints, Columns]] = {}
        """Predictions and derivatives at which refits of the present models begin."""

    def __getstate__(self) -> dict[str, Any]:
        """Without cached values."""
        return vars(self) | {"_known": {}}

    def residuals(self, models: Sequence[Model], step: DiagnosisStep | None = None) -> Callable[[], list[Array]]:
        """Start all refits; the returned function waits for them and returns measured minus predicted (n,) by model."""
        parts = [int(part) for part in np.unique(self._fold[self._fold >= 0])] if models else []
        left_out = self._executor.ahead(self._left_out, [(models, part) for part in parts], step)

        def residuals() -> list[Array]:
            missed = [np.full(len(self._problem.observed), np.nan) for _ in models]
            for part, of_models in zip(parts, left_out(), strict=True):
                for own, residual in zip(missed, of_models, strict=True):
                    own[self._fold == part] = residual
            self._known = {}
            return missed

        return residuals

    def _left_out(self, wanted: tuple[Sequence[Model], int]) -> list[Array]:
        """Measured minus predicted (r,) of the r values of one part, by fits of each model to all others; `wanted`: models, and
        the number of the part."""
        models, part = wanted
        problem, seen = self._problem, self._fold != part
        rest = only(problem, seen)
        return [(problem.observed - _predicted(problem, rest, m, self._linearised(m), seen))[~seen] for m in models]

    def _linearised(self, model: Model) -> tuple[Array, Ints, Columns]:
        """Prediction (n,) at the parameters of a model, which of them it leaves free (c,), and derivatives (n, c) by these."""
        free = np.flatnonzero(self._problem.parameters.scaled(model.prior)[0] > 0)
        begins = model.theta.tobytes(), free.tobytes()
        if begins not in self._known:
            predicted, columns = derivatives(self._problem.forward, model.theta, free.tolist())
            self._known[begins] = predicted, free, columns
        return self._known[begins]


def only(problem: Problem, seen: Mask) -> Problem:
    """The problem of the values marked `seen` (n,) alone."""
    forward, observed = MaskedForward(problem.forward, seen), problem.observed[seen]
    return Problem(forward, problem.parameters, observed, problem.noise.take(seen), problem.smooth.take(seen))


def _predicted(problem: Problem, rest: Problem, model: Model, around: tuple[Array, Ints, Columns], seen: Mask) -> Array:
    """Prediction (n,) of all values by a fit to those `seen`, begun at `around`: prediction and derivatives of the model."""
    predicted, free, columns = around
    own = Jacobian(len(model.theta), free, columns.rows(seen).whitened(rest.noise, rest.parameters.sd[free]))
    found = refit(rest, model.prior, model.size, Fit(model.theta, predicted[seen], own, np.nan, np.nan))
    if found.predicted_decrease > UNCONVERGED:
        found = fit(rest, model.prior, model.size, found.theta, least_promise=UNCONVERGED)
    everywhere, smooth, size = problem.forward.predict(found.theta), rest.whitened_discrepancy, model.size
    if model.smooth:  # with the most probable discrepancy of what the fit leaves of the values that it has seen
        left = smooth.T @ rest.noise.whiten(rest.observed - found.predicted)
        most_probable = np.asarray(np.linalg.solve(np.eye(len(left)) + size**2 * rest.gram, left), float)
        everywhere = everywhere + size**2 * problem.smooth.drawn(most_probable)
    return everywhere
