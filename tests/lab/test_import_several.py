"""Several files, columns that differ among them, contradicting units, exchanged markers: asked about, never guessed."""

import re
import shutil
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from commands import Cli, refused
from foreign import ROBOT, by_map, guessed, plain, tips

import lab
from benchmarks.faults.foreign_tables import PLATEAUS, STATES, sweep, text
from diagnosis.data.case import campaign_of
from lab.files.config import ConfigError, load
from lab.files.jumps import believed, copies, strays
from lab.imports.proposal import Guess
from lab.imports.table import Imported
from lab.verbs.import_data import grouped
from model.robot import Robot
from recordings.table_file import write_csv
from recordings.trials import TIP, Table

Rows = list[list[float]]
FEW, MANY = sweep(), sweep(40)
NAMES = ("t [s]", "p1 [kPa]", "p2 [kPa]", "p3 [kPa]", *(f"tip {a} [mm]" for a in "xyz"), *(f"mid {a} [mm]" for a in "xyz"))
COLUMNS: dict[str, Any] = dict(zip(("t", "p1", "p2", "p3", "x", "y", "z", "m1x", "m1y", "m1z"), NAMES, strict=True))


def with_middle(k: int, cells: list[str]) -> list[str]:
    """A second marker half-way."""
    return [*cells, *(f"{float(v) * f:.3f}" for v, f in zip(cells[4:], (0.3, 0.3, 0.5), strict=True))]


def exchanged(k: int, cells: list[str]) -> list[str]:
    cells = with_middle(k, cells)
    return [*cells[:4], *cells[7:], *cells[4:7]]


def read_all(folder: Path, contents: Mapping[str, str], order: Sequence[str] | None = None, **more: Any) -> Imported:
    for name, content in contents.items():
        (folder / name).write_text(content)
    values = {"columns": plain(**COLUMNS), "trials": {"begin": "rest"}} | more
    return by_map([folder / name for name in order or contents], **values)


WHOLE = text(FEW, headings=NAMES, change=with_middle)


# ------------------------------------------------------------------ markers
@pytest.mark.parametrize(
    ("change", "line"),
    [
        (lambda k, c: (with_middle if k < 18 else exchanged)(k, c), "a.csv, line 20"),
        (lambda k, c: (exchanged if k in (6, 7) else with_middle)(k, c), "a.csv, line 8"),
    ],
)
def test_markers_exchanged_within_a_file_are_asked_about(change: Any, line: str, tmp_path: Path) -> None:
    made = read_all(tmp_path, {"a.csv": text(FEW, headings=NAMES, change=change)})
    assert any(line in n and "the tip and marker 1 swap places: were they confused?" in n for n in made.notes)


def test_the_first_of_many_jumps_that_are_not_told_one_by_one_is_named(tmp_path: Path) -> None:
    often = text(FEW, headings=NAMES, change=lambda k, c: (with_middle, exchanged)[k % 5 == 4](k, c))
    assert any(n.startswith("a.csv, line 12: the first of 8 further") for n in read_all(tmp_path, {"a.csv": often}).notes)


def test_markers_exchanged_from_file_to_file_are_asked_about(tmp_path: Path) -> None:
    contents = {"a.csv": WHOLE, "b.csv": text(FEW, headings=NAMES, change=exchanged)}
    made = read_all(tmp_path, contents)
    assert any("b.csv, line 2" in n and "swap places" in n for n in made.notes)
    own = plain(**dict(zip(("x", "y", "z", "m1x", "m1y", "m1z"), (*NAMES[7:], *NAMES[4:7]), strict=True)))
    made = read_all(tmp_path, contents, files={"b.csv": {"columns": own}, "*": {}})
    assert not made.notes and tips(made.table)[STATES:] == pytest.approx(tips(made.table)[:STATES])


@pytest.mark.parametrize("straight", ["as recorded", "at rest", "first row"])
@pytest.mark.parametrize("loaded", [False, True])
def test_markers_in_another_order_in_one_file_are_always_asked_about(straight: str, loaded: bool, tmp_path: Path) -> None:
    contents = {"a.csv": WHOLE, "b.csv": text(FEW, headings=NAMES, change=exchanged), "c.csv": WHOLE}
    files: dict[str, Any] = {"b.csv": {"tip_mass": "20 g"}, "*": {}} if loaded else {}
    made = read_all(tmp_path, contents, straight=straight, files=files)
    (question,) = made.questions
    assert "b.csv: at rest the tip stands where marker 1 does, marker 1 stands where the tip does in a.csv" in question


