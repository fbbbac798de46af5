"""Tables of robots with tendons: tensions in N under words of other languages, and a tip that goes towards the tendon pulled."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

import lab
from diagnosis.diagnose import Options, diagnose
from lab.cli import main
from lab.files.inputs import read_case
from lab.imports.columns import judge
from lab.imports.headings import heading, tendon
from lab.pages.diagnosis_figures import Group
from lab.pages.diagnosis_report import write
from lab.verbs.diagnose import show, write_protocols
from model.effects import CATALOGUE
from model.prediction import Predictor

ROBOT = """\
name: trunk
length: 180 mm
outer_radius: 12 mm
inner_radius: 0 mm
density: 1080 kg/m^3
youngs_modulus: 320 kPa
shear_modulus: 107 kPa
tip_mass: 0 g
gravity: [0, 0, 9.81]
tendons:
  path_radius: 9 mm
  azimuths_deg: [0, 120, 240]
area_factor: 1.0
markers: [90 mm]
"""


def trunk(folder: Path, word: str) -> Path:
    """Three tendons pulled in turn to 4 N, twice; y of the cameras points up, against the hanging body."""
    folder.mkdir()
    (folder / "robot.yaml").write_text(ROBOT)
    tensions = [f"{word}{k} [N]" for k in (1, 2, 3)]
    lines = [";".join(["Zeit [s]", *tensions, *(f"{m}_{a} [mm]" for m in ("Spitze", "Mitte") for a in "xyz")])]
    t = 0.0
    for _ in range(2):
        for k in range(3):
            for pull in (0.0, 1.0, 2.0, 3.0, 4.0, 2.0, 0.0):
                turn, towards = 0.22 * pull, np.radians(120.0 * k)
                aside, along = 180 * (1 - np.cos(turn)) / max(turn, 1e-9), 180 * np.sinc(turn / np.pi)
                body = np.array([aside * np.cos(towards), aside * np.sin(towards), along])
                half = np.array([aside * np.cos(towards) / 4, aside * np.sin(towards) / 4, along / 2 + 0.01 * pull])
                seen = [v for b in (body, half + [14, 0, 0]) for v in (700 + b[0], -b[2], 40 + b[1])]  # 14 mm: on the skin
                row = [t, *(pull if k == j else 0.0 for j in range(3)), *seen]
                lines.append(";".join(f"{v:.3f}".replace(".", ",") for v in row))
                t += 3.0
    (folder / "table.csv").write_text("\n".join(lines) + "\n")
    return folder


TIP, MIDDLE = (tuple(f"{m}_{a} [mm]" for a in "xyz") for m in ("Spitze", "Mitte"))
COLUMNS: dict[str, dict[str, object]] = {f"p{k}": {"column": f"Seil_{k} [N]", "unit": "N"} for k in (1, 2, 3)}
COLUMNS |= {"t": {"column": "Zeit [s]"}} | {a: {"column": column} for a, column in zip("xyz", TIP, strict=True)}
FRAME = {"x": "x", "y": "z", "z": "-y"}


def mapped(lab: Path, columns: dict[str, dict[str, object]] = COLUMNS, **more: object) -> None:
    """Write the map of a trunk's table."""
    values = {"robot": "robot.yaml", "columns": columns, "frame": FRAME, "constants": {"spine_length": 0}, **more}
    (lab / "map.yaml").write_text(yaml.safe_dump(values))


def by_map(lab: Path, out: Path) -> int:
    """Import its table by its map; the exit code."""
    return main(["import", str(lab / "table.csv"), "--map", str(lab / "map.yaml"), "--out", str(out)])


def guessed(lab: Path, table: str = "table.csv") -> str:
    """The map that is proposed for it."""
    asked = ["import", str(lab / table), "--guess", "--robot", str(lab / "robot.yaml"), "--out", str(lab / "guessed")]
    assert main(asked) == 0
    return (lab / "guessed/map.yaml").read_text()


def told(capsys: pytest.CaptureFixture[str]) -> str:
    """What stands on stderr, as words between single blanks."""
    return " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("word", ["Seil_", "tension ", "F", "Zugkraft", "Seilzug ", "p"])
