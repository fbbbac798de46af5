"""Where trials begin in tables of other laboratories, and maps that read the right file wrongly: each is asked about."""

import copy
import functools
import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import foreign
import numpy as np
import pytest
import yaml
from commands import Cli, refused
from foreign import AZIMUTHS, OWN_TABLE, ROBOT, plain
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from lab.files.config import load
from lab.imports.table import Imported
from lab.pages import import_figure
from model.prediction import Predictor
from model.robot import Robot
from recordings.table_file import read_csv

GROUPS = ((1,), (3,), (2,), (1, 3))
TWO_RESTS, ONE_REST, NO_REST = (0, 150, 350, 150, 0), (0, 150, 350, 150), (150, 350, 150)
"""mbar"""
HEADINGS = ("Zeit [s]", "Druck 1 [mbar]", "Druck 2 [mbar]", "Druck 3 [mbar]", "Spitze X [mm]", "Spitze Y [mm]", "Spitze Z [mm]")
Label = Callable[[int, int, tuple[int, ...], int, int], Sequence[str]]
"""Further cells of a row, from sweep, repeat, group, level and row, all from 0."""


def named(group: tuple[int, ...]) -> str:
    return "+".join(map(str, group))


def tip(pressures: Sequence[float]) -> list[float]:
    """mm, away from the chambers inflated (mbar)."""
    away = -0.05 * np.array([np.cos(AZIMUTHS), np.sin(AZIMUTHS)]) @ np.array(pressures)
    return [*away.tolist(), 150.0 - float(away @ away) / 180]


def table(
    levels: Sequence[float],
    label: Label,
    headings: Sequence[str],
    repeats: int = 2,
    each: int = 1,
    groups: Sequence[tuple[int, ...]] = GROUPS,
) -> str:
    """Each group in turn up and down, `repeats` times; `each` rows of every level, 0.05 s apart, else 7 s."""
    lines = [";".join([*HEADINGS, *headings])]
    for sweep, (repeat, group) in enumerate(itertools.product(range(repeats), groups)):
        for level, _ in itertools.product(range(len(levels)), range(each)):
            k = len(lines) - 1
            pressures = [levels[level] * (c in group) for c in (1, 2, 3)]
            numbers = [k * (7.0 if each == 1 else 0.05), *(p + 0.4 * np.sin(2.1 * k + i) for i, p in enumerate(pressures))]
            cells = [f"{v:.2f}".replace(".", ",") for v in [*numbers, *tip(pressures)]]
            lines.append(";".join([*cells, *label(sweep, repeat, group, level, k)]))
    return "\n".join(lines) + "\n"


def through(folder: Path, content: str) -> tuple[dict[str, Any], list[str], Imported]:
    """The proposed map, what it asks, and the table that it makes."""
    made, found = foreign.through(folder / "versuche.csv", content)
    return made.values, made.doubts, found


def by_map(folder: Path, content: str, **more: Any) -> Imported:
    (folder / "versuche.csv").write_text(content)
    names = zip(("t", "p1", "p2", "p3", "x", "y", "z"), HEADINGS, strict=True)
    return foreign.by_map(folder / "versuche.csv", columns=plain(**dict(names)) | more.pop("columns", {}), **more)


def lengths(made: Imported) -> list[int]:
    """States of each trial."""
    return np.bincount(made.table["trial"])[1:].tolist()


def repeats(made: Imported) -> list[int]:
    return [next(r.repeat for r in made.table if r.trial == trial) for trial in range(1, len(lengths(made)) + 1)]


def test_the_example_s_own_table_has_its_trials(tmp_path: Path, cli: Cli) -> None:
    words = ["import", OWN_TABLE / "sweep.csv", "--robot", OWN_TABLE / "robot.yaml"]
    cli(*words, "--guess", "--out", tmp_path)
    proposed = (tmp_path / "map.yaml").read_text()
    assert "not used" not in proposed
    assert yaml.safe_load(proposed)["trials"] == {"begin": "rest", "change": ["chambers"]}
    cli(*words, "--map", tmp_path / "map.yaml", "--out", tmp_path / "case")
    first = {r.trial: r for r in reversed(read_csv(tmp_path / "case" / "trials.csv").rows)}
    assert len(first) == 18 and [first[k].repeat for k in sorted(first)] == [1] * 6 + [2] * 6 + [3] * 6


