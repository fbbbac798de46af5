"""rig.yaml, robot.yaml and any file of settings: one message tells all that is wrong, and what is written reads back."""

import json
import math
import re
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
import yaml
from commands import Cli, refused, run_there
from diagnosed_case import campaign, folder
from pydantic import Field

from lab.files.checked import digest
from lab.files.config import ConfigError, check, load, parse_yaml
from lab.files.inputs import same_robot
from lab.files.rig_file import Limits, RigFile, Safe, load_rig
from lab.files.robot_file import paper_robot, robot_yaml
from lab.files.units import KINDS, UnitError, to_si, written
from lab.verbs.fakes import PATIENT, beyond, left_out, played, rig_yaml
from lab.verbs.init import OF
from lab.verbs.jog import known
from model.plain_yaml import MOST_PROBLEMS, FileTable
from model.robot import Robot, robot_from_dict
from sim_fakes.instrument import FakeRegulators
from sim_fakes.rig import FakeRig
from sim_fakes.virtual_robot import RobotTruth
from tests.drivers.test_contract import install
from tests.simulated.bench import raises


# ------------------------------------------------------------------ a first robot and a first rig
def test_a_few_numbers_make_a_robot_and_a_rig_that_are_read_and_are_not_replaced(tmp_path: Path, cli: Cli) -> None:
    robot, rig = tmp_path / "robot.yaml", tmp_path / "rig.yaml"
    words = ("init", "--chambers", 4, "--length", "180 mm", "--outer-radius", "9 mm",
             "--max-pressure", "80 kPa", "--out", robot, "--rig", rig)  # fmt: skip
    told = cli(*words, "--instruments", "pressure=smc_itv,mocap").out
    made, bench = load(robot, Robot), load(rig, RigFile)
    assert (made.length, made.chambers.path_radius, made.max_pressure) == (0.18, 0.0054, 80e3)
    assert made.actuators.azimuths_deg == (0, 90, 180, 270)
    assert "CHECK: guessed" in robot.read_text() and "lines marked CHECK" in told
    assert bench.instruments.pressure.chambers == ((1,), (2,), (3,), (4,)) and bench.instruments.arm is None  # type: ignore[union-attr]
    assert re.fullmatch(
        r"p2 20 kPa \| vent \| help \| q; numbers .* in Pa, pressures may be in Pa, .*kPa, bar, .*; Ctrl-C .*", known(bench)
    )
    assert "is there already" in cli(*words, code=2).err
    tendons = tmp_path / "tendons.yaml"
    refused = cli("init", "--tendons", 4, "--length", "30 cm", "--out", tendons, "--rig", tmp_path / "new.yaml", code=2).flat_err
    assert "a rig can only drive chambers: measure elsewhere and `lab import` the table" in refused and not tendons.exists()
    cli("init", "--tendons", 4, "--length", "30 cm", "--max-tension", "5 N", "--out", tendons)
    pulled = load(tendons, Robot)
    assert pulled.max_pressure == 50e3 and "max_tension: 5 N" in robot_yaml(pulled, tendons.read_text())
    assert same_robot(pulled, pulled.replace(max_tension=6.0)) and not same_robot(pulled, pulled.replace(length=0.2))
    text = tendons.read_text() + "effects:\n  pressure_offset:\n    offset: {value: 0.2, sd: 0.01, unit: N}\n"
    assert vars(robot_of(text).stated["pressure_offset.offset"]) == {"value": 2000.0, "sd": 100.0, "unit": "Pa"}
    wider = robot_of(text).replace(effects={"pressure_offset": {"offset": {"value": 2500.0, "sd": 100.0, "unit": "Pa"}}})
    assert robot_of(robot_yaml(wider, text)) == wider != robot_of(text) and robot_yaml(robot_of(text), text) == text
    for given, said in (
        (("--chambers", 3, "--length", "180"), r"did you mean 180 cm or 180 mm\?"),
        (("--chambers", 3, "--length", "5 N"), "^--length: .*5 N"),
        (("--chambers", 3, "--length", "9 cm", "--max-tension", "4 N"), "^--max-tension 4 N: is of tendons; .*--max-pressure"),
        (
            ("--tendons", 4, "--length", "9 cm", "--max-pressure", "4 bar"),
            "^--max-pressure 4 bar: is of chambers; .*--max-tension",
        ),
        (("--tendons", 4, "--length", "9 cm", "--chamber-radius", "4 mm"), "--chamber-radius 4 mm: is of chambers"),
        (("--chambers", 3, "--length", "9 cm", "--instruments", "mocap"), "--instruments mocap: needs --rig"),
        (("--chambers", 3, "--length", "9 cm", "--rig", tmp_path / "rig"), r"rig: must end in \.yaml: write .*rig\.yaml$"),
    ):
        assert re.search(said, cli("init", *given, "--out", tmp_path / "b.yaml", code=2).flat_err)


