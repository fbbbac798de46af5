"""Sensitivities against converged central differences of fine solves, and their chain rule."""

from __future__ import annotations

import numpy as np
import pytest

from model.errors import BadCondition
from model.rods import FINE, Fast, Form, Rods, sensitivities, solve
from tests.model.rods.cases import robots

TIGHT = Fast(divisions=16.0, close=1e-13)
FULL = Form(elements=2, full=True)
"""With room for all that an effect may change, as the diagnosis differentiates rods."""
plain_too = pytest.mark.parametrize("form", [FULL, pytest.param(Form(elements=2), marks=pytest.mark.long)])
"""The plain form is compiled by itself, for half a minute."""


def direction(rods: Rods, name: str, value: object) -> np.ndarray:
    """One direction in which the field `name` changes by `value`."""
    row = np.zeros((1, 1, rods.form.width))
    rods.form.view(row, name)[0, 0] = value
    return row


def eight_directions(rods: Rods) -> np.ndarray:
    """Both moduli, actuation, tip weight, body weight, precurvature twice, spine length."""
    first = rods[0:1]
    inner, outer = np.array([[1.0], [0.0]]), np.array([[0.0], [1.0]])
    moduli = [
        direction(rods, "bend_stiffness", part * first.field("bend_stiffness")[0])
        + direction(rods, "stretch_stiffness", part * first.field("stretch_stiffness")[0])
        for part in (inner, outer)
    ]
    wrench = direction(rods, "tip_force", first.field("tip_force")[0]) + direction(
        rods, "tip_moment", first.field("tip_moment")[0]
    )
    others = [
        direction(rods, "dead_force", (0.0, 0.0, 1.0)),
        direction(rods, "load", (0.0, 0.0, 60.0)),
        direction(rods, "rest_curvature", (1.0, 0.0, 0.0)),
        direction(rods, "rest_curvature", (0.0, 1.0, 0.0)),
        direction(rods, "length", (1.0, -1.0)),
    ]
    return np.concatenate([*moduli, wrench, *others], axis=1)


def differences(rods: Rods, along: np.ndarray, size: float) -> np.ndarray:
    """Five-point differences of fine solves, (n, k, 3)."""
    found = []
    for row in along[0]:
        tips = {j: solve(Rods(rods.form, rods.values + j * size * row), TIGHT).trusted().tip for j in (-2, -1, 1, 2)}
        found.append((8 * (tips[1] - tips[-1]) - (tips[2] - tips[-2])) / (12 * size))
    return np.stack(found, axis=1)


def worst(found: np.ndarray, expected: np.ndarray) -> float:
    """Largest error of a derivative relative to the size of its vector."""
    return float((np.linalg.norm(found - expected, axis=-1) / np.linalg.norm(expected, axis=-1)).max())


@plain_too
def test_eight_parameters_agree_with_converged_differences_to_a_millionth(form: Form) -> None:
    rods = robots(5, np.linspace(60e3, 250e3, 5), 0.15, roll=0.3, form=form)
    along = eight_directions(rods)
    found = sensitivities(rods, solve(rods, TIGHT), along, TIGHT)
    assert worst(found.tip, differences(rods, along, 2e-4)) < 1e-6


@plain_too
def test_the_default_setting_is_good_to_a_ten_thousandth(form: Form) -> None:
    rods = robots(5, np.linspace(60e3, 250e3, 5), 0.15, roll=0.3, form=form)
    along = eight_directions(rods)
    assert worst(sensitivities(rods, solve(rods), along).tip, differences(rods, along, 2e-4)) < 1e-4


def test_springs_graded_curvature_series_and_compliance_have_sensitivities_too() -> None:
    form = Form(elements=2, springs=1, full=True)
    rods = robots(2, np.array([120e3, 200e3]), 0.15, form=form)
    rods.field("spring_direction")[:] = (1.0, 0.0, 0.0)
    rods.field("spring_stiffness")[:], rods.field("spring_origin")[:] = 60.0, -0.05
    rods.field("spring_softness")[:] = 5e-3
    rods.field("series")[:] = (0.02, 0.5, 1.0)
    rods.field("base_compliance")[:] = 0.01
    along = np.concatenate(
        [
            direction(rods, "spring_stiffness", 100.0),
            direction(rods, "spring_origin", 1.0),
            direction(rods, "series", (0.05, 0.0, 0.0)),
            direction(rods, "series", (0.0, 0.0, 1.0)),
            direction(rods, "curvature_rise", np.eye(9)[1]),
            direction(rods, "base_compliance", 0.01),
            direction(rods, "base_turn", (0.0, 1.0, 0.0)),
        ],
        axis=1,
    )
    found = sensitivities(rods, solve(rods, TIGHT), along, TIGHT)
    assert worst(found.tip, differences(rods, along, 2e-4)) < 1e-6


def test_rotation_and_base_wrench_have_sensitivities() -> None:
    rods = robots(1, 150e3, 0.1, form=FULL)
    along = direction(rods, "dead_force", (0.0, 1.0, 0.0))
    found = sensitivities(rods, solve(rods, TIGHT), along, TIGHT)
    moved = [solve(Rods(rods.form, rods.values + s * along[0]), TIGHT) for s in (1e-3, -1e-3)]
    by_moment = (moved[0].base_moment - moved[1].base_moment) / 2e-3
    by_force = (moved[0].base_force - moved[1].base_force) / 2e-3
    assert np.abs(found.base_moment[:, 0] - by_moment).max() < 1e-5
    assert np.abs(found.base_force[:, 0] - by_force).max() < 1e-5
    (w1, *v1), (w0, *v0) = moved[0].orientation[0], moved[1].orientation[0]
    turned = 2 * (w0 * np.array(v1) - w1 * np.array(v0) - np.cross(v1, v0)) / 2e-3
    assert np.abs(found.rotation[0, 0] - turned).max() < 1e-5


def test_each_rod_may_have_directions_of_its_own() -> None:
    rods = robots(20, np.linspace(60e3, 250e3, 20), 0.1, form=FULL)
    own = np.zeros((20, 1, rods.form.width))
    rods.form.view(own, "tip_force")[:, 0] = rods.field("tip_force")
    solution = solve(rods, FINE)
    found = sensitivities(rods, solution, own, FINE).tip
    shared = sensitivities(rods, solution, direction(rods, "tip_force", (0.0, 0.0, 1.0)), FINE).tip
    assert np.allclose(found[:, 0], shared[:, 0] * rods.field("tip_force")[:, 2:], rtol=1e-6, atol=1e-12)


def test_directions_of_the_wrong_shape_are_refused() -> None:
    rods = robots(3, 100e3, 0.1, form=FULL)
    with pytest.raises(BadCondition, match=r"directions: shape \(3, 1, 7\)"):
        sensitivities(rods, solve(rods), np.zeros((3, 1, 7)))