# ------------------------------------------------------------------ rests
@pytest.mark.parametrize(
    ("levels", "each", "states"),
    [
        (TWO_RESTS, 1, [5] * 8),
        (ONE_REST, 1, [4] * 8),
        ((0, 350), 1, [2] * 8),
        ((0, 0, 150, 350, 0), 1, [5] * 8),
        (TWO_RESTS, 3, [15] * 8),
        (ONE_REST, 3, [12] * 8),
    ],
)  # fmt: skip
def test_the_rest_before_a_rise_belongs_to_it_and_that_after_a_descent_to_the_descent(
    levels: Sequence[float], each: int, states: list[int], tmp_path: Path
) -> None:
    made = by_map(tmp_path, table(levels, lambda *_: (), (), each=each), trials={"begin": "rest"})
    assert lengths(made) == states and repeats(made) == [1] * 4 + [2] * 4
    starts = [next(r for r in made.table if r.trial == k) for k in range(1, 9)]
    assert all(max(r.pressures) < 100 for r in starts)


def test_a_peak_without_a_tip_ends_the_load_branch(tmp_path: Path) -> None:
    head, *rows = table((0, 150, 350, 600, 350, 150, 0), lambda *_: (), ()).splitlines()
    lost = [";".join([*row.split(";")[:4], *([""] * 3 if k % 7 == 3 else row.split(";")[4:])]) for k, row in enumerate(rows)]
    made = by_map(tmp_path, "\n".join([head, *lost]), trials={"begin": "rest"})
    assert made.table["branch"].tolist() == [*["load"] * 3, *["unload"] * 3] * 8


def test_a_rest_over_time_is_one_state_of_the_trial_that_rises_unless_a_column_parts_it(tmp_path: Path) -> None:
    states = {"plateaus": {"steady": "2 kPa"}}
    content = table(TWO_RESTS, lambda s, r, g, i, k: (named(g),), ("Kammern",), each=40)
    made = by_map(tmp_path, content, trials={"begin": "rest"}, states=states)
    assert lengths(made) == [*[4] * 7, 5]
    made = by_map(tmp_path, content, trials={"begin": "rest", "change": ["Kammern"]}, states=states)
    assert lengths(made) == [5] * 8 and not made.notes