@pytest.mark.parametrize("instruments", ["pressure,mocap", "pressure=smc_itv", "pressure,arm=ur5,force=ft300s", "spine=tmcl"])
@pytest.mark.parametrize(("most", "error"), [(3, 5), (60, 7.2), (450, 54), (1900, 120)])
def test_a_first_rig_has_the_limits_of_its_robot_and_lines_of_its_instruments_alone(
    most: float, error: float, instruments: str, tmp_path: Path, cli: Cli
) -> None:
    cli("init", "--chambers", 3, "--length", "12 cm", "--max-pressure", f"{most} kPa", "--out", tmp_path / "robot.yaml",
        "--rig", path := tmp_path / "rig.yaml", "--instruments", instruments)  # fmt: skip
    text, rig = path.read_text(), load_rig(path)
    if (pressure := rig.instruments.pressure) is not None:
        highest = min(most, 1000) * 1e3
        limits = (pressure.max_pressure, rig.limits.max_total_pressure, rig.limits.pressure_error)
        assert limits == (highest, 3 * highest, error * 1e3) and pressure.full_scale >= highest
    lines = {"pressure": "pressure.*:|vented", "arm": "arm|stand:", "force": "force|moment", "spine": "spine",
             "valve": "vacuum|valve", "gauge": "vacuum|gauge", "mocap": "hidden"}  # fmt: skip
    for role in lines.keys() - {one.partition("=")[0] for one in instruments.split(",")}:
        assert not re.search(rf"(?:\b|_)(?:{lines[role]})", text.partition("\nclock:")[2]), role
    assert set(OF) < {*Limits.model_fields, *Safe.model_fields} and not re.search("see (below|above)|Copy this", text)


def test_a_first_rig_of_an_own_driver_has_the_keys_that_this_needs(tmp_path: Path) -> None:
    environment = install(tmp_path, paper_robot().parents[1] / "regulator")
    places = [["--rig", tmp_path / f"rig{n}.yaml", "--out", tmp_path / f"robot{n}.yaml"] for n in (2, 5)]
    asked = ["init", "--length", "12 cm", "--max-pressure", "10 psi", "--instruments", "pressure=bench_pr4", "--chambers"]
    made, refused = run_there([[*asked, n, *place] for n, place in zip((2, 5), places, strict=True)], environment)
    text = (tmp_path / "rig2.yaml").read_text()
    assert made.returncode == 0 and re.search(r"port: +/dev.*# yours", text) and "pressure: 10 psi" in text, made.both
    assert "chambers: [[1], [2]]" in text and "units:" not in text
    assert "chambers: has 5 entries, must have at most 4" in refused.err


def test_fakes_of_a_robot_without_a_spine_have_no_arm_unless_it_is_asked_for(tmp_path: Path) -> None:
    three = load(paper_robot().parents[1] / "three_chambers/robot.yaml", Robot)
    assert left_out(None, three) == {"spine", "arm", "force"}
    assert left_out(None, None) == set() and left_out("", three) == {"spine"}
    solid = three.replace(inner_radius=0.0)
    assert played(solid).inner_radius == 0
    fakes = FakeRig(truth=played(solid), without=left_out(None, solid))
    table, file = fakes.rig_file(), tmp_path / "robot.yaml"
    assert set(table["instruments"]) == {"pressure", "mocap"} and "stand" not in table
    for stated, said in (({}, ""), ({"tip_moment": (0, 0.1, 0)}, "; not simulated: tip_moment"), ({"thrust": "walls"}, "")):
        file.write_text(robot_yaml(solid.replace(**stated)))
        assert beyond(fakes, {}, file) == f"Beyond the model of robot.yaml: no effect{said}"
    whole = beyond(FakeRig(truth=RobotTruth(arm_errors=2)), {"base_tilt": 0.02}, None)
    assert whole.endswith(": base_tilt = 0.02 rad, errors of the arm's build (--arm-errors 2)")
    refused("--without arms: is no instrument; give some of arm, force", left_out, "arms", three)


