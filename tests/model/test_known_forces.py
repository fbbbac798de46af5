"""Known forces on the tip: the rod's own equation, the campaign's model and its table agree."""

from __future__ import annotations

import numpy as np
import pytest

from model.condition import conditions
from model.effects.design import design_from_columns
from model.effects.forward import ForwardModel
from model.errors import BadCondition
from model.prediction.campaign import predict_campaign
from model.robot import Robot
from model.rods import FINE, solve
from model.section import body_area, body_second_moment, rods_of

FORCES = np.array([[0.0, 0.0, 0.0], [0.05, 0.0, 0.0], [0.0, -0.2, 0.1]])


def test_a_small_force_bends_a_weightless_rod_as_beam_theory_says(reference_robot: Robot) -> None:
    """F L^3 / 3 EI + F L / GA."""
    light = reference_robot.model_copy(update={"density": 0.0, "tip_mass": 0.0})
    at = conditions(light, 0.0, [0.0] * 9, force=[1e-3, 0.0, 0.0])
    length = light.length
    bends = length**3 / (3 * light.youngs_modulus * body_second_moment(light))
    shears = length / (light.shear_modulus * body_area(light))
    assert solve(rods_of(light, at), FINE).tip[0, 0] == pytest.approx(1e-3 * (bends + shears), rel=1e-3)


def test_a_mass_at_the_tip_is_a_force_along_gravity(reference_robot: Robot) -> None:
    weight = 0.1 * np.array(reference_robot.gravity)
    base = conditions(reference_robot, 0.1, [60e3] * 3 + [0.0] * 6, tip_mass=0.0, force=weight)
    heavy = conditions(reference_robot, 0.1, [60e3] * 3 + [0.0] * 6, tip_mass=0.1)
    one, other = (solve(rods_of(reference_robot, at), FINE).tip for at in (base, heavy))
    assert one == pytest.approx(other, abs=1e-9)


def test_a_campaign_with_forces_is_that_of_its_rods(reference_robot: Robot) -> None:
    n = len(FORCES)
    columns = {
        "trial": np.arange(1, n + 1),
        "spine_length": np.full(n, 0.1),
        "x": np.zeros(n),
        "y": np.zeros(n),
        "z": np.zeros(n),
    }
    columns |= {f"p{i}": np.full(n, 60e3 if i < 4 else 0.0) for i in range(1, 10)}
    columns |= {f"force_{axis}": FORCES[:, k] for k, axis in enumerate("xyz")}
    rods = rods_of(reference_robot, conditions(reference_robot, 0.1, [60e3] * 3 + [0.0] * 6, force=FORCES))
    tip = solve(rods, FINE).tip
    assert np.linalg.norm(tip[1:] - tip[0], axis=1).min() > 3e-4
    assert predict_campaign(reference_robot, columns).tip == pytest.approx(tip, abs=1e-6)
    design = design_from_columns(reference_robot, columns)
    forward = ForwardModel(reference_robot, design, "per_length", {})
    predicted = forward.predict(np.zeros(len(forward.parameters)))
    expected = [tip[row, "xyz".index(channel)] for row, channel in forward.labels]
    assert predicted == pytest.approx(expected, abs=1e-6)


def test_forces_of_another_shape_are_refused(reference_robot: Robot) -> None:
    with pytest.raises(BadCondition, match=r"force: shape \(1, 2\), must be \(3,\) or \(1, 3\)"):
        conditions(reference_robot, 0.1, [0.0] * 9, force=[0.0, 1.0])
