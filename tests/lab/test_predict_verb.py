"""`lab fit --with` and `lab predict`: files, screens, exit codes."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lab
from lab.cli import main
from lab.files.example import paper_robot
from model.effects.nominal import stated_effects
from tests.lab.diagnosed_case import ROBOT, campaign, folder

EFFECT = "chamber_azimuth"
THREE = Path(__file__).parents[2] / "examples/three_chambers/robot.yaml"


def run(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str, str]:
    code = main([str(w) for w in words])
    said = capsys.readouterr()
    return code, said.out, said.err


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return folder(tmp_path_factory.mktemp("case"), campaign({"chamber_azimuth.angle": 0.12}, repeats=2, lengths=(0.0, 0.2)))


@pytest.fixture(scope="module")
def robot(case: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("fit")
    assert main(["fit", str(case), "--with", EFFECT, "--out", str(out), "--samples", "5", "--seed", "3"]) == 0
    return out / "robot.yaml"


def test_a_robot_and_robots_drawn_from_its_posterior_are_written(robot: Path) -> None:
    fitted = lab.load_robot(robot)
    angle = fitted.effects[EFFECT]["angle"]
    assert abs(angle.value - 0.12) < 4 * angle.sd and list(stated_effects(fitted)) == [EFFECT]
    with (robot.parent / "samples" / "samples.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 5 and set(rows[0]) >= {"file", "area_factor", "chamber_azimuth.angle", "tilt.x"}
    drawn = lab.load_robot(robot.parent / "samples" / rows[0]["file"])
    assert drawn.posterior is None and drawn.area_factor == float(rows[0]["area_factor"])
    assert drawn.effects[EFFECT]["angle"].value == float(rows[0]["chamber_azimuth.angle"])
    values = np.array([float(r["chamber_azimuth.angle"]) for r in rows])
    assert len(set(values)) == 5 and np.abs(values - angle.value).max() < 4 * angle.sd


def test_compare_and_fit_know_the_robots_effects(case: Path, robot: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, said, _ = run(capsys, "fit", case, "--with", EFFECT, "--json")
    fitted = json.loads(said)
    assert code == 0 and fitted["in_sample"] and fitted["fitted_mm"] < fitted["calibrated_mm"]
    code, said, _ = run(capsys, "compare", case, "--robot", robot, "--json")
    assert code == 0 and 1e3 * json.loads(said)["rmse"] == pytest.approx(fitted["fitted_mm"], rel=1e-3)
    code, said, told = run(capsys, "fit", case, "--robot", robot, "--json")
    assert code == 0 and "--with chamber_azimuth" in " ".join(told.split()) and "area_factor" in said


def test_what_the_model_still_misses_is_learnt_for_predictions(
    case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, said, _ = run(capsys, "fit", case, "--residual", "--out", tmp_path, "--json")
    fitted = json.loads(said)
    assert code == 0 and fitted["effects"] == [] and fitted["residual_left_out_mm"] < 0.5 * fitted["calibrated_mm"]
    robot = lab.load_robot(tmp_path / "robot.yaml")
    assert robot.residual is not None and len(robot.residual.states) == fitted["states"] and robot.plain.residual is None
    code, said, _ = run(capsys, "compare", case, "--robot", tmp_path / "robot.yaml", "--json")
    assert code == 0 and 1e3 * json.loads(said)["rmse"] < fitted["residual_left_out_mm"]
    code, _, told = run(capsys, "diagnose", case, "--robot", tmp_path / "robot.yaml", "--holdout", tmp_path / "none")
    assert code == 2 and "would hide one" in " ".join(told.split())
    code, said, _ = run(capsys, "fit", case, "--with", EFFECT, "--residual")
    assert code == 0 and "each trial that it did not learn from" in " ".join(said.split())


def test_a_protocol_is_predicted_with_intervals(robot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table, figure = tmp_path / "p.csv", tmp_path / "p.svg"
    settings = ["--set", "pressures=[80e3, 160e3]", "--set", "spine_lengths=[0.0, 0.2]"]
    code, said, _ = run(
        capsys, "predict", "--robot", robot, "--protocol", "bending", *settings, "--out", table, "--figure", figure
    )
    assert code == 0 and "p (chambers)" in said and "80.0 (" in said and "±" in said and figure.stat().st_size > 1000
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [r["branch"] for r in rows] == ["load", "load", "load", "unload", "unload"] * 2
    assert [float(r["p1"]) for r in rows[:5]] == [0, 80e3, 160e3, 80e3, 0]
    assert all(float(r["x_low"]) < float(r["x"]) < float(r["x_high"]) for r in rows)


def test_a_table_is_predicted_as_from_python(robot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    states = tmp_path / "states.csv"
    states.write_text("p1,p2,spine_length\n80e3,0,0.1\n0,60e3,0\n")
    code, said, _ = run(capsys, "predict", "--robot", robot, "--table", states, "--json")
    found = json.loads(said)
    assert code == 0 and found["schema"] == "prediction/1" and found["effects"] == [EFFECT]
    tips = lab.predict(lab.load_robot(robot), [[80e3] + [0] * 8, [0, 60e3] + [0] * 7], [0.1, 0.0])
    np.testing.assert_allclose([[s[k] for k in "xyz"] for s in found["states"]], tips, atol=1e-9)


def test_pressures_for_wanted_tips(robot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    targets, table = tmp_path / "targets.csv", tmp_path / "p.csv"
    targets.write_text("x,y,z\n-0.05,0.01,\n1,0,0.2\n")
    words = ("predict", "--robot", robot, "--inverse", targets, "--groups", "9,1,2 3,4,5 6,7,8", "--spine-length", 0.1)
    code, said, _ = run(capsys, *words, "--out", table, "--figure", tmp_path / "p.png")
    assert code == 0 and "1 of 2 targets cannot be reached" in said and "2 (" in said
    with table.open(newline="") as file:
        first, second = csv.DictReader(file)
    assert first["reached"] == "True" and second["reached"] == "False" and first["p9"] == first["p1"] == first["p2"]
    pressures = [float(first[f"p{c}"]) for c in range(1, 10)]
    np.testing.assert_allclose(lab.predict(lab.load_robot(robot), pressures, 0.1)[0, :2], [-0.05, 0.01], atol=1e-4)
    assert lab.inverse(lab.load_robot(robot), [[-0.05, 0.01, float("nan")]], 0.1).reached.all()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("fit", "CASE", "--with", "chamber_azimut"), "did you mean chamber_azimuth"),
        (("fit", "CASE", "--samples", "2"), "needs --with"),
        (("fit", "CASE", "--with", EFFECT, "--samples", "2"), "needs --out"),
        (("predict", "--robot", "ROBOT", "--table", "BAD"), ":3: p1 = 'x' is not a finite number"),
        (("predict", "--robot", "ROBOT", "--table", "NONE"), "has no column that is known here"),
        (("predict", "--robot", "ROBOT", "--protocol", "stiffness"), "inflates no chamber"),
        (("predict", "--robot", "ROBOT", "--inverse", "NONE", "--max-pressure", "1e6"), "has no column"),
        (("predict", "--robot", "ROBOT", "--inverse", "GOOD", "--max-pressure", "1e6"), "must not exceed robot.yaml's"),
        (("predict", "--robot", "ROBOT", "--inverse", "GOOD", "--figure", "x.txt"), "must end in"),
        (("predict", "--robot", "UNKNOWN", "--inverse", "GOOD"), "effects.chamber_azimut: is not known"),
    ],
)
def test_what_cannot_be_used_is_refused_with_exit_code_2(
    words: tuple[str, ...], told: str, case: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files: dict[str, Any] = {"CASE": case, "ROBOT": paper_robot()}
    texts = {"BAD": "p1\n0\nx\n", "NONE": "a,b\n1,2\n", "GOOD": "x\n-0.01\n"}
    texts["UNKNOWN"] = paper_robot().read_text() + "effects: {chamber_azimut: {angle: {value: 0.1, unit: rad}}}\n"
    for name, text in texts.items():
        files[name] = tmp_path / name
        files[name].write_text(text)
    code, _, said = run(capsys, *(files.get(w, w) for w in words))
    assert code == 2 and told in " ".join(said.split())


def test_the_schema_of_robot_yaml_has_effects(capsys: pytest.CaptureFixture[str]) -> None:
    code, said, _ = run(capsys, "schema", "robot")
    schema = json.loads(said)
    assert code == 0 and {"effects", "tolerances", "posterior"} <= set(schema["properties"])
    assert {"Stated", "Posterior", "Noise"} <= set(schema["$defs"]) and ROBOT.plain == ROBOT


def test_a_robot_without_uncertainty_gets_no_interval(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = tmp_path / "states.csv"
    table.write_text("p1,p2,p3\n30000,0,0\n90000,0,0\n")
    assert main(["predict", "--robot", str(THREE), "--table", str(table)]) == 0
    said = capsys.readouterr()
    assert "±" not in said.out and "no interval: robot.yaml states no uncertainty" in " ".join(said.out.split())
    assert "up to 90 kPa are asked for, robot.yaml allows 80 kPa" in " ".join(said.err.split()) and "Warning" not in said.err
    assert main(["predict", "--robot", str(THREE), "--table", str(table), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["interval"] is None and found["states"][0]["x_low"] is None and found["states"][0]["x"] < 0


@pytest.mark.parametrize(
    ("option", "text", "says"),
    [
        (
            "--table",
            "p1,p2,p3\n30,0,0\n",
            "column p1: the highest pressure is 30 Pa, which looks like another unit; write Pa",
        ),
        (
            "--inverse",
            "x,y,z\n-10,,\n",
            "a target is 10 m from the base of a robot of 0.15 m, which looks like mm or cm",
        ),
    ],
)
def test_a_table_in_other_units_is_refused(
    option: str, text: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / "table.csv"
    table.write_text(text)
    assert main(["predict", "--robot", str(THREE), option, str(table)]) == 2
    assert says in " ".join(capsys.readouterr().err.split())
