"""Cross-validation predicts only unseen values."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.inference.cross_validation import CrossValidation, Model
from diagnosis.inference.fit import fit
from diagnosis.inference.problem import Problem
from tests.diagnosis.toy import MM, Grid, toy_problem

GRID = Grid()
LENGTH = np.repeat(np.round(GRID.length / 0.05).astype(np.int64), 3)
TRIAL = np.repeat(GRID.trial, 3)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def fitted(problem: Problem, named: tuple[str, ...], spike: float, size: float) -> Model:
    prior = problem.parameters.prior(problem.parameters.mask(named), spike)
    return Model(prior, size, fit(problem, prior, size, problem.parameters.mean).theta)


def changed(problem: Problem, by: np.ndarray) -> Problem:
    return replace(problem, observed=problem.observed + by)


def test_what_is_predicted_does_not_depend_on_its_own_measurement() -> None:
    problem = toy_problem(1, {"play": 1.0})
    model = fitted(problem, ("play",), 0.1, 0.5)
    before = problem.observed - CrossValidation(problem, LENGTH).residuals([model])()[0]
    lifted = changed(problem, np.where(LENGTH == 3, 5 * MM, 0.0))
    after = lifted.observed - CrossValidation(lifted, LENGTH).residuals([model])()[0]
    assert after[LENGTH == 3] == pytest.approx(before[LENGTH == 3], abs=1e-9)
    assert rms(after[LENGTH != 3] - before[LENGTH != 3]) > 1e-5


def test_with_the_right_effect_unseen_lengths_are_predicted_to_the_floor_and_without_it_they_are_not() -> None:
    problem = toy_problem(2, {"play": 1.0})
    without = rms(CrossValidation(problem, LENGTH).residuals([fitted(problem, (), 0.0, 0.0)])()[0])
    assert (
        rms(CrossValidation(problem, LENGTH).residuals([fitted(problem, ("play",), 0.0, 0.5)])()[0])
        < 0.4 * MM
        < 0.8 * MM
        < without
    )


def test_values_of_no_fold_are_not_predicted() -> None:
    problem = toy_problem(2, {})
    fold = np.where(LENGTH == 2, 0, -1)
    missed = CrossValidation(problem, fold).residuals([fitted(problem, (), 0.0, 0.0)])()[0]
    assert np.isnan(missed[fold < 0]).all() and np.isfinite(missed[fold == 0]).all()
