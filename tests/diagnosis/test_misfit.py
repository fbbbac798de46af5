"""Each misfit diagnostic responds to its own kind of cause outside the catalogue."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.criticism.misfit import MisfitDiagnostics, misfit_diagnostics
from diagnosis.criticism.probability_calibration import CALIBRATED
from diagnosis.inference.problem import Problem
from diagnosis.inference.search import Search
from diagnosis.judgement import PRIOR_OF_NUMBER
from tests.diagnosis.toy import Grid, toy_problem

GRID = Grid()
TRIAL = np.repeat(GRID.trial, 3)
KIND = np.zeros(TRIAL.size, np.int64)


def found(problem: Problem, kind: np.ndarray = KIND) -> MisfitDiagnostics:
    return misfit_diagnostics(problem, Search(problem).run()[0], TRIAL, kind, 1.0)


def shifted_by(problem: Problem, name: str, by: float) -> Problem:
    """The same world with one parameter further from its prior, in prior standard deviations."""
    p = problem.parameters
    i = p.names.index(name)
    slope = problem.forward.linearise(p.mean)[1][:, i]
    return replace(problem, observed=problem.observed + by * p.sd[i] * slope)


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_where_the_model_holds_there_is_no_prior_tension(seed: int) -> None:
    misfit = found(toy_problem(seed, {"play": 1.0}))
    assert misfit.prior_tension < 4 and misfit.furthest_from_prior == ""


def test_a_tolerance_far_from_its_prior_gives_prior_tension_and_is_named() -> None:
    calm, shifted = toy_problem(3, {}), shifted_by(toy_problem(3, {}), "trial 3", 12.0)
    assert found(shifted).prior_tension > found(calm).prior_tension + 5
    assert found(shifted).furthest_from_prior == "trial 3"


def test_the_spine_of_one_trial_far_from_its_prior_is_a_spine_outlier_and_no_prior_tension() -> None:
    problem = shifted_by(toy_problem(3, {}), "trial 3", 12.0)
    infos = [
        replace(i, source="spine_length", scope="trial") if i.name.startswith("trial") else i
        for i in problem.parameters.infos
    ]
    misfit = found(replace(problem, parameters=replace(problem.parameters, infos=tuple(infos))))
    assert misfit.spine_outlier > 5 and misfit.furthest_from_prior == ""


def test_a_kind_of_experiment_that_the_others_do_not_predict_raises_cross_prediction() -> None:
    kind = (TRIAL > 14).astype(np.int64)
    problem = toy_problem(3, {"play": 1.0})
    pushed = np.tile([0.0, 1.0, 0.0], len(GRID.trial)) * np.repeat(GRID.pressure / 250e3, 3) * 3e-3 * kind
    calm, surprised = found(problem, kind), found(replace(problem, observed=problem.observed + pushed), kind)
    assert calm.cross_prediction == pytest.approx(1.0, abs=0.3)
    assert surprised.cross_prediction is not None and surprised.cross_prediction > 1.5


def test_what_is_far_from_its_prior_is_no_sign_of_a_cause_outside_the_catalogue() -> None:
    calm = MisfitDiagnostics(-20.0, 0.0, 1.0, 0.0, "", 1.0, 1, 2.0, 1.0, None, 1.0, 0.0)
    heavy_tailed = replace(calm, prior_tension=10.0, spine_outlier=7.0)
    assert CALIBRATED.probability_outside(heavy_tailed) == CALIBRATED.probability_outside(calm)
    prior = 1 - sum(PRIOR_OF_NUMBER.values())
    assert CALIBRATED.probability_outside(calm) == pytest.approx(CALIBRATED.outside_without_sign)
    assert 0.7 * prior < CALIBRATED.outside_without_sign < prior


def test_every_diagnostic_raises_the_probability_of_a_cause_outside_the_catalogue() -> None:
    calm = MisfitDiagnostics(-20.0, 0.0, 1.0, 0.0, "", 1.0, 1, 2.0, 1.0, None, 1.0, 0.0)
    least = CALIBRATED.probability_outside(calm)
    assert least < 0.1
    for misfit, gain in (
        (replace(calm, cross_prediction=4.0), 0.0),
        (replace(calm, effects_named=3), 0.0),
        (replace(calm, excess_scatter=6.0), 0.0),
        (replace(calm, law_error_gain=8.0), 0.0),
        (calm, 8.0),
    ):
        assert CALIBRATED.probability_outside(misfit, gain) > least
