"""Effects in robot.yaml: what is refused and how it is told, and that the model has them."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from lab.files.config import ConfigError, load
from model.effects import CATALOGUE, EffectSpec, ForwardModel, Law, Parameter, design_from_columns, with_effects
from model.errors import BadEffect, BadRobot
from model.robot import Robot, robot_from_dict
from model.stated import Stated
from tests.model.effects.campaigns import Moved, campaign
from tests.simulated.bench import raises

SLIP = {"moment": {"value": 0.15, "sd": 0.01, "unit": "N m"}, "stroke": {"value": 0.3, "sd": 0.2, "unit": "ln"}}
AZIMUTH = {"angle": {"value": 0.1, "sd": 0.01, "unit": "rad"}}
POSTERIOR: dict[str, Any] = {
    "parameters": ["area_factor", "chamber_azimuth.angle"],
    "area_factor_sd": 0.01,
    "correlation": [[1], [0.5, 1]],
}
LEARNT = {"amplitude": 1e-3, "pressure_scale": 1e5, "length_scale": 0.1, "trial": 0.0, "reading": 1e-4}


def stating(robot: Robot, **more: Any) -> dict[str, Any]:
    return {**robot.model_dump(mode="json"), "area_factor": 1.6, **more}


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ({"effects": {"spine_slip": {}}}, "effects.spine_slip: states no parameter"),
        ({"effects": {"spine_slip": {"moment": {"value": 0.1}}}}, "effects.spine_slip.moment.unit: is missing"),
        ({"effects": {"spine_slip": {"moment": {**SLIP["moment"], "sd": -1}}}}, "moment.sd = -1: must be at least 0"),
        ({"effects": {"spine_slip": {"moment": 0.1}}}, "effects.spine_slip.moment"),
        ({"posterior": {**POSTERIOR, "correlation": [[1], [2, 1]]}}, "posterior.correlation"),
        ({"posterior": {**POSTERIOR, "correlation": [[1], [1, 1]]}}, "not positive definite"),
        ({"posterior": {**POSTERIOR, "correlation": [[1, 0], [0, 1]]}}, "must be a lower triangle of 2 rows"),
        ({"posterior": {**POSTERIOR, "correlation": [[0.5], [0.5, 1]]}}, "with itself, must be 1"),
        ({"posterior": {**POSTERIOR, "parameters": ["area_factor"] * 2}}, "area_factor stands there twice"),
        ({"posterior": {**POSTERIOR, "noise": {"reading_by_axis": [1e-3, -1e-3, 1e-3]}}}, "posterior.noise.reading_by_axis"),
        ({"posterior": POSTERIOR, "effects": {"chamber_azimuth": {"angle": {**AZIMUTH["angle"], "sd": 0}}}}, "sd = 0 rad"),
        ({"posterior": POSTERIOR, "effects": {"chamber_azimuth": AZIMUTH}, "area_factor": {0.0: 1.5}}, "not a table"),
        ({"residual": {**LEARNT, "learnt": [[1.0] * 13]}}, "residual.learnt: a state of 13 numbers, must have 14"),
    ],
)  # fmt: skip
def test_what_contradicts_itself_is_refused_where_the_file_is_read(
    paper_robot: Robot, tmp_path: Path, more: dict[str, Any], told: str
) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(yaml.safe_dump(stating(paper_robot, **more)))
    said = raises(ConfigError, None, load, path, Robot)
    assert told in said and str(path) in said


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ({"effects": {"spine_slap": SLIP}}, "effects.spine_slap: is not known, did you mean spine_slip?; if it is"),
        ({"effects": {"spine_slip": {"momment": SLIP["moment"]}}}, "did you mean moment?"),
        ({"effects": {"spine_slip": {"moment": {**SLIP["moment"], "unit": "N mm"}}}}, "unit 'N mm', must be 'N m'"),
        ({"effects": {"spine_slip": {"moment": {**SLIP["moment"], "value": 3}}}}, "= 3 N m: must be within 0 and 1.5 N m"),
        ({"effects": {"chamber_gain": {"x": {"value": 9, "unit": 1}}}}, "= 9: must be within -0.4 and 0.4"),
        ({"tolerances": {"tillt": {"x": {"value": 0, "unit": "rad"}}}}, "tolerances.tillt: is not known, did you mean tilt?"),
    ],
)  # fmt: skip
def test_what_the_catalogue_does_not_know_is_refused_where_the_model_is_made(
    paper_robot: Robot, more: dict[str, Any], told: str
) -> None:
    robot = robot_from_dict(stating(paper_robot, **more))
    design = design_from_columns(robot, campaign(lengths=(0.1,), levels=(60e3,)))
    assert told in raises(BadRobot, None, ForwardModel, robot, design)


def test_a_number_that_rounding_moves_beyond_its_bound_is_at_the_bound(paper_robot: Robot) -> None:
    columns, gain = campaign(lengths=(0.1,), levels=(60e3,)), {"chamber_gain": {"x": {"value": 0.4, "unit": "1"}}}
    at, beyond = (robot_from_dict(stating(paper_robot, effects=gain)) for gain["chamber_gain"]["x"]["value"] in (0.4, 0.4 + 1e-8))
    np.testing.assert_allclose(Moved(beyond, columns).still, Moved(at, columns).still, atol=1e-7)


def test_the_baseline_of_a_robot_has_its_effects(paper_robot: Robot) -> None:
    columns = campaign(lengths=(0.0, 0.2), levels=(80e3, 160e3))
    plain = robot_from_dict(stating(paper_robot))
    tilt = {"tilt": {"x": {"value": 2e-3, "sd": 1e-3, "unit": "rad"}}}
    robot = robot_from_dict(stating(paper_robot, effects={"spine_slip": SLIP}, tolerances=tilt))
    assert robot.plain == plain
    here, bare = (Moved(r, columns) for r in (robot, plain))
    stated = {"spine_slip.moment": 0.15, "spine_slip.stroke": 0.3, "tilt.x": 2e-3}
    still = bare.tips(stated)  # solved from the plain robot, the other from the one with its effects, to 1e-9
    np.testing.assert_allclose(here.still, still, atol=1e-9)
    # What is added to it, and derivatives, count from there.
    np.testing.assert_allclose(here.tips(spine_slip__moment=-0.05), bare.tips(stated | {"spine_slip.moment": 0.10}), atol=1e-9)
    slopes = (here.forward.linearise(here.vector())[1], bare.forward.linearise(bare.vector(stated))[1])
    np.testing.assert_allclose(*slopes, rtol=1e-6, atol=2e-5)
    own = {p.name: p for p in here.forward.parameters}
    moment, stroke = own["spine_slip.moment"], own["spine_slip.stroke"]
    assert (moment.low, moment.sign, stroke.role) == (-0.15, "both", "size")
    # The same where the effect is not among those that are varied.
    np.testing.assert_allclose(Moved(robot, columns, catalogue={"base_tilt": CATALOGUE["base_tilt"]}).still, still, atol=1e-9)


def test_an_effect_of_ones_own_may_stand_there_and_takes_part_like_any_other(paper_robot: Robot) -> None:
    def colder(q: Any, v: Any) -> None:
        q.body_modulus = q.body_modulus * (1 + v["excess"])

    own = EffectSpec("colder", "material", "", (Parameter("excess", "1", 0.1, -0.5, 1.0),), Law(before=colder), "", "")
    robot = robot_from_dict(stating(paper_robot, effects={"colder": {"excess": {"value": 0.2, "unit": "1"}}}))
    columns = campaign(lengths=(0.1,), levels=(60e3,))
    raises(BadRobot, r"effects\.colder: is not known.*--effects", Moved, robot, columns)
    with_it, plain = Moved(robot, columns, catalogue=with_effects([own])), Moved(robot.plain, columns, catalogue={})
    assert np.abs(with_it.still - plain.still).max() > 1e-3 < np.abs(with_it.by(colder__excess=0.2)).max()
    raises(BadEffect, "taken", with_effects, [own], with_effects([own]))


@pytest.mark.parametrize(
    ("uncertain", "parameter", "by", "changed"),
    [
        ("tip_mass", "tip_mass.excess", 0.05, lambda r: {"tip_mass": r.tip_mass + 0.05}),
        ("path_radius", "path_radius.excess", 1e-3, lambda r: {"chambers": {"path_radius": r.chambers.path_radius + 1e-3}}),
        ("azimuths", "azimuths.p1", 0.1, lambda r: {
            "chambers": {"azimuths_deg": [a + np.degrees(0.1) * (k == 0) for k, a in enumerate(r.chambers.azimuths_deg)]}}),
    ],
)  # fmt: skip
def test_a_tolerance_of_the_drawing_acts_as_another_drawing_does(
    paper_robot: Robot, uncertain: str, parameter: str, by: float, changed: Callable[[Robot], dict[str, Any]]
) -> None:
    columns = campaign(lengths=(0.0, 0.1), levels=(60e3,))
    columns.pop("tip_mass", None)
    surveyed = robot_from_dict(stating(paper_robot, uncertainty={uncertain: by}))
    drawn = paper_robot.model_dump()
    for key, value in changed(paper_robot).items():
        drawn[key] = {**drawn[key], **value} if isinstance(value, dict) else value
    other = Moved(robot_from_dict(drawn), columns).still
    assert Moved(surveyed, columns).tips({parameter: by}) == pytest.approx(other, abs=1e-6)
    assert np.abs(other - Moved(paper_robot, columns).still).max() > 1e-4


def test_the_uncertainty_of_a_robot_is_one_covariance(paper_robot: Robot) -> None:
    robot = robot_from_dict(stating(paper_robot, effects={"spine_slip": SLIP, "chamber_azimuth": AZIMUTH}, posterior=POSTERIOR))
    names, covariance = robot.joint_uncertainty()
    assert names == ("area_factor", "chamber_azimuth.angle", "spine_slip.moment", "spine_slip.stroke")
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), [0.01, 0.01, 0.01, 0.2])
    assert covariance[0, 1] == pytest.approx(0.5e-4) and covariance[2, 3] == 0
    removed = robot.replace(effects={"spine_slip": SLIP}).joint_uncertainty()  # of which the posterior still names an effect
    assert removed[0] == ("area_factor", "spine_slip.moment", "spine_slip.stroke")
    np.testing.assert_array_equal(removed[1], np.delete(np.delete(covariance, 1, 0), 1, 1))
    one = robot.with_values({"area_factor": 1.7, "spine_slip.moment": 0.2})
    assert one.area_factor == 1.7 and one.effects["spine_slip"]["moment"].value == 0.2 and one.posterior is None


def test_a_stated_effect_acts_where_it_stands_in_the_catalogue(paper_robot: Robot) -> None:
    """An offset of a gauge goes with its regulator to the chambers that hang on it, be their order stated or varied."""
    columns = campaign(lengths=(0.0,), levels=(100e3,), unload=False, chambers=(3, 4, 5))
    order, known = {"blend": 1.0, "which": 2.0}, {id: CATALOGUE[id] for id in ("pressure_offset", "chamber_order")}
    stated = {"chamber_order": {name: Stated(value=value, unit="1") for name, value in order.items()}}
    fixed = Moved(
        paper_robot.model_copy(update={"effects": stated}), columns, catalogue={"pressure_offset": known["pressure_offset"]}
    )
    varied = Moved(paper_robot, columns, catalogue=known)
    found = varied.tips({f"chamber_order.{name}": value for name, value in order.items()}, pressure_offset__offset=8e3)
    assert fixed.tips(pressure_offset__offset=8e3) == pytest.approx(found, abs=1e-6)
