"""`lab.case(frame, robot)`: a pandas DataFrame as a case, as `lab import` reads the same table from a file."""

import itertools
import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from commands import Cli, refused
from foreign import ROBOT, by_map
from scipy.spatial.transform import Rotation

import lab
from benchmarks.faults.foreign_tables import HEADINGS, sweep, text
from diagnosis.answer.experiments import candidate_experiments
from diagnosis.data.case import states
from diagnosis.diagnose import Options, diagnose
from diagnosis.edits.search import edit_first
from lab.files.config import ConfigError
from lab.files.robot_file import write_robot
from lab.verbs.fit import drawn
from model.effects import CATALOGUE
from model.stated import Stated
from recordings.table_file import write_csv
from recordings.trials import AXES

COLUMNS = dict(zip(("t", "p1", "p2", "p3", "x", "y", "z"), HEADINGS, strict=True))


def frame(turn: float = 0.005) -> pd.DataFrame:
    return pd.DataFrame([[float(f"{v:.3f}") for v in row] for row in sweep(40, turn=turn)], columns=list(HEADINGS))


FRAME = frame()
KEYS: dict[str, Any] = {"states": {"plateaus": {"steady": 1000.0}}, "trials": {"begin": "rest"}}


def test_a_frame_is_the_case_that_lab_import_makes_of_its_file(tmp_path: Path) -> None:
    file = tmp_path / "table.csv"
    file.write_text(text(sweep(40)))
    made = by_map(file, columns={name: {"column": heading} for name, heading in COLUMNS.items()}, **KEYS)
    case = lab.case(FRAME, ROBOT, columns=COLUMNS, **KEYS)
    assert case.table == made.table and len(case.table) > 20
    turned = FRAME.assign(qw=1.0, qx=0.0, qy=0.0, qz=0.0)
    assert any("qw, qx, qy, qz were taken" in w for w in lab.case(turned, ROBOT, columns=COLUMNS, **KEYS).table.warnings)
    assert "three-chamber robot" in case.robot_text and case == lab.case(FRAME, case.robot, columns=COLUMNS, **KEYS)


@pytest.mark.parametrize(
    ("change", "columns"),
    [
        (lambda f: f, {"p1": "P1 [kPa]"}),
        (lambda f: f.rename(columns={"P1 [kPa]": "left"}), {"p1": "left [kPa]"}),
        (lambda f: f.assign(left=f["P1 [kPa]"] / 100), {"p1": "left [bar]"}),
        (lambda f: f.assign(left=f["P1 [kPa]"] / 100), {"p1": {"column": "left", "unit": "bar"}}),
        (lambda f: f.assign(left=f["P1 [kPa]"]), {"p1": {"column": "left", "unit": "Kilopascal"}}),
        (lambda f: f.assign(p1=f["P1 [kPa]"] * 1e3), {}),
        (lambda f: f.assign(**{"p1 [kPa]": f["P1 [kPa]"]}), {}),
        (lambda f: f.assign(left=f["P1 [kPa]"].map("{:.3f}".format).str.replace(".", ",")), {"p1": "left [kPa]"}),
        (lambda f: f.set_index("Time [s]"), {"p1": "P1 [kPa]"}),
    ],
)
def test_units_come_from_headings_from_the_call_or_are_si(change: Callable[[Any], Any], columns: dict[str, Any]) -> None:
    others = {name: heading for name, heading in COLUMNS.items() if name != "p1"}
    case = lab.case(change(FRAME), ROBOT, columns=others | columns, **KEYS)
    assert case.table["p1"] == pytest.approx(lab.case(FRAME, ROBOT, columns=COLUMNS, **KEYS).table["p1"], abs=1e-6)


