"""robot.yaml written from a given one: the author's text stays, and what is read back is the robot that was written."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from diagnosed_case import campaign, folder

from lab.cli import main
from lab.files.config import ConfigError, check, load, parse_yaml
from lab.files.robot_file import robot_yaml
from model.robot import Robot, robot_from_dict

ARM = """\
# Arm 7, cast in March; z points down
---
name:   "arm 7"            # engraved on the base
length: 31.5 cm +- 2 mm    # tape, three readings
outer_radius:     4.0e-2
inner_radius: 20 mm
density: &rho 1_080        # data sheet

youngs_modulus: 350e3      # pulled at 20 %
shear_modulus: '117 kPa'
tip_mass: 20 g
gravity:
    - 0
    - 0.0                  # hangs
    - 9.81
# --- actuation
chambers:
    radius: 4 mm
    path_radius: 3 cm
    azimuths_deg: [0, 120,
                   240]    # counted from the connector
tendons:
area_factor:               # from the cut, by spine length
    # Monday
    0.0: 120 %             # ink
    0.2: 1.45              # calliper

spine: {radius: 19 mm, modulus: {0.1: 800 kPa, 0.2: 1.9e6}}   # the old granules
markers: [10 cm, 0.2]
# Ask Noor before changing anything above
"""
EFFECTS = {"chamber_azimuth": {"angle": {"value": 0.071, "sd": 0.004, "unit": "rad"}}}
POSTERIOR = {
    "parameters": ["area_factor", "chamber_azimuth.angle"],
    "area_factor_sd": 0.01,
    "correlation": [[1.0], [0.25, 1.0]],
}


def read(text: str) -> Robot:
    return check(parse_yaml(text, "robot.yaml"), Robot)


def changed(robot: Robot, **values: Any) -> Robot:
    return robot_from_dict({**robot.model_dump(), **values})


def close(a: Any, b: Any, rel: float = 1e-12) -> bool:
    """Whether all numbers of two dumps agree."""
    if isinstance(a, dict):
        return len(a) == len(b) and all(close(*pair, rel) for pair in zip(sorted(a.items()), sorted(b.items()), strict=True))
    if isinstance(a, (list, tuple)):
        return len(a) == len(b) and all(close(x, y, rel) for x, y in zip(a, b, strict=True))
    return math.isclose(a, b, rel_tol=rel) if isinstance(a, float) else bool(a == b)


def lines(before: str, after: str) -> tuple[list[str], list[str]]:
    """The lines that only one of two texts has."""
    old, new = before.splitlines(), after.splitlines()
    return [x for x in old if x not in new], [x for x in new if x not in old]


def test_a_robot_that_did_not_change_is_written_as_it_was_given() -> None:
    for text in (ARM, ARM.replace("\n", "\r\n"), ARM.rstrip("\n"), "\ufeff" + ARM):
        assert robot_yaml(read(text), text) == text


def test_a_changed_number_keeps_its_unit_and_what_stands_beside_it() -> None:
    robot = changed(
        read(ARM), length=0.322, tip_mass=0.0123456789, shear_modulus=118500.0, density=1081.5, inner_radius=0.0205,
        gravity=(0.0, 0.1, 9.81), markers=(0.11, 0.2),
    )  # fmt: skip
    text = robot_yaml(robot, ARM)
    assert lines(ARM, text)[1] == [
        "length: 32.2 cm +- 2 mm    # tape, three readings",
        "inner_radius: 20.5 mm",
        "density: &rho 1081.5        # data sheet",
        "shear_modulus: '118.5 kPa'",
        "tip_mass: 12.3456789 g",
        "    - 0.1                  # hangs",
        "markers: [11 cm, 0.2]",
    ]
    assert close(read(text).model_dump(), robot.model_dump())


def test_si_numbers_read_back_to_the_last_bit() -> None:
    given = ARM.replace("radius: 4 mm", "radius: 0.004").replace("3 cm", "3e-2")
    chambers = read(given).model_dump()["chambers"] | {"radius": 0.01 / 3, "path_radius": 0.1 / 3}
    robot = changed(read(given), outer_radius=0.13 / 3, youngs_modulus=1e6 / 3, chambers=chambers)
    text = robot_yaml(robot, given)
    assert read(text) == robot
    assert f"path_radius: {0.1 / 3}" in text and "# counted from the connector" in text


def test_a_table_takes_new_lengths_in_its_own_order_and_unit() -> None:
    robot = read(ARM)
    robot = changed(
        robot,
        area_factor={0.0: 1.25, 0.1: 1.3, 0.2: 1.45},
        spine={"radius": 0.019, "modulus": {0.05: 5e5, 0.1: 8e5, 0.2: 2e6}},
    )
    text = robot_yaml(robot, ARM)
    assert lines(ARM, text)[1] == [
        "    0.0: 125 %             # ink",
        "    0.1: 130 %",
        "spine: {radius: 19 mm, modulus: {0.05: 500 kPa, 0.1: 800 kPa, 0.2: 2000000.0}}   # the old granules",
    ]
    assert close(read(text).model_dump(), robot.model_dump())


def test_a_table_that_becomes_a_number_stays_as_a_comment() -> None:
    robot = changed(read(ARM), area_factor=1.31)
    text = robot_yaml(robot, ARM)
    assert lines(ARM, text)[1] == [
        "area_factor: 1.31",
        "# area_factor:               # from the cut, by spine length",
        "#     # Monday",
        "#     0.0: 120 %             # ink",
        "#     0.2: 1.45              # calliper",
    ]
    assert read(text) == robot
    back = robot_yaml(read(ARM), text)
    assert lines(text, back) == (["area_factor: 1.31"], ["area_factor: {0.0: 1.2, 0.2: 1.45}"])


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
@pytest.mark.parametrize("end", ["", "last"])
def test_effects_come_and_go_and_the_rest_stays(newline: str, end: str) -> None:
    given = (ARM if end else ARM.rstrip("\n")).replace("\n", newline)
    robot = changed(read(given), area_factor=1.31, effects=EFFECTS, posterior=POSTERIOR)
    known = robot_yaml(robot, given)
    assert read(known) == robot and "null" not in known
    assert known.count("\n") == known.count(newline) and known.endswith(newline) == bool(end)
    assert f"    angle: {{value: 0.071, sd: 0.004, unit: rad}}{newline}posterior:{newline}" in known
    more = {**EFFECTS, "base_tilt": {"x": {"value": 0.01, "sd": 0.002, "unit": "rad"}}}
    wider = POSTERIOR | {
        "parameters": ["area_factor", "chamber_azimuth.angle", "base_tilt.x"],
        "correlation": [[1.0], [0.2, 1.0], [0.0, 0.1, 1.0]],
    }
    again = changed(robot, effects=more, posterior=wider)
    second = robot_yaml(again, known)
    assert read(second) == again and f"  - [0.0, 0.1, 1.0]{newline}" in second
    plain = robot_yaml(again.plain, second)
    assert read(plain) == again.plain
    for text in (known, second, plain):
        assert [comment for comment in ARM.split("#")[1:] if comment.splitlines()[0].strip() not in text] == []
    assert plain.splitlines() == robot_yaml(changed(read(given), area_factor=1.31), given).splitlines()


def test_an_entry_with_a_comment_is_commented_out_and_one_without_is_removed() -> None:
    given = ARM + "uncertainty: {tilt: 1 deg}   # spirit level\nmax_pressure: 90 kPa\n"
    robot = changed(read(given), uncertainty={"length": 2e-3, "frame_shift": 1e-3}, max_pressure=None)
    text = robot_yaml(robot, given)
    assert lines(given, text)[1] == ["uncertainty: {frame_shift: 0.001}   # spirit level"] and "max_pressure" not in text
    given = given.replace(" +- 2 mm ", "")
    bare = robot_yaml(changed(read(given), uncertainty={}), given)
    assert "# uncertainty: {tilt: 1 deg}   # spirit level\nmax_pressure: 90 kPa\n" in bare


@pytest.mark.parametrize(
    "given",
    [
        "",
        "no: [robot",
        ARM.replace("name:   ", "? name\n: ").replace("area_factor:  ", "? area_factor\n:  "),
        json.dumps({"name": "arm", "sections": []}),
    ],
)
def test_a_text_that_cannot_be_edited_gives_way_to_a_new_one(given: str) -> None:
    robot = changed(read(ARM), area_factor=1.31, effects=EFFECTS)
    text = robot_yaml(robot, given)
    assert read(text) == robot and "null" not in text and "#" not in text
    assert "    angle: {value: 0.071, sd: 0.004, unit: rad}\n" in text


def test_parts_of_a_body_are_edited_where_they_stand() -> None:
    part = "sections:   # drawn 12 May\n- length: 20 cm      # stiff half\n  outer_radius: [4 cm, 35 mm]\n- {length: 0.115}\n"
    given = ARM + part
    sections = read(given).model_dump()["sections"]
    robot = changed(read(given), sections=[{**sections[0], "outer_radius": (0.04, 0.036)}, sections[1]])
    assert lines(given, robot_yaml(robot, given))[1] == ["  outer_radius: [4 cm, 36 mm]"]
    shorter = changed(read(given), sections=[{**sections[0], "outer_radius": None}, sections[1]])
    assert read(robot_yaml(shorter, given)) == shorter and "# tape, three readings" in robot_yaml(shorter, given)


def test_lab_fit_keeps_the_file_of_the_case_and_so_does_a_second_fit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    case = folder(tmp_path / "case", campaign({}, repeats=1, lengths=(0.0, 0.15)))
    given = (case / "robot.yaml").read_text().replace("length: 0.40  ", "length: 40 cm")
    (case / "robot.yaml").write_text(given)
    comments = [line.partition("#")[2] for line in given.splitlines() if "#" in line]
    for out, more in (("plain", []), ("known", ["--with", "base_tilt", "--samples", "2"])):
        assert main(["fit", str(case), "--out", str(tmp_path / out), *more]) == 0
        text = (tmp_path / out / "robot.yaml").read_text()
        assert [c for c in comments if c not in text] == [] and "length: 40 cm" in text and "null" not in text
        assert [x for x in lines(given, text)[0] if not x.startswith("area_factor:")] == []
    sample = (tmp_path / "known" / "samples" / "robot-0001.yaml").read_text()
    assert [c for c in comments if c not in sample] == [] and "posterior" not in sample
    assert main(["fit", str(case), "--robot", str(tmp_path / "known" / "robot.yaml"), "--out", str(tmp_path / "again")]) == 0
    plain, refitted = (load(tmp_path / out / "robot.yaml", Robot).model_dump() for out in ("plain", "again"))
    assert close(plain, refitted, rel=1e-3)
    again = (tmp_path / "again" / "robot.yaml").read_text()
    assert [c for c in comments if c not in again] == [] and "effects" not in again


def test_a_missing_number_without_a_unit_is_asked_for_as_a_number(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text("name: no factor\n")
    with pytest.raises(ConfigError, match="area_factor: is missing; give a number"):
        load(path, Robot)
