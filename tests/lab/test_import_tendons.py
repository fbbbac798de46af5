"""Tables of robots with tendons: tensions in N under words of other languages, and a tip that goes towards the tendon pulled."""

import itertools
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml
from commands import Cli, Done, refused
from foreign import plain

import lab
from diagnosis.answer.experiments import candidate_experiments, columns
from diagnosis.data.case import states
from diagnosis.diagnose import Options, diagnose
from lab.files.inputs import read_case
from lab.imports.columns import judge
from lab.imports.headings import heading, tendon
from lab.pages.diagnosis_figures import StateGroup
from lab.pages.diagnosis_report import write
from lab.verbs.diagnose import show, write_protocols
from model.effects import CATALOGUE
from model.prediction import Predictor
from recordings.table_file import read_csv
from recordings.trials import Table

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


TIP, MIDDLE = (tuple(f"{m}_{a} [mm]" for a in "xyz") for m in ("Spitze", "Mitte"))
COLUMNS: dict[str, dict[str, object]] = {f"p{k}": {"column": f"Seil_{k} [N]", "unit": "N"} for k in (1, 2, 3)}
COLUMNS |= plain(t="Zeit [s]", **dict(zip("xyz", TIP, strict=True)))
FRAME = {"x": "x", "y": "z", "z": "-y"}


def number(cell: str) -> float:
    return float(cell.replace(",", "."))


def cell(value: float) -> str:
    return f"{value:.3f}".replace(".", ",")


class Trunk:
    """A folder with a robot, its table, and a map: three tendons pulled in turn to 4 N, twice.

    y of the cameras points up, against the hanging body.
    """

    def __init__(self, folder: Path, cli: Cli, word: str = "Seil_{} [N]") -> None:
        self.folder, self.cli = folder, cli
        self.robot, self.table, self.map = (folder / name for name in ("robot.yaml", "table.csv", "map.yaml"))
        folder.mkdir()
        self.robot.write_text(ROBOT)
        head = ["Zeit [s]", *map(word.format, (1, 2, 3)), *TIP, *MIDDLE]
        plan = itertools.product(range(2), np.eye(3), (0.0, 2.0, 4.0, 2.0, 0.0))
        pulls = np.array([pull * tendon for _, tendon, pull in plan])
        robot, rows = lab.load_robot(self.robot), []
        rod = Predictor(robot)(pulls * robot.actuators.words.pascal)
        for n, (pull, tip, (half,)) in enumerate(zip(pulls, 1e3 * rod.tip, 1e3 * rod.shape, strict=True)):
            seen = [v for b in (tip, half + [14, 0, 0]) for v in (700 + b[0], -b[2], 40 + b[1])]  # 14 mm: on the skin
            rows.append([cell(v) for v in (3.0 * n, *pull, *seen)])
        self.write(head, rows)

    def write(self, head: list[str], rows: list[list[str]]) -> None:
        self.table.write_text("".join(";".join(line) + "\n" for line in [head, *rows]))

    def read(self) -> tuple[list[str], list[list[str]]]:
        """Headings and cells of the table."""
        head, *rows = (line.split(";") for line in self.table.read_text().splitlines())
        return head, rows

    def mapped(self, columns: dict[str, dict[str, object]] = COLUMNS, **more: object) -> None:
        """Write its map."""
        values = {"robot": "robot.yaml", "columns": columns, "frame": FRAME, "constants": {"spine_length": 0}, **more}
        self.map.write_text(yaml.safe_dump(values))

    @contextmanager
    def changed(self) -> Iterator[dict[str, Any]]:
        """What the map says, to be changed."""
        values = yaml.safe_load(self.map.read_text())
        yield values
        self.map.write_text(yaml.safe_dump(values))

    def imported(self, name: str = "case", code: int = 0) -> Done:
        """Its table imported by its map, into a folder of this name beside its own."""
        return self.cli("import", self.table, "--map", self.map, "--out", self.folder.with_name(name), code=code)

    def case(self, name: str = "case") -> Table:
        return read_case([self.folder.with_name(name)]).table

    def guessed(self) -> tuple[str, Done]:
        """The map that is proposed for it, and what was said."""
        done = self.cli("import", self.table, "--guess", "--robot", self.robot, "--out", self.folder / "guessed")
        return (self.folder / "guessed/map.yaml").read_text(), done