def test_the_table_of_a_case_comes_back_from_pandas_as_it_went(small_case: Path) -> None:
    case = lab.case(small_case)
    frame = case.table.to_frame()
    assert lab.case(frame, case.robot).table == case.table
    frame["P_left"] = frame.pop("p1") / 1e5
    assert lab.case(small_case, robot=case.robot.replace(tip_mass=0.5)).robot.tip_mass == 0.5
    left = lab.case(frame, case.robot, columns={"p1": "P_left [bar]"}).table
    assert left["p1"] == pytest.approx(case.table["p1"], abs=1e-6) and left == case.table.replaced({"p1": left["p1"]})
    frame["p1"] = case.table["p1"]
    bare = lab.case(frame.drop(columns=["step", "repeat", "branch"]), case.robot).table
    assert all((bare[name] == case.table[name]).all() for name in ("trial", "step", "p1", "x", "z"))


def test_rows_that_lack_a_value_are_left_out_and_named(small_case: Path) -> None:
    case = lab.case(small_case)
    frame = case.table.to_frame()
    frame.loc[[3, 5], "p1"], frame.loc[7, ["x", "y", "z"]] = pd.NA, np.nan
    kept = lab.case(frame, case.robot).table
    assert len(kept) == len(case.table) - 2 and "2 of 14 rows are left out, first index 3: no value for p1" in kept.warnings[0]
    assert kept.unread.sum() == 1 and "1 of 12 states have no tip" in kept.warnings[-1]
    with pytest.warns(match=r"2 of 14 rows have no pressure \(first: index 3\)") as told:
        mapped = lab.case(frame.drop(columns="step"), case.robot, columns={"p1": "p1"}).table
    assert len(mapped) == kept.with_tip.sum() and {Path(w.filename) for w in told} == {Path(__file__)}


@pytest.mark.parametrize(
    ("change", "columns", "match"),
    [
        (lambda f: f, {"p1": "P_left"}, r"DataFrame: columns.p1 = 'P_left': no such column; there are .*'P1 \[kPa\]'"),
        (lambda f: f, {"q1": "P1 [kPa]"}, "lab.case: columns.q1: is no column of trials.csv"),
        (lambda f: f.rename(columns={"P1 [kPa]": "P1"}), {"p1": "P1 [foo]"}, "columns.p1.unit = 'foo': p1 needs one of Pa"),
        (lambda f: f.astype({"P1 [kPa]": object}).replace({"P1 [kPa]": {0.0: "zero"}}), {}, "index 0.*'zero' is not a number"),
        (lambda f: f[[]], {}, "no column can be read"),
        (lambda f: f, ["P1 [kPa]"], "lab.case: columns: write columns of trials.csv and their headings"),
    ],
)
def test_a_wrong_column_is_named_with_place_and_remedy(change: Callable[[Any], Any], columns: Any, match: str) -> None:
    refused(match, lab.case, change(FRAME), ROBOT, columns=COLUMNS | columns if isinstance(columns, dict) else columns)


@pytest.mark.parametrize("wrong", [{}, {"states": {"plateaus": {"steady": 1000.0}}},
                                   pytest.param({"frame": {"x": "x", "y": "z", "z": "-y"}}, marks=pytest.mark.long)])  # fmt: skip
def test_a_unit_that_is_missing_is_named_first_with_what_to_write(wrong: dict[str, Any]) -> None:
    # one state, which no rod reaches, is refused; one that a rod may reach is asked about
    bare = frame(0.013 if "states" in wrong else 0.005).rename(columns={f"P{k} [kPa]": f"left {k}" for k in (1, 2, 3)})
    columns = COLUMNS | {f"p{k}": f"left {k}" for k in (1, 2, 3)}
    said = refused(None, lab.case, bare, ROBOT, columns=columns, **wrong)
    first = said.splitlines()[0]
    assert "the pressures must be 1000 times as large" in first or "nothing says the unit of the pressures" in first
    line = re.search("write columns=({.*?}) in lab.case", first)
    if line is not None:
        assert lab.case(bare, ROBOT, columns=columns | json.loads(line[1])) == lab.case(FRAME, ROBOT, columns=COLUMNS)
    assert ("no pressure stands" not in said) and (line is not None or "states" in wrong)


