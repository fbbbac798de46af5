"""What gives way to a cause outside the catalogue is seen, and seen as what it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.criticism.probability_calibration import CALIBRATED
from diagnosis.criticism.unknown import Signs, signs
from diagnosis.inference.problem import Problem
from diagnosis.inference.search import Search
from tests.diagnosis.toy import Grid, toy_problem

GRID = Grid()
TRIAL = np.repeat(GRID.trial, 3)
KIND = np.zeros(TRIAL.size, np.int64)


def found(problem: Problem, kind: np.ndarray = KIND) -> Signs:
    return signs(problem, Search(problem).run()[0], TRIAL, kind, 1.0)


def stretched(problem: Problem, name: str, by: float) -> Problem:
    """The same world with one parameter further from its prior, in prior standard deviations."""
    p = problem.parameters
    i = p.names.index(name)
    slope = problem.forward.linearise(p.mean)[1][:, i]
    return replace(problem, observed=problem.observed + by * p.sd[i] * slope)


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_where_the_model_holds_nothing_is_strained(seed: int) -> None:
    sign = found(toy_problem(seed, {"play": 1.0}))
    assert sign.strain < 4 and sign.strained == ""


def test_a_tolerance_far_beyond_its_prior_is_strain_and_named() -> None:
    calm, strained = toy_problem(3, {}), stretched(toy_problem(3, {}), "trial 3", 12.0)
    assert found(strained).strain > found(calm).strain + 5
    assert found(strained).strained == "trial 3"


def test_a_spine_that_one_trial_has_of_its_own_is_odd_and_no_strain() -> None:
    problem = stretched(toy_problem(3, {}), "trial 3", 12.0)
    own = [name.startswith("trial") for name in problem.parameters.names]
    sources = tuple("spine_length" if o else "" for o in own)
    trials = tuple(number if o else None for number, o in enumerate(own))
    sign = found(replace(problem, parameters=replace(problem.parameters, sources=sources, trials=trials)))
    assert sign.odd_spine > 5 and sign.strained == ""


def test_a_kind_of_experiment_that_the_others_do_not_predict_is_a_surprise() -> None:
    kind = (TRIAL > 14).astype(np.int64)
    problem = toy_problem(3, {"play": 1.0})
    pushed = np.tile([0.0, 1.0, 0.0], len(GRID.trial)) * np.repeat(GRID.pressure / 250e3, 3) * 3e-3 * kind
    calm, surprised = found(problem, kind), found(replace(problem, observed=problem.observed + pushed), kind)
    assert calm.transport == pytest.approx(1.0, abs=0.3)
    assert surprised.transport is not None and surprised.transport > 1.5


def test_every_sign_raises_the_probability_of_a_cause_outside_the_catalogue() -> None:
    calm = Signs(-20.0, 0.0, 1.0, 0.0, "", 1.0, 1, 2.0, 1.0, None, 1.0)
    least = CALIBRATED.outside(calm, 1.0)
    assert least < 0.1
    for sign, trend in (
        (replace(calm, strain=10.0), 1.0),
        (replace(calm, transport=4.0), 1.0),
        (replace(calm, odd_spine=7.0), 1.0),
        (replace(calm, named=3), 1.0),
        (replace(calm, beyond=6.0), 1.0),
        (calm, 1e-4),
    ):
        assert CALIBRATED.outside(sign, trend) > least