@pytest.fixture
def trunk(tmp_path: Path, cli: Cli) -> Trunk:
    return Trunk(tmp_path / "lab", cli)


@pytest.fixture
def known(trunk: Trunk) -> Trunk:
    """With a map written by hand, by which it was imported."""
    trunk.mapped(straight="first state", trials={"begin": "rest"})
    trunk.imported()
    return trunk


@pytest.mark.parametrize(
    "word", ["Seil_{} [N]", "tension {} [N]", "F{} [N]", "Zugkraft{} [N]", "Seilzug {} [N]", "p{} [N]", "F{}", "T{}", "p{}"]
)
def test_a_map_of_tensions_is_guessed_and_the_tip_goes_to_where_they_pull(word: str, tmp_path: Path, cli: Cli) -> None:
    trunk = Trunk(tmp_path / "lab", cli, word)
    text, done = trunk.guessed()
    proposed = yaml.safe_load(text)
    wanted = {f"p{k}": {"column": word.format(k), "unit": "N"} for k in (1, 2, 3)}
    assert proposed["columns"] | wanted == proposed["columns"]
    assert ("states no unit for" in text) == ("[N]" not in word)
    assert proposed["frame"] == FRAME and "towards the tendons pulled" in done.flat_out


def test_columns_in_newtons_are_the_tendons_where_there_are_as_many_and_their_order_is_asked_about(trunk: Trunk) -> None:
    head, rows = trunk.read()
    trunk.write([head[0], "Seil_1 [kPa]", *head[2:]], rows)
    assert "Seil_1 [kPa]" not in str(yaml.safe_load(trunk.guessed()[0])["columns"].get("p1"))
    names = ["T_N/N", "T_E/N", "T_S/N"]
    trunk.write([head[0], *names, *head[4:]], rows)
    columns = yaml.safe_load(text := trunk.guessed()[0])["columns"]
    assert [columns[f"p{k}"] for k in (1, 2, 3)] == [{"column": name, "unit": "N"} for name in names]
    assert "T_N/N, T_E/N, T_S/N are taken as tendons 1 to 3" in text
    trunk.write([head[0], *names, "load cell [N]", *head[4:]], [[*row[:4], cell(0.1), *row[4:]] for row in rows])
    text = trunk.guessed()[0]
    assert "T_S/N are taken as tendons" in text and "not used: load cell [N]; name a force under force_x" in text


def test_without_tensions_the_entries_to_write_are_named(trunk: Trunk) -> None:
    frame, write = pd.DataFrame(np.ones((2, 5)), columns=["F1", "F2 [N]", *"xyz"]), '{"p1": "F1 [N]", "p2": "F2 [N]"}'
    refused(rf"no tension is given; write columns={re.escape(write)} in lab.case", lab.case, frame, trunk.robot)
    trunk.mapped({k: v for k, v in COLUMNS.items() if k[0] != "p"})
    assert "`p1: {column: 'Seil_1 [N]', unit: N}, p2: " in trunk.imported(code=2).flat_err


@pytest.mark.parametrize(("numbers", "kind"), [((1, 2, 3), "tendons"), ((1, 2, 4), "chambers")])
def test_columns_belong_to_the_numbers_in_their_headings_and_an_actuator_without_one_is_named(
    numbers: tuple[int, ...], kind: str, trunk: Trunk
) -> None:
    unit, table = ("N", "tendons:") if kind == "tendons" else ("kPa", "chambers:\n  radius: 3 mm")
    (missing,) = {1, 2, 3, 4} - {*numbers}
    azimuths = np.insert([0, 120, 240], missing - 1, 60).tolist()
    trunk.robot.write_text(ROBOT.replace("tendons:", table).replace("[0, 120, 240]", str(azimuths)))
    head, rows = trunk.read()
    trunk.write([head[0], *(f"F{n} [{unit}]" for n in numbers), *head[4:]], rows)
    proposed = yaml.safe_load(trunk.guessed()[0])
    assert {k: c["column"] for k, c in proposed["columns"].items() if k[0] == "p"} == {f"p{n}": f"F{n} [{unit}]" for n in numbers}
    assert proposed["constants"] == {f"p{missing}": f"0 {unit}"}
    assert f"constants.p{missing}: no column of {kind[:-1]} {missing}: was its" in str(proposed["unconfirmed"])


