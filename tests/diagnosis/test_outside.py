"""Causes outside the catalogue: what relatives explain, errors of a stage, misfits, and prediction of unseen values."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from diagnosis.answer.attribute import Attribution
from diagnosis.answer.decision import Decision, Verdict
from diagnosis.answer.experiments import propose
from diagnosis.answer.result import Proposal, Value
from diagnosis.answer.size import places_found
from diagnosis.arrays import rms
from diagnosis.criticism.gaussian import Gaussian, outlier_trial
from diagnosis.criticism.outside import fit_relative, log_weight_of, related
from diagnosis.criticism.relatives import RELATIVES, named_places, relatives, walls
from diagnosis.criticism.stage_errors import StageError, odds_unnamed, smooth_functions, stage_errors, total_gain
from diagnosis.data.case import states
from diagnosis.inference.candidate import Candidate
from diagnosis.inference.cross_validation import CrossValidation, Model
from diagnosis.inference.evidence import Hypothesis
from diagnosis.inference.fit import fit
from diagnosis.inference.posterior import UNKNOWN, Related, alike, odds_of_relatives
from diagnosis.inference.prepare import prepare, table_columns
from diagnosis.inference.problem import Problem, derivatives
from diagnosis.inference.search import Search
from diagnosis.judgement import FREE_FORM_ODDS, RELATIVE_ODDS, SAME_ODDS, SEPARATED_EVIDENCE, TEMPERATURE
from model.effects.catalogue import CATALOGUE
from model.effects.design import design_from_columns
from model.effects.forward import ForwardModel
from model.effects.spec import Stage
from model.robot import Robot, Uncertainty, robot_from_dict
from recordings.trials import Table, TrialRow
from tests.diagnosis.small_campaigns import FEW, measured
from tests.diagnosis.test_case import ROBOT, Measured, case, row, sweep
from tests.diagnosis.toy import MM, ROBOT_LENGTH, Array, Grid, toy_problem
from tests.model.effects.campaigns import Moved

KNOWN = [SimpleNamespace(named=h, log_evidence=z) for h, z in (((), 90.0), (("marker_offset",), 100.0))]
SCALE = Related("camera_scale", (), 100.0)
LEAST = SAME_ODDS + FREE_FORM_ODDS


def odds(among: tuple[Related, ...] = (), free_form: float = 0.0, scatter: float = 1.0) -> float:
    weights = [log_weight_of(r, len(CATALOGUE)) for r in among]
    return odds_unnamed(free_form, scatter) + odds_of_relatives(KNOWN, weights, len(CATALOGUE))  # type: ignore[arg-type]


def test_a_relative_as_good_as_what_is_named_is_rarer_by_its_prior_odds() -> None:
    assert odds() == pytest.approx(LEAST)
    assert 0.3 * RELATIVE_ODDS < odds((SCALE,)) - LEAST < RELATIVE_ODDS
    better = Related("camera_scale", (), 100.0 + TEMPERATURE)
    assert odds((better,)) - LEAST == pytest.approx(np.e * (odds((SCALE,)) - LEAST))
    assert odds((Related("camera_scale", ("marker_offset",), 100.0),)) - LEAST < 0.05 * RELATIVE_ODDS
    assert odds((SCALE, Related("lens", (), np.nan))) == odds((SCALE,))


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
    y, slope = with_it.linearise(np.zeros(len(with_it.parameters)), with_it.index(id))
    assert y == pytest.approx(plain.predict(np.zeros(len(plain.parameters))), abs=1e-9)
    assert np.abs(slope).max() > 0


def small(azimuths: Sequence[float]) -> Robot:
    """A small robot without spine, its chambers in any order about the axis."""
    chambers = {"radius": 0.004, "path_radius": 0.014, "azimuths_deg": list(azimuths)}
    return robot_from_dict({
        "name": "small", "length": 0.2, "outer_radius": 0.02, "inner_radius": 0.006, "density": 1080.0, "youngs_modulus": 6e5,
        "shear_modulus": 2e5, "tip_mass": 0.0, "gravity": [0, 0, 9.81], "area_factor": 1.0, "chambers": chambers,
    })  # fmt: skip


@pytest.mark.parametrize(
    ("azimuths", "parted"),
    [((0, 180), {(1, 2)}), ((0, 240, 120), {(1, 2), (2, 3), (1, 3)}), ((10, -80, 190, 100), {(1, 2), (2, 3), (3, 4), (1, 4)})],
)
def test_a_share_of_the_difference_passes_each_wall_whose_neighbours_are_so_by_angle(
    azimuths: Sequence[float], parted: set[tuple[int, ...]]
) -> None:
    robot = small(azimuths)
    spec = relatives(robot)["shared_pressure"]
    assert set(walls(robot)) == parted and len(spec.parameters) == len(parted)
    inside = np.arange(1.0, len(azimuths) + 1)[None, None] ** 2
    for k, (i, j) in enumerate(walls(robot)):
        q = SimpleNamespace(robot=robot, pressure=inside)
        spec.law.before(q, {p.name: np.full((1, 1), 0.3 * (m == k)) for m, p in enumerate(spec.parameters)})  # type: ignore
        by = 0.3 * (j**2 - i**2)
        changed = {n + 1: x for n, x in enumerate((q.pressure - inside)[0, 0].tolist()) if x}
        assert changed == pytest.approx({i: by, j: -by})


@pytest.mark.parametrize(
    ("azimuths", "leaks", "found"),
    [
        ((0, 72, 144, 216, 288), {"1_5": 0.25}, ["chambers 1 and 5"]),
        ((0, 120, 60, 180, 300, 240), {"2_3": 0.3}, ["chambers 2 and 3"]),
        ((0, 120, 60, 180, 300, 240), {"2_3": 0.3, "5_6": 0.2}, ["chambers 2 and 3", "chambers 5 and 6"]),
        ((0, 90, 180, 270), {"1_2": 0.2, "2_3": 0.2, "3_4": 0.2}, []),
    ],
)
def test_the_leaking_wall_and_its_share_are_found(
    azimuths: Sequence[float], leaks: Mapping[str, float], found: list[str]
) -> None:
    robot, rows = small(azimuths).replace(uncertainty=Uncertainty(azimuths=np.radians(1))), list[TrialRow]()
    for trial, k in enumerate(2 * tuple(range(len(azimuths)))):
        alone = np.eye(len(azimuths))[k]
        rows += [replace(row(trial + 1, i, 0.0, 0.0), pressures=tuple(60e3 * i * alone), tip=(0.0, 0.0, 0.2)) for i in range(3)]
    leaking = {"shared_pressure": relatives(robot)["shared_pressure"]}
    table = Table.of(rows)
    tips = Moved(robot, table_columns(states(Measured(robot, table))[0]), area="one", catalogue=leaking).tips(
        {f"shared_pressure.share_{wall}": share for wall, share in leaks.items()}
    )
    tips = tips + 0.3e-3 * np.random.default_rng(0).normal(size=tips.shape)
    table = Table.of([replace(r, tip=tuple(tip)) for r, tip in zip(rows, tips.tolist(), strict=True)])
    prepared = prepare(robot, states(Measured(robot, table))[0], catalogue={"base_tilt": CATALOGUE["base_tilt"]})
    search = Search(prepared.problem)
    search.run()
    leak = fit_relative(prepared, Related("shared_pressure", (), 0.0), search.with_all_derivatives(search.found[()]), -np.inf)[0]
    sizes = {name: Value(*size, "1") for name, size in zip(named_places(leak.relative, robot), leak.sizes, strict=True)}
    assert places_found(sizes) == found
    true = {f"chambers {wall.replace('_', ' and ')}": share for wall, share in leaks.items()}
    assert all(abs(v.value - true.get(name, 0.0)) < 3 * v.sd < 0.2 for name, v in sizes.items())
    # azimuths that turn towards a leak are no longer asked for
    none, unknown = search.found[()], Decision("unknown", (), 1.0, 1.0, relatives=("shared_pressure",))
    told = SimpleNamespace(prepared=prepared, best=none, calibrated=none.fit, decision=unknown, closes=lambda _: False)
    asked = [Attribution.tense(SimpleNamespace(**vars(told), relatives=r), None) for r in ((), (leak,))]  # type: ignore[arg-type]
    assert asked[0] and asked[1] == {}


def test_a_leak_is_tested_at_its_wall_before_effects_are_told_apart_that_are_improbable_together() -> None:
    def proposed(verdict: Verdict, outside: float) -> list[Proposal]:
        told = SimpleNamespace(map=lambda do, menu, step: [replace(x, expected_bits=0.8) for x in menu])
        sizes = tuple((0.3 if pair == (3, 4) else 0.02, 0.02) for pair in walls(ROBOT))
        found = SimpleNamespace(
            prepared=SimpleNamespace(robot=ROBOT, states=states(case(sweep()))[0], pushes_only=False),
            posterior=SimpleNamespace(ranking=((UNKNOWN, outside), ((), 1 - outside))),
            decision=Decision(verdict, (), outside, outside, relatives=("shared_pressure",)),
            relatives=(Related("shared_pressure", (), 9.0, sizes), Related("shared_pressure", ("base_tilt",), 8.0, sizes[::-1])),
        )
        return list(propose(found, SimpleNamespace(candidates=(1, 2), names=("none", "lag")), told))  # type: ignore[arg-type]

    (alone,) = proposed("unknown", 0.98)
    assert alone.protocol["chambers"] == [3] and alone.do.startswith("hold one of chambers 3 and 4 at pressure with the other")
    first, *others = proposed("unknown", 0.6)
    assert first.id == alone.id and first.separates == (("unknown", "none"),) and "rate" in [x.id for x in others]
    assert {x.expected_bits for x in others} == {0.32} and {x.expected_bits for x in proposed("effect", 0.1)} == {0.8}


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
    assert odds_of_relatives(search.tried, [log_weight_of(r, 2) for r in found], 2) > LEAST


STAGES: dict[str, Stage] = {
    "stiffer": "material", "ballooning": "actuation", "play": "structure", "turned": "actuation", "offset": "measurement",
    "bent": "boundary", "late": "measurement",
}  # fmt: skip
GRID = Grid()


def found(problem: Problem, named: Hypothesis) -> StageError:
    """The stage that gains most beside a hypothesis."""
    search = Search(problem)
    best = search.with_all_derivatives(next(c for c in search.run() if c.named == named))
    g = Gaussian(best.fit.linear(problem), best.prior(problem.parameters), best.weighed.peak.size, best.weighed.peak.form_error)
    time = np.arange(len(GRID.length), dtype=float)
    every = smooth_functions(GRID.length, GRID.pressure, GRID.branch, time, ROBOT_LENGTH)
    functions = {name: np.repeat(f, 3, axis=0) for name, f in every.items()}
    return stage_errors(g, problem.parameters, STAGES, functions)[0]


def response(problem: Problem, effect: str) -> np.ndarray:
    """What an effect does at its plausible scale."""
    return derivatives(problem.forward, np.zeros_like(problem.parameters.sd))[1].whole[:, problem.parameters.names.index(effect)]


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


def leading(problem: Problem) -> Candidate:
    return Search(problem).run()[0]


def changed(problem: Problem, by: Array) -> Problem:
    return replace(problem, observed=problem.observed + by)


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_data_of_the_catalogue_raise_no_diagnostic_and_no_stage_gains(seed: int) -> None:
    problem = toy_problem(seed, {"play": 1.0})
    assert found(problem, ("play",)).gain < 1
    assert outlier_trial(problem, leading(problem), TRIAL) is None


def test_a_law_that_is_far_off_is_seen_as_an_error_of_the_laws() -> None:
    problem = toy_problem(3, {"turned": 1.0})
    other = changed(problem, 0.5 * response(problem, "turned") * np.sin(np.repeat(GRID.length, 3) / 0.06))
    assert leading(problem).weighed.law_error_gain < 0 < 5 < leading(other).weighed.law_error_gain


def test_one_bad_trial_is_named() -> None:
    problem = changed(toy_problem(3, {}), np.where(TRIAL == 12, 1.5 * MM, 0.0))
    assert outlier_trial(problem, leading(problem), TRIAL) == 12


LENGTH = np.repeat(np.round(GRID.length / 0.05).astype(np.int64), 3)


def fitted(problem: Problem, named: tuple[str, ...], spike: float, size: float) -> Model:
    prior = problem.parameters.prior(problem.parameters.mask(named), spike, 1.0)
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