def test_a_tip_behind_the_base_in_one_file_is_asked_about(tmp_path: Path) -> None:
    def of_two(k: int, cells: list[str], turned: bool) -> list[str]:
        base, end = ["0.5", "0.5", "10"], [cells[4], cells[5], f"{float(cells[6]) + 10:.3f}"]
        return [*cells[:4], *(base + end if turned else end + base)]

    contents = {f"{name}.csv": text(FEW, headings=NAMES, change=lambda k, c, n=name: of_two(k, c, n == "b")) for name in "abc"}
    points = {"tip": {"of": [list(NAMES[4:7])], "against": [list(NAMES[7:])]}}
    columns = plain(**{n: c for n, c in COLUMNS.items() if n[0] in "tp"})
    (question,) = read_all(tmp_path, contents, columns=columns, points=points).questions
    assert "b.csv: at rest the tip is behind the base, 300 mm from where it is in a.csv" in question
    turned = {"tip": {"of": [list(NAMES[7:])], "against": [list(NAMES[4:7])]}}
    own = {"b.csv": {"points": turned}, "*": {}}
    assert not read_all(tmp_path, contents, columns=columns, points=points, files=own).questions


def test_a_marker_that_jumps_is_asked_about_and_one_that_bends_is_not(tmp_path: Path) -> None:
    def moved(k: int, cells: list[str]) -> list[str]:
        cells = with_middle(k, cells)
        return cells if k < 13 else [*cells[:5], f"{float(cells[5]) + 37:.3f}", *cells[6:]]

    made = read_all(tmp_path, {"a.csv": text(FEW, headings=NAMES, change=moved)})
    assert any("a.csv, line 16: the tip moves by 37.0 mm" in n and "farther than the body can" in n for n in made.notes)
    assert not read_all(tmp_path, {"a.csv": WHOLE}).notes


def test_places_logged_a_row_late_from_a_row_on_are_named_with_lines_and_remedy(tmp_path: Path) -> None:
    rows = [[4.0 * k, *row[1:]] for k, row in enumerate(FEW + FEW)]
    late = [row if k < 40 else [*row[:4], *rows[k - 1][4:]] for k, row in enumerate(rows)]
    (note,) = (n for n in read_all(tmp_path, {"a.csv": text(late, headings=NAMES, change=with_middle)}).notes if "logged" in n)
    assert re.match(r"a.csv, line 4[23] to a.csv, line 61 .*positions are logged 1 row late.*markers 1 row up there", note)
    lost = [row if k != 7 else [*row[:4], 2270.0, *row[5:]] for k, row in enumerate(late)]  # nor hides a filler the shift
    assert any("1 row late" in n for n in read_all(tmp_path, {"a.csv": text(lost, headings=NAMES, change=with_middle)}).notes)
    assert not read_all(tmp_path, {"a.csv": text(rows, headings=NAMES, change=with_middle)}).notes


@pytest.mark.parametrize(("body", "row", "mm", "states"), [(0, 6, 37, 3), (1, 6, 37, 3), (0, 4, 20, 11)])
def test_a_place_that_all_other_states_at_its_pressures_contradict_is_left_out(
    body: int, row: int, mm: float, states: int, tmp_path: Path
) -> None:
    def moved(k: int, cells: list[str]) -> list[str]:
        cells = with_middle(k, cells)
        cells[5 + 3 * body] = f"{float(cells[5 + 3 * body]) + mm * (k == row):.3f}"
        return cells

    made = read_all(tmp_path, {"a.csv": text(FEW, headings=NAMES, change=moved)})
    (note,) = made.notes
    assert f"a.csv, line {row + 2}: {('the tip', 'marker 1')[body]} moves by" in note and f"unlike in all {states} states" in note
    assert len(made.table) == STATES - (body == 0) and np.isnan(made.table.markers[row]).all() == (body == 1)


def test_points_that_change_places_in_one_state_alone_are_left_out(tmp_path: Path) -> None:
    for row in (3, 6):
        content = text(FEW, headings=NAMES, change=lambda k, c, row=row: (exchanged if k == row else with_middle)(k, c))
        made = read_all(tmp_path, {"a.csv": content})
        (note,) = made.notes
        assert f"a.csv, line {row + 2}: the tip and marker 1 swap places, unlike in all" in note and len(made.table) == STATES - 1


def test_markers_that_change_places_in_one_state_are_both_left_out_without_an_import(tmp_path: Path) -> None:
    whole = read_all(tmp_path, {"a.csv": WHOLE}).table
    places = {f"m{k}{a}": share * whole[a] for k, share in ((1, 0.3), (2, 0.8)) for a in "xyz"}
    here = np.arange(STATES) == 6
    swapped = {name: np.where(here, places[name.translate({49: 50, 50: 49})], own) for name, own in places.items()}
    with pytest.warns(match="marker 1 and marker 2 swap places, unlike in all"):
        table = lab.case(whole.replaced(swapped).to_frame(), ROBOT).table
    assert len(table) == STATES and (np.isnan(table.markers).all(axis=(1, 2)) == here).all()