def test_a_map_that_is_guessed_is_not_asked_about_and_one_of_another_frame_is(trunk: Trunk) -> None:
    proposed = yaml.safe_load(trunk.guessed()[0])
    for frame, doubted in ((FRAME, False), ({"x": "-x", "y": "-z", "z": "-y"}, True)):
        trunk.map.write_text(yaml.safe_dump(proposed | {"frame": frame}))
        assert ("all azimuths are" in trunk.imported().flat_err) == doubted


def test_a_frame_is_guessed_of_a_body_that_is_turned_in_its_mount(trunk: Trunk) -> None:
    head, rows = trunk.read()
    at = head.index("Spitze_x [mm]")
    for row in rows:
        # a quarter about the base's z, which the file has as -y: x goes to z, z to -x
        row[at], row[at + 2] = cell(700 - (number(row[at + 2]) - 40)), cell(40 + (number(row[at]) - 700))
        row.append("90")
    trunk.write([*head, "roll_deg"], rows)
    assert yaml.safe_load(trunk.guessed()[0])["frame"] == FRAME


@pytest.mark.parametrize("straight", ["first state", "first row"])
def test_markers_too_are_taken_from_the_straight_robot(straight: str, trunk: Trunk) -> None:
    trunk.mapped(straight=straight, points={"m1": {"of": [list(MIDDLE)], "unit": "mm"}})
    assert "write `trials: {begin: rest}` in map.yaml" in trunk.imported().flat_err
    (first, *others) = trunk.case().rows
    assert first.markers[0] == pytest.approx((0.0, 0.0, 0.09), abs=1e-9)
    assert max(abs(r.markers[0][0]) for r in others) > 0.005


def test_a_robot_at_rest_is_put_where_the_model_stands_under_its_weight(trunk: Trunk) -> None:
    trunk.robot.write_text(ROBOT.replace("gravity: [0, 0, 9.81]", "gravity: [1, 0, 0]"))
    sag = Predictor(lab.load_robot(trunk.robot))(np.zeros(3)).tip[0]
    assert sag[0] > 0.002
    head, rows = trunk.read()
    first, second, *_ = (row for row in rows if row[1:4] == ["0,000"] * 3)
    for row, off in ((first, 0.3), (second, -0.3)):
        row[5] = cell(number(row[5]) + off)
    trunk.write(head, rows)
    proposed, _ = trunk.guessed()
    assert "\n- 'straight: at rest the recorded tip is" in proposed and yaml.safe_load(proposed)["straight"] == "at rest"
    trunk.map.write_text(proposed)
    trunk.imported()
    tips = [r.tip for r in trunk.case().rows if max(r.pressures) == 0 and r.step == 1]
    assert np.mean(np.array(tips), axis=0) == pytest.approx(sag, abs=1e-6)


@pytest.mark.parametrize("gravity", [(0.0, 0.0, -9.81), (0.0, -9.81, 0.0)])
def test_another_gravity_than_that_of_readings_put_at_rest_is_asked_about(
    gravity: tuple[float, float, float], trunk: Trunk
) -> None:
    soft = ROBOT.replace("length: 180 mm", "length: 260 mm").replace("[90 mm]", "[130 mm]").replace("320 kPa", "220 kPa")
    hangs, stated = soft.replace("107 kPa", "73 kPa"), f"gravity: {list(gravity)}"
    trunk.robot.write_text(hangs)
    predicted_table(trunk, (0.0, 0.4, 0.8, 1.2, 0.0), (30, -20, 5))
    columns = plain(**{f"p{k}": f"F{k} [N]" for k in (1, 2, 3)}, **{a: f"tip {a} [mm]" for a in "xyz"})
    trunk.map.write_text(yaml.safe_dump({"robot": "robot.yaml", "columns": columns, "straight": "at rest"}))
    for text, asked in ((hangs, False), (hangs.replace("gravity: [0, 0, 9.81]", stated), True)):
        trunk.robot.write_text(text.replace("markers: [130 mm]\n", ""))
        assert ("gravity [0, 0, 9.81] instead of" in trunk.imported().flat_err) is asked


