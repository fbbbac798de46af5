"""What tendons lose on their way: friction makes a loop that no rate changes, slack takes the first newtons."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from model.actuators import PULL_AREA
from model.condition import conditions
from model.effects.catalogue import CATALOGUE
from model.effects.design import design_from_columns
from model.effects.forward import ForwardModel
from model.effects.laws.tendons import PLACES, _by_weight
from model.robot import Robot, robot_from_dict
from model.section import body_area, body_second_moment

TENSIONS = np.array([0.0, 10.0, 20.0, 10.0, 0.0])
"""N, one tendon in and out."""


@pytest.fixture
def pulled(reference_robot: Robot) -> Robot:
    ring = {"path_radius": 0.04, "azimuths_deg": [0.0, 120.0, 240.0]}
    return robot_from_dict({**reference_robot.model_dump(), "chambers": None, "tendons": ring, "spine": None, "area_factor": 1.0})


@pytest.fixture
def moved(pulled: Robot) -> Callable[..., np.ndarray]:
    def made(rate: float = 20e3, **values: float) -> np.ndarray:
        """(5,) m sideways."""
        n = len(TENSIONS)
        columns: dict[str, Any] = {name: np.zeros(n) for name in ("spine_length", "p2", "p3", "x", "y", "z")}
        columns |= {
            "trial": np.ones(n, int),
            "p1": TENSIONS / 1e-4,
            "rate": np.full(n, rate),
            "branch": ["load"] * 3 + ["unload"] * 2,
        }
        forward = ForwardModel(pulled, design_from_columns(pulled, columns))
        names = [p.name for p in forward.parameters]
        theta = np.zeros(len(names))
        for name, value in values.items():
            theta[names.index(name.replace("__", "."))] = value
        return forward.predict(theta).reshape(n, 3)[:, 0]

    return made


def test_friction_pulls_less_on_the_way_in_and_holds_on_the_way_out(moved: Callable[..., np.ndarray]) -> None:
    free, held = moved(), moved(tendon_friction__coefficient=0.5)
    assert free[1] == pytest.approx(free[3], abs=1e-9) and free[2] > 0.02
    assert held[2] < free[2] - 4e-4
    assert held[3] > held[1] + 1e-4
    assert held[0] == pytest.approx(0.0, abs=1e-9)


def test_no_rate_changes_the_loop(moved: Callable[..., np.ndarray]) -> None:
    slow, fast = (moved(rate, tendon_friction__coefficient=0.5) for rate in (1e3, 100e3))
    np.testing.assert_allclose(slow, fast, atol=1e-12)


def test_slack_takes_the_first_newtons(moved: Callable[..., np.ndarray]) -> None:
    free, slack = moved(), moved(tendon_slack__tension=2.0)
    assert slack[0] == 0.0
    assert slack[1] / free[1] == pytest.approx(0.8, abs=0.03)
    assert slack[2] / free[2] == pytest.approx(0.9, abs=0.03)


def test_its_derivatives_are_those_of_its_predictions(pulled: Robot) -> None:
    n = len(TENSIONS)
    columns: dict[str, Any] = {name: np.zeros(n) for name in ("spine_length", "p2", "p3", "x", "y", "z")}
    columns |= {"trial": np.ones(n, int), "p1": TENSIONS / 1e-4, "branch": ["load"] * 3 + ["unload"] * 2}
    forward = ForwardModel(pulled, design_from_columns(pulled, columns))
    names = [p.name for p in forward.parameters]
    theta = np.zeros(len(names))
    theta[names.index("tendon_friction.coefficient")] = 0.4
    _, slope = forward.linearise(theta)
    for name, step in (
        ("tendon_friction.coefficient", 1e-4),
        ("body_modulus.excess", 1e-4),
        ("tendon_slack.tension", 1e-3),
    ):
        k = names.index(name)
        there = theta.copy()
        there[k] += step
        moved = (forward.predict(there) - forward.predict(theta)) / step
        np.testing.assert_allclose(slope[:, k], moved, atol=0.02 * np.abs(moved).max())


def test_each_kind_of_robot_has_its_own_causes(pulled: Robot, paper_robot: Robot) -> None:
    n = 5
    for robot, own, other in (
        (pulled, "tendon_friction", "chamber_ballooning"),
        (paper_robot, "chamber_ballooning", "tendon_friction"),
    ):
        columns = {
            "trial": np.ones(n, int),
            "p1": TENSIONS / 1e-4,
            **{c: np.zeros(n) for c in ("spine_length", "x", "y", "z")},
        }
        design = design_from_columns(robot, columns)
        shown = {id for id, spec in CATALOGUE.items() if spec.shown is None or spec.shown(robot, design)}
        assert own in shown and other not in shown


@pytest.mark.parametrize("cuts", [(), (0.1, 0.3)])
def test_friction_bends_the_body_as_its_law_does_all_along(pulled: Robot, cuts: tuple[float, ...]) -> None:
    """Without weight and stretch k(s) = T(s) r / EI and a(s) = T0 r s / EI, whatever sections the body is cut into."""
    still = {**pulled.model_dump(), "gravity": (0.0, 0.0, 0.0), "axial_stiffness": 1e9, "bending_stiffness": 0.3}
    robot = robot_from_dict({**still, "sections": [{"length": x} for x in cuts]})
    pulls, mu = np.array([0.0, 10.0, 20.0, 15.0]), 0.3
    columns: dict[str, Any] = {name: np.zeros(4) for name in ("spine_length", "p2", "p3", "x", "y", "z")}
    columns |= {"trial": np.ones(4, int), "p1": pulls / 1e-4, "branch": ["load"] * 3 + ["unload"]}
    forward = ForwardModel(robot, design_from_columns(robot, columns))
    theta = np.zeros(len(forward.parameters))
    theta[[p.name for p in forward.parameters].index("tendon_friction.coefficient")] = mu

    s = np.linspace(0.0, robot.length, 4001)
    bent = pulls[:, None] * (0.04 / 0.3)
    up, down = (bent / (1 + sign * mu * bent * s) for sign in (1, -1))
    up[3] = np.clip(up[2], up[3], down[3])
    angle, side, along = np.zeros(up.shape), np.zeros(up.shape), np.zeros(up.shape)
    for whole, slope in ((angle, lambda: up), (side, lambda: np.sin(angle)), (along, lambda: np.cos(angle))):
        whole[:, 1:] = np.cumsum((slope()[:, 1:] + slope()[:, :-1]) / 2 * np.diff(s), axis=1)
    read = forward.read(theta)
    turn = 2 * np.arccos(np.abs(read.orientation[0, :, 0]))
    np.testing.assert_allclose(turn, angle[:, -1], atol=1e-3)
    places = [2000, 3000, 4000]
    found = forward.shapes(theta, s[places])
    # On the way out tensions rise from the base to where the way in has left them lower: a line is a rougher guess of that.
    near = np.array([2e-4, 2e-4, 2e-4, 1e-3])[:, None]
    assert (np.abs(np.hypot(found[..., 0], found[..., 1]) - side[:, places]) < near).all()
    assert (np.abs(found[..., 2] - along[:, places]) < near).all()


def test_the_bend_on_the_way_to_each_place_is_that_of_a_body_that_hangs_under_its_weight(pulled: Robot) -> None:
    """From the curvature at the tip and its mean alone."""
    robot = robot_from_dict({**pulled.model_dump(), "gravity": (0.0, 0.0, 9.81), "tip_mass": 0.01})
    model = ForwardModel.of_single_states(robot).at(conditions(robot, 0.0, [[20.0 / PULL_AREA, 0.0, 0.0]]), np.zeros(0))
    arcs = np.linspace(0.0, robot.length, 1 + 4 * PLACES)
    steps = np.diff(model.shapes(np.zeros(len(model.parameters)), arcs)[0], axis=0)
    turned = np.unwrap(np.arctan2(steps[:, 0], steps[:, 2]))
    curvature = np.diff(turned) / np.diff(arcs)[1:]
    tip, mean = curvature[-1], turned[-1] / (arcs[-1] + arcs[-2]) * 2  # of the last chord's middle
    stiffness = robot.youngs_modulus * body_second_moment(robot)
    q = SimpleNamespace(
        density=np.array([[robot.density]]), body=SimpleNamespace(mean_weight_area=body_area(robot)), robot=robot,
        payload=np.zeros((1, 1)), design=SimpleNamespace(tip_mass=np.array([robot.tip_mass])),
    )  # fmt: skip
    h: Any = SimpleNamespace(quantities=q, bend_stiffness=np.full((1, 1, 2), stiffness))
    along = (np.arange(PLACES) + 0.5) / PLACES
    at_tip, average = (np.array([[[0.0, k]]]) for k in (tip, mean))
    found = tip + _by_weight(h, at_tip, average, np.array([[robot.length]]), along)[0, 0, :, 1]
    expected = np.interp(along, arcs[1:-1] / robot.length, curvature)
    assert abs(tip / mean - 1) > 0.03
    assert np.cumsum(found) == pytest.approx(np.cumsum(expected), rel=0.04)
