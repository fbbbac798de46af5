"""What tendons lose on their way: friction makes a loop that no rate changes, slack takes the first newtons."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from model.actuators import PULL_AREA
from model.body import body_of
from model.condition import conditions
from model.effects.catalogue import CATALOGUE
from model.effects.design import design_from_columns
from model.effects.forward import ForwardModel
from model.effects.laws.tendons import PLACES, _by_weight
from model.robot import Robot, robot_from_dict
from tests.model.effects.campaigns import Moved

TENSIONS = np.array([0.0, 10.0, 20.0, 10.0, 0.0])
"""N, one tendon in and out."""


def pulls(tensions: Any, **more: Any) -> Any:
    """Columns of one tendon that is pulled to its largest tension (N) and let go."""
    n, top = len(tensions), int(np.argmax(tensions)) + 1
    columns = {name: np.zeros(n) for name in ("spine_length", "p2", "p3", "x", "y", "z")}
    return columns | {"trial": np.ones(n, int), "p1": tensions / 1e-4, "branch": ["load"] * top + ["unload"] * (n - top), **more}


def sideways(robot: Robot, rate: float = 20e3, **values: float) -> np.ndarray:
    """(5,) m."""
    return Moved(robot, pulls(TENSIONS, rate=np.full(len(TENSIONS), rate))).tips(**values)[:, 0]


def test_friction_pulls_less_on_the_way_in_and_holds_on_the_way_out_at_any_rate(pulled: Robot) -> None:
    free, held = sideways(pulled), sideways(pulled, tendon_friction__coefficient=0.5)
    assert free[1] == pytest.approx(free[3], abs=1e-9) and free[2] > 0.02
    assert held[2] < free[2] - 4e-4
    assert held[3] > held[1] + 1e-4
    assert held[0] == pytest.approx(0.0, abs=1e-9)
    for rate in (1e3, 100e3):
        np.testing.assert_allclose(sideways(pulled, rate, tendon_friction__coefficient=0.5), held, atol=1e-12)


def test_slack_takes_the_first_newtons(pulled: Robot) -> None:
    free, slack = sideways(pulled), sideways(pulled, tendon_slack__tension=2.0)
    assert slack[0] == 0.0
    assert slack[1:3] / free[1:3] == pytest.approx([0.8, 0.9], abs=0.03)


def test_its_derivatives_are_those_of_its_predictions(pulled: Robot) -> None:
    made, friction = Moved(pulled, pulls(TENSIONS)), "tendon_friction.coefficient"
    _, slope = made.forward.linearise(made.vector({friction: 0.4}))
    names = [p.name for p in made.forward.parameters]
    for name, step in ((friction, 1e-4), ("body_modulus.excess", 1e-4), ("tendon_slack.tension", 1e-3)):
        there = {friction: 0.4} | {name: step + 0.4 * (name == friction)}
        difference = (made.tips(there) - made.tips({friction: 0.4})).ravel() / step
        np.testing.assert_allclose(slope[:, names.index(name)], difference, atol=0.02 * np.abs(difference).max())


def test_each_kind_of_robot_has_its_own_causes(pulled: Robot, paper_robot: Robot) -> None:
    for robot, own, other in (
        (pulled, "tendon_friction", "chamber_ballooning"),
        (paper_robot, "chamber_ballooning", "tendon_friction"),
    ):
        design = design_from_columns(robot, pulls(TENSIONS))
        shown = {id for id, spec in CATALOGUE.items() if spec.shown is None or spec.shown(robot, design)}
        assert own in shown and other not in shown


@pytest.mark.parametrize("cuts", [(), (0.1, 0.3)])
def test_friction_bends_the_body_as_its_law_does_all_along(pulled: Robot, cuts: tuple[float, ...]) -> None:
    """Without weight and stretch k(s) = T(s) r / EI and a(s) = T0 r s / EI, whatever sections the body is cut into."""
    still = {**pulled.model_dump(), "gravity": (0.0, 0.0, 0.0), "axial_stiffness": 1e9, "bending_stiffness": 0.3}
    robot = robot_from_dict({**still, "sections": [{"length": x} for x in cuts]})
    pulls_to, mu = np.array([0.0, 10.0, 20.0, 15.0]), 0.3
    friction = {"tendon_friction.coefficient": mu}
    made = Moved(robot, pulls(pulls_to))
    s = np.linspace(0.0, robot.length, 4001)
    bent = pulls_to[:, None] * (0.04 / 0.3)
    up, down = (bent / (1 + sign * mu * bent * s) for sign in (1, -1))
    up[3] = np.clip(up[2], up[3], down[3])
    angle, side, along = np.zeros(up.shape), np.zeros(up.shape), np.zeros(up.shape)
    for whole, slope in ((angle, lambda: up), (side, lambda: np.sin(angle)), (along, lambda: np.cos(angle))):
        whole[:, 1:] = np.cumsum((slope()[:, 1:] + slope()[:, :-1]) / 2 * np.diff(s), axis=1)
    turn = 2 * np.arccos(np.abs(made.forward.read(made.vector(friction)).orientation[0, :, 0]))
    np.testing.assert_allclose(turn, angle[:, -1], atol=1e-3)
    places = [2000, 3000, 4000]
    found = made.forward.shapes(made.vector(friction), s[places])
    # On the way out tensions rise from the base to where the way in has left them lower: a line is a rougher guess of that.
    near = np.array([2e-4, 2e-4, 2e-4, 1e-3])[:, None]
    assert (np.abs(np.hypot(found[..., 0], found[..., 1]) - side[:, places]) < near).all()
    assert (np.abs(found[..., 2] - along[:, places]) < near).all()


def test_the_bend_on_the_way_to_each_place_is_that_of_a_body_that_hangs_under_its_weight(pulled: Robot) -> None:
    robot = robot_from_dict({**pulled.model_dump(), "gravity": (0.0, 0.0, 9.81), "tip_mass": 0.01})
    model = ForwardModel.of_single_states(robot).at(conditions(robot, 0.0, [[20.0 / PULL_AREA, 0.0, 0.0]]), np.zeros(0))
    arcs = np.linspace(0.0, robot.length, 1 + 4 * PLACES)
    steps = np.diff(model.shapes(np.zeros(len(model.parameters)), arcs)[0], axis=0)
    turned = np.unwrap(np.arctan2(steps[:, 0], steps[:, 2]))
    curvature = np.diff(turned) / np.diff(arcs)[1:]
    tip, mean = curvature[-1], turned[-1] / (arcs[-1] + arcs[-2]) * 2  # of the last chord's middle
    stiffness = robot.youngs_modulus * body_of(robot).mean_second
    q = SimpleNamespace(
        density=np.array([[robot.density]]), body=SimpleNamespace(mean=float, weight_area=body_of(robot).mean_area), robot=robot,
        payload=np.zeros((1, 1)), design=SimpleNamespace(tip_mass=np.array([robot.tip_mass])),
    )  # fmt: skip
    h: Any = SimpleNamespace(quantities=q, bend_stiffness=np.full((1, 1, 2), stiffness))
    along = (np.arange(PLACES) + 0.5) / PLACES
    at_tip, average = (np.array([[[0.0, k]]]) for k in (tip, mean))
    found = tip + _by_weight(h, at_tip, average, np.array([[robot.length]]), along)[0, 0, :, 1]
    expected = np.interp(along, arcs[1:-1] / robot.length, curvature)
    assert abs(tip / mean - 1) > 0.03
    assert np.cumsum(found) == pytest.approx(np.cumsum(expected), rel=0.04)