@pytest.mark.parametrize(
    ("tip", "marker", "said"),
    [
        (TIP, MIDDLE, ""),
        ((TIP[1], f"-{TIP[0]}", TIP[2]), MIDDLE, "the tip uses other axes"),
        (MIDDLE, TIP, "the tip and marker 1 are swapped"),
    ],
)
def test_places_that_are_no_points_along_the_body_are_asked_about(
    tip: tuple[str, ...], marker: tuple[str, ...], said: str, trunk: Trunk
) -> None:
    head, rows = trunk.read()
    trunk.write(head, [row for row in rows if row[2:4] == ["0,000", "0,000"]])
    places = {a: {"column": c.lstrip("-"), "scale": -1 if c[0] == "-" else 1} for a, c in zip("xyz", tip, strict=True)}
    points, trials = {"m1": {"of": [list(marker)], "unit": "mm"}}, {"begin": "rest"}
    trunk.mapped(COLUMNS | places, straight="at rest", points=points, trials=trials)
    doubts = trunk.imported().flat_err
    assert said in doubts if said else doubts == "", doubts


def test_a_base_that_the_map_places_is_subtracted_from_tip_and_markers(trunk: Trunk) -> None:
    places = {a: {"column": c, "zero": z} for a, c, z in zip("xyz", TIP, (700.0, 0.0, 40.0), strict=True)}
    trunk.mapped(COLUMNS | places, points={"m1": {"of": [list(MIDDLE)], "unit": "mm"}})
    trunk.imported()
    written = trunk.folder.with_name("case") / "trials.csv"  # with the marker, which stands off the axis
    (first, *_), rest = read_csv(written).rows, Predictor(lab.load_robot(trunk.robot))(np.zeros(3))
    assert first.tip == pytest.approx(rest.tip[0], abs=1e-6)
    assert first.markers[0] == pytest.approx(rest.shape[0, 0] + [0.014, 0.0, 0.0], abs=1e-6)
    trunk.mapped(COLUMNS | {a: places[a] | {"scale": -1} for a in places}, points={"m1": {"of": [list(MIDDLE)], "unit": "mm"}})
    trunk.imported()
    again = read_csv(written).rows[0]
    assert [again.tip, *again.markers] == pytest.approx(-np.array([first.tip, *first.markers]))


OF_CHAMBERS = re.compile(
    r"\b(kPa|area factors?|chambers?|inflated?|lab run|pressures?(?! rising| and loads| to reading|\.csv))\b"
)
"""Words that say nothing of tendons; the glossary and the name of a file aside."""


