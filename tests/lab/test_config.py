"""One message tells everything that is wrong with a file."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Annotated, Literal

import pytest
from pydantic import BaseModel, ConfigDict, Field

from lab.files.config import ConfigError, check, load, parse_yaml
from lab.files.example import paper_robot
from lab.files.robot_file import robot_yaml
from lab.files.units import UnitError, to_si
from model.plain_yaml import MOST_PROBLEMS
from model.robot import Robot


class Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Alpha(Table):
    driver: Literal["alpha"]
    max_pressure: float = Field(3e5, gt=0, le=1e6, json_schema_extra={"unit": "Pa"})


class Beta(Table):
    driver: Literal["beta"]
    ports: list[str]


class File(Table):
    name: str
    length: float = Field(gt=0, le=2, json_schema_extra={"unit": "m"})
    levels: list[Annotated[float, Field(ge=1e3, le=3e5)]] = Field([5e4], json_schema_extra={"unit": "Pa"})
    table: dict[float, float] = Field({}, json_schema_extra={"unit": "Pa"})
    device: Annotated[Alpha | Beta, Field(discriminator="driver")] | None = None


def read(tmp_path: Path, text: str) -> File:
    path = tmp_path / "file.yaml"
    path.write_text(text)
    return load(path, File)


def problems(tmp_path: Path, text: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        read(tmp_path, text)
    return str(caught.value).splitlines()


def test_quantities_with_units_become_si(tmp_path: Path) -> None:
    text = "name: a\nlength: 40 cm\nlevels: [50 kPa, 0.1 MPa, 2e5]\ndevice: {driver: alpha, max_pressure: 2 bar}\n"
    file = read(tmp_path, text)
    assert file.length == pytest.approx(0.4)
    assert file.levels == pytest.approx([5e4, 1e5, 2e5])
    assert isinstance(file.device, Alpha) and file.device.max_pressure == pytest.approx(2e5)


def test_a_table_of_quantities_is_converted_too(tmp_path: Path) -> None:
    assert read(tmp_path, "name: a\nlength: 1\ntable: {0.05: 318 kPa}\n").table == {0.05: 318e3}


def test_all_problems_of_a_file_come_at_once_with_their_lines(tmp_path: Path) -> None:
    found = problems(tmp_path, "name: a\nlenght: 0.4\nlevels: [50e3, 250]\ndevice:\n  driver: alpha\n  max_pressure: 2e6\n")
    assert len(found) == 4
    assert "file.yaml:2: lenght: unknown key; did you mean 'length'?" in found[0]
    assert "file.yaml:3: levels[1] = 250 Pa: must be at least 1 kPa; did you mean 250 kPa?" in found[1]
    assert "file.yaml:6: device.max_pressure = 2 MPa: must be at most 1 MPa" in found[2]
    assert "length: is missing; give it in m" in found[3]


def test_a_wrong_unit_names_those_that_would_do(tmp_path: Path) -> None:
    (line,) = problems(tmp_path, "name: a\nlength: 5 kPa\n")
    assert "length" in line and "'kPa'" in line and "mm" in line


def test_an_unknown_driver_gets_the_nearest_one(tmp_path: Path) -> None:
    (line,) = problems(tmp_path, "name: a\nlength: 1\ndevice: {driver: alfa}\n")
    assert "device" in line and "did you mean 'alpha'?" in line


@pytest.mark.parametrize("value", [".nan", ".inf", "-0.1", "0", "abc", "[1]", "{}", "null"])
def test_a_number_that_is_none_is_refused_by_name(tmp_path: Path, value: str) -> None:
    (line,) = problems(tmp_path, f"name: a\nlength: {value}\n")
    assert "file.yaml:2: length" in line


@pytest.mark.parametrize("text", ["", "[]", "just text", "name: [unclosed", "a: &x 1\nb: *x\n", "\x00"])
def test_what_is_no_table_is_one_clear_error(tmp_path: Path, text: str) -> None:
    assert len(problems(tmp_path, text)) == 1


def test_a_missing_file_says_so(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        load(tmp_path / "none.yaml", File)


def test_a_quantity_of_a_million_characters_is_refused_at_once() -> None:
    # matching them would take a time that grows with the square of their number
    for text in ("1" * 10**6 + "\nx", "1 a" + " " * 10**6 + "b"):
        with pytest.raises(UnitError, match="not a number with a unit"):
            to_si(text, "Pa")


def test_of_very_many_problems_the_first_are_spelled_out_and_the_rest_is_counted() -> None:
    text = "\n".join(f"key{i}: 1" for i in range(500))
    with pytest.raises(ConfigError, match=r"and \d+ more problems") as caught:
        check(parse_yaml(text, "rig.yaml"), File)
    assert len(str(caught.value).splitlines()) == MOST_PROBLEMS + 1


def test_a_number_may_say_how_well_it_is_known(tmp_path: Path) -> None:
    text = paper_robot().read_text()
    (tmp_path / "robot.yaml").write_text(
        re.sub(r"(?m)^length: .*$", "length: 40 cm +- 2 mm", re.sub(r"(?m)^density: .*$", "density: 1300 ± 3 %", text))
        + "uncertainty: {tilt: 1 deg}\n"
    )
    robot = load(tmp_path / "robot.yaml", Robot)
    assert robot.length == pytest.approx(0.4) and robot.density == 1300.0
    assert robot.uncertainty.stated == pytest.approx({"length": 2e-3, "density": 0.03, "tilt": math.pi / 180})
    again = check(parse_yaml(robot_yaml(robot), "again"), Robot)
    assert again == robot
    (tmp_path / "robot.yaml").write_text(re.sub(r"(?m)^length: .*$", "length: 40 cm +- 2 kPa", text))
    with pytest.raises(ConfigError, match="length: '2 kPa' has the unit 'kPa'.*505 kPa \\+- 30 %"):
        load(tmp_path / "robot.yaml", Robot)


def test_a_bending_stiffness_may_say_how_well_it_is_known(tmp_path: Path) -> None:
    """In place of a modulus, whose uncertainty counts for the material that it replaces."""
    text = re.sub(r"(?m)^youngs_modulus: .*$", "youngs_modulus: 200 GPa +- 30 %", paper_robot().read_text())
    (tmp_path / "robot.yaml").write_text(f"bending_stiffness: 0.115 N m^2 +- 15 %\n{text}".replace("# shear", "#"))
    assert load(tmp_path / "robot.yaml", Robot).uncertainty.stated == pytest.approx({"youngs_modulus": 0.15})
