"""The table of trials and its file: exact numbers, strict reading, messages that help."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recordings.errors import BadTable
from recordings.table_file import read_csv, write_csv
from recordings.trials import Mapped, Table, TrialRow
from tests.simulated.bench import raises

ROW = TrialRow(
    trial=1, step=1, protocol="bending", repeat=1, branch="load", t=12.5, spine_length=0.1, pressures=(50e3,) * 3 + (0.0,) * 6,
    rate=1e4, hold=2.0, vacuum=80e3, tip_mass=0.053, roll_deg=0.0, force_x=0.02, force_y=0.0, force_z=-0.1,
    tip=(0.1, -0.02, 0.38), orientation=(1.0, 0.0, 0.0, 0.0), markers=((0.0, 0.0, 0.1), (math.nan,) * 3, (0.05, 0.0, 0.3)),
    sd={"x": 3e-4, "p1": 80.0},
)  # fmt: skip
PUSH = replace(ROW, step=2, protocol="stiffness", tip=None, orientation=None, specimen="spine", force=0.5, deflection=2e-3)


def written(tmp_path: Path, *rows: TrialRow) -> tuple[Path, list[str]]:
    write_csv(Table.of(rows), tmp_path / "trials.csv")
    return tmp_path / "trials.csv", (tmp_path / "trials.csv").read_text().splitlines()


def test_columns_stand_in_the_order_of_the_format(tmp_path: Path) -> None:
    _, lines = written(tmp_path, ROW, PUSH)
    assert lines[0] == (
        "trial,step,protocol,repeat,branch,t,rate,hold,spine_length,vacuum,tip_mass,roll_deg,force_x,force_y,force_z,"
        "p1,p2,p3,p4,p5,p6,p7,p8,p9,x,y,z,qw,qx,qy,qz,m1x,m1y,m1z,m3x,m3y,m3z,specimen,force,deflection,sd_p1,sd_x"
    )


def test_columns_that_no_row_has_are_absent_and_empty_cells_come_back_as_none(tmp_path: Path) -> None:
    path, lines = written(tmp_path, replace(ROW, vacuum=None, markers=(), sd={}, orientation=None), PUSH)
    back = read_csv(path)
    assert "qw" not in lines[0] and back.rows[0].vacuum is None and back.rows[1].tip is None
    assert np.isnan(back["x"]).tolist() == [False, True] and back["specimen"].tolist() == ["", "spine"]
    assert back["trial"].dtype == np.int64


def test_states_joined_with_those_of_a_recording_keep_what_their_map_said() -> None:
    recorded, kept, moved = (replace(Table.of([ROW]), mapped=m) for m in (None, Mapped(), Mapped(("y", "x", "-z"), "at rest")))
    assert [Table.joined(t).mapped for t in ([recorded, kept], [kept, moved, recorded])] == [kept.mapped, moved.mapped]


@settings(max_examples=60)
@given(
    numbers=st.lists(st.floats(-4.9, 4.9, allow_subnormal=True), min_size=6, max_size=6),
    pressures=st.lists(st.floats(-9e4, 1.9e6), min_size=1, max_size=12),
    t=st.floats(0, 1e7),
)
def test_numbers_come_back_as_they_went(
    tmp_path_factory: pytest.TempPathFactory, numbers: list[float], pressures: list[float], t: float
) -> None:
    row = replace(ROW, t=t, tip=tuple(numbers[:3]), markers=(tuple(numbers[3:]),), pressures=tuple(pressures))
    path, _ = written(tmp_path_factory.mktemp("t"), row)
    assert read_csv(path).rows[0].to_json() == row.to_json()


@pytest.mark.parametrize(
    ("column", "text", "match"),
    [
        ("x", "40.0", "40 m exceeds 5 m.*mm or cm"),
        ("m1z", "-380", "mm or cm"),
        ("spine_length", "15", "15 m"),
        ("p4", "-120000", "-120000 Pa is outside"),
        ("p1", "nan", "leave the cell empty"),
        ("p2", "fifty", "'fifty' is not a number"),
        ("p1", "", "no value for p1"),
        ("y", "", "without y"),
        ("trial", "1.5", "not a whole number"),
        ("branch", "up", "not one of load, unload"),
        ("tip_mass", "53", "looks like g; .* divide by 1000"),
        ("force_z", "-981", "exceeds 500 N: looks like mN or grams"),
        ("hold", "-1", "before the ramp's end"),
    ],
)
def test_a_cell_that_cannot_be_right_is_named_by_line_and_column(tmp_path: Path, column: str, text: str, match: str) -> None:
    path, lines = written(tmp_path, ROW)
    cells = lines[1].split(",")
    cells[lines[0].split(",").index(column)] = text
    path.write_text(lines[0] + "\n" + ",".join(cells) + "\n")
    assert "line 2" in raises(BadTable, match, read_csv, path)


def test_a_missing_column_is_named_with_its_likely_misspelling(tmp_path: Path) -> None:
    path, lines = written(tmp_path, ROW)
    path.write_text(lines[0].replace("spine_length", "spine_lenght") + "\n" + lines[1] + "\n")
    raises(BadTable, r"no column spine_length \(is it the column 'spine_lenght'", read_csv, path)


def test_foreign_columns_are_left_out_and_named(tmp_path: Path) -> None:
    path, lines = written(tmp_path, ROW)
    path.write_text("﻿" + lines[0] + ", note\n" + lines[1] + ",sunny\n\n")
    assert read_csv(path).ignored == ("note",)
    assert [r.to_json() for r in read_csv(path)] == [ROW.to_json()]


@pytest.mark.parametrize("text", ["", "trial,step\n1,2\n", "a\nb\n"])
def test_a_file_that_is_no_table_is_told(tmp_path: Path, text: str) -> None:
    (tmp_path / "t.csv").write_text(text)
    raises(BadTable, r"t\.csv", read_csv, tmp_path / "t.csv")


def test_a_stiffness_row_needs_force_and_deflection_and_others_a_tip(tmp_path: Path) -> None:
    path, _ = written(tmp_path, replace(PUSH, force=None))
    raises(BadTable, "needs specimen, force and deflection", read_csv, path)
    path, _ = written(tmp_path, replace(ROW, tip=None))
    assert read_csv(path).unread.all()


def test_asking_for_a_column_that_is_not_there_names_those_that_are() -> None:
    with pytest.raises(BadTable, match="no column q; the table has trial, step"):
        Table.of([ROW])["q"]


@pytest.mark.parametrize(
    ("protocol", "asked"), [("elongaton", "elongation"), ("stifness", "stiffness"), ("bending_slow", ""), ("twist", "")]
)
def test_a_protocol_that_is_nearly_a_known_one_is_asked_about(protocol: str, asked: str, tmp_path: Path) -> None:
    path = tmp_path / "trials.csv"
    path.write_text(
        "trial,step,protocol,repeat,branch,t,spine_length,p1,x,y,z\n"
        f"1,1,{protocol},1,load,0,0,0,0,0,0.3\n1,2,{protocol},1,load,9,0,40000,0.02,0,0.29\n"
    )
    said = " ".join(read_csv(path).warnings)
    assert (f"did you mean '{asked}'" in said) if asked else ("did you mean" not in said)


def test_rows_that_are_equal_in_every_cell_count_once_and_those_with_other_readings_do_not(tmp_path: Path) -> None:
    again = [replace(ROW, t=20.0), replace(ROW, tip=(0.1, -0.02, 0.37))]
    back = read_csv(written(tmp_path, ROW, PUSH, *again, ROW, PUSH)[0])
    assert back.rows == (ROW, PUSH, *again)
    (said,) = back.warnings
    assert said == "trial 1 step 1 appears more than once (such rows: 4; of these equal in every cell, and left out: 2)"