def test_answer_page_and_proposals_of_a_robot_with_tendons_speak_of_tendons_and_newtons(
    known: Trunk, tmp_path: Path, cli: Cli, capsys: pytest.CaptureFixture[str]
) -> None:
    case = read_case([known.folder.with_name("case")])
    found = diagnose(case, Options(catalogue={e: CATALOGUE[e] for e in ("pressure_offset", "chamber_azimuth")}))
    capsys.readouterr()
    show(found, None)
    assert found.attribute.conclusion == "noise"  # however exact the readings of a robot as it is described
    page = write(found, case, [tmp_path / "case"], tmp_path / "page.html").read_text()
    visible = re.sub(r"(?s)<style.*?</style>|<script.*?</script>|<section id=\"glossary.*|<[^>]*>|\[\w+\]", " ", page)
    for text in (capsys.readouterr().out, visible.partition(" Terms ")[0]):
        assert not OF_CHAMBERS.findall(text)
    assert "tendon 1" in visible and "4.0 N" in visible and "states to apply" in visible
    (first, *_) = found.next_experiment
    paths = write_protocols(found.next_experiment, tmp_path / "next", case.robot)
    assert {p.suffix for p in paths} == {".csv"}
    two = replace(case, table=case.table.take(case.table["p3"] < 1e3))
    assert "other_tendons" in [e.id for e in candidate_experiments(case.robot, states(two)[0])]
    head, *rows = (tmp_path / f"next/{first.id}.csv").read_text().splitlines()
    highest = max(float(row.split(",")[head.split(",").index("p3 [N]")]) for row in rows)
    assert highest == pytest.approx(max(first.protocol["pressures"]) / 1e4)
    words = ["predict", "--robot", str(tmp_path / "case/robot.yaml"), "--table"]
    assert "p in N" in cli(*words, tmp_path / f"next/{first.id}.csv", "--out", tmp_path / "tips.csv").out
    trials = tmp_path / "case/trials.csv"
    trials.write_text(trials.read_text().replace("bending", "elongation"))
    told = cli("compare", tmp_path / "case").out
    assert "lowest tension" in told and "2.0 N" in told and not OF_CHAMBERS.search(told)
    reached = case.robot.replace(max_tension=5.0).inverse([[0.03, 0.0, float("nan")]])
    assert all(1 < f.to_frame()[["p1 [N]", "p2 [N]", "p3 [N]"]].max().max() < 5 for f in (lab.compare(case), reached))
    taut = case.table.replaced({p: case.table[p] + 1.5e3 for p in ("p1", "p2", "p3")})
    menu = candidate_experiments(case.robot, states(replace(case, table=taut))[0])
    assert all(columns(e.protocol, 3, ())["p1"].min() == 1.5e3 for e in menu)


NEWTONS = "p1 (mN),p2,p3[N],spine_length [mm]\n2500,0,0,0\n"


def test_predict_takes_tensions_in_newtons_and_asks_about_small_pressures(tmp_path: Path, cli: Cli) -> None:
    robot, table = tmp_path / "robot.yaml", tmp_path / "states.csv"
    robot.write_text(ROBOT + "max_pressure: 5 N/cm^2\n")

    def predicted(text: str, *words: str, code: int = 0) -> Done:
        table.write_text(text)
        return cli("predict", "--robot", robot, *(words or ("--table",)), table, code=code)

    in_newtons, in_pascal = (predicted(t, "--json", "--table").json["states"][0] for t in (NEWTONS, "p1,p2,p3\n25000,0,0\n"))
    assert in_newtons == pytest.approx(in_pascal) and in_newtons["x"] > 0.01
    for text, says in (
        ("p1\n2.5\n", "name the column 'p1 [N]'"), ("p1,p1 [N]\n0,2.5\n", "several columns are p1"),
        ("p1 [kPa]\n25\n", "tensions in N (1 N is 10000 Pa in tables): convert the column and name it 'p1 [N]'"),
    ):  # fmt: skip
        assert says in predicted(text, code=2).flat_err
    beyond = predicted("p1 [N]\n6\n").flat_err
    assert "tensions outside 0 to 5 N, the limits of trunk: 6 N of tendon 1 in row 1" in beyond
    assert "note: no column of tendons 2, 3: taken as 0 N" in beyond
    assert "-1 N of tendon 2 in row 1: a tendon cannot push" in predicted("p2 [N]\n-1\n", code=2).flat_err
    assert "column p4: trunk has tendons 1, 2, 3; leave" in predicted("p4 [N]\n1\n", code=2).flat_err
    said = predicted("x [mm],y,z\n30,,\n", "--inverse").out
    assert "p in N" in said and not OF_CHAMBERS.search(said)


