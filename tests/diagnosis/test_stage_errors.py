"""A stage that has an error of its own is found, with what it depends on; where the model holds none asks for one."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.criticism.gaussian import Gaussian
from diagnosis.criticism.stage_errors import StageError, smooth_functions, stage_errors, total_gain
from diagnosis.inference.evidence import Hypothesis
from diagnosis.inference.problem import Problem
from diagnosis.inference.search import Search
from model.effects.spec import Stage
from tests.diagnosis.toy import ROBOT_LENGTH, Grid, toy_problem

STAGES: dict[str, Stage] = {
    "stiffer": "material",
    "ballooning": "actuation",
    "play": "structure",
    "turned": "actuation",
    "offset": "measurement",
    "bent": "boundary",
    "late": "measurement",
}
GRID = Grid()


def found(problem: Problem, named: Hypothesis) -> StageError:
    """The stage that gains most beside a hypothesis."""
    search = Search(problem)
    best = search.with_all_derivatives(next(c for c in search.run() if c.named == named))
    g = Gaussian(best.linear(problem), best.prior(problem.parameters), best.grid_point.size, best.grid_point.form_error)
    time = np.arange(len(GRID.length), dtype=float)
    every = smooth_functions(GRID.length, GRID.pressure, GRID.branch, time, ROBOT_LENGTH)
    functions = {name: np.repeat(f, 3, axis=0) for name, f in every.items()}
    return stage_errors(g, problem.parameters, STAGES, functions)[0]


def response(problem: Problem, effect: str) -> np.ndarray:
    """What an effect does at its plausible scale."""
    return problem.linearise(problem.parameters.mean)[1][:, problem.parameters.names.index(effect)]


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_where_the_model_holds_no_stage_gains(seed: int) -> None:
    assert found(toy_problem(seed, {"play": 1.0}), ("play",)).gain < 1


def test_a_moment_that_turns_with_the_spine_s_length_is_an_error_of_actuation() -> None:
    problem = toy_problem(3, {"play": 1.0})
    outside = 0.5 * response(problem, "turned") * np.repeat(np.sin(2 * np.pi * GRID.length / 0.3), 3)
    worst = found(replace(problem, observed=problem.observed + outside), ("play",))
    assert (worst.stage, worst.dependence) == ("actuation", "spine length") and worst.gain > 10


def test_a_drift_of_the_base_is_an_error_of_the_boundary_over_time() -> None:
    problem = toy_problem(3, {})
    time = np.linspace(0, 1, len(GRID.length))
    outside = response(problem, "bent") * np.repeat(np.sin(2 * np.pi * time), 3)
    worst = found(replace(problem, observed=problem.observed + outside), ())
    assert (worst.stage, worst.dependence) == ("boundary", "time") and worst.gain > 10


def test_a_wander_of_the_cameras_is_no_sign_of_a_cause_outside_the_catalogue() -> None:
    wander, tilt = StageError("measurement", "time", 40.0), StageError("boundary", "time", 20.0)
    rest = StageError("load", "pressure", 0.0)
    assert total_gain((wander, rest)) == pytest.approx(0.0)
    assert total_gain((wander, tilt, rest)) == pytest.approx(20.0 - np.log(2), abs=1e-6)
    assert total_gain((wander,)) == total_gain(()) == 0.0
