"""Causes outside the catalogue: what relatives explain, errors of a stage, misfits, and prediction of unseen values."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from diagnosis.criticism.gaussian import Gaussian, MisfitDiagnostics, misfit_diagnostics
from diagnosis.criticism.outside import odds_outside, related
from diagnosis.criticism.relatives import RELATIVES
from diagnosis.criticism.stage_errors import StageError, smooth_functions, stage_errors, total_gain
from diagnosis.data.case import states
from diagnosis.inference.cross_validation import CrossValidation, Model
from diagnosis.inference.evidence import Hypothesis
from diagnosis.inference.fit import fit
from diagnosis.inference.posterior import Related, alike
from diagnosis.inference.prepare import prepare, table_columns
from diagnosis.inference.problem import Problem, derivatives
from diagnosis.inference.search import Search
from diagnosis.judgement import FREE_FORM_ODDS, RELATIVE_ODDS, SAME_ODDS, SEPARATED_EVIDENCE, TEMPERATURE
from model.effects.catalogue import CATALOGUE
from model.effects.design import design_from_columns
from model.effects.forward import ForwardModel
from model.effects.spec import Stage
from model.robot import Uncertainty
from tests.diagnosis.small_campaigns import FEW, measured
from tests.diagnosis.test_case import ROBOT, case
from tests.diagnosis.toy import IDS, MM, ROBOT_LENGTH, Array, Grid, toy_problem


@dataclass(frozen=True)
class Tried:
    """A hypothesis and its log evidence."""

    named: Hypothesis
    log_evidence: float


KNOWN = (Tried((), 90.0), Tried(("marker_offset",), 100.0))
SCALE = Related("camera_scale", (), 100.0)
LEAST = SAME_ODDS + FREE_FORM_ODDS


def odds(among: tuple[Related, ...] = (), free_form: float = 0.0, scatter: float = 1.0) -> float:
    return odds_outside(KNOWN, among, free_form, scatter, len(CATALOGUE))  # type: ignore[arg-type]


def test_a_relative_as_good_as_what_is_named_is_rarer_by_its_prior_odds() -> None:
    assert odds() == pytest.approx(LEAST)
    assert 0.3 * RELATIVE_ODDS < odds((SCALE,)) - LEAST < RELATIVE_ODDS
    better = Related("camera_scale", (), 100.0 + TEMPERATURE)
    assert odds((better,)) - LEAST == pytest.approx(np.e * (odds((SCALE,)) - LEAST))
    assert odds((Related("camera_scale", ("marker_offset",), 100.0),)) - LEAST < 0.05 * RELATIVE_ODDS


def test_free_forms_and_excess_scatter_of_repeats_raise_the_odds() -> None:
    assert odds(free_form=-20.0) == pytest.approx(SAME_ODDS, rel=0.05)
    assert odds(free_form=4 * TEMPERATURE) > 20 * LEAST
    assert odds(scatter=1.9) == odds() and odds(scatter=6.0) == pytest.approx(3 * odds())


def test_what_does_the_same_takes_the_place_of_an_effect_that_is_named() -> None:
    far = Related("lens", (), 100.0 - 2 * SEPARATED_EVIDENCE)
    more = Related("body_length", ("marker_offset",), 99.0)
    assert alike((SCALE, more, far), ("marker_offset",), 100.0) == ("camera_scale",)
    assert alike((SCALE, more), ("marker_offset", "base_tilt"), 101.0) == ("camera_scale", "body_length")
    assert alike((SCALE, far), (), 90.0) == ("camera_scale",) and alike((SCALE, far), (), 99.0) == ()


@pytest.mark.parametrize("id", RELATIVES)
def test_a_relative_of_size_zero_does_nothing_and_moves_some_reading(id: str) -> None:
    design = design_from_columns(ROBOT, table_columns(states(measured(2, 4, FEW))[0]))
    plain, with_it = (ForwardModel(ROBOT, design, "one", effects, every_law=True) for effects in ({}, {id: RELATIVES[id]}))
    theta = np.zeros(len(with_it.parameters))
    y, slope = with_it.linearise(theta, with_it.index(id))
    assert y == pytest.approx(plain.predict(np.zeros(len(plain.parameters))), abs=1e-9)
    assert np.abs(slope).max() > 0


def test_air_passes_through_one_wall_alone() -> None:
    robot = ROBOT.replace(chambers=ROBOT.actuators.model_copy(update={"azimuths_deg": [0.0, 240.0, 120.0]}))
    beside = np.radians(180.0)  # the wall between the second and the third
    one = {"share": 1, "x1": 2 * np.cos(beside), "y1": 2 * np.sin(beside), "x2": 0, "y2": 0}
    q = SimpleNamespace(robot=robot, pressure=np.array([[[9e4, 6e4, 2e4]]]))
    RELATIVES["shared_pressure"].law.before(q, {name: np.array([[0.36 / 3 * x]]) for name, x in one.items()})  # type: ignore
    assert q.pressure[0, 0] == pytest.approx([9e4, 6e4 - 0.18 * 4e4, 2e4 + 0.18 * 4e4])


def test_cameras_that_read_too_long_are_a_relative_of_the_nearest_effect() -> None:
    rows = measured(2, 4, FEW).table
    scaled = [replace(r, tip=tuple(1.01 * x for x in r.tip)) for r in rows if r.tip is not None]
    nearest = {e: CATALOGUE[e] for e in ("marker_offset", "body_modulus")}
    surveyed = ROBOT.model_copy(update={"uncertainty": Uncertainty(length=0.5e-3, frame_shift=0.5e-3)})
    prepared = prepare(surveyed, states(case(scaled))[0], catalogue=nearest)
    search = Search(prepared.problem)
    search.run()
    asked = [search.with_all_derivatives(search.found[h]) for h in ((), ("marker_offset",))]
    reached = {h: c.log_evidence for h, c in search.found.items()}
    found = related(prepared, asked, reached)
    assert found[0].relative in ("camera_scale", "body_length")
    assert found[0].log_evidence > max(reached.values()) - SEPARATED_EVIDENCE
    assert odds_outside(search.tried, found, 0.0, 1.0, 2) > 2 * LEAST


STAGES: dict[str, Stage] = {
    "stiffer": "material", "ballooning": "actuation", "play": "structure", "turned": "actuation", "offset": "measurement",
    "bent": "boundary", "late": "measurement",
}  # fmt: skip
GRID = Grid()


def found(problem: Problem, named: Hypothesis) -> StageError:
    """The stage that gains most beside a hypothesis."""
    search = Search(problem)
    best = search.with_all_derivatives(next(c for c in search.run() if c.named == named))
    g = Gaussian(best.fit.linear(problem), best.prior(problem.parameters), best.grid_point.size, best.grid_point.form_error)
    time = np.arange(len(GRID.length), dtype=float)
    every = smooth_functions(GRID.length, GRID.pressure, GRID.branch, time, ROBOT_LENGTH)
    functions = {name: np.repeat(f, 3, axis=0) for name, f in every.items()}
    return stage_errors(g, problem.parameters, STAGES, functions)[0]


def response(problem: Problem, effect: str) -> np.ndarray:
    """What an effect does at its plausible scale."""
    return derivatives(problem.forward, np.zeros_like(problem.parameters.sd))[1].whole[:, problem.parameters.names.index(effect)]


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_where_the_model_holds_no_stage_gains(seed: int) -> None:
    assert found(toy_problem(seed, {"play": 1.0}), ("play",)).gain < 1


def test_a_moment_that_turns_with_the_spine_s_length_is_an_error_of_actuation() -> None:
    problem = toy_problem(3, {"play": 1.0})
    outside = 0.5 * response(problem, "turned") * np.repeat(np.sin(2 * np.pi * GRID.length / 0.3), 3)
    worst = found(changed(problem, outside), ("play",))
    assert (worst.stage, worst.dependence) == ("actuation", "spine length") and worst.gain > 10


def test_a_drift_of_the_base_is_an_error_of_the_boundary_over_time() -> None:
    problem = toy_problem(3, {})
    time = np.linspace(0, 1, len(GRID.length))
    outside = response(problem, "bent") * np.repeat(np.sin(2 * np.pi * time), 3)
    worst = found(changed(problem, outside), ())
    assert (worst.stage, worst.dependence) == ("boundary", "time") and worst.gain > 10


def test_a_wander_of_the_cameras_is_no_sign_of_a_cause_outside_the_catalogue() -> None:
    wander, tilt = StageError("measurement", "time", 40.0), StageError("boundary", "time", 20.0)
    rest = StageError("load", "pressure", 0.0)
    assert total_gain((wander, rest)) == pytest.approx(0.0)
    assert total_gain((wander, tilt, rest)) == pytest.approx(20.0 - np.log(2), abs=1e-6)
    assert total_gain((wander,)) == total_gain(()) == 0.0


TRIAL = np.repeat(GRID.trial, 3)


def diagnosed(problem: Problem) -> MisfitDiagnostics:
    best = Search(problem).run()[0]
    return misfit_diagnostics(problem, best, TRIAL, 1.0, best)


def changed(problem: Problem, by: Array) -> Problem:
    return replace(problem, observed=problem.observed + by)


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_data_of_the_catalogue_raise_no_diagnostic(seed: int) -> None:
    misfit = diagnosed(toy_problem(seed, {"play": 1.0}))
    assert misfit.lack_of_fit == pytest.approx(1.0, abs=0.15) and misfit.outlier_trial is None


def test_a_law_that_is_far_off_is_seen_as_an_error_of_the_laws() -> None:
    problem = toy_problem(3, {"turned": 1.0})
    turned = derivatives(problem.forward, np.zeros_like(problem.parameters.sd))[1].whole[:, IDS.index("turned")]
    other = changed(problem, 0.5 * turned * np.sin(np.repeat(GRID.length, 3) / 0.06))
    assert diagnosed(problem).law_error_gain < 0 < 5 < diagnosed(other).law_error_gain


def test_one_bad_trial_is_named() -> None:
    assert diagnosed(changed(toy_problem(3, {}), np.where(TRIAL == 12, 1.5 * MM, 0.0))).outlier_trial == 12


LENGTH = np.repeat(np.round(GRID.length / 0.05).astype(np.int64), 3)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def fitted(problem: Problem, named: tuple[str, ...], spike: float, size: float) -> Model:
    prior = problem.parameters.prior(problem.parameters.mask(named), spike)
    return Model(prior, size, fit(problem, prior, size, np.zeros_like(problem.parameters.sd)).theta)


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
    without, right = (
        rms(CrossValidation(problem, LENGTH).residuals([fitted(problem, *named)])()[0])
        for named in (((), 0.0, 0.0), (("play",), 0.0, 0.5))
    )
    assert right < 0.4 * MM < 0.8 * MM < without


def test_values_of_no_fold_are_not_predicted() -> None:
    problem = toy_problem(2, {})
    fold = np.where(LENGTH == 2, 0, -1)
    missed = CrossValidation(problem, fold).residuals([fitted(problem, (), 0.0, 0.0)])()[0]
    assert np.isnan(missed[fold < 0]).all() and np.isfinite(missed[fold == 0]).all()
