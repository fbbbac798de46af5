"""`lab.case(frame, robot)`: a pandas DataFrame as a case, as `lab import` reads the same table from a file."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from foreign import ROBOT, by_map

import lab
from benchmarks.faults.foreign_tables import HEADINGS, sweep, text
from lab.files.config import ConfigError

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
    frame = case.table.to_pandas()
    assert lab.case(frame, case.robot).table == case.table
    frame["P_left"] = frame.pop("p1") / 1e5
    left = lab.case(frame, case.robot, columns={"p1": "P_left [bar]"}).table
    assert left["p1"] == pytest.approx(case.table["p1"], abs=1e-6) and left == case.table.replaced({"p1": left["p1"]})
    frame["p1"] = case.table["p1"]
    bare = lab.case(frame.drop(columns=["step", "repeat", "branch"]), case.robot).table
    assert all((bare[name] == case.table[name]).all() for name in ("trial", "step", "p1", "x", "z"))


def test_rows_that_lack_a_value_are_left_out_and_named(small_case: Path) -> None:
    case = lab.case(small_case)
    frame = case.table.to_pandas()
    frame.loc[[3, 5], "p1"], frame.loc[7, ["x", "y", "z"]] = pd.NA, np.nan
    kept = lab.case(frame, case.robot).table
    assert len(kept) == len(case.table) - 3 and "3 of 14 rows are left out, first index 3: no value for p1" in kept.warnings[0]
    mapped = lab.case(frame.drop(columns="step"), case.robot, columns={"p1": "p1"}).table
    assert len(mapped) == len(kept)
    assert any("2 of 14 rows have no pressure (first: index 3)" in doubt for doubt in mapped.warnings)


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
    with pytest.raises(ConfigError, match=match):
        lab.case(change(FRAME), ROBOT, columns=COLUMNS | columns if isinstance(columns, dict) else columns)


@pytest.mark.parametrize("wrong", [{}, {"states": {"plateaus": {"steady": 1000.0}}}, {"frame": {"x": "x", "y": "z", "z": "-y"}}])
def test_a_unit_that_is_missing_is_named_first_with_what_to_write(wrong: dict[str, Any]) -> None:
    # one state, which no rod reaches, is refused; one that a rod may reach is asked about
    bare = frame(0.013 if "states" in wrong else 0.005).rename(columns={f"P{k} [kPa]": f"left {k}" for k in (1, 2, 3)})
    columns = COLUMNS | {f"p{k}": f"left {k}" for k in (1, 2, 3)}
    with pytest.raises(ConfigError) as refused:
        lab.case(bare, ROBOT, columns=columns, **wrong)
    first = str(refused.value).splitlines()[0]
    assert "the pressures must be 1000 times as large" in first or "nothing says the unit of the pressures" in first
    line = re.search("write columns=({.*?}) in lab.case", first)
    if line is not None:
        assert lab.case(bare, ROBOT, columns=columns | json.loads(line[1])) == lab.case(FRAME, ROBOT, columns=COLUMNS)
    assert ("no pressure stands" not in str(refused.value)) and (line is not None or "states" in wrong)


def test_values_that_cannot_be_right_are_refused_as_those_of_a_file(small_case: Path) -> None:
    case = lab.case(small_case)
    frame = case.table.to_pandas()
    for column, value, match in (("p1", 1e9, "index 0, p1: 1e.09 Pa is outside"), ("trial", 1.5, "is not a whole number"),
                                 ("branch", "up", "index 0.*says 'up'"), ("x", 0.38e3, "380 m exceeds 5 m")):  # fmt: skip
        with pytest.raises(ConfigError, match=match):
            lab.case(frame.astype({column: object}).assign(**{column: value}), case.robot)


def test_what_is_neither_a_frame_nor_a_path_is_told(small_case: Path) -> None:
    for inputs, keys, match in (((FRAME,), {}, "needs one robot, 0 are given"), ((3,), {}, "int is neither the path"),
                                ((), {}, "nothing is given"),
                                ((FRAME, ROBOT), {"columns": COLUMNS, "source": {"missing": 3}}, "source.missing"),
                                ((small_case,), {"columns": COLUMNS, "foo": 1}, "columns, foo: only with a DataFrame"),
                                ((FRAME, ROBOT), {"foo": 1}, "foo: unknown key; known keys: robot, "),
                                ((FRAME, ROBOT), {"Robt": 1}, "Robt: unknown key; did you mean robot?"),
                                ((FRAME, ROBOT), {"files": {"*": {}}}, "files: does not apply")):  # fmt: skip
        with pytest.raises(ConfigError, match=match):
            lab.case(*inputs, **keys)