@pytest.mark.parametrize(("straight", "aside", "asked"), [("", 30, True), ("first state", 30, False), ("", 2, False)])
def test_a_resting_tip_out_of_reach_asks_for_the_straight_state(straight: str, aside: float, asked: bool, known: Trunk) -> None:
    with known.changed() as values:
        values.pop("straight")
        values |= {"straight": straight} if straight else {}
    head, rows = known.read()
    for row in rows:
        x, y, z = map(number, row[4:7])
        row[4:7] = map(cell, (x - 700 + aside, y - (20 if aside > 10 else 0), z - 40))
    known.write(head, rows)
    said = known.imported().flat_err
    assert ("all places are displaced by [30" in said) == asked
    assert ("straight: at rest" in said) == asked


@pytest.mark.parametrize(
    ("columns", "frame", "says"),
    [
        ({}, FRAME, ""),
        ({"p1": "Seil_2 [N]", "p2": "Seil_1 [N]"}, FRAME, "tendons 1 and 2 are swapped"),
        pytest.param(
            {}, {"x": "x", "y": "-y", "z": "-z"}, "write `frame: {x: x, y: z, z: -y}` in map.yaml", marks=pytest.mark.long
        ),
    ],
)
def test_exchanged_tendons_and_axes_are_asked_about_at_import_and_by_compare(
    columns: dict[str, str], frame: dict[str, str], says: str, known: Trunk
) -> None:
    with known.changed() as values:
        values["frame"] = frame
        for name, column in columns.items():
            values["columns"][name]["column"] = column
    for said in (known.imported().flat_err, known.cli("compare", known.folder.with_name("case")).flat_err):
        assert says in said if says else "the tip" not in said


@pytest.mark.parametrize("spelt", ["Knoten4_{} [mm]", "Knoten4 {} (mm)", "Knoten4.{}", "knoten4_{}_mm"])
def test_a_marker_is_named_without_its_axes_however_the_file_writes_them(spelt: str, known: Trunk, tmp_path: Path) -> None:
    text = known.table.read_text()
    for axis in "xyz":
        text = text.replace(f"Spitze_{axis} [mm]", spelt.format(axis))
    known.table.write_text(text)
    with known.changed() as values:
        values["columns"] = {n: c for n, c in values["columns"].items() if n not in tuple("xyz")}
        values["points"] = {"tip": {"of": ["Knoten4"], "unit": "mm"}}
    assert ["written: " in known.imported("again").out for _ in range(2)] == [True, False]
    assert (tmp_path / "again/trials.csv").read_text() == (tmp_path / "case/trials.csv").read_text()
    with known.changed() as values:
        values["points"]["tip"]["of"] = ["Knoten"]
    said = known.imported("again", code=2).flat_err
    assert f"there are '{spelt.format('x')}'" in said and "[[Knoten_x, Knoten_y, Knoten_z]]" in said


@pytest.mark.parametrize("guessed", [True, False])
def test_a_note_of_the_user_among_the_tables_is_left_out(guessed: bool, known: Trunk, tmp_path: Path, cli: Cli) -> None:
    measured = tmp_path / "measured"
    measured.mkdir()
    (measured / "a note.txt").write_text("camera 2 was moved before lunch\nask Jonas\n")
    (measured / "table.csv").write_text(known.table.read_text())
    way = ["--guess", "--robot", known.robot] if guessed else ["--map", known.map]
    made = cli("import", measured, *way, "--out", tmp_path / "out")
    assert "30 states" in made.out and "a note.txt" in made.flat_err
    cli("import", measured / "a note.txt", *way, "--out", tmp_path / "out", code=2)


def test_a_marker_that_stands_still_is_the_base_and_those_of_robot_yaml_are_points_of_the_body(trunk: Trunk) -> None:
    head, rows = trunk.read()
    fixed = [f"Knoten1_{a} [mm]" for a in "xyz"]
    trunk.write([*head, *fixed], [[*row, cell(700.01 + 0.02 * (k % 3)), "0,000", "40,000"] for k, row in enumerate(rows)])
    proposed, _ = trunk.guessed()
    points = yaml.safe_load(proposed)["points"]
    assert points["tip"]["against"] == points["m1"]["against"] == [fixed]
    assert points["m1"]["of"] == [list(MIDDLE)]
    assert "does not move" in proposed and "not used" not in proposed
    trunk.robot.write_text(ROBOT.replace("markers: [90 mm]\n", ""))
    proposed = yaml.safe_load(trunk.guessed()[0])
    assert "points" in proposed and str(proposed["unconfirmed"]).count("Mitte_x [mm]") == 1