def test_a_column_that_changes_while_the_pressure_settles_parts_no_level(tmp_path: Path) -> None:
    content = table(TWO_RESTS, lambda s, r, g, i, k: (str(max(k - 44, 0) // 200),), ("Lauf",), each=40)
    made = by_map(tmp_path, content, trials={"begin": "rest", "change": ["Lauf"]}, states={"plateaus": {"steady": "2 kPa"}})
    assert lengths(made) == [5, *[4] * 7] and not made.notes


def test_a_table_that_never_rests_has_the_trials_of_its_columns(tmp_path: Path) -> None:
    content = table(NO_REST, lambda s, r, g, i, k: (str(r + 1), named(g)), ("Wiederholung", "Kammern"))
    made = by_map(tmp_path, content, trials={"change": ["Kammern"]}, columns={"repeat": {"column": "Wiederholung"}})
    assert lengths(made) == [3] * 8 and repeats(made) == [1] * 4 + [2] * 4 and not made.notes


def test_trials_that_follow_each_other_at_rest_are_kept(tmp_path: Path) -> None:
    levels = (0, 350, 0, 0, 0, 0)
    content = table(levels, lambda s, r, g, i, k: (str(10 * s + max(i - 1, 1)),), ("run",), repeats=1, groups=((1,), (2,)))
    assert lengths(by_map(tmp_path, content, trials={"change": ["run"]})) == [3, 1, 1, 1, 3, 1, 1, 1]


def test_what_a_gauge_reads_at_rest_is_asked_about_unless_the_map_states_its_zero(tmp_path: Path) -> None:
    head, *rows = (line.split(";") for line in table(TWO_RESTS, lambda *_: (), ()).splitlines())
    moved = [[*row[:2], f"{float(row[2].replace(',', '.')) + 12:.2f}".replace(".", ","), *row[3:]] for row in rows]
    content = "\n".join(map(";".join, (head, *moved)))
    (asked,) = by_map(tmp_path, content, trials={"begin": "rest"}).questions
    assert (
        asked.startswith("at rest p2 read 12 mbar, constant within their noise") and "write `zero: 12` under columns.p2" in asked
    )
    zero = {"p2": {"column": HEADINGS[2], "zero": 12.0}}
    assert by_map(tmp_path, content, trials={"begin": "rest"}, columns=zero).questions == ()


# ------------------------------------------------------------------ columns
@pytest.mark.parametrize(
    ("headings", "label"),
    [
        (("rep", "chambers"), lambda s, r, g, i, k: (str(r + 1), named(g))),
        (("Repetition", "inflated"), lambda s, r, g, i, k: (str(r), named(g) if i % 4 else "none")),
        (("Wdh", "Kammern"), lambda s, r, g, i, k: (str(r + 1), "".join("ABC"[c - 1] for c in g))),
        (("Durchlauf", "Sehnen"), lambda s, r, g, i, k: (f"D{r + 1}", ", ".join(f"S{c}" for c in g))),
        (("rep", "direction"), lambda s, r, g, i, k: (str(r + 1), {(1,): "x", (2,): "-x", (3,): "y", (1, 3): "-y"}[g])),
        (("rep", "Kammer"), lambda s, r, g, i, k: (str(r + 1), "".join(map(str, g)))),
        (("rep", "chambers"), lambda s, r, g, i, k: (str(r + 1) if k % 3 else "", named(g) if k % 4 == 2 else "-")),
        (("Versuch",), lambda s, r, g, i, k: (str(s + 1),)),
        (("run",), lambda s, r, g, i, k: (str(r + 1),)),
        (("run", "rep"), lambda s, r, g, i, k: (str(k), "1")),
        (("group", "direction"), lambda s, r, g, i, k: (named(g), "hin" if i < 3 else "ab")),
    ],
)  # fmt: skip
@pytest.mark.parametrize("levels", [TWO_RESTS, ONE_REST])
def test_trials_are_found_by_what_columns_count_and_name(
    levels: Sequence[float], headings: Sequence[str], label: Label, tmp_path: Path
) -> None:
    _, _, made = through(tmp_path, table(levels, label, headings))
    assert lengths(made) == [len(levels)] * 8 and repeats(made) == [1] * 4 + [2] * 4, made.notes
    assert made.table["p2"] / 100 == pytest.approx([lev * (2 in g) for g in (*GROUPS, *GROUPS) for lev in levels], abs=0.5)


@pytest.mark.parametrize(
    ("headings", "label", "said"),
    [
        (("rep",), lambda s, r, g, i, k: ("1",), "not used: rep, which is the same in all rows"),
        (("rep",), lambda s, r, g, i, k: (str(1 + (k > 22)),), "'rep' changes while chambers are inflated (first from '1' to '2' "
         "in line 25): it is not used"),
        (("Kammern",), lambda s, r, g, i, k: ("9" if k == 12 else named(g),), "from '2' to '9' in line 14): no trial begins"),
        (("direction",), lambda s, r, g, i, k: ("1" if i < 3 else "-1",), "'direction' changes while chambers are inflated"),
    ],
)  # fmt: skip
def test_columns_that_rests_contradict_are_asked_about(headings: Sequence[str], label: Label, said: str, tmp_path: Path) -> None:
    _, doubts, made = through(tmp_path, table(TWO_RESTS, label, headings))
    assert any(said in d for d in doubts), doubts
    assert lengths(made) == [5] * 8 and repeats(made) == [1] * 4 + [2] * 4


def test_a_wrong_repeat_is_named_and_neither_begins_a_trial_nor_counts(tmp_path: Path) -> None:
    content = table(TWO_RESTS, lambda s, r, g, i, k: ("5" if k == 12 else str(r + 1),), ("Wiederholung",), repeats=3)
    made = by_map(tmp_path, content, trials={"begin": "rest"}, columns={"repeat": {"column": "Wiederholung"}})
    assert lengths(made) == [5] * 12 and repeats(made) == [1] * 4 + [2] * 4 + [3] * 4
    assert set(made.table["repeat"].tolist()) == {1, 2, 3}
    note = "versuche.csv, line 14: column 'Wiederholung' (columns.repeat) changes from '1' to '5' while p2 is 35 kPa, not at rest"
    assert any(n.startswith(note) and "no trial begins there" in n for n in made.notes)


def test_words_may_count_repeats(tmp_path: Path) -> None:
    content = table(TWO_RESTS, lambda s, r, g, i, k: ("AB"[r],), ("Wiederholung",))
    columns = {"repeat": {"column": "Wiederholung", "values": {"A": 3, "B": "1"}}}
    assert repeats(by_map(tmp_path, content, trials={"begin": "rest"}, columns=columns)) == [3] * 4 + [1] * 4


def test_repeats_that_are_the_same_for_trials_alike_are_asked_about(tmp_path: Path) -> None:
    content = table(TWO_RESTS, lambda *_: ("1",), ("Wiederholung",))
    made = by_map(tmp_path, content, trials={"begin": "rest"}, columns={"repeat": {"column": "Wiederholung"}})
    assert any("trials 1 and 5 inflate the same chambers as far, and column 'Wiederholung' says" in n for n in made.notes)
    content = table(TWO_RESTS, lambda s, r, g, i, k: ("1", str(50 * r)), ("Wiederholung", "Haken [g]"))
    made = by_map(tmp_path, content, trials={"begin": "rest"}, columns={"repeat": {"column": "Wiederholung"}})
    assert any("column 'Haken [g]' differs between them and is not used: map it, e.g. as tip_mass" in n for n in made.notes)
    (said,) = [n for n in made.notes if "'Haken [g]' is not used" in n]
    assert "if it loads the tip, write `tip_mass: {column: Haken [g], unit: g}` under columns" in said
    for heading, cell, key in (("push [N]", "0.5", "write `force_z: "), ("weight_g", "0", ""), ("scale_g", "{k}", "")):
        content = table(TWO_RESTS, lambda s, r, g, i, k, cell=cell: (cell.format(k=k),), (heading,))  # type: ignore[misc]
        notes = by_map(tmp_path, content, trials={"begin": "rest"}).notes
        assert [key in n for n in notes if "is not used" in n] == [True] * bool(key), notes


def test_a_trial_column_says_where_trials_begin_and_a_change_under_pressure_is_noted(tmp_path: Path) -> None:
    content = table(TWO_RESTS, lambda s, r, g, i, k: ("9" if k in (22, 23) else str(s % 4),), ("trial",))
    made = by_map(tmp_path, content, trials={"begin": "rest"}, columns={"trial": {"column": "trial"}})
    assert lengths(made) == [5, 5, 5, 5, 2, 3, 5, 5, 5]
    assert any("line 24: column 'trial' (columns.trial) changes" in n and "a trial begins there" in n for n in made.notes)


@pytest.mark.parametrize(
    ("label", "said"),
    [
        (lambda k: "1", "states were repeated within one trial only"),
        (lambda k: str(1 + k % 3), "columns.trial: 40 trials in 40 states, though the robot rests in between: does it count"),
    ],
)  # fmt: skip
def test_what_to_write_instead_of_a_column_that_counts_no_trials_is_said_and_helps(
    label: Callable[[int], str], said: str, tmp_path: Path
) -> None:
    content = table(TWO_RESTS, lambda s, r, g, i, k: (label(k),), ("trial",))
    (*_, note) = by_map(tmp_path, content, columns={"trial": {"column": "trial"}}).notes
    assert said in note and note.endswith("leave out columns.trial, and write `trials: {begin: rest}` in map.yaml"), note
    made = by_map(tmp_path, content, trials={"begin": "rest"})
    assert lengths(made) == [5] * 8 and not made.notes


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"trials": {"change": ["Kammer"]}}, "trials.change = 'Kammer': no such column"),
        ({"trials": {"begin": "state", "change": ["Kammern"]}}, "begin: state begins a trial with each state; leave out"),
        ({"trials": {"change": ["Kammern"]}, "columns": {"trial": {"column": "run"}}}, "columns.trial also states where"),
    ],
)  # fmt: skip
def test_what_a_map_says_wrong_of_trials_is_named(more: dict[str, Any], said: str, tmp_path: Path) -> None:
    content = table(TWO_RESTS, lambda s, r, g, i, k: (str(s), named(g)), ("run", "Kammern"))
    assert said in refused(None, by_map, tmp_path, content, **more)


