"""Each misfit diagnostic responds to its own kind of cause outside the catalogue."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.criticism.misfit import MisfitDiagnostics, misfit_diagnostics
from diagnosis.inference.problem import Problem
from diagnosis.inference.search import Search
from tests.diagnosis.toy import IDS, MM, Array, Grid, toy_problem

GRID = Grid()
TRIAL = np.repeat(GRID.trial, 3)


def found(problem: Problem) -> MisfitDiagnostics:
    return misfit_diagnostics(problem, Search(problem).run()[0], TRIAL, 1.0)


def shifted_by(problem: Problem, name: str, by: float) -> Problem:
    """The same world with one parameter further from its prior, in prior standard deviations."""
    p = problem.parameters
    i = p.names.index(name)
    slope = problem.forward.linearise(p.mean)[1][:, i]
    return changed(problem, by * p.sd[i] * slope)


def changed(problem: Problem, by: Array) -> Problem:
    return replace(problem, observed=problem.observed + by)


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_data_of_the_catalogue_raise_no_diagnostic(seed: int) -> None:
    misfit = found(toy_problem(seed, {"play": 1.0}))
    assert misfit.prior_tension < 4 and misfit.furthest_from_prior == ""
    assert misfit.lack_of_fit == pytest.approx(1.0, abs=0.15) and misfit.outlier_trial is None


def test_a_law_that_is_far_off_is_seen_as_an_error_of_the_laws() -> None:
    problem = toy_problem(3, {"turned": 1.0})
    turned = problem.linearise(problem.parameters.mean)[1][:, IDS.index("turned")]
    other = changed(problem, 0.5 * turned * np.sin(np.repeat(GRID.length, 3) / 0.06))
    assert found(problem).law_error_gain < 0 < 5 < found(other).law_error_gain


def test_one_bad_trial_is_named() -> None:
    assert found(changed(toy_problem(3, {}), np.where(TRIAL == 12, 1.5 * MM, 0.0))).outlier_trial == 12


def test_a_tolerance_far_from_its_prior_gives_prior_tension_and_is_named() -> None:
    calm, shifted = toy_problem(3, {}), shifted_by(toy_problem(3, {}), "trial 3", 12.0)
    assert found(shifted).prior_tension > found(calm).prior_tension + 5
    assert found(shifted).furthest_from_prior == "trial 3"


def test_the_spine_of_one_trial_far_from_its_prior_is_a_spine_outlier_and_no_prior_tension() -> None:
    problem = shifted_by(toy_problem(3, {}), "trial 3", 12.0)
    infos = [
        replace(i, source="spine_length", scope="trial") if i.name.startswith("trial") else i for i in problem.parameters.infos
    ]
    misfit = found(replace(problem, parameters=replace(problem.parameters, infos=tuple(infos))))
    assert misfit.spine_outlier > 5 and misfit.furthest_from_prior == ""