def test_a_table_without_a_row_at_rest_has_a_map_proposed_and_marked(trunk: Trunk) -> None:
    head, rows = trunk.read()
    trunk.write(head, [row for row in rows if any(number(c) > 0 for c in row[1:4])])
    text, _ = trunk.guessed()
    assert "\n- 'straight: the robot is at rest in no row" in text
    proposed = yaml.safe_load(text)
    assert proposed["columns"]["p3"]["column"] == "Seil_3 [N]" and proposed["columns"]["x"]["column"] == "Spitze_x [mm]"
    assert proposed["frame"] == FRAME and proposed["straight"] == "at rest"
    trunk.map.write_text(text)
    trunk.imported()
    own = trunk.case().take(np.array([0]))
    assert own.tip == pytest.approx(Predictor(lab.load_robot(trunk.robot))(own.pressures).tip, abs=0.003)


def test_groups_of_tendons_are_no_clock_times() -> None:
    assert judge(pd.Series(["1:2", "2:3", "3:1"])).values.dtype.kind == "U"
    assert judge(pd.Series(["1:02", "2:03", "3:01"])).unit == "s"


def test_the_map_of_gaps_lists_single_tendons_first_and_the_rest_last() -> None:
    nothing = np.zeros(30, bool)
    names = ["24 other settings", "tendons 1, 2", "tendon 10", "nothing pulled", "tendon 2", "tendons 1, 3", "tendon 1"]
    made = [StateGroup(name, nothing, np.zeros(3), np.zeros(1), name.endswith("settings")) for name in names]
    assert [g.name for g in sorted(made, key=lambda g: g.order)] == [
        "nothing pulled", "tendon 1", "tendon 2", "tendon 10", "tendons 1, 2", "tendons 1, 3", "24 other settings",
    ]  # fmt: skip


