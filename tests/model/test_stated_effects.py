"""Effects in robot.yaml: what is refused and how it is told, and that the model has them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from lab.files.config import ConfigError, load
from model.effects import CATALOGUE, EffectSpec, ForwardModel, Law, Parameter, design_from_columns
from model.errors import BadRobot
from model.robot import Robot, robot_from_dict
from model.stated import Stated
from tests.model.effects.campaigns import campaign

SLIP = {"moment": {"value": 0.15, "sd": 0.01, "unit": "N m"}, "stroke": {"value": 0.3, "sd": 0.2, "unit": "ln"}}
AZIMUTH = {"angle": {"value": 0.1, "sd": 0.01, "unit": "rad"}}
POSTERIOR: dict[str, Any] = {
    "parameters": ["area_factor", "chamber_azimuth.angle"],
    "area_factor_sd": 0.01,
    "correlation": [[1], [0.5, 1]],
}


def stating(robot: Robot, **more: Any) -> dict[str, Any]:
    return {**robot.model_dump(mode="json"), "area_factor": 1.6, **more}


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ({"effects": {"spine_slip": {}}}, "effects.spine_slip: states no parameter"),
        ({"effects": {"spine_slip": {"moment": {"value": 0.1}}}}, "effects.spine_slip.moment.unit: is missing"),
        ({"effects": {"spine_slip": {"moment": {**SLIP["moment"], "sd": -1}}}}, "moment.sd = -1: must be at least 0"),
        ({"effects": {"spine_slip": {"moment": 0.1}}}, "effects.spine_slip.moment"),
        ({"posterior": POSTERIOR}, "chamber_azimuth.angle is not stated"),
        ({"posterior": {**POSTERIOR, "correlation": [[1], [2, 1]]}}, "posterior.correlation"),
        ({"posterior": {**POSTERIOR, "correlation": [[1], [1, 1]]}}, "not positive definite"),
        ({"posterior": {**POSTERIOR, "correlation": [[1, 0], [0, 1]]}}, "must be a lower triangle of 2 rows"),
        ({"posterior": {**POSTERIOR, "correlation": [[0.5], [0.5, 1]]}}, "with itself, must be 1"),
        ({"posterior": {**POSTERIOR, "parameters": ["area_factor"] * 2}}, "area_factor stands there twice"),
        ({"posterior": POSTERIOR, "effects": {"chamber_azimuth": {"angle": {**AZIMUTH["angle"], "sd": 0}}}}, "sd = 0 rad"),
        ({"posterior": POSTERIOR, "effects": {"chamber_azimuth": AZIMUTH}, "area_factor": {0.0: 1.5}}, "not a table"),
    ],
)  # fmt: skip
def test_what_contradicts_itself_is_refused_where_the_file_is_read(
    paper_robot: Robot, tmp_path: Path, more: dict[str, Any], told: str
) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(yaml.safe_dump(stating(paper_robot, **more)))
    with pytest.raises(ConfigError) as caught:
        load(path, Robot)
    assert told in str(caught.value) and str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ({"effects": {"spine_slap": SLIP}}, "effects.spine_slap: is not known, did you mean spine_slip?; if it is"),
        ({"effects": {"spine_slip": {"momment": SLIP["moment"]}}}, "did you mean moment?"),
        ({"effects": {"spine_slip": {"moment": {**SLIP["moment"], "unit": "N mm"}}}}, "unit 'N mm', must be 'N m'"),
        ({"effects": {"spine_slip": {"moment": {**SLIP["moment"], "value": 3}}}}, "= 3 N m: must be within 0 and 1.5 N m"),
        ({"tolerances": {"tillt": {"x": {"value": 0, "unit": "rad"}}}}, "tolerances.tillt: is not known, did you mean tilt?"),
    ],
)  # fmt: skip
def test_what_the_catalogue_does_not_know_is_refused_where_the_model_is_made(
    paper_robot: Robot, more: dict[str, Any], told: str
) -> None:
    robot = robot_from_dict(stating(paper_robot, **more))
    with pytest.raises(BadRobot) as caught:
        ForwardModel(robot, design_from_columns(robot, campaign(lengths=(0.1,), levels=(60e3,))))
    assert told in str(caught.value)


def test_the_baseline_of_a_robot_has_its_effects(paper_robot: Robot) -> None:
    columns = campaign(lengths=(0.0, 0.2), levels=(80e3, 160e3))
    plain = robot_from_dict(stating(paper_robot))
    tilt = {"tilt": {"x": {"value": 2e-3, "sd": 1e-3, "unit": "rad"}}}
    robot = robot_from_dict(stating(paper_robot, effects={"spine_slip": SLIP}, tolerances=tilt))
    assert robot.plain == plain
    forward, bare = (ForwardModel(r, design_from_columns(r, columns)) for r in (robot, plain))
    names = [p.name for p in forward.parameters]
    theta = np.zeros(len(names))
    for name, value in (("spine_slip.moment", 0.15), ("spine_slip.stroke", 0.3), ("tilt.x", 2e-3)):
        theta[names.index(name)] = value
    np.testing.assert_array_equal(forward.predict(0 * theta), bare.predict(theta))
    # What is added to it, and derivatives, count from there.
    change = np.zeros(len(names))
    change[names.index("spine_slip.moment")] = -0.05
    np.testing.assert_allclose(forward.predict(change), bare.predict(theta + change), atol=1e-15)
    np.testing.assert_array_equal(forward.linearise(0 * theta)[1], bare.linearise(theta)[1])
    moment, stroke = (forward.parameters[names.index(f"spine_slip.{k}")] for k in ("moment", "stroke"))
    assert (moment.low, moment.sign, stroke.role) == (-0.15, "both", "size")
    # The same where the effect is not among those that are varied.
    fixed = ForwardModel(robot, design_from_columns(robot, columns), catalogue={"base_tilt": CATALOGUE["base_tilt"]})
    np.testing.assert_array_equal(fixed.predict(np.zeros(len(fixed.parameters))), bare.predict(theta))


def test_an_effect_of_ones_own_may_stand_there(paper_robot: Robot) -> None:
    def colder(q: Any, v: Any) -> None:
        q.body_modulus = q.body_modulus * (1 + v["excess"])

    own = EffectSpec("colder", "material", "", (Parameter("excess", "1", 0.1, -0.5, 1.0),), Law(before=colder), "", "")
    robot = robot_from_dict(stating(paper_robot, effects={"colder": {"excess": {"value": 0.2, "unit": "1"}}}))
    design = design_from_columns(robot, campaign(lengths=(0.1,), levels=(60e3,)))
    with pytest.raises(BadRobot, match=r"effects\.colder: is not known.*--effects"):
        ForwardModel(robot, design)
    moved = ForwardModel(robot, design, catalogue={"colder": own})
    zero = np.zeros(len(moved.parameters))
    assert np.abs(moved.predict(zero) - ForwardModel(robot.plain, design, catalogue={}).predict(zero[1:])).max() > 1e-3


def test_the_uncertainty_of_a_robot_is_one_covariance(paper_robot: Robot) -> None:
    robot = robot_from_dict(stating(paper_robot, effects={"spine_slip": SLIP, "chamber_azimuth": AZIMUTH}, posterior=POSTERIOR))
    names, covariance = robot.joint_uncertainty()
    assert names == ("area_factor", "chamber_azimuth.angle", "spine_slip.moment", "spine_slip.stroke")
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), [0.01, 0.01, 0.01, 0.2])
    assert covariance[0, 1] == pytest.approx(0.5e-4) and covariance[2, 3] == 0
    one = robot.with_values({"area_factor": 1.7, "spine_slip.moment": 0.2})
    assert one.area_factor == 1.7 and one.effects["spine_slip"]["moment"].value == 0.2 and one.posterior is None


def test_a_stated_effect_acts_where_it_stands_in_the_catalogue(paper_robot: Robot) -> None:
    """An offset of a gauge goes with its regulator to the chambers that hang on it, be their order stated or varied."""
    columns = {"trial": np.ones(2, int), "spine_length": np.zeros(2), "x": np.zeros(2), "y": np.zeros(2), "z": np.zeros(2)}
    columns |= {f"p{c}": np.array([0.0, 100e3 if c in (3, 4, 5) else 0.0]) for c in range(1, 10)}
    design = design_from_columns(paper_robot, columns)
    stated = {"chamber_order": {"blend": Stated(value=1.0, unit="1"), "which": Stated(value=2.0, unit="1")}}
    fixed = paper_robot.model_copy(update={"effects": stated})
    found = []
    for robot, size in ((fixed, 0.0), (paper_robot, 1.0)):
        known = {id: CATALOGUE[id] for id in ("pressure_offset", "chamber_order") if size or id != "chamber_order"}
        forward = ForwardModel(robot, design, catalogue=known)
        theta = np.zeros(len(forward.parameters))
        theta[forward.index("pressure_offset")[0]] = 8e3
        if size:
            theta[forward.index("chamber_order")] = [1.0, 2.0]
        found.append(forward.predict(theta))
    assert found[0] == pytest.approx(found[1], abs=1e-6)
