"""Calibration: area factors from tips, stiffness and moduli from pushes, and how well each is known."""

from typing import Any

import numpy as np
import pytest

from model.body import body_of
from model.calibration import fit_area_factor, fit_area_factor_by_length, fit_spine_modulus, fit_stiffness, youngs_modulus
from model.errors import BadCondition, NotIdentified
from model.robot import Robot
from tests.model.rods.cases import Bending, solved
from tests.simulated.bench import raises

PRESSURES = [50e3, 150e3, 250e3]


def test_a_known_factor_is_found_within_its_error(paper_robot: Robot, bending: Bending) -> None:
    states = bending(paper_robot, [0.0, 0.1, 0.3], PRESSURES)
    truth = solved(paper_robot.replace(area_factor=1.73), states).tip
    tip = truth + np.random.default_rng(1).normal(0, 0.3e-3, truth.shape)
    fit = fit_area_factor(paper_robot, states, tip)
    low, high = fit.interval
    assert low < 1.73 < high
    assert high - low < 0.01
    assert fit.rms_residual == pytest.approx(0.3e-3 * np.sqrt(3), rel=0.4)


def test_a_factor_of_its_own_for_each_length_gives_back_the_papers_sequence(paper_robot: Robot, bending: Bending) -> None:
    lengths = [0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3]
    states = bending(paper_robot, lengths, PRESSURES)
    fits = fit_area_factor_by_length(paper_robot.replace(area_factor=1.0), states, solved(paper_robot, states).tip)
    assert list(fits) == pytest.approx(lengths)
    assert [f.value for f in fits.values()] == pytest.approx([1.5, 1.5, 1.7, 1.9, 2.0, 2.15, 2.4], rel=1e-6)


def test_errors_shared_by_a_trial_are_not_averaged_away(paper_robot: Robot, bending: Bending) -> None:
    once = bending(paper_robot, [0.0, 0.2], PRESSURES)
    states = once[np.tile(np.arange(len(once)), 4)]
    trial = np.repeat(np.arange(4), len(once))
    sideways = np.array([2e-3, -1e-3, 1e-3, -2e-3])
    tip = solved(paper_robot.replace(area_factor=1.6), states).tip
    tip[:, 0] += sideways[trial]
    alone = fit_area_factor(paper_robot, states, tip)
    shared = fit_area_factor(paper_robot, states, tip, trial=trial)
    assert shared.dof == 3
    assert shared.standard_error > 1.5 * alone.standard_error


@pytest.mark.parametrize(
    ("pressures", "measured", "kind", "said"),
    [
        ([0.0, 0.0], lambda tip: 0 * tip, NotIdentified, "pressure"),
        (PRESSURES, lambda tip: tip * [-1, 1, 1], NotIdentified, "bound"),
        (PRESSURES, lambda tip: tip[:, :2], BadCondition, r"tip: shape \(3, 2\)"),
        (PRESSURES, lambda tip: np.where([[0], [1], [0]], np.nan, tip), BadCondition, "tip: row 1"),
    ],
    ids=["no pressure", "the other way", "two columns", "missing"],
)
def test_tips_that_do_not_tell_the_factor_are_refused(
    paper_robot: Robot, bending: Bending, pressures: list[float], measured: Any, kind: type[Exception], said: str
) -> None:
    states = bending(paper_robot, [0.0], pressures)
    raises(kind, said, fit_area_factor, paper_robot, states, measured(solved(paper_robot, states).tip))


def test_body_modulus_comes_back_from_its_stiffness_rows(paper_robot: Robot) -> None:
    y = np.linspace(0.005, 0.04, 8)
    force = 3 * 5.1e5 * body_of(paper_robot).mean_second / paper_robot.length**3 * y + 0.1
    found = youngs_modulus(fit_stiffness(y, force), paper_robot.length, body_of(paper_robot).mean_second)
    assert found.value == pytest.approx(5.1e5, rel=1e-10)


def test_spine_modulus_comes_back_for_each_length() -> None:
    y = np.linspace(0.002, 0.01, 5)
    second = np.pi * 0.029**4 / 4
    truth = {0.05: 0.318e6, 0.30: 4.389e6}
    force = np.concatenate([3 * e * second / length**3 * y for length, e in truth.items()])
    found = fit_spine_modulus(0.029, np.repeat(list(truth), 5), np.tile(y, 2), force)
    assert {length: fit.value for length, fit in found.items()} == pytest.approx(truth)


DEFLECTION = np.linspace(0.002, 0.02, 10)


def test_each_trial_has_its_own_intercept() -> None:
    trial = np.repeat(["a", "b"], 5)
    slope = fit_stiffness(DEFLECTION, 80 * DEFLECTION + np.where(trial == "a", 0.5, -0.3), trial=trial)
    assert slope.value == pytest.approx(80, rel=1e-12)


def test_the_interval_covers_the_truth_as_often_as_it_says() -> None:
    draw = np.random.default_rng(3)
    covered = 0
    for _ in range(400):
        low, high = fit_stiffness(DEFLECTION, 100 * DEFLECTION + draw.normal(0, 0.05, 10)).interval
        covered += low < 100 < high
    assert 0.92 < covered / 400 < 0.98


def test_errors_shared_within_a_trial_widen_the_standard_error() -> None:
    draw = np.random.default_rng(5)
    trial = np.repeat(np.arange(6), 10)
    y = np.tile(DEFLECTION, 6)
    by_trial = fit_stiffness(y, (100 + draw.normal(0, 5, 6)[trial]) * y, trial=trial)
    assert by_trial.dof == 5
    assert by_trial.standard_error == pytest.approx(5 / np.sqrt(6), rel=0.6)


@pytest.mark.parametrize(
    ("deflection", "force", "kind", "word"),
    [
        ([0.01, 0.01, 0.01], [1, 2, 3], NotIdentified, "deflection"),
        ([0.01, 0.02], [1, 2], NotIdentified, "at least 3"),
        ([0.01, 0.02, np.nan], [1, 2, 3], BadCondition, "deflection: row 2"),
        ([0.01, 0.02, 0.03], [1, 2], BadCondition, "force"),
    ],
)
def test_readings_that_cannot_be_fitted_are_refused(
    deflection: list[float], force: list[float], kind: type[Exception], word: str
) -> None:
    raises(kind, word, fit_stiffness, deflection, force)
