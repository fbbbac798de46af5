"""States as arrays: the same numbers as the forward model, gradients, intervals, and the way back."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from model.effects import CATALOGUE, ForwardModel, Parameter, design_from_columns
from model.errors import BadCondition, BadRobot
from model.prediction import Predictor
from model.prediction.campaign import predict_campaign
from model.prediction.inverse import inverse, limits_of
from model.robot import Robot, robot_from_dict

GROUPS = ((9, 1, 2), (3, 4, 5), (6, 7, 8))
AZIMUTH = {"chamber_azimuth": {"angle": {"value": 0.1, "sd": 0.01, "unit": "rad"}}}
PLAIN = {
    **AZIMUTH,
    "marker_offset": {"x": {"value": 0.004, "sd": 0.001, "unit": "m"}},
    "tether_load": {"spring": {"value": 2.0, "sd": 0.3, "unit": "N/m"}},
}
MEMORY = {
    **PLAIN,
    "spine_slip": {"moment": {"value": 0.12, "sd": 0.01, "unit": "N m"}},
    "viscoelastic": {"slow": {"value": 0.04, "sd": 0.01, "unit": "1"}},
}
POSTERIOR: dict[str, Any] = {
    "parameters": ["area_factor", "chamber_azimuth.angle"],
    "area_factor_sd": 0.01,
    "correlation": [[1], [0.5, 1]],
    "law_error": 0.05,
    "discrepancy": 1e-4,
    "noise": {"floor": 6e-4, "reading": 2e-4, "pressure": 300.0, "spine_length": 1e-3, "spine_stiffness": 0.02},
}


def robot_with(paper_robot: Robot, effects: dict[str, Any], **more: Any) -> Robot:
    tilt = {"tilt": {"x": {"value": 1e-3, "sd": 1e-3, "unit": "rad"}}}
    stated = {"effects": effects, "tolerances": tilt, "posterior": POSTERIOR, "markers": [0.2], **more}
    return robot_from_dict({**paper_robot.model_dump(), "area_factor": 1.6, **stated})


def asked(n: int, seed: int = 0) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    rng = np.random.default_rng(seed)
    pressures = np.zeros((n, 9))
    for row in pressures:
        for g in rng.choice(3, 2, replace=False):
            row[[c - 1 for c in GROUPS[g]]] = rng.uniform(20e3, 200e3)
    return pressures, rng.uniform(0.01, 0.29, n)


def columns(pressures: NDArray[np.float64], lengths: NDArray[np.float64]) -> dict[str, NDArray[Any]]:
    n = len(lengths)
    return {"trial": np.arange(n), "spine_length": lengths, **{f"p{c + 1}": pressures[:, c] for c in range(9)}}


@pytest.mark.parametrize("markers", [(), (0.2,)])
def test_a_robot_without_any_uncertainty_has_an_interval_of_no_width(paper_robot: Robot, markers: tuple[float, ...]) -> None:
    robot = paper_robot.model_copy(update={"markers": markers})
    found = predict_campaign(robot, columns(*asked(4)), intervals=True)
    assert found.sd is not None and not found.sd.any() and found.shape.shape == (4, len(markers), 3)
    np.testing.assert_array_equal(found.tip, predict_campaign(robot, columns(*asked(4))).tip)


@pytest.mark.parametrize("effects", [PLAIN, MEMORY], ids=["plain", "with memory"])
def test_states_are_those_of_the_forward_model(paper_robot: Robot, effects: dict[str, Any]) -> None:
    robot = robot_with(paper_robot, effects)
    p, lengths = asked(6)
    found = Predictor(robot, cores=1)(p, lengths, intervals=True)
    read = {name: np.zeros(6) for name in "xyz"}
    forward = ForwardModel(robot, design_from_columns(robot, {**columns(p, lengths), **read}), "per_length")
    np.testing.assert_allclose(found.tip, forward.predict(np.zeros(len(forward.parameters))).reshape(6, 3), atol=1e-9)
    # The forward model's own derivatives give the same intervals.
    other = predict_campaign(robot, columns(p, lengths), intervals=True)
    for name in ("tip", "orientation", "shape"):
        np.testing.assert_allclose(getattr(found, name), getattr(other, name), atol=1e-9, err_msg=name)
    for name in ("model_sd", "sd", "orientation_sd", "shape_sd"):
        np.testing.assert_allclose(getattr(found, name), getattr(other, name), rtol=0.03, err_msg=name)
    low, high = found.interval()
    assert (low < found.tip).all() and (found.tip < high).all() and found.shape.shape == (6, 1, 3)


@pytest.mark.parametrize("effects", [PLAIN, MEMORY], ids=["plain", "with memory"])
def test_gradients_are_those_of_differences(paper_robot: Robot, effects: dict[str, Any]) -> None:
    at = Predictor(robot_with(paper_robot, effects), cores=1)
    p, lengths = asked(3)
    found = at(p, lengths, gradient=True)
    assert found.tip_by_pressure is not None and found.tip_by_length is not None
    for c in (0, 4):
        step = 500.0 * np.eye(9)[c]
        differences = (at(p + step, lengths).tip - at(p - np.minimum(step, p), lengths).tip) / (step + np.minimum(step, p))[
            :, c, None
        ]
        np.testing.assert_allclose(found.tip_by_pressure[:, :, c], differences, atol=2e-8)
    along = (at(p, lengths + 1e-4).tip - at(p, lengths - 1e-4).tip) / 2e-4
    np.testing.assert_allclose(found.tip_by_length, along, rtol=0.01, atol=1e-3)


def test_many_states_on_several_cores_come_back_in_their_order(paper_robot: Robot) -> None:
    at = Predictor(robot_with(paper_robot, AZIMUTH), cores=2)
    p, lengths = asked(9000)
    few = np.array([0, 17, 8999])
    np.testing.assert_allclose(at(p, lengths).tip[few], at(p[few], lengths[few]).tip, atol=1e-5)


def test_what_cannot_be_predicted_is_refused(paper_robot: Robot) -> None:
    at = Predictor(robot_with(paper_robot, AZIMUTH))
    with pytest.raises(BadCondition, match=r"arcs: 0\.5 m must lie between 0 and the robot's length 0\.4 m"):
        at([0.0] * 9, arcs=[0.5])
    with pytest.raises(BadCondition, match="9 chambers"):
        at([0.0] * 8)
    with pytest.raises(BadCondition, match="intervals=True"):
        at([0.0] * 9).interval()
    with pytest.raises(BadRobot, match="obstacle_azimuth_deg"):
        Predictor(robot_with(paper_robot, {**AZIMUTH, "contact": {"stiffness": {"value": 300.0, "unit": "N/m"}}}))


def test_targets_that_were_reached_are_reached_with_no_more_pressure(paper_robot: Robot) -> None:
    robot = robot_with(paper_robot, AZIMUTH)
    at = Predictor(robot, cores=1)
    p, lengths = asked(8, seed=3)
    found = inverse(at, at(p, lengths).tip, limits_of(robot, GROUPS))
    assert found.reached.all() and (found.pressures.sum(axis=1) <= p.sum(axis=1) * (1 + 1e-4)).all()
    assert (found.pressures >= 0).all() and (found.pressures <= robot.max_pressure).all()
    for group in GROUPS:
        own = found.pressures[:, [c - 1 for c in group]]
        np.testing.assert_array_equal(own, own[:, :1] + 0 * own)
    assert found.prediction.model_sd is not None and (found.prediction.model_sd > 0).all()


def test_targets_out_of_reach_are_told_with_the_nearest_point(paper_robot: Robot) -> None:
    robot = robot_with(paper_robot, AZIMUTH)
    nan = float("nan")
    found = inverse(Predictor(robot), [[1.0, 0.0, 0.2], [-0.03, nan, nan]], limits_of(robot, spine=(0.1, 0.1)))
    assert found.reached.tolist() == [False, True] and found.miss[0] > 0.5 and (found.spine_length == 0.1).all()
    # Nothing near does better.
    rng = np.random.default_rng(1)
    other = np.clip(found.pressures[0] + rng.normal(0, 20e3, (200, 9)), 0, robot.max_pressure)
    away = np.linalg.norm(Predictor(robot)(other, 0.1).tip - [1.0, 0.0, 0.2], axis=1)
    assert away.min() > found.miss[0] - 1e-4


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ({"groups": [(1, 2), (2, 3)]}, "groups"),
        ({"groups": [(10,)]}, "counted from 1 to 9"),
        ({"max_pressure": 1e6}, "must not exceed robot.yaml's 250000 Pa"),
        ({"spine": (0.1, 0.5)}, "must lie between 0 and 0.4 m"),
    ],
)
def test_limits_that_the_robot_does_not_have_are_refused(paper_robot: Robot, more: dict[str, Any], told: str) -> None:
    with pytest.raises(BadCondition, match=told):
        limits_of(paper_robot, **more)


def test_every_effect_of_the_catalogue_can_be_predicted_with(paper_robot: Robot) -> None:
    def small(p: Parameter) -> dict[str, Any]:
        return {"value": float(np.clip(0.3 * p.scale, p.low, p.high)), "sd": 0.1 * p.scale, "unit": p.unit}

    effects = {id: {p.name: small(p) for p in spec.parameters} for id, spec in CATALOGUE.items()}
    robot = robot_with(paper_robot, effects, obstacle_azimuth_deg=180.0)
    found = Predictor(robot, cores=1)([[60e3] * 3 + [0.0] * 6], 0.1, intervals=True)
    assert found.converged.all() and found.sd is not None and np.isfinite(found.sd).all()


def test_states_beyond_the_robot_s_limits_are_marked(paper_robot: Robot) -> None:
    at = Predictor(paper_robot)
    assert paper_robot.max_pressure is not None
    rows = [[60e3] + [0.0] * 8, [paper_robot.max_pressure + 50e3] + [0.0] * 8, [-5e3] + [0.0] * 8, [-200.0] + [0.0] * 8]
    with pytest.warns(UserWarning, match="2 of 4 states have pressures outside 0 to"):
        found = at(rows)
    assert found.outside is not None and found.outside.tolist() == [False, True, True, False]