# ------------------------------------------------------------------ settings
class Alpha(FileTable):
    driver: Literal["alpha"]
    max_pressure: float = Field(3e5, gt=0, le=1e6, json_schema_extra={"unit": "Pa"})


class Beta(FileTable):
    driver: Literal["beta"]
    ports: list[str]


class File(FileTable):
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
    return raises(ConfigError, None, read, tmp_path, text).splitlines()


def test_quantities_with_units_become_si(tmp_path: Path) -> None:
    text = "name: a\nlength: 40 cm\nlevels: [50 kPa, 0.1 MPa, 2e5]\ndevice: {driver: alpha, max_pressure: 2 bar}\n"
    file = read(tmp_path, f"{text}table: {{0.05: 318 kPa}}\n")
    assert file.table == {0.05: 318e3}
    assert file.length == pytest.approx(0.4)
    assert file.levels == pytest.approx([5e4, 1e5, 2e5])
    assert isinstance(file.device, Alpha) and file.device.max_pressure == pytest.approx(2e5)


def test_a_tension_in_place_of_a_pressure_is_refused_with_its_size_as_a_pressure(tmp_path: Path) -> None:
    (found,) = problems(tmp_path, "name: a\nlength: 40 cm\ndevice: {driver: alpha, max_pressure: 5 N}\n")
    assert "'5 N' has the unit 'N'" in found and "max_tension takes N" in found


def test_all_problems_of_a_file_come_at_once_with_their_lines(tmp_path: Path) -> None:
    found = problems(tmp_path, "name: a\nlenght: 0.4\nlevels: [50e3, 250]\ndevice:\n  driver: alpha\n  max_pressure: 2e6\n")
    assert len(found) == 4
    assert "file.yaml:2: lenght: unknown key; did you mean length?" in found[0]
    assert "file.yaml:3: levels[1] = 250 Pa: must be at least 1 kPa; did you mean 250 kPa?" in found[1]
    assert "file.yaml:6: device.max_pressure = 2 MPa: must be at most 1 MPa" in found[2]
    assert "length: is missing; give it in m" in found[3]


@pytest.mark.parametrize("value", [".nan", ".inf", "-0.1", "0", "abc", "[1]", "{}", "null"])
def test_a_number_that_is_none_is_refused_by_name(tmp_path: Path, value: str) -> None:
    (line,) = problems(tmp_path, f"name: a\nlength: {value}\n")
    assert "file.yaml:2: length" in line


@pytest.mark.parametrize("text", ["", "[]", "just text", "name: [unclosed", "a: &x 1\nb: *x\n", "\x00"])
def test_what_is_no_table_is_one_clear_error(tmp_path: Path, text: str) -> None:
    assert len(problems(tmp_path, text)) == 1


def test_a_quantity_of_a_million_characters_is_refused_at_once() -> None:
    # matching them would take a time that grows with the square of their number
    for text in ("1" * 10**6 + "\nx", "1 a" + " " * 10**6 + "b"):
        raises(UnitError, "not a number with a unit", to_si, text, "Pa")


def test_of_very_many_problems_the_first_are_spelled_out_and_the_rest_is_counted() -> None:
    text = "\n".join(f"key{i}: 1" for i in range(500))
    told = raises(ConfigError, r"and \d+ more problems", check, parse_yaml(text, "rig.yaml"), File)
    assert len(told.splitlines()) == MOST_PROBLEMS + 1


def test_a_number_may_say_how_well_it_is_known() -> None:
    text = stated = paper_robot().read_text()
    for key, value in {"length": "40 cm +- 2 mm", "density": "1300 ± 3 %", "tip_mass": "8 g +- 0.5 g"}.items():
        stated = re.sub(rf"(?m)^{key}: .*$", f"{key}: {value}", stated)
    stated = re.sub(r"(?m)^  path_radius: .*$", "  path_radius: 4 cm +- 1 %", stated)
    robot = robot_of(f"{stated}uncertainty: {{tilt: 1 deg, area_factor: 5 %, azimuths: 1 deg}}\n")
    assert robot.length == pytest.approx(0.4) and robot.density == 1300.0 and robot.actuators.path_radius == 0.04
    assert robot.uncertainty.stated == pytest.approx({
        "length": 2e-3, "density": 0.03, "tip_mass": 5e-4, "path_radius": 4e-4,
        "tilt": math.pi / 180, "area_factor": 0.05, "azimuths": math.pi / 180,
    })  # fmt: skip
    assert robot_of(robot_yaml(robot)) == robot
    pressed = re.sub(r"(?m)^length: .*$", "length: 40 cm +- 2 kPa", text)
    refused("length: '2 kPa' has the unit 'kPa'.*505 kPa \\+- 30 %", robot_of, pressed)
    wide = re.sub(r"(?m)^outer_radius: .*$", "outer_radius: 40 mm +- 2 %", text)
    refused(r"outer_radius: '40 mm \+- 2 %': \+- may follow length, .*bending_stiffness", robot_of, wide)