def test_values_that_cannot_be_right_are_refused_as_those_of_a_file(small_case: Path) -> None:
    case = lab.case(small_case)
    frame = case.table.to_frame()
    for column, value, match in (("p1", 1e9, "index 0, p1: 1e.09 Pa is outside"), ("trial", 1.5, "is not a whole number"),
                                 ("branch", "up", "index 0.*says 'up'"), ("x", 0.38e3, "380 m exceeds 5 m")):  # fmt: skip
        refused(match, lab.case, frame.astype({column: object}).assign(**{column: value}), case.robot)


def test_what_is_neither_a_frame_nor_a_path_is_told(small_case: Path) -> None:
    for inputs, keys, match in (((FRAME,), {}, "needs one robot, 0 are given"), ((3,), {}, "int is neither the path"),
                                ((), {}, "nothing is given"),
                                ((FRAME, ROBOT), {"columns": COLUMNS, "source": {"missing": 3}}, "source.missing"),
                                ((small_case,), {"columns": COLUMNS, "foo": 1}, "columns, foo: only with a DataFrame"),
                                ((FRAME, ROBOT), {"foo": 1}, "foo: unknown key; known keys: robot, "),
                                ((FRAME, ROBOT), {"Robt": 1}, "Robt: unknown key; did you mean robot?"),
                                ((FRAME, ROBOT), {"files": {"*": {}}}, "files: does not apply")):  # fmt: skip
        refused(match, lab.case, *inputs, **keys)
    for verb, given in itertools.product((lab.diagnose, lab.fit, lab.compare), ("case1", FRAME)):
        with pytest.raises(TypeError, match=f"lab.{verb.__name__}: takes a case, not a .*; write .*lab.case"):
            verb(given)  # type: ignore[operator]


# ------------------------------------------------------------------ what a call leaves out
FINGER = ROBOT.parents[1] / "own_table" / "robot.yaml"
RISING = ("-x", "-z", "-y")
"""Axes of the cameras along x, y and z of the base."""


def seen(effect: str, axis: str, value: float, unit: str, axes: Sequence[str] = RISING, groups: int = 6) -> pd.DataFrame:
    """Three sweeps of the finger with an effect, by cameras with these axes that stand 0.4 m aside."""
    finger, dice = lab.load_robot(FINGER), np.random.default_rng(3)
    inflated = ((1,), (2,), (3,), (1, 2), (2, 3), (3, 1))[:groups]
    pressures = [[2e4 * k if c in group else 0.0 for c in (1, 2, 3)]
                 for _ in range(3) for group in inflated for k in (0, 1, 2, 3)]  # fmt: skip
    true = finger.model_copy(update={"effects": {effect: {axis: Stated(value=value, unit=unit)}}})
    tips = true.predict(pressures).tip @ np.array([AXES[a] for a in axes]) + [0.0, 0.4, 0.0]
    tips += dice.normal(0, 0.15e-3, tips.shape)
    columns = {f"p{c}": dice.normal(np.array(pressures)[:, c - 1], 50.0) for c in (1, 2, 3)}
    return pd.DataFrame({"t": 12.0 * np.arange(len(tips)), **columns, **dict(zip("xyz", tips.T, strict=True))})


BY_REST: dict[str, Any] = {"trials": {"begin": "rest"}}
AT_REST: dict[str, Any] = {"frame": dict(zip("xyz", RISING, strict=True)), "straight": "at rest"}
WEIGHED = {e: CATALOGUE[e] for e in ("base_tilt", "frame_misalignment", "marker_offset", "chamber_azimuth", "tether_load")}


