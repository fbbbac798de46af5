"""The robot description: what it accepts, and what it says about what it does not."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

import lab
from model.arm import load_arm
from model.calibration import fit_area_factor
from model.condition import conditions
from model.errors import BadArm, BadRobot
from model.robot import Robot, load_robot, robot_from_dict
from tests.simulated.bench import raises

WIDE = {"radius": 0.02, "path_radius": 0.01, "azimuths_deg": [0]}
"""One chamber that reaches over the axis."""


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"outer_radius": -0.05}, ["outer_radius", "-0.05 m", "greater than 0"]),
        ({"density": float("nan")}, ["density", "nan kg/m^3", "finite"]),
        ({"inner_radius": 0.06}, ["inner_radius 0.06 m", "outer_radius 0.05 m"]),
        ({"chambers": {"radius": 0.02, "path_radius": 0.04, "azimuths_deg": [0]}}, ["chambers", "20 to 60 mm", "wall"]),
        ({"inner_radius": 0, "spine": None, "chambers": WIDE | {"azimuths_deg": [0, 180]}}, ["chambers", "-10 to 30 mm", "wall"]),
        ({"inner_radius": 0.001, "spine": None, "chambers": WIDE}, ["chambers", "-10 to 30 mm", "wall"]),
        ({"spine": {"radius": 0.03, "modulus": {0.1: 1e6}}}, ["spine.radius 0.03 m", "inner_radius 0.029 m"]),
        ({"spine": {"radius": 0.02, "modulus": {0.5: 1e6}}}, ["spine.modulus", "0.5 m", "length 0.4 m"]),
        ({"spine": {"radius": 0.02, "modulus": {0.1: 3}}}, ["spine.modulus.0.1", "3 Pa", "1000"]),
        ({"area_factor": {-0.1: 1.5}}, ["area_factor.-0.1", "-0.1 m"]),
        ({"area_factor": {}}, ["area_factor", "empty"]),
        ({"area_factor": "large"}, ["area_factor", "'large'", "number"]),
        ({"markers": [0.1, 0.41]}, ["markers", "0.41 m", "length 0.4 m"]),
        ({"lenght": 0.4}, ["lenght", "not permitted"]),
        ({"base_to_world": {"position": [0, 0, 0], "orientation": [1, 1, 0, 0]}}, ["base_to_world", "norm 1.41", "normal"]),
    ],
)
def test_a_wrong_value_is_refused_with_field_value_and_limit(
    paper_robot: Robot, change: dict[str, Any], words: list[str]
) -> None:
    said = raises(BadRobot, None, robot_from_dict, {**paper_robot.model_dump(), **change})
    for word in words:
        assert word in said


def test_one_chamber_may_reach_over_the_axis_of_a_body_without_a_bore(paper_robot: Robot) -> None:
    robot = robot_from_dict({**paper_robot.model_dump(), "inner_radius": 0, "spine": None, "chambers": WIDE})
    assert (lab.predict(robot, [20e3]).tip[..., 0] < 0).all()


def test_azimuths_in_rad_are_refused(paper_robot: Robot) -> None:
    data = paper_robot.model_dump(exclude_none=True)
    data["chambers"]["azimuths_deg"] = [0.0, 2.0944, 4.18879]
    raises(BadRobot, r"azimuths_deg: 4.18879 at most.*look like rad.*multiply by 57.2958", robot_from_dict, data)


def test_tendons_have_no_thrust_and_one_limit(paper_robot: Robot) -> None:
    data = paper_robot.model_dump() | {"thrust": "walls"}
    tendons = {"chambers": None, "tendons": {"path_radius": 0.04, "azimuths_deg": (0, 120, 240)}, "max_pressure": None}
    raises(BadRobot, "thrust: says nothing of a robot with tendons", robot_from_dict, data | tendons)
    pulled = robot_from_dict(data | tendons | {"thrust": None, "max_tension": 5.0})
    assert pulled.replace(max_pressure=2e4).max_tension is None and pulled.replace(max_tension=2.0).max_pressure == 2e4
    assert pulled.replace(max_tension=[2.0, 3.0, 4.0]).pressure_limits.tolist() == [2e4, 3e4, 4e4]
    for wrong, told in ((2e4, "max_pressure and max_tension are both given: keep max_tension"), ("abc", "max_pressure.*abc")):
        raises(BadRobot, told, robot_from_dict, pulled.model_dump() | {"max_pressure": wrong})
    walls = robot_from_dict(data)
    assert walls.causes["chamber_thrust"]["share"].value == 1.0 and not walls.effects and not paper_robot.causes


def test_thrust_that_robot_yaml_states_acts_in_every_prediction(paper_robot: Robot) -> None:
    walls, bent = paper_robot.model_copy(update={"thrust": "walls"}), [60e3] * 3 + [0.0] * 6
    assert np.linalg.norm(lab.predict(walls, bent).tip - lab.predict(paper_robot, bent).tip) > 1e-3
    pressures = [np.multiply(bent, share) for share in (0.3, 0.6, 1.0)]
    tips = lab.predict(walls.replace(area_factor=1.2), pressures).tip
    fitted = fit_area_factor(walls, conditions(walls, [0.0] * 3, pressures), tips)
    assert fitted.value == pytest.approx(1.2, rel=1e-4)


def test_all_wrong_and_missing_fields_are_named_at_once(paper_robot: Robot) -> None:
    given = {**paper_robot.model_dump(), "length": 0, "tip_mass": -1}
    del given["density"]
    raises(BadRobot, r"(?s)length.*density: .*required.*tip_mass", robot_from_dict, given)


UNITLESS = {
    "name", "chambers", "spine", "base_to_world", "effects", "tolerances", "posterior", "residual", "uncertainty", "learnt",
    "noise", "parameters", "unit", "value", "sd", "sections", "tendons", "thrust",
}  # fmt: skip
"""Fields that are no numbers, and those whose unit stands beside them."""


def test_every_number_tells_its_unit() -> None:
    schema = Robot.model_json_schema()
    silent = [
        f"{owner}.{field}"
        for owner, body in {"Robot": schema, **schema["$defs"]}.items()
        for field, spec in body["properties"].items()
        if field not in UNITLESS and "unit" not in spec
    ]
    assert silent == []


def test_the_spine_s_modulus_is_scipy_s_monotone_cubic_and_levels_off_beyond_its_table(paper_robot: Robot) -> None:
    spine = paper_robot.spine
    curve = PchipInterpolator(*np.array(sorted(spine.modulus.items())).T, extrapolate=False)
    beyond = np.linspace(0.0, paper_robot.length, 400)
    inside = beyond[(beyond >= curve.x[0]) & (beyond <= curve.x[-1])]
    np.testing.assert_allclose(spine.modulus_at(inside), curve(inside), rtol=1e-12)
    along = spine.modulus_at(beyond)
    assert (np.diff(along) > 0).all() and along[0] > 0.5 * 318e3 and along[-1] < 2 * 4389e3
    np.testing.assert_allclose(spine.model_copy(update={"modulus": {0.2: 1e6}}).modulus_at([0.0, 0.2, 0.4]), [1e6, 1e6, 1e6])


def test_the_area_factor_is_linear_between_entries_and_held_beyond_them(paper_robot: Robot) -> None:
    np.testing.assert_allclose(paper_robot.area_factor_at([0.0, 0.075, 0.4]), [1.5, 1.6, 2.4])


def test_a_replaced_value_is_checked_and_an_area_factor_holds_at_every_spine_length(paper_robot: Robot) -> None:
    np.testing.assert_allclose(paper_robot.replace(area_factor=1.6).area_factor_at([0.0, 0.2]), [1.6, 1.6])
    raises(BadRobot, "area_factor", paper_robot.replace, area_factor=-1.0)
    assert paper_robot.replace(length=0.42).length == 0.42


@pytest.mark.parametrize(("read", "kind", "missing"), [(load_robot, BadRobot, "length"), (load_arm, BadArm, "links")])
def test_a_bad_file_is_named(tmp_path: Path, read: Callable[[Path], object], kind: type[Exception], missing: str) -> None:
    path = tmp_path / "own.yaml"
    bad = {
        b"- 1\n- 2\n": "holds no table",
        b"a: [1,\n": "not valid YAML",
        b"name: x\n": f"{missing}: Field required",
        b"\xff": "",
    }
    for data, words in bad.items():
        path.write_bytes(data)
        said = raises(kind, None, read, path)
        assert said.startswith(str(path)) and words in said
    raises(kind, "nowhere.yaml: cannot be read", read, tmp_path / "nowhere.yaml")
    raises(kind, "not a file", read, tmp_path)
