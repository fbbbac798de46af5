"""`lab fit --with`, `lab predict` and the tables that verbs print: files, screens, exit codes, one number for each quantity."""

import csv
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest
from commands import Cli, refused

import lab
from diagnosis.diagnose import Options, diagnose
from lab.cli import main
from lab.files.inputs import read_case
from lab.files.robot_file import paper_robot, write_robot
from model.body import annulus_second_moment
from model.effects.catalogue import CATALOGUE
from model.effects.nominal import stated_effects
from recordings.table_file import write_csv
from tests.lab.diagnosed_case import campaign, folder

EFFECT = "chamber_azimuth"
THREE = Path(__file__).parents[2] / "examples/three_chambers/robot.yaml"


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a robot that states its thrust, so that no fit has to settle it first."""
    made = folder(tmp_path_factory.mktemp("case"), campaign({"chamber_azimuth.angle": 0.12}, repeats=2, lengths=(0.0, 0.2)))
    with (made / "robot.yaml").open("a", encoding="utf-8") as robot:
        robot.write("thrust: cap\n")
    return made


@pytest.fixture(scope="module")
def robot(case: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("fit")
    assert main(["fit", str(case), "--with", EFFECT, "--out", str(out), "--samples", "5", "--seed", "3"]) == 0
    return out / "robot.yaml"


def test_a_robot_and_robots_drawn_from_its_posterior_are_written(robot: Path) -> None:
    fitted = lab.load_robot(robot)
    angle = fitted.effects[EFFECT]["angle"]
    assert abs(angle.value - 0.12) < 4 * angle.sd and list(stated_effects(fitted)) == [EFFECT]
    rows = [*csv.DictReader((robot.parent / "samples" / "samples.csv").read_text().splitlines())]
    assert len(rows) == 5 and set(rows[0]) >= {"file", "area_factor", "chamber_azimuth.angle", "tilt.x"}
    drawn = lab.load_robot(robot.parent / "samples" / rows[0]["file"])
    assert drawn.posterior is None and drawn.area_factor == float(rows[0]["area_factor"])
    assert drawn.effects[EFFECT]["angle"].value == float(rows[0]["chamber_azimuth.angle"])
    values = np.array([float(r["chamber_azimuth.angle"]) for r in rows])
    assert len(set(values)) == 5 and np.abs(values - angle.value).max() < 4 * angle.sd


def test_compare_and_fit_know_the_robots_effects(case: Path, robot: Path, tmp_path: Path, cli: Cli) -> None:
    fitted = cli("fit", case, "--with", EFFECT, "--json").json
    assert fitted["in_sample"] and fitted["fitted_mm"] < fitted["calibrated_mm"]
    known, given = (cli("compare", case, *of, "--json").json for of in (("--robot", robot), ()))
    assert 1e3 * known["rmse"] == pytest.approx(fitted["fitted_mm"], rel=1e-3) and known["notes"] == []
    assert "mm rms, after a rough calibration by 0." in given["notes"][-1] and "lab diagnose" in given["notes"][-1]
    done = cli("fit", case, "--robot", robot, "--json")
    assert "--with chamber_azimuth" in done.flat_err and "area_factor" in done.out
    plain = cli("fit", case, "--out", tmp_path / "exact").flat
    missed = 1e3 * cli("compare", case, "--robot", tmp_path / "exact/robot.yaml", "--json").json["rmse"]
    calibrated, said = (float(plain.partition(f"misses the tip by {words}")[2].split()[0]) for words in ("", "up to "))
    assert calibrated < missed < said and "which --set-up --out FOLDER writes. Without it, robot.yaml takes" in plain
    assert cli("fit", case, "--set-up", "--json").json["calibrated_mm"] == pytest.approx(calibrated, abs=0.01)


def test_effects_that_are_named_one_by_one_are_all_fitted(case: Path, cli: Cli) -> None:
    assert cli("fit", case, "--with", "base_tilt", "--with", EFFECT, "--json").json["effects"] == [EFFECT, "base_tilt"]


def test_a_fit_says_where_the_diagnosis_of_its_case_disagrees(case: Path, tmp_path: Path, cli: Cli) -> None:
    copied = Path(shutil.copytree(case, tmp_path / "case"))
    few = {effect: CATALOGUE[effect] for effect in (EFFECT, "base_tilt")}
    found = diagnose(read_case([case]), Options(quantify=False, experiments=False, catalogue=few))
    (copied / "diagnosis.json").write_text(found.to_json())
    assert found.fitted is not None and found.fitted.effects == (EFFECT,)
    assert "diagnosis.json" not in cli("fit", copied, "--with", EFFECT).flat
    other = cli("fit", copied, "--with", "base_tilt").flat
    assert f"diagnosis.json names {EFFECT}, which leaves {found.fitted.left_mm:.2f} mm; with base_tilt" in other
    changed = replace(found, fitted=replace(found.fitted, left_mm=2 * found.fitted.left_mm))
    (copied / "diagnosis.json").write_text(changed.to_json())
    assert "has changed since. Diagnose the case again" in cli("fit", copied, "--with", EFFECT).flat


def test_what_the_model_still_misses_is_learnt_for_predictions(case: Path, tmp_path: Path, cli: Cli) -> None:
    fitted = cli("fit", case, "--residual", "--out", tmp_path, "--json").json
    assert fitted["effects"] == [] and fitted["residual_left_out_mm"] < 0.7 * fitted["calibrated_mm"]
    robot = lab.load_robot(tmp_path / "robot.yaml")
    assert robot.residual is not None and len(robot.residual.learnt) == fitted["states"] and robot.plain.residual is None
    assert 1e3 * cli("compare", case, "--robot", tmp_path / "robot.yaml", "--json").json["rmse"] < fitted["residual_left_out_mm"]
    few = Options(quantify=False, experiments=False, catalogue={"chamber_azimuth": CATALOGUE["chamber_azimuth"]})
    answer = diagnose(read_case([case], tmp_path / "robot.yaml"), few)
    assert "residual_ignored" in {f.code for f in answer.findings}
    assert "settings that it did not learn from" in cli("fit", case, "--with", EFFECT, "--residual").flat_out


def test_a_protocol_is_predicted_with_intervals(robot: Path, tmp_path: Path, cli: Cli) -> None:
    table, figure = tmp_path / "p.csv", tmp_path / "p.svg"
    settings = ["--set", "pressures=[80e3, 160e3]", "--set", "spine_lengths=[0.0, 0.2]"]
    said = cli("predict", "--robot", robot, "--protocol", "bending", *settings, "--out", table, "--figure", figure).out
    assert "p (chambers)" in said and "80.0 (" in said and "±" in said and figure.stat().st_size > 1000
    rows = [*csv.DictReader(table.read_text().splitlines())]
    assert [r["branch"] for r in rows] == ["load", "load", "load", "unload", "unload"] * 2
    assert [float(r["p1"]) for r in rows[:5]] == [0, 80e3, 160e3, 80e3, 0]
    assert all(float(r["x_low"]) < float(r["x"]) < float(r["x_high"]) for r in rows)


def test_a_table_is_predicted_as_from_python(case: Path, robot: Path, tmp_path: Path, cli: Cli) -> None:
    states = tmp_path / "states.csv"
    states.write_text("P1_bar,p2 (kPa),spine_length\n0.8,0,0.1\n0,60,0\n")
    found = cli("predict", "--robot", robot, "--table", states, "--json").json
    assert found["schema"] == "prediction/1" and found["effects"] == [EFFECT]
    tips = lab.predict(lab.load_robot(robot), [[80e3] + [0] * 8, [0, 60e3] + [0] * 7], [0.1, 0.0]).tip
    np.testing.assert_allclose([[s[k] for k in "xyz"] for s in found["states"]], tips, atol=1e-9)
    assert len(found["notes"]) == 1
    states.write_text("p1 [kPa],p2 [kPa],spine_length\n60,0.3,0\n")
    assert "60.0 (1) " in (said := cli("predict", "--robot", robot, "--table", states).flat) and "0.3 (2)" not in said
    states.write_text("p1 [kPa],spine_length\n240.5,0.2\n248,0.2\n")
    (beyond := tmp_path / "robot.yaml").write_text(robot.read_text().replace("tilt.x,", "gone.x,"))
    said, found = (cli("predict", "--robot", beyond, "--table", states, *more) for more in ((), ("--json",)))
    for note in (
        "1 of 2 states have pressures outside 0 to 240 kPa, to which robot.yaml was fitted: 248 kPa of chamber 1 in row 2",
        "robot.yaml: posterior: gone.x not stated in effects or tolerances, and ignored",
    ):
        assert f"note: {note}" in said.flat_err and sum(text.startswith(note) for text in found.json["notes"]) == 1
    compared = cli("compare", case, "--robot", beyond, "--json").json["notes"]
    fitted = cli("fit", case, "--robot", beyond, "--set-up", "--json").json["findings"]
    assert any("gone.x" in text for text in compared) and any("gone.x" in f["text"] for f in fitted if f["code"] == "as_read")


def test_pressures_for_wanted_tips(robot: Path, tmp_path: Path, cli: Cli) -> None:
    targets, table = tmp_path / "targets.csv", tmp_path / "p.csv"
    targets.write_text("x,y,z\n-0.05,0.01,\n1,0,0.2\n")
    words = ("predict", "--robot", robot, "--inverse", targets, "--groups", "9,1,2 3,4,5 6,7,8", "--spine-length", 0.1)
    done = cli(*words, "--out", table, "--figure", tmp_path / "p.png")
    assert "1 of 2 targets are out of reach" in done.out and "2 (" in done.out
    assert "1 of 2 states have pressures outside 0 to 240 kPa" in done.flat_err and "Warning" not in done.err
    first, second = csv.DictReader(table.read_text().splitlines())
    assert first["reached"] == "True" and second["reached"] == "False" and first["p9"] == first["p1"] == first["p2"]
    pressures = [float(first[f"p{c}"]) for c in range(1, 10)]
    np.testing.assert_allclose(lab.predict(lab.load_robot(robot), pressures, 0.1).tip[0, :2], [-0.05, 0.01], atol=1e-4)
    assert lab.inverse(lab.load_robot(robot), [[-0.05, 0.01, float("nan")]], 0.1).reached.all()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("fit", "CASE", "--with", "chamber_azimut"), "did you mean chamber_azimuth"),
        (("fit", "CASE", "--samples", "2"), "needs --with"),
        (("fit", "CASE", "--with", ""), "--with: names no effect; to fit area factor and tolerances alone give --set-up"),
        (("fit", "CASE", "--with", EFFECT, "--samples", "2"), "needs --out"),
        (("predict", "--robot", "ROBOT", "--table", "BAD"), " line 3, p1: 'x' is not a number"),
        (("predict", "--robot", "ROBOT", "--table", "NONE"), "has no column that is known here"),
        (("predict", "--robot", "ROBOT", "--protocol", "stiffness"), "inflates no chamber"),
        (("predict", "--robot", "ROBOT", "--inverse", "NONE"), "has no column"),
        (("predict", "--robot", "ROBOT", "--inverse", "GOOD", "--figure", "x.txt"), "must end in"),
        (("predict", "--robot", "UNKNOWN", "--inverse", "GOOD"), "effects.chamber_azimut: is not known"),
        (("predict", "--robot", "ROBOT", "--table", "KPA"), "p1: the highest pressure is 30 Pa, which looks like another unit"),
    ],
)
def test_what_cannot_be_used_is_refused_with_exit_code_2(
    words: tuple[str, ...], told: str, case: Path, tmp_path: Path, cli: Cli
) -> None:
    files: dict[str, Any] = {"CASE": case, "ROBOT": paper_robot()}
    texts = {"BAD": "p1\n0\nx\n", "NONE": "a,b\n1,2\n", "GOOD": "x\n-0.01\n", "KPA": "p1\n30\n"}
    texts["UNKNOWN"] = paper_robot().read_text() + "effects: {chamber_azimut: {angle: {value: 0.1, unit: rad}}}\n"
    for name, text in texts.items():
        files[name] = tmp_path / name
        files[name].write_text(text)
    assert told in cli(*(files.get(w, w) for w in words), code=2).flat_err


def test_a_robot_without_uncertainty_gets_no_interval(tmp_path: Path, cli: Cli) -> None:
    table = tmp_path / "states.csv"
    table.write_text("p1,p2,p3\n30000,0,0\n90000,0,0\n")
    said = cli("predict", "--robot", THREE, "--table", table)
    rows = [[cell.strip() for cell in line.split("│")[1:4]] for line in said.out.splitlines() if line.startswith("│")]
    assert "p3" in said.out and rows == [["30.0", "0.0", "0.0"], ["90.0", "0.0", "0.0"]]
    assert "±" not in said.out and "no interval: robot.yaml is not fitted" in " ".join(said.out.split())
    assert "outside 0 to 80 kPa, the limits of three-chamber robot: 90 kPa of chamber 1 in row 2" in said.flat_err
    assert "Warning" not in said.err
    found = cli("predict", "--robot", THREE, "--table", table, "--json").json
    assert found["interval"] is None and found["states"][0]["x_low"] is None and found["states"][0]["x"] < 0


# ------------------------------------------------------------------ tables: names in full, one number for each quantity


def test_fit_gives_one_area_factor_for_all_lengths(small_case: Path, tmp_path: Path, cli: Cli) -> None:
    told, again = (cli("fit", small_case, "--out", tmp_path).out for _ in range(2))
    assert told.replace("written: ", "replaced: ") == again != told
    found = cli("fit", small_case, "--json").json["area_factor"]
    (row,) = [line for line in told.splitlines() if "factor, tolerances" in line]
    assert f"{found['value']:.3f} ± {found['standard_error']:.3f}" in row
    assert f"{lab.fit(lab.case(small_case)).area_factor.value:.3f}" in row  # type: ignore[union-attr]
    assert len(re.findall(r"\d\.\d+ ± ", told)) == 3  # two lengths and all
    rows = (small_case / "trials.csv").read_text().count("\n") - 1
    counts = [int(line.split("│")[4]) for line in told.splitlines() if "area factor, " in line]
    assert counts[-1] == rows == sum(counts[:-1])


@pytest.mark.parametrize(("kind", "said"), [("chambers", "chamber 2 pushes 30 ± 1 % less"), ("tendons", "tendon 2 pulls 30 ±")])
def test_a_fit_states_what_each_actuator_does_and_which_parameter_is_at_its_bound(
    kind: str, said: str, tmp_path: Path, cli: Cli
) -> None:
    four = {"path_radius": 0.0125, "azimuths_deg": [0, 90, 180, 270]} | ({"radius": 0.004} if kind == "chambers" else {})
    stated = {"thrust": "cap"} if kind == "chambers" else {}
    robot, rng = lab.load_robot(THREE).replace(**{"chambers": None, kind: four, **stated}), np.random.default_rng(10)
    shares = [np.eye(4)[k % 4] + 0.25 * (k > 7) * np.eye(4)[(k + 1) % 4] for k in range(12)]
    pressures = np.concatenate([np.outer([0, 20e3, 40e3, 60e3, 80e3], share) for share in shares])
    tip = robot.predict(pressures * [1, 0.7, 1, 1]).tip + rng.normal(0, 1e-4, (60, 3))
    frame = pandas.DataFrame(pressures, columns=["p1", "p2", "p3", "p4"]).assign(x=tip[:, 0], y=tip[:, 1], z=tip[:, 2])
    case = lab.case(frame.assign(protocol="bending", t=20.0 * np.arange(60), trial=np.repeat(np.arange(1, 13), 5)), robot)
    fitted, word = lab.fit(case, "chamber_gain"), said.split()[0]
    table = fitted.to_frame().set_index("parameter")
    single, weak = table.loc["chamber_gain.single"], table.loc[f"chamber_gain of {word} 2"]
    assert weak["value"] == pytest.approx(0.7 / 0.925, abs=3 * weak["sd"]) and 1e-4 < weak["sd"] < 0.01
    assert single["note"] == "not determined, at its bound" and single["low 95 %"] == -1.5 < single["high 95 %"] < -0.9
    assert said in repr(fitted) and single["note"] in repr(fitted) and single["note"] in fitted._repr_html_()
    write_csv(case.table, tmp_path / "trials.csv")
    write_robot(robot, tmp_path / "robot.yaml")
    told = cli("fit", tmp_path, "--with", "chamber_gain").out
    assert said.capitalize() in told and re.search(rf"{word} 2 +│ 0.7\d+ ± .* times the mean", told)
    assert re.search("single +│ not determined, at its bound", told)
    found = cli("fit", tmp_path, "--with", "chamber_gain", "--json").json
    assert {"determined": False, "bound": "low"}.items() <= found["parameters"]["chamber_gain.single"].items()
    assert found["by_actuator"][0]["factor"][1] == pytest.approx(weak["value"], rel=1e-3)


def test_compare_tabulates_a_recorded_elongation(tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    robot = lab.load_robot(paper_robot())
    pressures, spine = np.tile(np.repeat([[0.0], [60e3]], 9, axis=1), (2, 1)), np.repeat([0.0, 0.1], 2)
    z = robot.predict(pressures, spine).tip[:, 2] + [0, 1e-3, 0, 2e-3]
    frame = pandas.DataFrame(pressures, columns=[f"p{c}" for c in range(1, 10)])
    case = lab.case(frame.assign(protocol="elongation", t=60.0 * np.arange(4), spine_length=spine, x=0.0, y=0.0, z=z), robot)
    found = lab.compare(case).elongation
    assert [(length, p) for length, p, *_ in found] == [(0.0, 60e3), (0.1, 60e3)]
    assert [1e3 * (measured - model) for *_, measured, model in found] == pytest.approx([1, 2])
    write_csv(case.table, tmp_path / "trials.csv")
    shutil.copy(paper_robot(), tmp_path / "robot.yaml")
    monkeypatch.chdir(tmp_path)
    told = cli("compare", ".").out
    assert "Elongation from the lowest pressure" in told and re.search(r"states\W+x\W+y\W+z\W+rms", told)
    assert re.search(r"in x, .* in y, .* in z", " ".join(told.split()))


def test_a_moment_at_the_tip_bends_a_weightless_body_into_an_arc() -> None:
    robot, moment = lab.load_robot(THREE).replace(gravity=(0.0, 0.0, 0.0), tip_mass=0.0), 0.01
    curvature = moment / (robot.youngs_modulus * annulus_second_moment(robot.outer_radius, robot.inner_radius))
    arc = np.array([1 - np.cos(curvature * robot.length), 0.0, np.sin(curvature * robot.length)]) / curvature
    assert robot.replace(tip_moment=(0.0, moment, 0.0)).predict([0.0, 0.0, 0.0]).tip[0] == pytest.approx(arc, abs=1e-6)
    rows = pandas.DataFrame({"t": [0.0, 9.0], "tip_moment_y": [0.0, moment], "x": 0.0, "y": 0.0, "z": 0.15})
    found = lab.compare(lab.case(rows.assign(p1=0.0, p2=0.0, p3=0.0), robot))
    assert found.predicted == pytest.approx(np.array([[0.0, 0.0, robot.length], arc]), abs=1e-6)


def test_power_names_causes_in_full_and_says_what_it_does(small_case: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    longest = {effect: CATALOGUE[effect] for effect in sorted(CATALOGUE, key=len)[-5:]}
    monkeypatch.setattr("lab.files.own_effects.CATALOGUE", longest)
    words = ("--set", "pressures=[120 kPa]", "--worlds", 2, "--no-additions")
    told = cli("power", "--protocol", "bending", "--robot", small_case / "robot.yaml", *words).out
    assert all(effect in told for effect in longest) and "…" not in told and "tip moved /" in told
    assert told.index("clean: 2 worlds of each") < told.index("cluttered: 2 worlds of each") < told.index("How often")


def test_the_effects_of_the_fakes_are_a_table(cli: Cli) -> None:
    told = cli("fakes", "--list-effects").out
    assert "plausible size" in told and re.search(r"spine_slip\W+0\.15 N m\W", told)
    (row,) = [line for line in told.splitlines() if "vacuum_leak" in line]
    assert row.split("│")[2].strip() == "0.3"


def test_what_is_no_case_is_refused_with_the_way_to_one(tmp_path: Path) -> None:
    refused(r"has no trials\.csv", lab.case, tmp_path)
    (tmp_path / "table.csv").write_text("p1,x\n0,1\n")
    refused(r"make a case of it, beginning with: lab import .*table\.csv --guess", lab.case, tmp_path / "table.csv")
    (tmp_path / "my case").mkdir()
    for name in ("robot.yaml", "trials.csv"):
        (tmp_path / "my case" / name).touch()
    for name in ("robot.yaml", "trials.csv"):
        refused(r"is part of a case; give its folder: .*my case$", lab.case, tmp_path / "my case" / name)
    (tmp_path / "robot.yaml").touch()
    refused("a robot.yaml goes with --robot", lab.case, tmp_path / "robot.yaml")
    (tmp_path / "one.mcap").touch()
    refused("is a folder of recordings, not a case folder", lab.case, tmp_path)