@pytest.mark.parametrize(
    "effect",
    [("base_tilt", "x", 0.05, "rad"), ("marker_offset", "y", 3e-3, "m"), ("frame_misalignment", "z", 0.14, "rad"),
     *(pytest.param(e, marks=pytest.mark.long)
       for e in (("frame_misalignment", "x", 0.05, "rad"), ("chamber_azimuth", "angle", 0.14, "rad")))],
)  # fmt: skip
def test_a_tip_that_a_map_moved_to_the_model_says_nothing_of_where_it_was(effect: tuple[str, str, float, str]) -> None:
    case = lab.case(seen(*effect), lab.load_robot(FINGER).replace(uncertainty={}), **AT_REST, **BY_REST)
    answer = diagnose(case, Options(False, False, WEIGHED))
    said = answer.attribute
    about_z = effect[2] == 0.14
    assert said.effects == (("chamber_azimuth",) if about_z else effect[:1]) and "frame_shift" not in str(answer)
    assert "`straight: at rest` moved tip and markers to the model" in str(answer) and "as `zero` of columns" in str(answer)
    sizes = next(r.parameters for r in said.ranking if r.effects == effect[:1])
    assert sizes[".".join(effect[:2])].value == pytest.approx(effect[2], rel=0.15)
    if about_z:
        assert "angle of the chambers about the axis or turn of the cameras' frame" in answer.headline.lower()
    if said.rivals:
        assert f" or {answer.names[said.rivals[0]].split()[0]}" in answer.headline or " or the " in answer.headline
        assert said.probability <= 0.8 and "`straight: at rest` hides" in said.doubts[0]


def test_a_case_knows_what_its_map_moved(tmp_path: Path) -> None:
    case = lab.case(seen("base_tilt", "x", 0.05, "rad", groups=1), FINGER, **AT_REST, **BY_REST)
    (tmp_path / "robot.yaml").write_text(FINGER.read_text())
    write_csv(case.table, tmp_path / "trials.csv")
    for line, moved in (("straight: at rest", "at rest"), ("straight: as recorded", ""), ("frame: {}", "")):
        (tmp_path / "map.yaml").write_text(f"{line}\n")
        assert lab.case(tmp_path).table.moved_to_model == moved


def test_repeats_that_are_one_trial_are_several_once_the_remedy_is_written() -> None:
    frame = seen("chamber_azimuth", "angle", 0.14, "rad", groups=2)
    for table in (frame, frame[frame[["p1", "p2", "p3"]].max(axis=1) > 5e3]):
        with pytest.warns(match="write trials=({.*}) in lab.case") as told:
            lab.case(table, FINGER, **AT_REST)
        remedy = json.loads(re.search("write trials=({.*}) in lab.case", str(told[0].message))[1])  # type: ignore[index]
        campaign, left = states(lab.case(table, FINGER, **AT_REST, trials=remedy))
        assert campaign.repeats >= 3 and not {"repeated_within_trials", "not_repeated"} & {f.code for f in left}


@pytest.mark.parametrize(
    ("axes", "groups"),
    [(RISING, 6), (RISING, 1),
     *(pytest.param(*more, marks=pytest.mark.long) for more in ((RISING, 3), (("z", "-y", "x"), 6), (("-z", "-x", "y"), 1)))],
)  # fmt: skip
def test_a_frame_that_a_turn_explains_is_no_mirror_image(axes: Sequence[str], groups: int) -> None:
    frame = seen("chamber_azimuth", "angle", 0.14, "rad", axes, groups)
    said = refused(None, lab.case, frame, FINGER, **BY_REST)
    certain = [float(p) for p in re.findall(r"mirror image of the base's \(p = ([\d.]+)\)", said)]
    assert max(certain, default=0.0) < 0.5 and 'straight="at rest"' in said, said
    if (written := re.search("write frame=({.*?}) in lab.case", said)) is not None and groups > 1:
        case = lab.case(frame, FINGER, frame=json.loads(written[1]), straight="at rest", **BY_REST)
        assert case.table.warnings == (), said


def sagging(place: Path, sd: str, mass: float, **true: Any) -> tuple[Any, Any, Any]:
    """The case of a level finger that is not quite as stated, its pressures and its tips."""
    given = {
        "name": "finger", "length": 0.12, "outer_radius": 9e-3, "inner_radius": 0, "density": 1070, "tip_mass": mass,
        "youngs_modulus": f"800 kPa +- {sd}", "shear_modulus": "200 kPa", "area_factor": 1.0,
        "gravity": [-9.81, 0, 0], "max_pressure": "60 kPa",
        "chambers": {"path_radius": 5.2e-3, "radius": 2.8e-3, "azimuths_deg": [0, 180]}}  # fmt: skip
    (place / "given.yaml").write_text(json.dumps(given))
    pressure = np.vstack([1e3 * np.outer([0, 20, 40, 48, 40, 20], on) for _ in range(3) for on in ([1, 0], [0, 1], [1, 1])])
    tips = lab.predict(lab.load_robot(place / "given.yaml").replace(**true), pressure).tip
    tips = tips + 1e-4 * np.random.default_rng(1).normal(size=(len(pressure), 3))
    frame = pd.DataFrame(np.hstack([pressure, tips]), columns=["p1", "p2", "x", "y", "z"])
    return lab.case(frame, place / "given.yaml", trials={"begin": "rest"}), pressure, tips