@pytest.mark.parametrize("body", [0, 1])
def test_a_place_that_its_table_contradicts_is_left_out_without_an_import(body: int, tmp_path: Path) -> None:
    whole, x = read_all(tmp_path, {"a.csv": WHOLE}).table, ("x", "m1x")[body]
    settings = {"spine_length": (0.1, 1e-4), "vacuum": (80e3, 500.0), "tip_mass": (0.02, 1e-4), "roll_deg": (0.0, 0.1)}
    loads = {name: mean + sd * np.random.default_rng(0).normal(size=STATES) for name, (mean, sd) in settings.items()}
    moved = replace(whole.replaced(loads | {x: whole[x] + 0.037 * (np.arange(STATES) == 6)}), mapped=None)
    (case := tmp_path / "by_hand").mkdir()
    write_csv(moved, case / "trials.csv")
    shutil.copy(ROBOT, case)
    for given in ((case,), (moved.to_frame(), ROBOT)):
        with pytest.warns(match=f"{('the tip', 'marker 1')[body]} moves by 3... mm .*unlike in all 3 states") as said:
            table = lab.case(*given).table
        assert len(said) == 1 and len(table) == STATES - (body == 0) and np.isnan(table.markers[6]).all() == (body == 1)
    write_csv(whole, case / "trials.csv")
    assert len(lab.case(case).table) == STATES


@pytest.mark.parametrize("body", [0, 1])
def test_a_place_far_from_its_repeats_is_left_out_and_places_that_scatter_are_not(body: int, tmp_path: Path) -> None:
    table = read_all(tmp_path, {"a.csv": WHOLE}).table
    x, noise = ("x", "m1x")[body], np.random.default_rng(1).normal(0.0, 3e-4, (3, STATES))
    repeated = Table.joined([replace(table, warnings=()).replaced({x: table[x] + own}) for own in noise])
    bad = repeated.replaced({x: repeated[x] + 0.012 * (np.arange(3 * STATES) == 2 * STATES + 8)})
    with pytest.warns(match=f"trial .* step .*: {('the tip', 'marker 1')[body]} is 1[12][.]. mm from all its repeats") as said:
        kept = lab.case(bad.to_frame(), ROBOT).table
    assert len(said) == 1 and len(kept) == 3 * STATES - (body == 0) and np.isnan(kept.markers).sum() == 3 * (body == 1)
    lost = repeated.replaced({x: np.where(np.arange(3 * STATES) == 7, -1.6, repeated[x])}).to_frame()
    with pytest.warns(match=rf"{('the tip', 'marker 1')[body]} is 1[.]6\d? m from the base") as said:
        assert len(lab.case(lost, ROBOT).table) == 3 * STATES - (body == 0)
    assert len(said) == 1  # and nothing of its neighbours
    bent = np.arange(3 * STATES) == np.linalg.norm(repeated.tip[:, :2], axis=1).argmax()  # its regulators read 0
    unread = {p: np.where(bent, 0.0, repeated[p]) for p in ("p1", "p2", "p3")} | {"branch": np.where(bent, "unload", "load")}
    with pytest.warns(match="the tip is .* mm from all its repeats"):
        assert len(lab.case(repeated.replaced(unread).to_frame(), ROBOT).table) == 3 * STATES - 1
    slipped = repeated.replaced({x: repeated[x] + 0.02 * (repeated.trial == repeated.trial[-1])})
    assert len(lab.case(slipped.to_frame(), ROBOT).table) == 3 * STATES


