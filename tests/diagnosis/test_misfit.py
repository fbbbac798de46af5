"""Each misfit diagnostic responds to its own kind of cause outside the catalogue."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.criticism.misfit import MisfitDiagnostics, misfit_diagnostics
from diagnosis.inference.problem import Problem
from diagnosis.inference.search import Search
from tests.diagnosis.toy import Grid, toy_problem

GRID = Grid()
TRIAL = np.repeat(GRID.trial, 3)


def found(problem: Problem) -> MisfitDiagnostics:
    return misfit_diagnostics(problem, Search(problem).run()[0], TRIAL, 1.0)


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
        replace(i, source="spine_length", scope="trial") if i.name.startswith("trial") else i for i in problem.parameters.infos
    ]
    misfit = found(replace(problem, parameters=replace(problem.parameters, infos=tuple(infos))))
    assert misfit.spine_outlier > 5 and misfit.furthest_from_prior == ""