def test_chambers_of_two_kinds_are_imported_fitted_and_written(tmp_path: Path, cli: Cli) -> None:
    kinds = {"radius": (4e-3, 4e-3, 3e-3), "path_radius": 12.5e-3, "azimuths_deg": (0, 120, 240)}
    robot = lab.load_robot(ROBOT).replace(chambers=kinds, max_pressure=(50e3, 50e3, 90e3))
    write_robot(robot, tmp_path / "robot.yaml")
    alone = [share * robot.pressure_limits * one for one in np.eye(3) for share in (0, 0.5, 1, 0.5)]
    tips = lab.predict(robot.replace(area_factor=1.2), alone * 2).tip
    tips = tips + 1e-4 * np.random.default_rng(1).normal(size=tips.shape)
    names = ("p1", "p2", "p3", *"xyz")
    pd.DataFrame(np.hstack([alone * 2, tips]), columns=names).to_csv(tmp_path / "read.csv", index=False)
    (tmp_path / "map.yaml").write_text(json.dumps({"columns": {n: n for n in names}, "trials": {"begin": "rest"}}))
    cli("import", tmp_path / "read.csv", "--map", tmp_path / "map.yaml", "--out", tmp_path / "case")
    cli("fit", tmp_path / "case", "--out", tmp_path / "fitted")
    fitted = lab.load_robot(tmp_path / "fitted" / "robot.yaml")
    assert fitted.chambers == robot.chambers and fitted.max_pressure == robot.max_pressure
    assert fitted.area_factor_at(0.0) == pytest.approx(1.2, abs=0.01)
    menu = candidate_experiments(robot, states(lab.case(tmp_path / "case"))[0])
    asked = {(max(e.protocol["pressures"]), *e.protocol["chambers"]) for e in menu}
    assert (50e3, 1, 2, 3) in asked and all(p <= min(robot.pressure_limits[c - 1] for c in group) for p, *group in asked)


def test_a_load_that_is_left_out_is_named_with_its_mass(tmp_path: Path) -> None:
    found, *_ = sagging(tmp_path, "15 %", 6e-3, tip_mass=16e-3)
    (first, *_) = diagnose(found, Options(False, False, WEIGHED | {"tip_payload": CATALOGUE["tip_payload"]})).attribute.ranking
    mass = first.parameters["tip_payload.mass"]
    assert first.effects == ("tip_payload",) and first.probability > 0.9 and abs(mass.value - 10e-3) < mass.sd < 5e-3


def test_a_body_that_sags_half_as_stiff_as_stated_is_fitted_diagnosed_and_predicted_as_written(tmp_path: Path) -> None:
    tilt = {"base_tilt": {"x": {"value": 0.05, "unit": "rad"}}}
    found, pressure, tips = sagging(tmp_path, "50 %", 3e-3, youngs_modulus=440e3, effects=tilt)
    answer = diagnose(found, Options(False, False, WEIGHED))
    assert answer.attribute.effects == ("base_tilt",) and answer.locate.gap_rmse_mm < 1, answer.headline
    assert answer.calibration is not None and answer.calibration.determined and not answer.calibration.origins
    assert lab.fit(found, set_up=True).robot.tolerances and not lab.fit(found).robot.tolerances
    fitted = lab.fit(found, effects=("base_tilt",))
    assert fitted.robot.stated["youngs_modulus.excess"].value == pytest.approx(-0.45, abs=0.08) and fitted.left_mm < 0.25
    for robot in (fitted.robot, *drawn(fitted.robot, CATALOGUE, 1, 0)[2]):
        assert np.linalg.norm(np.asarray(lab.predict(robot, pressure).tip) - tips, axis=1).max() < 2e-3


