"""Stiffness trials: slope, modulus, standard errors."""

import numpy as np
import pytest

from model.cantilever import fit_stiffness, youngs_modulus
from model.errors import BadCondition, NotIdentified
from model.section import annulus_second_moment

DEFLECTION = np.linspace(0.002, 0.02, 10)


def test_a_push_at_the_end_is_equation_nine_whatever_the_force_s_offset() -> None:
    nine = 4 * 120 * 0.2**3 / (3 * np.pi * 0.029**4)
    slope = fit_stiffness(DEFLECTION, 120 * DEFLECTION + 0.4)
    assert youngs_modulus(slope, 0.2, annulus_second_moment(0.029)).value == pytest.approx(nine, rel=1e-12)


def test_a_load_short_of_the_end_is_equation_eight() -> None:
    second, x = 1e-7, 0.1
    slope = fit_stiffness(DEFLECTION, 50 * DEFLECTION)
    e = youngs_modulus(slope, 0.2, second, load_at=x).value
    assert 50 * (3 * 0.2 - x) * x**2 / (6 * e * second) == pytest.approx(1.0)


def test_each_trial_has_its_own_intercept() -> None:
    trial = np.repeat(["a", "b"], 5)
    force = 80 * DEFLECTION + np.where(trial == "a", 0.5, -0.3)
    slope = fit_stiffness(DEFLECTION, force, trial=trial)
    assert slope.value == pytest.approx(80, rel=1e-12)


def test_the_interval_covers_the_truth_as_often_as_it_says() -> None:
    draw = np.random.default_rng(3)
    covered = 0
    for _ in range(400):
        low, high = fit_stiffness(DEFLECTION, 100 * DEFLECTION + draw.normal(0, 0.05, 10)).interval
        covered += low < 100 < high
    assert 0.92 < covered / 400 < 0.98


def test_readings_with_a_large_error_count_less() -> None:
    force = 100 * DEFLECTION
    force[-1] += 5
    sd = np.full(10, 0.01)
    sd[-1] = 10.0
    assert fit_stiffness(DEFLECTION, force, sd).value == pytest.approx(100, rel=1e-3)
    assert fit_stiffness(DEFLECTION, force).value > 130


def test_errors_shared_within_a_trial_widen_the_standard_error() -> None:
    draw = np.random.default_rng(5)
    trial = np.repeat(np.arange(6), 10)
    y = np.tile(DEFLECTION, 6)
    force = (100 + draw.normal(0, 5, 6)[trial]) * y
    by_trial = fit_stiffness(y, force, trial=trial)
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
    with pytest.raises(kind, match=word):
        fit_stiffness(deflection, force)


def test_a_load_beyond_the_beam_is_refused() -> None:
    slope = fit_stiffness(DEFLECTION, 50 * DEFLECTION)
    with pytest.raises(BadCondition, match=r"loaded at 0.3 m"):
        youngs_modulus(slope, 0.2, 1e-7, load_at=0.3)