def test_words_in_a_column_of_numbers_make_no_footer_of_the_last_sweep(tmp_path: Path) -> None:
    content = table(ONE_REST, lambda s, r, g, i, k: (named(g),), ("Kammern",), repeats=1, groups=((1,), (2,), (3,), (1, 2)))
    _, _, made = through(tmp_path, content)
    assert len(made.table) == 16 and lengths(made) == [4] * 4 and not made.notes
    _, _, made = through(tmp_path, content + "Mittel;10;10;10;0;0;150;0\n")
    assert len(made.table) == 16 and any("line 18 is not a row of numbers" in n for n in made.notes)


# ------------------------------------------------------------------ the picture
@pytest.mark.usefixtures("drawn")
@pytest.mark.parametrize(
    ("groups", "titles"),
    [
        (((2,),), ["p2"]),
        (((1,), (3,), (1, 3), (1, 2, 3)), ["p1", "p3", "p1 + p3", "p1 + p2 + p3"]),
        (((1,), (2,), (3,), (1, 2), (1, 3), (2, 3)), ["p1", "p2", "p3", "p1 + p2", "p1 + p3", "p2 + p3"]),
    ],
)  # fmt: skip
def test_the_picture_has_a_panel_for_each_group_and_legends_beside_the_data(
    groups: tuple[tuple[int, ...], ...], titles: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr(import_figure, "save", lambda figure, path: drawn.append(figure))
    made = by_map(tmp_path, table(ONE_REST, lambda *_: (), (), groups=groups), trials={"begin": "rest"})
    import_figure.draw(made, load(ROBOT, Robot), tmp_path / "states.png")
    (figure,) = drawn
    figure.canvas.draw()
    axes = [ax for ax in figure.axes if ax.axison]
    assert [ax.get_title() for ax in axes if ax.get_title().startswith("p")] == titles
    assert all(", " in ax.get_ylabel() for ax in axes)  # a quantity and its unit
    legends = [legend for ax in axes if (legend := ax.get_legend()) is not None]
    assert len(legends) == 2
    for legend, ax in itertools.product(legends, axes):
        assert not legend.get_window_extent().overlaps(ax.get_window_extent()), ax.get_ylabel()


# ------------------------------------------------------------------ maps that read the right file wrongly
ANGLES, QUATERNION = ("phi x [deg]", "phi y [deg]", "phi z [deg]"), ("q w", "q x", "q y", "q z")
HALF, MATRIX = ("mid x", "mid y", "mid z"), [[f"R{i}{k}" for k in "123"] for i in "123"]
EACH_AND_PAIRS = ((1,), (2,), (3,), (1, 2), (2, 3))


@functools.cache
def content() -> str:
    """Each group up and down twice, as the rod has it (mbar, mm): the tip, its angles, quaternion and matrix, and a marker
    at half the length."""
    robot, lines = load(ROBOT, Robot), [";".join([*HEADINGS, *ANGLES, *HALF, *QUATERNION, *sum(MATRIX, [])])]
    asked = [(level, group) for group in 2 * EACH_AND_PAIRS for level in (0, 200, 450, 200, 0)]
    pressures = np.array([[level * (c in group) for c in (1, 2, 3)] for level, group in asked], float)
    rod = Predictor(robot)(100.0 * pressures, arcs=[robot.length / 2])
    turn = Rotation.from_quat(rod.orientation, scalar_first=True)
    angles, rows = turn.as_euler("xyz", degrees=True), turn.as_matrix().reshape(-1, 9)
    for k, values in enumerate(np.column_stack([pressures, 1e3 * rod.tip, angles, 1e3 * rod.shape[:, 0], rod.orientation, rows])):
        lines.append(";".join(f"{v:.3f}".replace(".", ",") for v in (7.0 * k, *values)))
    return "\n".join(lines) + "\n"


RIGHT: dict[str, Any] = {
    "columns": plain(**dict(zip(("t", "p1", "p2", "p3", "x", "y", "z"), HEADINGS, strict=True))),
    "orientation": {"columns": list(ANGLES), "order": "euler xyz"},
    "points": {"m1": {"of": [list(HALF)], "unit": "mm"}},
    "trials": {"begin": "rest"},
}
Change = Callable[[dict[str, Any]], object]


def exchange(a: str, b: str) -> Change:
    def change(values: dict[str, Any]) -> None:
        columns = values["columns"]
        columns[a], columns[b] = columns[b], columns[a]

    return change


def column(name: str, **more: Any) -> Change:
    return lambda values: values["columns"].setdefault(name, {}).update(more)


def also(**more: Any) -> Change:
    return lambda values: values.update(more)


def told(folder: Path, content: str, values: dict[str, Any], cli: Cli) -> str:
    """What the import notes or refuses."""
    (folder / "a.csv").write_text(content)
    (folder / "robot.yaml").write_text(ROBOT.read_text().replace("markers: [0.05, 0.10]", "markers: [0.075]"))
    (folder / "map.yaml").write_text(yaml.safe_dump({"robot": "robot.yaml"} | values))
    return cli("import", folder / "a.csv", "--map", folder / "map.yaml", "--out", folder / "case", code=(0, 2)).flat_err


@pytest.mark.parametrize(
    ("order", "columns"),
    [("euler xyz", ANGLES), ("matrix rows", sum(MATRIX, [])), ("axes xz", [row[k] for k in (0, 2) for row in MATRIX])],
)
def test_a_right_map_is_not_asked_about(order: str, columns: Sequence[str], tmp_path: Path, cli: Cli) -> None:
    assert told(tmp_path, content(), RIGHT | {"orientation": {"columns": [*columns], "order": order}}, cli) == ""
    turns = [read_csv(tmp_path / "case" / "trials.csv")[name] for name in ("qx", "qy", "qz")]
    assert np.abs(turns).max() > 0.1


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (exchange("p2", "p3"), "chambers 2 and 3 are swapped"),
        pytest.param(exchange("x", "y"), "along the base's axes its columns are x: y, y: x, z: z", marks=pytest.mark.long),
        (column("y", scale=-1), "the turn of the tip does not fit its place (agreement of directions"),
        pytest.param(also(frame={"x": "y", "y": "-x", "z": "z"}), "all azimuths are 90 deg off", marks=pytest.mark.long),
        (also(frame={"x": "y", "y": "z", "z": "x"}, straight="first state"), "write `frame: {x: x, y: y, z: z}` in map.yaml"),
        (column("p2", scale=10), "column Druck 2 [mbar] must be 0.1 times as large"),
        pytest.param(column("p2", unit="psi"), "column p2: 3.10264e+06 Pa gauge, must be at most 2e+06 Pa gauge: check its unit",
                     marks=pytest.mark.long),
        (column("p2", unit="kPa"), "the file says mbar, the map kPa"),
        (lambda v: v["orientation"].update(order="euler XYZ"), "orientation.order euler XYZ: the tip turns by"),
        pytest.param(lambda v: v["orientation"].update(order="rotation vector"), "with euler xyz, by 0.0 deg: check the order",
                     marks=pytest.mark.long),
        (lambda v: v["orientation"].update(columns=sum(MATRIX, []), order="matrix columns"), "write `order: matrix rows` under"),
        (lambda v: v["orientation"].update(columns=list(ANGLES[::-1])), "write `order: euler ZYX` under orientation"),
        (lambda v: v["orientation"].update(columns=list(QUATERNION), order="xyzw"),
         "with wxyz, by 0.0 deg: check the order, and if it is this one, write `order: wxyz` under orientation"),
        (lambda v: v.update(orientation={"columns": [*QUATERNION[1:], QUATERNION[0]]}, frame={"x": "y", "y": "-x", "z": "z"},
                            straight="at rest"), "write `order: xyzw` under orientation"),
        (lambda v: v.pop("points") and v["columns"].update({a: {"column": f"mid {a}", "unit": "mm"} for a in "xyz"}),
         "no single mistake explains it: check which marker is the tip"),
        (column("roll_deg", column="phi y [deg]"), "write it under orientation"),
        (lambda v: (column("roll_deg", column="phi y [deg]")(v), also(trials={"begin": "state"})(v)),
         "columns.roll_deg: the pressures account for"),
        (lambda v: [column(f"p{k}", zero=30.0)(v) for k in (1, 2, 3)],
         "all chambers read -3.0 kPa at rest, which is then not found as rest: is this the pressure of the room? If so, write "
         "`zero: 0` (mbar) under columns.p1 .."),
        (column("tip_mass", column=HEADINGS[0], unit="g"), "is this column really a mass at the tip?"),
    ],
)  # fmt: skip
def test_a_wrong_map_is_asked_about(change: Change, said: str, tmp_path: Path, cli: Cli) -> None:
    values = copy.deepcopy(RIGHT)
    change(values)
    assert said in told(tmp_path, content(), values, cli)