@pytest.mark.parametrize(
    ("error", "states", "found"),
    [((0.0, 9e-3, 0.0), [7], 1), ((0.0, 9e-3, 0.0), [7, 8], 0), ((0.0, 9e-3, 0.0), [9], 0), ((-9e-3, 0.0, 0.0), [7], 1),
     ((-9e-3, 0.0, 0.0), [7, 12], 0), ((-4e-3, 0.0, 0.0), [7], 1), ((-4e-3, 0.0, 0.0), [*range(5, 10)], 0)],
)  # fmt: skip
def test_one_place_off_the_path_of_all_repeats_is_left_out_and_what_lasts_recurs_or_snaps_at_the_peak_is_not(
    error: tuple[float, ...], states: list[int], found: int
) -> None:
    pressures, n = np.tile([0.0, 60e3, 80e3, 100e3, 120e3], 16), 80
    tip = np.column_stack([1e-6 * pressures, np.zeros(n), np.full(n, 0.3)])
    tip += np.random.default_rng(0).normal(0.0, 2e-4, tip.shape)
    tip[states] += error
    columns = {"trial": np.arange(n) // 5, "p1": pressures, **dict(zip(TIP, tip.T, strict=True))}
    own = campaign_of(Table({"spine_length": np.zeros(n), **columns}), np.arange(n), np.arange(0))
    assert len(list(strays(own, 0.3))) == found


@pytest.mark.parametrize(("error", "found"), [(0.0, 0), (0.02, 1)])
def test_hysteresis_makes_no_state_a_stray_whose_own_branch_is_not_repeated(error: float, found: int) -> None:
    pressures, at = np.tile([0.0, 60e3, 80e3, 100e3, 120e3, 100e3, 80e3, 60e3], 9), np.arange(72)
    unload = at % 8 > 4
    x = 1e-6 * pressures + 0.03 * unload + np.random.default_rng(0).normal(0.0, 2e-4, 72) - error * (at == 9)
    columns = {"trial": at // 8, "branch": np.where(unload, "unload", "load"), "p1": pressures, "x": x}
    table = Table({"y": 0.0 * x, "z": 0.3 + 0.0 * x, "spine_length": 0.0 * x, **columns}).take((at % 8 != 5) | (at == 5))
    assert len([*strays(campaign_of(table, np.arange(len(table)), np.arange(0)), 0.3)]) == found


@pytest.mark.parametrize(
    ("wrong", "repeats", "found"),
    [
        ("exchanged", 1, "pressures 2 and 3 are exchanged: the tip is .* mm from where the other states put it"),
        ("misplaced", 1, "the tip is .* mm from where the other states put it"),
        ("misplaced", 2, "the tip is .* mm from all its repeats"),
        ("corner", 2, "the tip is .* mm from all its repeats"),
        ("loaded", 3, "the tip is .* mm from where the other states put it"),
        ("snaps", 1, ""),
    ],
)  # fmt: skip
def test_the_other_states_show_which_one_is_misread_and_no_law_of_the_body_is(wrong: str, repeats: int, found: str) -> None:
    random, at = np.random.default_rng(3), np.arange(repeats * 60)
    once = 10e3 * random.integers(0, 11, (60, 3))
    once[7:9] = (30e3, 90e3, 10e3), (100e3 * (wrong != "loaded"), 0.0, 0.0)  # so that state 7 is a peak under a load alone
    once[7] = (140e3, 140e3, 140e3) if wrong == "corner" else once[7]  # few other states are near
    pressures = np.tile(once, (repeats, 1))
    tip = np.column_stack([2e-7 * (pressures[:, :2] - pressures[:, 2:]), 0.15 - 4e-12 * pressures[:, 0] ** 2])
    tip += random.normal(0.0, 2e-4, tip.shape)
    tip[7] += 0.04 * (wrong in ("misplaced", "corner", "loaded"))
    mass = 0.05 * (at < 60) * (wrong == "loaded")
    tip[pressures[:, 0] > 93e3] += 0.03 * (wrong == "snaps")
    pressures[7] = pressures[7, [0, 2, 1]] if wrong == "exchanged" else pressures[7]
    columns = dict(zip(("p1", "p2", "p3", *TIP), np.column_stack([pressures, tip]).T, strict=True))
    columns |= {"spine_length": 0.0 * at, "tip_mass": mass, "trial": at // 10, "step": at}
    kept = believed(Table(columns), load(ROBOT, Robot))
    assert len(kept) == len(at) - len(kept.warnings) == len(at) - bool(found)
    assert not found or re.match(f"trial 0 step 7: {found}", kept.warnings[0])


def test_a_state_within_which_markers_are_exchanged_is_left_out(tmp_path: Path) -> None:
    content = text(MANY, headings=NAMES, change=lambda k, c: (with_middle if k < 500 else exchanged)(k, c))
    made = read_all(tmp_path, {"a.csv": content}, states={"plateaus": {"steady": "1 kPa"}})
    assert any(
        "a.csv, line 502: a marker jumps within a state" in n and "0 rows and 1 states are left out" in n for n in made.notes
    )
    z = tips(made.table)[:, 2]
    assert ((z > 138) | (z < 76)).all()


def test_a_row_in_which_a_marker_jumps_and_comes_back_is_left_out_of_its_state(tmp_path: Path) -> None:
    content = text(MANY, headings=NAMES, change=lambda k, c: (exchanged if k % 50 == 27 else with_middle)(k, c))
    made = read_all(tmp_path, {"a.csv": content}, states={"plateaus": {"steady": "1 kPa"}})
    assert len(made.table) == PLATEAUS and tips(made.table)[:, 2].min() > 144
    assert any("a.csv, line 29: a marker jumps within a state" in n and " and 0 states are left out" in n for n in made.notes)


@pytest.mark.parametrize("scatters", [True, False])
def test_copies_count_once_and_repeats_that_nothing_scatters_are_none(scatters: bool, tmp_path: Path) -> None:
    table = read_all(tmp_path, {"a.csv": WHOLE}).table
    digits = dict.fromkeys(("x", "y", "z", "m1x", "m1y", "m1z"), 3) | dict.fromkeys(("p1", "p2", "p3"), -3)
    noise = np.random.default_rng(1).normal(0.0, 3e-4, STATES)
    table = table.replaced({"x": table["x"] + noise} if scatters else {n: np.round(table[n], k) for n, k in digits.items()})
    with warnings.catch_warnings(record=True) as said:
        read = lab.case(Table.joined([replace(table, warnings=())] * 2).to_frame(), ROBOT).table
    assert len(read) == (1 if scatters else 2) * STATES
    assert any("repeats trial 1 step 1 to trial 6 step 5 to the last digit" in str(w.message) for w in said) == scatters
    still = table.replaced({n: np.where(np.arange(STATES) == 7, np.roll(table[n], 1), table[n]) for n in digits if n[0] != "p"})
    every = np.arange(2 * STATES)
    left_out = [row for rows, _ in copies(campaign_of(Table.joined([still] * 2), every, every[:0])) for row in rows.tolist()]
    assert left_out == [*range(STATES, 2 * STATES)] * scatters  # a tracker that stands still and its copy, too


@pytest.mark.parametrize(
    ("column", "number", "states", "text"),
    [
        ("p3", 7e5, 1, "pressure 700 kPa, .* times (the highest of the others|max_pressure)"),
        ("p3", -6e4, 1, "pressure -60 kPa"),
        ("tip_mass", 0.2, 1, "tip_mass 200 g, 10 times the highest of the others"),
        ("spine_length", 1.0, 1, "spine_length 1000 mm, .* times the robot's length"),
        ("p3", 7e5, 4, ""),
        ("still", 0.0, 1, "the tip repeats the state before to the last digit: left out"),
    ],
)  # fmt: skip
def test_few_slipped_numbers_and_a_tracker_that_stands_still_are_left_out(
    column: str, number: float, states: int, text: str, tmp_path: Path
) -> None:
    table = read_all(tmp_path, {"a.csv": WHOLE}).table
    noise = np.random.default_rng(1).normal(0.0, 3e-4, (3, STATES))
    own = [replace(table, warnings=()).replaced({"x": table["x"] + x, "tip_mass": np.full(STATES, 0.02)}) for x in noise]
    good, here, robot = Table.joined(own), np.isin(np.arange(3 * STATES), 7 + 10 * np.arange(states)), load(ROBOT, Robot)
    changed = {column: np.where(here, number, good.get(column, 0.0))}
    if column == "still":
        changed = {n: np.where(here, np.roll(good[n], 1), good[n]) for n in TIP}
    kept = believed(good.replaced(changed), robot)
    assert len(believed(good, robot)) == 3 * STATES
    assert len(kept) == 3 * STATES - len(kept.warnings) == 3 * STATES - bool(text)
    assert not text or re.match(f"trial .* step .*: {text}", kept.warnings[0])


def test_rows_that_were_written_twice_count_once_and_are_imported_once(tmp_path: Path) -> None:
    noise = np.random.default_rng(1).normal(0.0, 0.3, STATES)
    content = text(FEW, headings=NAMES, change=lambda k, c: with_middle(k, [*c[:4], f"{float(c[4]) + noise[k]:.3f}", *c[5:]]))
    head, *rows = content.splitlines()
    twice = np.sort([*range(STATES), 0, 10, 20])
    once, made = (read_all(tmp_path, {"a.csv": "\n".join([head, *(rows[k] for k in own)])}) for own in (range(STATES), twice))
    assert made.table == once.table
    assert any(note.startswith("a.csv, line 2, 13, 24: repeats a.csv, line 3, 14, 25 to") for note in made.notes)
    kept = believed(replace(once.table.take(twice), warnings=()), load(ROBOT, Robot))
    assert kept == once.table
    assert len(kept.warnings) == 1


# ------------------------------------------------------------------ several files
def test_columns_may_differ_from_file_to_file(tmp_path: Path) -> None:
    other = [n.replace("p2 [kPa]", "regulator 2 [bar]").replace("tip", "Spitze") for n in NAMES]
    contents = {
        "a.csv": WHOLE,
        "b 1.csv": text(FEW, headings=other, change=lambda k, c: with_middle(k, [*c[:2], f"{float(c[2]) / 100:.5f}", *c[3:]])),
    }
    lost = r"b 1.csv: columns.p2 = 'p2 \[kPa\]': no such column.*lacks the columns for p2, x, y, z.* under files: .*'b 1.csv'"
    refused(lost, read_all, tmp_path, contents)
    columns = {"p2": {"column": other[2]}, **{a: {"column": f"Spitze {a} [mm]"} for a in "xyz"}}
    made = read_all(tmp_path, contents, files={"b*": {"columns": columns, "tip_mass": "30 g"}, "*": {}})
    assert tips(made.table)[STATES:] == pytest.approx(tips(made.table)[:STATES])
    assert made.table["p2"][STATES:] == pytest.approx(made.table["p2"][:STATES], abs=1)
    assert [r.tip_mass for r in made.table.rows[STATES - 1 : STATES + 1]] == [None, 0.03]


def test_the_tip_of_some_files_may_be_given_by_them_alone(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(text(FEW))
    columns, tip = plain(**{f"p{i}": f"P{i} [kPa]" for i in (1, 2, 3)}), plain(**{a: f"Tip {a.upper()} [mm]" for a in "xyz"})
    assert len(by_map(tmp_path / "a.csv", columns=columns, files={"*": {"columns": tip}}).table) == STATES
    with pytest.raises(ConfigError, match=r"a.csv: the map of this file \(files\): columns: give the tip by x, y and z"):
        by_map(tmp_path / "a.csv", columns=columns, files={"*": {"columns": {"x": tip["x"]}}})


@pytest.mark.parametrize(
    ("own", "said"),
    [
        ({"tip_masss": 1}, r"files.\*.tip_masss: is no column of trials.csv"),
        ({"columns": {"q": {"column": 1}}}, r"files.\*.columns.q: is no column of trials.csv"),
        ({"columns": {"p1": {"column": 1, "unit": "mm"}}}, r"files.\*.columns.p1.unit = 'mm': p1 needs one of Pa"),
        ({"tip_mass": "20 mm"}, r"files.\*.tip_mass: '20 mm' has the unit 'mm'"),
    ],
)
def test_what_is_wrong_under_files_is_named(own: dict[str, Any], said: str, tmp_path: Path) -> None:
    refused(said, read_all, tmp_path, {"a.csv": WHOLE}, files={"*": own})


def test_files_are_read_in_the_order_of_their_times_or_as_people_count(tmp_path: Path) -> None:
    def at(start: float) -> str:
        return text([[1.7e9 + start + r[0], *r[1:]] for r in FEW], headings=NAMES, change=with_middle)

    made = read_all(tmp_path, {"late.csv": at(1000), "early.csv": at(0)})
    assert any("in the order of their times: early.csv, late.csv" in n for n in made.notes)
    assert made.table["t"][STATES] == pytest.approx(1000)
    (tmp_path / "runs").mkdir()
    made = read_all(tmp_path, {f"runs/run{n}.csv": WHOLE for n in (10, 2, 1)}, order=["runs"])
    assert [s.path.name for s, _, _ in made.files] == ["run1.csv", "run2.csv", "run10.csv"]


def on_the_clock(start: int) -> str:
    def change(k: int, cells: list[str]) -> list[str]:
        s = (start + int(FEW[k][0])) % 86_400
        return with_middle(k, [f"{s // 3600:02d}:{s // 60 % 60:02d}:{s % 60:02d}", *cells[1:]])

    return text(FEW, headings=["Uhrzeit", *NAMES[1:]], change=change)


@pytest.mark.parametrize(
    ("starts", "order", "says"),
    [
        ((34_000, 30_000), ["b.csv", "a.csv"], "in the order of their times: b.csv, a.csv"),
        ((30_000, 34_000), ["a.csv", "b.csv"], ""),
        ((86_000, 500), ["a.csv", "b.csv"], "in the order of their names; by their times the order would be"),
    ],
)
def test_files_are_read_in_the_order_of_the_clock(starts: tuple[int, int], order: list[str], says: str, tmp_path: Path) -> None:
    columns = COLUMNS | {"t": "Uhrzeit"}
    contents = {name: on_the_clock(start) for name, start in zip(("a.csv", "b.csv"), starts, strict=True)}
    made = read_all(tmp_path, contents, columns=plain(**columns))
    assert [s.path.name for s, _, _ in made.files] == order
    assert says in " ".join(made.notes) and bool(made.notes) == bool(says)
    assert (np.diff(made.table["t"]) > 0).all()


# ------------------------------------------------------------------ times
def test_a_file_written_backwards_is_read_forwards(tmp_path: Path) -> None:
    made = read_all(tmp_path, {"a.csv": text(FEW[::-1], headings=NAMES, change=with_middle)})
    assert tips(made.table)[:, 2] == pytest.approx([r[6] for r in FEW], abs=1e-3)
    assert any("is read backwards" in n for n in made.notes)


def test_times_that_begin_again_begin_a_trial_and_late_rows_are_put_in_order(tmp_path: Path) -> None:
    rows = [[4.0 * (k % 15), *r[1:]] for k, r in enumerate(FEW)]
    made = read_all(tmp_path, {"a.csv": text(rows, headings=NAMES, change=with_middle)}, trials={"begin": "file"})
    assert any("times begin again once, first in line 17 (56 s to 0 s)" in n for n in made.notes)
    assert np.flatnonzero(np.diff(made.table["trial"])).tolist() == [14] and (np.diff(made.table["t"]) > 0).all()
    made = read_all(tmp_path, {"a.csv": text([*FEW[:8], FEW[9], FEW[8], *FEW[10:]], headings=NAMES, change=with_middle)})
    assert any("1 rows are earlier than the row before (first: line 11)" in n for n in made.notes)
    assert tips(made.table)[:, 2] == pytest.approx([r[6] for r in FEW], abs=1e-3)


def timed(folder: Path, times: Callable[[int], float | str | None], heading: str = "t [s]", rows: Rows = MANY) -> Imported:
    """A sweep of 4 s holds, read ten times a second, with these times."""

    def change(k: int, cells: list[str]) -> list[str]:
        found = times(k)
        return with_middle(k, ["" if found is None else found if isinstance(found, str) else f"{found:.12g}", *cells[1:]])

    content = text(rows, headings=[heading, *NAMES[1:]], change=change)
    return read_all(
        folder, {"a.csv": content}, columns=plain(**COLUMNS | {"t": heading}), states={"plateaus": {"steady": "1 kPa"}}
    )


def stamp(seconds: float) -> str:
    return (datetime(2026, 3, 29, 1, 59, 0) + timedelta(seconds=seconds)).isoformat(sep=" ", timespec="milliseconds")


@pytest.mark.parametrize(
    ("times", "heading", "says"),
    [
        (lambda k: stamp(0.1 * k + 3600 * (k >= 600)), "Uhrzeit", "the clock goes forward by 1 h"),
        (lambda k: stamp(0.1 * k - 3600 * (k >= 611)), "Uhrzeit", "the clock goes back by 1 h"),
        (lambda k: stamp(0.1 * k - 1800 * (k >= 611)), "Uhrzeit", "the clock goes back by 0.5 h"),
        (lambda k: 500 + 0.1 * k - 0.9 * (k >= 611), "t [s]", "the clock goes back by 0.9 s while rows go on"),
        (lambda k: float((2**32 - 60_000 + 100 * k) % 2**32), "t [ms]", ""),
        (lambda k: float((65_000 + 100 * k) % 2**16), "t [ms]", ""),
        (lambda k: f"{59 + k // 600:02d}:{k % 600 / 10:04.1f}" if k < 600 else f"00:{k % 600 / 10:04.1f}", "Uhrzeit", ""),
    ],
    ids=["summer", "winter", "half an hour", "set back", "32 bits", "16 bits", "minutes"],
)
def test_a_clock_that_was_set_and_a_counter_that_overflows_neither_part_nor_stretch_a_state(
    times: Callable[[int], float | str], heading: str, says: str, tmp_path: Path
) -> None:
    plain_rows = timed(tmp_path, lambda k: 0.1 * k).table
    made = timed(tmp_path, times, heading, MANY[:1200])
    assert len(made.table) == PLATEAUS and made.table["hold"] == pytest.approx(plain_rows["hold"], abs=0.06)
    assert set(made.table["trial"]) == set(plain_rows["trial"])
    assert any(says in q and "a.csv, line" in q for q in made.questions) if says else not made.questions


@pytest.mark.parametrize("step", [90.0, 3600.0, 86_400.0 * 3])
def test_a_gap_ends_a_state_and_is_asked_about(step: float, tmp_path: Path) -> None:
    made = timed(tmp_path, lambda k: 0.1 * k + step * (k >= 620))
    assert made.table["hold"].max() < 5 and len(made.table) == PLATEAUS + 1
    (question,) = made.questions
    assert f"a.csv, line 622: a gap of {step + 0.1:.5g} s" in question and "Was the logger stopped" in question
    head, *rows = (tmp_path / "a.csv").read_text().splitlines()
    counted = "\n".join([f"{head},run", *(f"{row},{1 + (k >= 620)}" for k, row in enumerate(rows))])
    stated = yaml.safe_load((tmp_path / "map.yaml").read_text()) | {"trials": {"change": ["run"]}}
    assert not read_all(tmp_path, {"a.csv": counted}, **stated).questions  # where a trial begins anyway


def test_times_that_fall_to_somewhere_else_than_where_they_began_are_asked_about(tmp_path: Path) -> None:
    made = timed(tmp_path, lambda k: 1000 + 0.1 * k - 71.3 * (k >= 800))
    assert any("a.csv, line 802: times jump back by 71.2 s, but not to their beginning" in q for q in made.questions)
    assert (np.diff(made.table["t"]) > 0).all()


def test_rows_without_a_time_have_none_and_are_counted(tmp_path: Path) -> None:
    made = timed(tmp_path, lambda k: 0.1 * k if k % 7 else None)
    assert len(made.table) == PLATEAUS and not made.questions
    assert any(f"{len(MANY[::7])} of {len(MANY)} rows have no time (first: line 2); they were skipped" in n for n in made.notes)


def test_times_that_are_all_equal_or_coarse_are_told(tmp_path: Path) -> None:
    refused(r"columns.t: all rows have the same time; name another column", timed, tmp_path, lambda k: 7.0)
    assert any("Is there a finer time column" in q for q in timed(tmp_path, lambda k: 4.0 * (k // 40)).questions)


# ------------------------------------------------------------------ units
def test_a_unit_that_is_none_of_the_quantity_is_asked_about(tmp_path: Path) -> None:
    content = text(FEW, headings=[n.replace("p3 [kPa]", "p3 [V]") for n in NAMES], change=with_middle)
    columns = plain(**COLUMNS) | {"p3": {"column": "p3 [V]"}}
    with pytest.raises(ConfigError, match=r"a.csv: column 'p3 \[V\]' \(columns.p3\): the file says 'V' .*write columns.p3.unit"):
        read_all(tmp_path, {"a.csv": content}, columns=columns)


def test_columns_and_files_of_which_the_same_is_said_share_a_note(tmp_path: Path) -> None:
    columns = {n: {"column": c, **({"unit": "cm"} if c.endswith("[mm]") else {})} for n, c in COLUMNS.items()}
    made = read_all(tmp_path, dict.fromkeys(("a.csv", "b.csv"), WHOLE), columns=columns)
    (said,) = [n for n in made.notes if "the file says" in n]
    assert said.startswith("a.csv, b.csv: columns '") and "the map cm" in said
    assert all(f"'{c}'" in said and f"columns.{n}" in said for n, c in COLUMNS.items() if c.endswith("[mm]"))


@pytest.mark.parametrize("names", [("pset{}", "pist{}"), ("P{}_SP", "P{}_PV"), ("Soll {}", "Druck {}"), ("p{}_cmd", "p{}")])
def test_measured_pressures_are_preferred_to_set_points(names: tuple[str, str], tmp_path: Path) -> None:
    asked, read = ([name.format(i) for i in (1, 2, 3)] for name in names)
    headings = ["t", *asked, *read, "x", "y", "z"]
    change = lambda k, c: [c[0], *(f"{1.4 * float(v):.3f}" for v in c[1:4]), *c[1:]]  # noqa: E731
    (tmp_path / "a.csv").write_text(text(FEW, headings=headings, change=change))
    made, _ = guessed(tmp_path / "a.csv")
    assert [made.values["columns"][f"p{i}"]["column"] for i in (1, 2, 3)] == read
    (tmp_path / "a.csv").write_text(text(FEW, headings=["t", *asked, "x", "y", "z"]))
    if "p" in names[0].casefold():
        made, _ = guessed(tmp_path / "a.csv")
        assert any("are set-points; no measured pressures were found" in d for d in made.doubts)


def test_the_column_of_a_tip_in_doubt_is_listed_with_the_others() -> None:
    proposed = Guess()
    proposed.say("columns.x", {"column": "LED X"}, "it moves most")
    proposed.doubt("columns.x", "no heading names a tip")
    assert grouped(proposed) == {"it moves most; see `unconfirmed`": ["columns.x"]}


@pytest.mark.parametrize(
    ("name", "remedy"), [("a.xlsx", "save the sheet as CSV"), ("a.db3", "convert"), ("a.mcap.zstd", "unpack")]
)
def test_the_exit_code_of_a_file_of_an_unknown_kind_is_2(name: str, remedy: str, tmp_path: Path, cli: Cli) -> None:
    (tmp_path / name).write_bytes(b"SQLite format 3\0")
    (tmp_path / "map.yaml").write_text(yaml.safe_dump({"columns": plain(**COLUMNS), "robot": str(ROBOT)}))
    told = cli("import", tmp_path / name, "--map", tmp_path / "map.yaml", "--out", tmp_path / "c", code=2)
    assert remedy in told.flat_err
