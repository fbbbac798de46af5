"""The forward model of a campaign: baseline, derivatives, round trip."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from model.condition import conditions
from model.effects import ForwardModel, design_from_columns
from model.robot import Robot
from model.rod import solve


def at_some_values(forward: ForwardModel, seed: int, share: float = 0.4) -> Any:
    """A parameter vector with everything present at a share of its scale."""
    rng = np.random.default_rng(seed)
    low, high, sd = np.array([(p.low, p.high, p.sd) for p in forward.parameters]).T
    drawn = share * sd * rng.normal(size=sd.size)
    return np.clip(np.where(low == 0, np.abs(drawn), drawn), low, high)


def test_at_zero_parameters_the_tips_are_those_of_the_converged_rod(
    paper_robot: Robot, make_campaign: Callable[..., Any]
) -> None:
    columns = make_campaign(unload=False)
    design = design_from_columns(paper_robot, columns)
    forward = ForwardModel(paper_robot, design, area="per_length")
    predicted = forward.predict(np.zeros(len(forward.parameters)))
    expected = solve(paper_robot, conditions(paper_robot, design.spine_length, design.pressure)).trusted().tip
    for k, axis in enumerate("xyz"):
        own = forward.observations.channel == axis
        assert predicted[own] == pytest.approx(expected[:, k], abs=1e-5)


def test_derivatives_agree_with_differences_of_predictions(
    paper_robot: Robot, make_campaign: Callable[..., Any]
) -> None:
    design = design_from_columns(paper_robot, make_campaign(lengths=(0.0, 0.12, 0.27), levels=(60e3, 180e3)))
    forward = ForwardModel(paper_robot, design)
    theta = at_some_values(forward, seed=3)
    theta[forward.index("contact")] = 0.0
    _, jacobian = forward.linearise(theta)
    for k, info in enumerate(forward.parameters):
        step = np.zeros(theta.size)
        step[k] = 3e-4 * info.sd
        if theta[k] - step[k] < info.low or theta[k] + step[k] > info.high:
            continue
        expected = (forward.predict(theta + step) - forward.predict(theta - step)) / (2 * step[k])
        assert jacobian[:, k] * info.sd == pytest.approx(expected * info.sd, abs=2e-6, rel=2e-3), info.name