@pytest.mark.parametrize(
    ("column", "factor", "found", "unit"),
    [("x", 2.54, r"column x holds cm read as inches \(x 0.3937, p = ", "cm"),
     ("p2", 6.895, r"column p2 must be 0.14\d+ times as large \(p = 1.00\): it looks like kPa read as psi; ", "kPa"),
     ("p2", 0.1, r"column p2 must be (9.9|10)\S* times as large .*: it looks like kPa read as mbar or MPa read as bar; ", ""),
     *(pytest.param(*more, marks=pytest.mark.long) for more in (
        ("y", 1 / 25.4, r"column y holds inches read as mm \(x 25.4, p = ", "in"),
        ("p3", 0.01, r"column p3 must be (99|10[01])\S* times .*: it looks like mbar read as Pa or bar read as kPa; ", "")))],
)  # fmt: skip
def test_one_column_in_another_unit_is_named_with_the_entry_to_change(
    tmp_path: Path, column: str, factor: float, found: str, unit: str
) -> None:
    frame = seen("base_tilt", "x", 0.001, "rad")
    frame[column] *= factor
    case = lab.case(frame, FINGER, **AT_REST, **BY_REST)
    remedy = f'write columns={{"{column}": "{column} [{unit}]"}}' if unit else f"correct unit or scale of {column}"
    (mistake,) = map(str, edit_first(case.robot, states(case)[0]).changes)
    assert re.match(found, mistake) and mistake.endswith(f"{remedy} in lab.case"), mistake
    (tmp_path / "robot.yaml").write_text(FINGER.read_text())
    columns = f"columns:\n  {column}: {{column: my column}}\n"
    (tmp_path / "map.yaml").write_text(f"straight: at rest\nframe: {{x: -x, y: -z, z: -y}}\n{columns}")
    write_csv(case.table, tmp_path / "trials.csv")
    case = lab.case(tmp_path)
    remedy = f"write `unit: {unit}` for columns.{column}" if unit else remedy
    (mistake,) = map(str, edit_first(case.robot, states(case)[0]).changes)
    assert mistake.startswith("column my column ") and mistake.endswith(f"{remedy} in map.yaml"), mistake


def test_a_column_whose_unit_puts_the_tip_out_of_reach_is_named_where_it_is_refused() -> None:
    for groups, factor, wrong in ((1, 10.0, "cm"), (4, 25.4, "inches")):
        frame = seen("base_tilt", "x", 0.001, "rad", groups=groups)
        frame["x"] *= factor
        with pytest.raises(ConfigError, match=f"of {12 * groups} states\\): column x holds mm read as {wrong} .* write columns="):
            lab.case(frame, FINGER, **AT_REST, **BY_REST)


def test_a_unit_of_points_that_a_sensor_moved_back_is_named_as_the_file_holds_it() -> None:
    pressures = 2e4 * np.array([k * np.array(group) for group in ((1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0)) for k in range(4)])
    found = lab.load_robot(FINGER).predict(pressures)
    points = found.tip + Rotation.from_quat(found.orientation, scalar_first=True).apply([0.0, 0.0, 0.03])
    columns = np.hstack([pressures, 0.1 * points, found.orientation]).T
    frame = pd.DataFrame(dict(zip(["p1", "p2", "p3", *"xyz", "qw", "qx", "qy", "qz"], columns, strict=True)))
    refused("hold cm read as mm", lab.case, frame, FINGER, sensor=[0.0, 0.0, 0.03], **BY_REST)


def test_an_axis_that_any_unit_fits_is_not_said_to_be_in_another() -> None:
    frame = seen("base_tilt", "x", 0.001, "rad", groups=4)
    frame["y"] = frame["y"].mean()
    case = lab.case(frame, FINGER, **AT_REST, **BY_REST)
    assert not any("holds" in str(f) for f in edit_first(case.robot, states(case)[0]).changes)