def test_a_bending_stiffness_may_say_how_well_it_is_known() -> None:
    text = re.sub(r"(?m)^youngs_modulus: .*$", "youngs_modulus: 200 GPa +- 30 %", paper_robot().read_text())
    robot = robot_of(f"bending_stiffness: 0.115 N m^2 +- 15 %\n{text}".replace("# shear", "#"))
    assert robot.uncertainty.stated == pytest.approx({"youngs_modulus": 0.15})


# ------------------------------------------------------------------ rig.yaml as `lab fakes` writes it
AWKWARD = {
    "limits": {"max_total_pressure": 1e6 / 3, "max_age_in_motion": 0.03, "max_force": 59.999, "max_vacuum": 94_999.999},
    "stand": {"standoff": 0.0073, "tool_rotation": [0.1, 1.5707963267948966, 1 / 3]},
}


def merged(table: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    both = {k: merged(table[k], v) for k, v in changes.items() if isinstance(v, dict) and k in table}
    return {**table, **changes, **both}


@pytest.mark.parametrize("changes", [{}, PATIENT, AWKWARD])
@pytest.mark.parametrize(
    "how",
    [
        {"regulators": FakeRegulators("alicat", 206.8e3, unit="psi"), "speed": 20.0},
        {"regulators": "smc_itv", "spine": "tmcl"},
        {"without": ("spine",)},
    ],
)
def test_the_rig_that_is_read_is_the_one_that_was_written(how: dict[str, Any], changes: dict[str, Any]) -> None:
    fakes = FakeRig(**how)
    if not fakes.rig_file()["instruments"].get("spine"):
        changes = {key: values for key, values in changes.items() if key != "instruments"}
    read = check(parse_yaml(rig_yaml(fakes, "robot.yaml", changes), "rig.yaml"), RigFile)
    asked = RigFile.model_validate(merged(fakes.rig_file(), changes))
    assert read == asked and digest(read) == digest(asked)


def test_every_number_whose_unit_is_known_has_it() -> None:
    text = rig_yaml(FakeRig(), "robot.yaml", AWKWARD)
    told = yaml.safe_load(text)
    assert told["instruments"]["pressure"]["full_scale"] == "400 kPa"
    assert told["stand"]["origin"] == ["50 cm", "0 cm", "70 cm"] and told["stand"]["standoff"] == "7.3 mm"
    assert told["stand"]["tool_rotation"] == ["0.1 rad", "1.5707963267948966 rad", "0.3333333333333333 rad"]
    assert told["limits"]["max_age_in_motion"] == "0.03 s" and told["limits"]["max_force"] == "59.999 N"
    assert re.findall(r"(\w+): -?\d+(?:\.\d+)?(?=[,}\n])", text) == ["speed"]


@pytest.mark.parametrize("unit", KINDS)
def test_what_is_written_reads_back_to_the_last_bit(unit: str) -> None:
    values = [0.0, 1 / 3, 0.07, 0.29, 1e-3 / 7, 123456.789, 2.5e5, 1e-12, -0.35, 6.02e23]
    for value in values:
        assert [to_si(text, unit) for text in written([value], unit)] == [value]
    assert [to_si(text, unit) for text in written(values, unit)] == values
    assert len({text.partition(" ")[2] for text in written(values, unit)}) == 1


# ------------------------------------------------------------------ robot.yaml, written from a given one
ARM = """\
# Arm 7, cast in March; z points down
---
name:   "arm 7"            # engraved on the base
length: 31.5 cm +- 2 mm    # tape, three readings
outer_radius:     4.0e-2
inner_radius: 20 mm
density: &rho 1080        # data sheet

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
markers: [10 cm, {arc_length: 0.2, offset: [15 mm, 0]}]
# Ask Noor before changing anything above
"""
EFFECTS = {"chamber_azimuth": {"angle": {"value": 0.071, "sd": 0.004, "unit": "rad"}}}
POSTERIOR = {"parameters": ["area_factor", "chamber_azimuth.angle"], "area_factor_sd": 0.01, "correlation": [[1.0], [0.25, 1.0]]}


def robot_of(text: str) -> Robot:
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


def test_a_marker_is_a_number_or_a_table() -> None:
    for wrong, says in (("true", "must be a number in m"), ("{arc_length: 1 cm}", "offset: is missing; give it in m")):
        refused(says, robot_of, ARM.replace("markers: [10 cm", f"markers: [{wrong}"))


def test_a_robot_that_did_not_change_is_written_as_it_was_given() -> None:
    for text in (ARM, ARM.replace("\n", "\r\n"), ARM.rstrip("\n"), "\ufeff" + ARM):
        assert robot_yaml(robot_of(text), text) == text


CHANGES: dict[str, tuple[dict[str, Any], list[str]]] = {
    "a number keeps its unit and what stands beside it": (
        {"length": 0.322, "tip_mass": 0.0123456789, "shear_modulus": 118500.0, "density": 1081.5, "inner_radius": 0.0205,
         "gravity": (0.0, 0.1, 9.81), "markers": (0.11, {"arc_length": 0.21, "offset": (0.016, 0.0)})},
        ["length: 32.2 cm +- 2 mm    # tape, three readings", "inner_radius: 20.5 mm", "density: &rho 1081.5        # data sheet",
         "shear_modulus: '118.5 kPa'", "tip_mass: 12.3456789 g", "    - 0.1                  # hangs",
         "markers: [11 cm, {arc_length: 0.21, offset: [16 mm, 0]}]"],
    ),
    "a table takes new lengths in its own order and unit": (
        {"area_factor": {0.0: 1.25, 0.1: 1.3, 0.2: 1.45}, "spine": {"radius": 0.019, "modulus": {0.05: 5e5, 0.1: 8e5, 0.2: 2e6}}},
        ["    0.0: 125 %             # ink", "    0.1: 130 %",
         "spine: {radius: 19 mm, modulus: {0.05: 500 kPa, 0.1: 800 kPa, 0.2: 2000000.0}}   # the old granules"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", CHANGES)
def test_what_changed_is_edited_where_it_stands(kind: str) -> None:
    values, written = CHANGES[kind]
    robot = changed(robot_of(ARM), **values)
    text = robot_yaml(robot, ARM)
    assert lines(ARM, text)[1] == written
    assert close(robot_of(text).model_dump(), robot.model_dump())


def test_si_numbers_read_back_to_the_last_bit() -> None:
    given = ARM.replace("radius: 4 mm", "radius: 0.004").replace("3 cm", "3e-2")
    chambers = robot_of(given).model_dump()["chambers"]
    chambers |= {"radius": [0.01 / 3, 0.004, 0.004], "path_radius": [0.1 / 3, 0.03, 0.031]}
    robot = changed(robot_of(given), outer_radius=0.13 / 3, youngs_modulus=1e6 / 3, chambers=chambers)
    text = robot_yaml(robot, given)
    assert robot_of(text) == robot and f"  radius: [{0.01 / 3}, 0.004, 0.004]" in text
    assert f"path_radius: [{0.1 / 3}, 0.03, 0.031]" in text and "# counted from the connector" in text


def test_a_table_that_becomes_a_number_stays_as_a_comment() -> None:
    robot = changed(robot_of(ARM), area_factor=1.31)
    text = robot_yaml(robot, ARM)
    assert lines(ARM, text)[1] == [
        "area_factor: 1.31",
        "# area_factor:               # from the cut, by spine length",
        "#     # Monday",
        "#     0.0: 120 %             # ink",
        "#     0.2: 1.45              # calliper",
    ]
    assert robot_of(text) == robot
    assert lines(text, robot_yaml(robot_of(ARM), text)) == (["area_factor: 1.31"], ["area_factor: {0.0: 1.2, 0.2: 1.45}"])


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
@pytest.mark.parametrize("end", ["", "last"])
def test_effects_come_and_go_and_the_rest_stays(newline: str, end: str) -> None:
    given = (ARM if end else ARM.rstrip("\n")).replace("\n", newline)
    robot = changed(robot_of(given), area_factor=1.31, effects=EFFECTS, posterior=POSTERIOR)
    known = robot_yaml(robot, given)
    assert robot_of(known) == robot and "null" not in known
    assert known.count("\n") == known.count(newline) and known.endswith(newline) == bool(end)
    assert f"    angle: {{value: 0.071, sd: 0.004, unit: rad}}{newline}posterior:{newline}" in known
    more = {**EFFECTS, "base_tilt": {"x": {"value": 0.01, "sd": 0.002, "unit": "rad"}}}
    wider = POSTERIOR | {
        "parameters": ["area_factor", "chamber_azimuth.angle", "base_tilt.x"],
        "correlation": [[1.0], [0.2, 1.0], [0.0, 0.1, 1.0]],
    }
    again = changed(robot, effects=more, posterior=wider)
    second = robot_yaml(again, known)
    assert robot_of(second) == again and f"  - [0.0, 0.1, 1.0]{newline}" in second
    plain = robot_yaml(again.plain, second)
    assert robot_of(plain) == again.plain
    for text in (known, second, plain):
        assert [comment for comment in ARM.split("#")[1:] if comment.splitlines()[0].strip() not in text] == []
    assert plain.splitlines() == robot_yaml(changed(robot_of(given), area_factor=1.31), given).splitlines()


def test_an_entry_with_a_comment_is_commented_out_and_one_without_is_removed() -> None:
    given = ARM + "uncertainty: {tilt: 1 deg}   # spirit level\nmax_pressure: 90 kPa\n"
    robot = changed(robot_of(given), uncertainty={"length": 2e-3, "frame_shift": 1e-3}, max_pressure=None)
    text = robot_yaml(robot, given)
    assert lines(given, text)[1] == ["uncertainty: {frame_shift: 0.001}   # spirit level"] and "max_pressure" not in text
    given = given.replace(" +- 2 mm ", "")
    bare = robot_yaml(changed(robot_of(given), uncertainty={}), given)
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
    robot = changed(robot_of(ARM), area_factor=1.31, effects=EFFECTS)
    text = robot_yaml(robot, given)
    assert robot_of(text) == robot and "null" not in text and "#" not in text
    assert "    angle: {value: 0.071, sd: 0.004, unit: rad}\n" in text


def test_parts_of_a_body_are_edited_where_they_stand() -> None:
    part = "sections:   # drawn 12 May\n- length: 20 cm      # stiff half\n  outer_radius: [4 cm, 35 mm]\n- {length: 0.115}\n"
    given = ARM + part
    sections = robot_of(given).model_dump()["sections"]
    robot = changed(robot_of(given), sections=[{**sections[0], "outer_radius": (0.04, 0.036)}, sections[1]])
    assert lines(given, robot_yaml(robot, given))[1] == ["  outer_radius: [4 cm, 36 mm]"]
    shorter = changed(robot_of(given), sections=[{**sections[0], "outer_radius": None}, sections[1]])
    assert robot_of(robot_yaml(shorter, given)) == shorter and "# tape, three readings" in robot_yaml(shorter, given)


def test_lab_fit_keeps_the_file_of_the_case_and_so_does_a_second_fit(tmp_path: Path, cli: Cli) -> None:
    case = folder(tmp_path / "case", campaign({}, repeats=1, lengths=(0.0, 0.15)))
    given = (case / "robot.yaml").read_text().replace("length: 0.40  ", "length: 40 cm")
    (case / "robot.yaml").write_text(given)
    comments = [line.partition("#")[2] for line in given.splitlines() if "#" in line]
    for out, more in (("plain", []), ("known", ["--with", "base_tilt", "--samples", "2"])):
        cli("fit", case, "--out", tmp_path / out, *more)
        text = (tmp_path / out / "robot.yaml").read_text()
        assert [c for c in comments if c not in text] == [] and "length: 40 cm" in text and "null" not in text
        assert [x for x in lines(given, text)[0] if not x.startswith("area_factor:")] == []
    sample = (tmp_path / "known" / "samples" / "robot-0001.yaml").read_text()
    assert [c for c in comments if c not in sample] == [] and "posterior" not in sample
    cli("fit", case, "--robot", tmp_path / "known" / "robot.yaml", "--out", tmp_path / "again")
    plain, refitted = (load(tmp_path / out / "robot.yaml", Robot).model_dump() for out in ("plain", "again"))
    assert close(plain, refitted, rel=1e-3)
    again = (tmp_path / "again" / "robot.yaml").read_text()
    assert [c for c in comments if c not in again] == [] and "effects" not in again