def test_power_says_the_plan_and_leaves_out_effects_of_parts_that_the_robot_has_not(
    tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    some = ("base_tilt", "time_offset", "spine_slip", "vacuum_leak", "chamber_ballooning", "chamber_thrust")
    monkeypatch.setattr("lab.files.own_effects.CATALOGUE", {effect: CATALOGUE[effect] for effect in some})
    (tmp_path / "robot.yaml").write_text(ROBOT)
    plan = ["--protocol", "bending", "--set", "pressures=[15 kPa, 35 kPa]", "--worlds", "2", "--no-additions"]
    said = cli("power", "--robot", tmp_path / "robot.yaml", *plan).flat_out
    assert "plan: 5 states in 1 trial, tendons up to 3.5 N, and robot.yaml states no max_tension" in said
    assert "rule them out: time_offset" in said
    assert not re.search("spine|vacuum|ballooning|thrust", said)


def predicted_table(trunk: Trunk, pulls: Sequence[float], base: Sequence[float] = (0, 0, 0)) -> np.ndarray:
    """Each tendon in turn pulled so far (N), and the tip (mm) by robot.yaml with its base there; written as the trunk's table."""
    tensions = [[pull * (k == j) for j in range(3)] for k in range(3) for pull in pulls]
    tips = lab.predict(lab.load_robot(trunk.robot), np.multiply(tensions, 1e4)).tip * 1e3 + base
    lines = ["t [s],F1 [N],F2 [N],F3 [N],tip x [mm],tip y [mm],tip z [mm]"]
    lines += [",".join(map(str, (3.0 * i, *f, *tip))) for i, (f, tip) in enumerate(zip(tensions, tips, strict=True))]
    trunk.table.write_text("\n".join(lines) + "\n")
    return tips


def test_an_arm_across_gravity_that_sags_as_its_robot_yaml_says_needs_no_straight_state(trunk: Trunk) -> None:
    arm = ROBOT.replace("180 mm", "320 mm").replace("[0, 0, 9.81]", "[0, -9.81, 0]").replace("[90 mm]", "[]")
    trunk.robot.write_text(arm.replace("320 kPa", "8 MPa").replace("107 kPa", "2.7 MPa"))
    assert abs(predicted_table(trunk, (0.0, 20.0, 40.0, 0.0))[0, 1]) > 0.05 * 320
    assert "straight" not in yaml.safe_load(trunk.guessed()[0])


@pytest.mark.parametrize("azimuth", [0, 45])
def test_axes_that_the_data_do_not_force_are_marked(azimuth: int, trunk: Trunk) -> None:
    trunk.robot.write_text(ROBOT.replace("[0, 120, 240]", f"[{azimuth}, {120 + azimuth}, {240 + azimuth}]"))
    proposed, _ = trunk.guessed()
    assert ("frame.x, frame.y: with the base''s x along the file''s x" in proposed) == bool(azimuth)
    assert "# axis of the robot's base (z from base to tip): axis of the file" in proposed


def test_a_map_takes_newtons_of_tendons(known: Trunk, tmp_path: Path) -> None:
    before, (head, rows) = known.case(), known.read()
    known.write([*head, "Rate"], [[*row, "500,0"] for row in rows])
    with known.changed() as values:  # pressures in three units of a tendon's tension
        values["columns"]["p1"]["unit"], values["columns"]["p2"]["unit"] = "N", "N/cm^2"
        del values["columns"]["p3"]["unit"]
        values["columns"]["rate"] = {"column": "Rate", "unit": "mN/s"}
    said = known.imported("again")
    assert not said.err and all(str(tmp_path / "again" / name) in said.out for name in ("robot.yaml", "trials.csv"))
    found = known.case("again")
    assert np.array_equal(found["p1"], before["p1"]) and np.array_equal(found["p3"], before["p3"])
    assert found["p1"].max() == pytest.approx(4e4) and set(found["rate"]) == {5e3}
    with known.changed() as values:
        values["columns"].pop("p3")
        values["columns"]["p1"]["unit"], values["constants"]["p3"], values["trials"]["below"] = "kPa", "500 mN", "60 gf"
    assert "column 'Seil_1 [N]' (columns.p1): the file says N, the map kPa" in known.imported("again").flat_err
    assert set(known.case("again")["p3"]) == {5e3} and known.case("again").trial.max() == 2
    known.write(head, [[cell(3 * n + k / 10), *row[1:]] for n, row in enumerate(rows) for k in range(20)])
    known.map.write_text(known.guessed()[0])
    assert "steady: 0.08 N" in known.map.read_text() and "25 states in 6 trials" in known.imported("again").out


@pytest.mark.parametrize(("reading", "noise", "named"), [("0,153", 0.01, True), ("0,000", 0.01, False), ("0,153", 0.0, False)])
def test_a_constant_reading_is_named_where_all_others_have_noise(reading: str, noise: float, named: bool, known: Trunk) -> None:
    head, rows = known.read()
    times = [(3 * n + k / 10, noise * (k % 3), row) for n, row in enumerate(rows) for k in range(20)]
    lines = [[cell(t), *(cell(number(c) + more) for c in row[1:4]), *row[4:]] for t, more, row in times]
    known.write(head, [[*line[:2], reading, *line[3:]] for line in lines])
    known.map.write_text(known.guessed()[0])
    for said in (known.imported("again"), known.cli("compare", known.folder.with_name("again"))):
        assert ("column p2: 0.153 N in all 15 states without noise, unlike the other tensions" in said.flat_err) is named


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


def test_a_column_of_tendons_pulled_begins_trials(tmp_path: Path, cli: Cli) -> None:
    trunk = Trunk(tmp_path / "lab", cli, "Zug_{} [N]")
    head, rows = trunk.read()
    trunk.write([*head, "Seile"], [[*row, str(1 + k // 7 % 3)] for k, row in enumerate(rows)])
    assert yaml.safe_load(trunk.guessed()[0])["trials"] == {"begin": "rest", "change": ["Seile"]}