def test_a_map_of_tensions_is_guessed_and_the_tip_goes_to_where_they_pull(
    word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lab = trunk(tmp_path / "lab", word)
    proposed = yaml.safe_load(guessed(lab))
    said = " ".join(capsys.readouterr().out.split())
    assert proposed["columns"] | {f"p{k}": {"column": f"{word}{k} [N]", "unit": "N"} for k in (1, 2, 3)} == proposed["columns"]
    assert proposed["frame"] == FRAME and "towards the tendons pulled" in said
    for frame, doubted in ((FRAME, False), ({"x": "-x", "y": "-z", "z": "-y"}, True)):
        (lab / "map.yaml").write_text(yaml.safe_dump(proposed | {"frame": frame}))
        assert by_map(lab, tmp_path / f"case{doubted}") == 0
        assert ("does not go to where the tensions pull it" in told(capsys)) == doubted


def test_a_frame_is_guessed_of_a_body_that_is_turned_in_its_mount(tmp_path: Path) -> None:
    """Of one experiment in which all states are."""
    lab = trunk(tmp_path / "lab", "Seil_")
    head, *rows = (lab / "table.csv").read_text().splitlines()
    (at,) = (head.split(";").index(f"Spitze_{a} [mm]") for a in "x")
    turned = []
    for row in rows:
        cells = row.split(";")
        x, z = (float(cells[at + k].replace(",", ".")) for k in (0, 2))
        # a quarter about the base's z, which the file has as -y: x goes to z, z to -x
        for k, v in ((0, 700 - (z - 40)), (2, 40 + (x - 700))):
            cells[at + k] = f"{v:.3f}".replace(".", ",")
        turned.append(";".join([*cells, "90"]))
    (lab / "table.csv").write_text("\n".join([f"{head};roll_deg", *turned]) + "\n")
    assert yaml.safe_load(guessed(lab))["frame"] == FRAME


def test_a_robot_with_tendons_takes_no_column_of_pressures_for_one(tmp_path: Path) -> None:
    lab = trunk(tmp_path / "lab", "Seil_")
    (lab / "table.csv").write_text((lab / "table.csv").read_text().replace("Seil_1 [N]", "Seil_1 [kPa]", 1))
    assert "Seil_1 [kPa]" not in str(yaml.safe_load(guessed(lab))["columns"].get("p1"))


@pytest.mark.parametrize("straight", ["first state", "first row"])
def test_markers_too_are_taken_from_the_straight_robot(straight: str, tmp_path: Path) -> None:
    lab = trunk(tmp_path / "lab", "Seil_")
    mapped(lab, straight=straight, points={"m1": {"of": [list(MIDDLE)], "unit": "mm"}})
    assert by_map(lab, tmp_path / "case") == 0
    (first, *others) = read_case([tmp_path / "case"]).table.rows
    assert first.markers[0] == pytest.approx((0.0, 0.0, 0.09), abs=1e-9)
    assert max(abs(r.markers[0][0]) for r in others) > 0.005


def test_a_robot_at_rest_is_put_where_the_model_stands_under_its_weight(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its tip sags, and each trial's first reading has its own noise: their mean counts."""
    own = trunk(tmp_path / "lab", "Seil_")
    (own / "robot.yaml").write_text(ROBOT.replace("gravity: [0, 0, 9.81]", "gravity: [1, 0, 0]"))
    robot = lab.load_robot(own / "robot.yaml")
    sag = Predictor(robot)(np.zeros(3)).tip[0]
    assert sag[0] > 0.002
    head, *rows = (own / "table.csv").read_text().splitlines()
    noise = [0.3, -0.3] + [0.0] * len(rows)
    for at, off in zip((i for i, r in enumerate(rows) if r.split(";")[1:4] == ["0,000"] * 3), noise, strict=False):
        cells = rows[at].split(";")
        cells[5] = f"{float(cells[5].replace(',', '.')) + off:.3f}".replace(".", ",")
        rows[at] = ";".join(cells)
    (own / "table.csv").write_text("\n".join([head, *rows]) + "\n")
    proposed = guessed(own)
    assert "# CHECK: straight: at rest the tip is" in proposed and yaml.safe_load(proposed)["straight"] == "at rest"
    (own / "map.yaml").write_text(proposed)
    assert by_map(own, tmp_path / "case") == 0
    tips = [r.tip for r in read_case([tmp_path / "case"]).table.rows if max(r.pressures) == 0 and r.step == 1]
    assert np.mean(np.array(tips), axis=0) == pytest.approx(sag, abs=1e-6)


@pytest.mark.parametrize("gravity", [(0.0, 0.0, -9.81), (0.0, -9.81, 0.0)])
def test_another_gravity_than_that_of_readings_put_at_rest_is_asked_about(
    gravity: tuple[float, float, float], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A soft robot that hangs, whose readings `straight: at rest` moves to where the model stands."""
    own = trunk(tmp_path / "lab", "Seil_")
    soft = ROBOT.replace("length: 180 mm", "length: 260 mm").replace("[90 mm]", "[130 mm]").replace("320 kPa", "220 kPa")
    hangs, stated = soft.replace("107 kPa", "73 kPa"), f"gravity: {list(gravity)}"
    (own / "robot.yaml").write_text(hangs)
    robot = lab.load_robot(own / "robot.yaml")
    tensions = np.array([np.eye(3)[k] * pull for k in range(3) for pull in (0.0, 0.4, 0.8, 1.2, 0.0)])
    tips = [1e3 * Predictor(robot)(row * robot.actuators.words.pascal).tip[0] + (30, -20, 5) for row in tensions]
    lines = [
        "p1,p2,p3,x,y,z",
        *(",".join(f"{v:.4f}" for v in (*p, *tip)) for p, tip in zip(tensions, tips, strict=True)),
    ]
    (own / "rest.csv").write_text("\n".join(lines) + "\n")
    columns = {f"p{k}": {"column": f"p{k}", "unit": "N"} for k in (1, 2, 3)} | {a: {"column": a, "unit": "mm"} for a in "xyz"}
    (own / "map.yaml").write_text(yaml.safe_dump({"robot": "robot.yaml", "columns": columns, "straight": "at rest"}))
    for text, asked in ((hangs, False), (hangs.replace("gravity: [0, 0, 9.81]", stated), True)):
        (own / "robot.yaml").write_text(text.replace("markers: [130 mm]\n", ""))
        out = str(tmp_path / f"case{asked}")
        assert main(["import", str(own / "rest.csv"), "--map", str(own / "map.yaml"), "--out", out]) == 0
        said = told(capsys)
        assert ("mm with [0, 0, 9.81]: does gravity point down" in said) is asked, said


@pytest.mark.parametrize(
    ("tip", "marker", "said"),
    [
        (TIP, MIDDLE, ""),
        ((TIP[1], TIP[0], TIP[2]), MIDDLE, "the tip moves along z, the robot's axis"),
        (TIP, (MIDDLE[1], MIDDLE[0], MIDDLE[2]), "marker 1 moves along z, the robot's axis"),
        ((TIP[1], f"-{TIP[0]}", TIP[2]), MIDDLE, "the tip is up to"),
        (MIDDLE, TIP, "was it taken for it?"),
    ],
)
def test_places_that_are_no_points_along_the_body_are_asked_about(
    tip: tuple[str, ...], marker: tuple[str, ...], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lab = trunk(tmp_path / "lab", "Seil_")
    head, *rows = (lab / "table.csv").read_text().splitlines()
    one_sided = [r for r in rows if r.split(";")[2:4] == ["0,000", "0,000"]]
    (lab / "table.csv").write_text("\n".join([head, *one_sided]) + "\n")
    places = {a: {"column": c.lstrip("-"), "scale": -1 if c[0] == "-" else 1} for a, c in zip("xyz", tip, strict=True)}
    mapped(lab, COLUMNS | places, straight="at rest", points={"m1": {"of": [list(marker)], "unit": "mm"}})
    code, doubts = by_map(lab, tmp_path / "case"), told(capsys)
    assert code == 0 and (said in doubts if said else doubts == ""), doubts


def test_a_base_that_the_map_places_is_subtracted_from_tip_and_markers(tmp_path: Path) -> None:
    own = trunk(tmp_path / "lab", "Seil_")
    places = {a: {"column": c, "zero": z} for a, c, z in zip("xyz", TIP, (700.0, 0.0, 40.0), strict=True)}
    mapped(own, COLUMNS | places, points={"m1": {"of": [list(MIDDLE)], "unit": "mm"}})
    assert by_map(own, tmp_path / "case") == 0
    (first, *_) = read_case([tmp_path / "case"]).table.rows
    assert first.tip == pytest.approx((0.0, 0.0, 0.18), abs=1e-6)
    assert first.markers[0] == pytest.approx((0.014, 0.0, 0.09), abs=1e-6)


def test_tensions_ten_times_too_large_are_asked_about(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    imported(tmp_path)
    assert "times as far as a beam" not in told(capsys)
    text = yaml.safe_load((tmp_path / "lab/map.yaml").read_text())
    for k in (1, 2, 3):
        text["columns"][f"p{k}"]["scale"] = 10
    (tmp_path / "lab/map.yaml").write_text(yaml.safe_dump(text))
    assert by_map(tmp_path / "lab", tmp_path / "other") == 0
    wanted = r"the tip moves 0\.\d+ times as far as a beam .* under these tensions: check the unit and scale of the"
    assert re.search(wanted, told(capsys))


def imported(folder: Path) -> Path:
    """The case of a trunk, its map written by hand."""
    lab = trunk(folder / "lab", "Seil_")
    mapped(lab, straight="first state", trials={"begin": "rest"})
    assert by_map(lab, folder / "case") == 0
    return folder / "case"


OF_CHAMBERS = re.compile(
    r"\b(kPa|area factors?|chambers?|inflated?|lab run|pressures?(?! rising| and loads| to reading|\.csv))\b"
)
"""Words that say nothing of tendons; the glossary and the name of a file aside."""


def test_answer_page_and_proposals_of_a_robot_with_tendons_speak_of_tendons_and_newtons(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = read_case([imported(tmp_path)])
    few = {e: CATALOGUE[e] for e in ("pressure_offset", "chamber_azimuth")}
    found = diagnose(case, Options(catalogue=few))
    capsys.readouterr()
    show(found, None)
    page = write(found, case, [tmp_path / "case"], tmp_path / "page.html").read_text()
    visible = re.sub(r"(?s)<style.*?</style>|<script.*?</script>|<section id=\"glossary.*|<[^>]*>|\[\w+\]", " ", page)
    for text in (capsys.readouterr().out, visible.partition(" Terms ")[0]):
        assert not OF_CHAMBERS.findall(text)
    assert "tendon 1" in visible and "4.0 N" in visible and "states to apply" in visible
    (first, *_) = found.next_experiment
    paths = write_protocols(found.next_experiment, tmp_path / "next", case.robot)
    assert {p.suffix for p in paths} == {".csv"}
    head, *rows = (tmp_path / f"next/{first.id}.csv").read_text().splitlines()
    highest = max(float(row.split(",")[head.split(",").index("p3 [N]")]) for row in rows)
    assert highest == pytest.approx(max(first.protocol["pressures"]) / 1e4)
    words = ["predict", "--robot", str(tmp_path / "case/robot.yaml"), "--table"]
    assert main([*words, str(tmp_path / f"next/{first.id}.csv"), "--out", str(tmp_path / "tips.csv")]) == 0
    assert "p in N" in capsys.readouterr().out


def test_predict_takes_tensions_in_newtons_and_asks_about_small_pressures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot, table = tmp_path / "robot.yaml", tmp_path / "states.csv"
    robot.write_text(ROBOT + "max_pressure: 5 N/cm^2\n")
    found = []
    for text in ("p1 [N],p2,p3[N]\n2.5,0,0\n", "p1,p2,p3\n25000,0,0\n"):
        table.write_text(text)
        assert main(["predict", "--robot", str(robot), "--table", str(table), "--json"]) == 0
        found.append(json.loads(capsys.readouterr().out)["states"][0])
    assert found[0] == pytest.approx(found[1]) and found[0]["x"] > 0.01
    for text, says in (("p1\n2.5\n", "name the column 'p1 [N]'"), ("p1,p1 [N]\n0,2.5\n", "name one tendon")):
        table.write_text(text)
        assert main(["predict", "--robot", str(robot), "--table", str(table)]) == 2
        assert says in told(capsys)
    table.write_text("p1 [N]\n6\n")
    assert main(["predict", "--robot", str(robot), "--table", str(table)]) == 0
    assert "up to 6 N are asked for, robot.yaml allows 5 N" in capsys.readouterr().err
    targets = tmp_path / "targets.csv"
    targets.write_text("x,y,z\n0.03,,\n")
    assert main(["predict", "--robot", str(robot), "--inverse", str(targets)]) == 0
    said = capsys.readouterr().out
    assert "N (tendons)" in said and not OF_CHAMBERS.search(said)


@pytest.mark.parametrize(
    ("heading", "unit", "says"),
    [
        ("Seil_1 [N]", "kPa", "column 'Seil_1 [N]' (columns.p1): the file says N, the map kPa"),
        ("Seil_1 [V]", "N/cm^2", "column 'Seil_1 [V]' (columns.p1): the file says V, the map N/cm^2"),
        ("Seil_1 [bar]", "kPa", "column 'Seil_1 [bar]' (columns.p1): the file says bar, the map kPa"),
        ("Seil_1 [N]", "N/cm^2", ""),
    ],
)
def test_a_unit_of_the_file_that_contradicts_the_map_is_asked_about(
    heading: str, unit: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    imported(tmp_path)
    lab = tmp_path / "lab"
    (lab / "table.csv").write_text((lab / "table.csv").read_text().replace("Seil_1 [N]", heading))
    values = yaml.safe_load((lab / "map.yaml").read_text())
    values["columns"]["p1"] = {"column": heading, "unit": unit}
    (lab / "map.yaml").write_text(yaml.safe_dump(values))
    capsys.readouterr()
    by_map(lab, tmp_path / "case")
    said = told(capsys)
    assert (says in said) if says else ("the file says" not in said)


@pytest.mark.parametrize(("straight", "aside", "asked"), [("", 30, True), ("first state", 30, False), ("", 2, False)])
def test_a_resting_tip_that_no_body_reaches_asks_for_the_straight_state(
    straight: str, aside: float, asked: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    imported(tmp_path)
    lab = tmp_path / "lab"
    values = yaml.safe_load((lab / "map.yaml").read_text())
    values.pop("straight")
    values |= {"straight": straight} if straight else {}
    (lab / "map.yaml").write_text(yaml.safe_dump(values))
    head, *rows = (lab / "table.csv").read_text().splitlines()
    moved = []
    for row in rows:
        cells = row.split(";")
        place = [float(c.replace(",", ".")) for c in cells[4:7]]
        place = [place[0] - 700 + aside, place[1] - (20 if aside > 10 else 0), place[2] - 40]
        moved.append(";".join([*cells[:4], *(f"{p:.3f}".replace(".", ",") for p in place), *cells[7:]]))
    (lab / "table.csv").write_text("\n".join([head, *moved]) + "\n")
    capsys.readouterr()
    assert by_map(lab, tmp_path / "case") == 0
    said = told(capsys)
    assert ("at rest the tip is 30 mm off the axis and 202 mm from the origin, the robot is 180 mm long" in said) == asked
    assert ("straight: at rest" in said) == asked


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({}, ""),
        ({"columns": {"p1": "Seil_2 [N]", "p2": "Seil_1 [N]"}}, "an exchange of columns p1 and p2"),
        ({"frame": {"x": "x", "y": "-y", "z": "z"}}, "y seems to be the robot's axis"),
    ],
)
def test_exchanged_tendons_and_axes_are_asked_about_at_import_and_by_compare(
    change: dict[str, dict[str, str]], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    imported(tmp_path)
    lab = tmp_path / "lab"
    values = yaml.safe_load((lab / "map.yaml").read_text())
    for name, column in change.get("columns", {}).items():
        values["columns"][name]["column"] = column
    values["frame"] = {"x": "x", "y": "-y", "z": "-z"} if "frame" in change else values["frame"]
    (lab / "map.yaml").write_text(yaml.safe_dump(values))
    capsys.readouterr()
    assert by_map(lab, tmp_path / "case") == 0
    at_import = told(capsys)
    assert main(["compare", str(tmp_path / "case")]) == 0
    compared = told(capsys)
    assert all((says in said) if says else ("the tip" not in said) for said in (at_import, compared))


@pytest.mark.parametrize("spelt", ["Knoten4_{} [mm]", "Knoten4 {} (mm)", "Knoten4.{}", "knoten4_{}_mm"])
def test_a_marker_is_named_without_its_axes_however_the_file_writes_them(
    spelt: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    imported(tmp_path)
    lab = tmp_path / "lab"
    text = (lab / "table.csv").read_text()
    for axis in "xyz":
        text = text.replace(f"Spitze_{axis} [mm]", spelt.format(axis))
    (lab / "table.csv").write_text(text)
    values = yaml.safe_load((lab / "map.yaml").read_text())
    for axis in "xyz":
        values["columns"].pop(axis)
    values["points"] = {"tip": {"of": ["Knoten4"], "unit": "mm"}}
    (lab / "map.yaml").write_text(yaml.safe_dump(values))
    assert by_map(lab, tmp_path / "again") == 0
    assert (tmp_path / "again/trials.csv").read_text() == (tmp_path / "case/trials.csv").read_text()
    values["points"]["tip"]["of"] = ["Knoten"]
    (lab / "map.yaml").write_text(yaml.safe_dump(values))
    capsys.readouterr()
    assert by_map(lab, tmp_path / "again") == 2
    said = told(capsys)
    assert f"there are '{spelt.format('x')}'" in said and "[[Knoten_x, Knoten_y, Knoten_z]]" in said


@pytest.mark.parametrize("guessed", [True, False])
def test_a_note_of_the_user_among_the_tables_is_left_out(
    guessed: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    imported(tmp_path)
    lab = tmp_path / "lab"
    measured = tmp_path / "measured"
    measured.mkdir()
    (measured / "a note.txt").write_text("camera 2 was moved before lunch\nask Jonas\n")
    (measured / "table.csv").write_text((lab / "table.csv").read_text())
    way = ["--guess", "--robot", str(lab / "robot.yaml")] if guessed else ["--map", str(lab / "map.yaml")]
    capsys.readouterr()
    assert main(["import", str(measured), *way, "--out", str(tmp_path / "out")]) == 0
    made = capsys.readouterr()
    assert "42 states" in made.out and "a note.txt" in " ".join(made.err.split())
    assert main(["import", str(measured / "a note.txt"), *way, "--out", str(tmp_path / "out")]) == 2


def with_base(lab: Path) -> str:
    """The table of a trunk with a marker at its base."""
    head, *lines = (lab / "table.csv").read_text().splitlines()
    fixed = [f"{line};{700.01 + 0.02 * (k % 3):.3f};0,000;40,000".replace(".", ",") for k, line in enumerate(lines)]
    (lab / "with_base.csv").write_text("\n".join([f"{head};Knoten1_x [mm];Knoten1_y [mm];Knoten1_z [mm]", *fixed]) + "\n")
    return "with_base.csv"


def test_a_marker_that_stands_still_is_the_base_and_those_of_robot_yaml_are_points_of_the_body(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lab = trunk(tmp_path / "lab", "Seil_")
    points = yaml.safe_load(guessed(lab, with_base(lab)))["points"]
    said = told(capsys)
    fixed = [[f"Knoten1_{a} [mm]" for a in "xyz"]]
    assert points["tip"]["against"] == points["m1"]["against"] == fixed
    assert points["m1"]["of"] == [[f"Mitte_{a} [mm]" for a in "xyz"]]
    assert "stands still" in said and "not used" not in said
    (lab / "robot.yaml").write_text(ROBOT.replace("markers: [90 mm]\n", ""))
    assert "points" in yaml.safe_load(guessed(lab, with_base(lab))) and told(capsys).count("Mitte_x [mm]") == 1


def test_a_table_without_a_row_at_rest_has_a_map_proposed_and_marked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lab = trunk(tmp_path / "lab", "Seil_")
    head, *lines = (lab / "table.csv").read_text().splitlines()
    pulled = [line for line in lines if any(float(c.replace(",", ".")) > 0 for c in line.split(";")[1:4])]
    (lab / "table.csv").write_text("\n".join([head, *pulled]) + "\n")
    proposed, said = guessed(lab), told(capsys)
    assert "in no row with a tip is the robot at rest" in said and "# CHECK: frame: in no row" in proposed
    columns = yaml.safe_load(proposed)["columns"]
    assert columns["p3"]["column"] == "Seil_3 [N]" and columns["x"]["column"] == "Spitze_x [mm]"
    assert "straight" not in yaml.safe_load(proposed)


def test_groups_of_tendons_are_no_clock_times() -> None:
    import pandas as pd  # slow to import

    assert judge(pd.Series(["1:2", "2:3", "3:1"])).values.dtype.kind == "U"
    assert judge(pd.Series(["1:02", "2:03", "3:01"])).unit == "s"


def test_the_map_of_gaps_lists_single_tendons_first_and_the_rest_last() -> None:
    nothing = np.zeros(30, bool)
    names = ["24 other settings", "tendons 1, 2", "tendon 10", "nothing pulled", "tendon 2", "tendons 1, 3", "tendon 1"]
    made = [Group(name, nothing, np.zeros(3), np.zeros(1)) for name in names]
    assert [g.name for g in sorted(made, key=lambda g: g.order)] == [
        "nothing pulled", "tendon 1", "tendon 2", "tendon 10", "tendons 1, 2", "tendons 1, 3", "24 other settings",
    ]  # fmt: skip


def test_power_says_the_plan_and_leaves_out_effects_of_parts_that_the_robot_has_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "robot.yaml").write_text(ROBOT)
    plan = ["--protocol", "bending", "--set", "pressures=[15 kPa, 35 kPa]", "--worlds", "2", "--no-additions"]
    assert main(["power", "--robot", str(tmp_path / "robot.yaml"), *plan]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "plan: 5 states in 1 trial, tendons up to 3.5 N, and robot.yaml states no max_pressure" in said
    assert "never seen in these states: time_offset" in said
    assert not re.search("spine|vacuum|ballooning|thrust", said)


def test_an_arm_across_gravity_that_sags_as_its_robot_yaml_says_needs_no_straight_state(tmp_path: Path) -> None:
    arm = ROBOT.replace("180 mm", "320 mm").replace("[0, 0, 9.81]", "[0, -9.81, 0]").replace("[90 mm]", "[]")
    arm = arm.replace("320 kPa", "8 MPa").replace("107 kPa", "2.7 MPa")
    (tmp_path / "robot.yaml").write_text(arm)
    robot = lab.load_robot(tmp_path / "robot.yaml")
    tensions = [[pull * (k == j) for j in range(3)] for k in range(3) for pull in (0.0, 20.0, 40.0, 0.0)]
    tips = lab.predict(robot, np.multiply(tensions, 1e4)) * 1e3
    assert abs(tips[0, 1]) > 0.05 * 320
    lines = ["t [s],F1 [N],F2 [N],F3 [N],tip x [mm],tip y [mm],tip z [mm]"]
    lines += [",".join(map(str, (3.0 * i, *f, *tip))) for i, (f, tip) in enumerate(zip(tensions, tips, strict=True))]
    (tmp_path / "table.csv").write_text("\n".join(lines) + "\n")
    assert "straight" not in yaml.safe_load(guessed(tmp_path))


@pytest.mark.parametrize("azimuth", [0, 45])
def test_axes_that_the_data_do_not_force_are_marked(azimuth: int, tmp_path: Path) -> None:
    lab = trunk(tmp_path / "lab", "Seil_")
    turned = f"[{azimuth}, {120 + azimuth}, {240 + azimuth}]"
    (lab / "robot.yaml").write_text(ROBOT.replace("[0, 120, 240]", turned))
    proposed = guessed(lab)
    assert ("# CHECK: frame.x, frame.y: with the base's x along the file's x" in proposed) == bool(azimuth)
    assert "# axis of the robot's base (z from base to tip): axis of the file" in proposed


def with_rate(lab: Path) -> str:
    head, *lines = (lab / "table.csv").read_text().splitlines()
    return "\n".join([f"{head};Rate", *(f"{line};500,0" for line in lines)]) + "\n"


@pytest.mark.parametrize(
    ("robot", "refused"),
    [(ROBOT, ""), (ROBOT.replace("tendons:", "chambers:\n  radius: 3 mm"), "the robot has chambers")],
)
def test_a_map_takes_newtons_of_tendons_alone(
    robot: str, refused: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = read_case([imported(tmp_path)]).table
    lab = tmp_path / "lab"
    (lab / "robot.yaml").write_text(robot)
    values = yaml.safe_load((lab / "map.yaml").read_text())
    values["columns"]["p1"]["unit"], values["columns"]["p2"]["unit"] = "N", "N/cm^2"
    del values["columns"]["p3"]["unit"]
    (lab / "table.csv").write_text(with_rate(lab))
    values["columns"]["rate"] = {"column": "Rate", "unit": "mN/s"}
    (lab / "map.yaml").write_text(yaml.safe_dump(values))
    capsys.readouterr()
    assert by_map(lab, tmp_path / "again") == (2 if refused else 0)
    said = capsys.readouterr()
    if refused:
        assert f"{lab / 'map.yaml'}: columns.p1.unit = 'N': p1 needs one of Pa" in said.err and refused in said.err
        return
    assert not said.err and all(str(tmp_path / "again" / name) in said.out for name in ("robot.yaml", "trials.csv"))
    found = read_case([tmp_path / "again"]).table
    assert np.array_equal(found["p1"], before["p1"]) and np.array_equal(found["p3"], before["p3"])
    assert found["p1"].max() == pytest.approx(4e4) and set(found["rate"]) == {5e3}
    values["columns"].pop("p3")
    values["constants"]["p3"] = "500 mN"
    (lab / "map.yaml").write_text(yaml.safe_dump(values))
    assert by_map(lab, tmp_path / "again") == 0
    assert set(read_case([tmp_path / "again"]).table["p3"]) == {5e3}


@pytest.mark.parametrize(
    ("heading_", "number"),
    [
        ("Seil 2 [N]", 2), ("Seile_3", 3), ("Zug2 [N]", 2), ("Sehne 1 Ist [N]", 1), ("Sehnenkraft 4 [N]", 4), ("câble 2 [N]", 2),
        ("Tirant 3", 3), ("corde1 [N]", 1), ("tendón 2 [N]", 2), ("Cuerda_3 [N]", 3), ("Zug [N]", 1), ("Seil Soll", 1),
        ("cable length 2 [mm]", None), ("F2", None), ("F2 [N]", 2), ("Zugfeder", None),
    ],
)  # fmt: skip
def test_words_for_a_tendon_in_several_languages(heading_: str, number: int | None) -> None:
    assert tendon(heading(heading_)) == number


def test_a_column_of_tendons_pulled_begins_trials(tmp_path: Path) -> None:
    lab = trunk(tmp_path / "lab", "Zug_")
    head, *lines = (lab / "table.csv").read_text().splitlines()
    pulled = [f"{line};{1 + k // 7 % 3}" for k, line in enumerate(lines)]
    (lab / "table.csv").write_text("\n".join([f"{head};Seile", *pulled]) + "\n")
    proposed = guessed(lab)
    assert yaml.safe_load(proposed)["trials"] == {"begin": "rest", "change": ["Seile"]}


@pytest.mark.parametrize("gravity", ["[0, -9.81, 0]", "[0, 9.81, 0]"])
def test_gravity_that_points_up_is_asked_about_at_import_and_by_compare(
    gravity: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arm = ROBOT.replace("[90 mm]", "[]").replace("320 kPa", "900 kPa").replace("107 kPa", "300 kPa")
    place = tmp_path / "robot.yaml"
    place.write_text(arm.replace("[0, 0, 9.81]", "[0, -9.81, 0]"))
    pulls = [[pull * (k == j) for j in range(3)] for k in range(3) for pull in (0.0, 1.0, 2.0, 0.0)]
    tips = lab.predict(lab.load_robot(place), np.multiply(pulls, 1e4)) * 1e3
    lines = ["t [s],F1 [N],F2 [N],F3 [N],x [mm],y [mm],z [mm]"]
    lines += [",".join(map(str, (3.0 * i, *f, *tip))) for i, (f, tip) in enumerate(zip(pulls, tips, strict=True))]
    (tmp_path / "table.csv").write_text("\n".join(lines) + "\n")
    place.write_text(arm.replace("[0, 0, 9.81]", gravity))
    columns = {"t": "t [s]"} | {f"p{k}": f"F{k} [N]" for k in (1, 2, 3)} | {a: f"{a} [mm]" for a in "xyz"}
    values = {"columns": {n: {"column": c} for n, c in columns.items()}, "trials": {"begin": "rest"}}
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(values))
    said = []
    for command in (["import", str(tmp_path / "table.csv"), "--map", str(tmp_path / "map.yaml"), "--out"], ["compare"]):
        assert main([*command, str(tmp_path / "case")]) == 0
        said.append(" ".join(capsys.readouterr().err.split()))
    assert all(("mm with [0, -9.81, 0]: does gravity" in text) == ("[0, 9.81" in gravity) for text in said)
