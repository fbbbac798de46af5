"""Cross-validation predicts only unseen values; misfit diagnostics show what the catalogue cannot explain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.criticism.misfit import misfit_diagnostics
from diagnosis.data.noise import Noise
from diagnosis.inference.cross_validation import CrossValidation, Model
from diagnosis.inference.fit import fit
from diagnosis.inference.problem import Problem
from diagnosis.inference.search import Search
from tests.diagnosis.toy import IDS, MM, Grid, toy_problem

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


def test_data_of_the_catalogue_raise_no_diagnostic() -> None:
    problem = toy_problem(3, {"play": 1.0})
    found = misfit_diagnostics(problem, Search(problem).run()[0], TRIAL, 1.0)
    assert found.lack_of_fit == pytest.approx(1.0, abs=0.15)
    assert found.outlier_trial is None


def test_a_law_that_is_far_off_is_seen_as_an_error_of_the_laws() -> None:
    problem = toy_problem(3, {"turned": 1.0})
    turned = problem.linearise(problem.parameters.mean)[1][:, IDS.index("turned")]
    other = changed(problem, 0.5 * turned * np.sin(np.repeat(GRID.length, 3) / 0.06))
    gains = [misfit_diagnostics(p, Search(p).run()[0], TRIAL, 1.0).law_error_gain for p in (problem, other)]
    assert gains[0] < 0 < 5 < gains[1]


def test_one_bad_trial_is_named() -> None:
    problem = changed(toy_problem(3, {}), np.where(TRIAL == 12, 1.5 * MM, 0.0))
    assert misfit_diagnostics(problem, Search(problem).run()[0], TRIAL, 1.0).outlier_trial == 12


def test_noise_of_a_part_is_the_part_of_the_noise() -> None:
    noise = Noise(np.repeat(np.arange(5), 3), np.arange(1.0, 16), np.linspace(-1, 1, 15)[:, None])
    own = np.repeat(np.arange(5), 3) == 3
    values = np.linspace(0, 1, 15)
    assert noise.take(own).whiten(values[own]) == pytest.approx(noise.whiten(values)[own])
