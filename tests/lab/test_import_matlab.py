"""MATLAB's tables, strings, dates, cells, structures and arrays on their side: columns where they are clear, else named."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat
from test_import_tables import ROBOT, guessed

from benchmarks.faults.foreign_tables import HEADINGS, STATES, sweep
from lab.files.config import ConfigError, load
from lab.imports.formats import read
from lab.imports.map_file import Map, Source
from lab.imports.table import Imported, imported
from model.robot import Robot

ROWS = np.array(sweep())
TIME, PRESSURES, TIP = ROWS[:, 0], ROWS[:, 1:4], ROWS[:, 4:]
BRANCHES = np.array([["up", "up", "up", "down", "down"][k % 5] for k in range(STATES)], dtype=object)


def through(file: Path) -> Imported:
    _, place = guessed(file)
    return imported([file], load(place, Map), load(ROBOT, Robot))


def check(made: Imported) -> None:
    assert len(made.table) == STATES
    assert np.column_stack([made.table[a] for a in "xyz"]) * 1e3 == pytest.approx(TIP, abs=1e-6)
    assert np.column_stack([made.table[f"p{i}"] for i in (1, 2, 3)]) / 1e3 == pytest.approx(PRESSURES, abs=1e-6)


def table(**more: Any) -> Any:
    import pandas as pd  # the libraries of tables are slow to import, and few of the tests need them

    columns = {f"P{i + 1}": PRESSURES[:, i] for i in range(3)} | {f"Tip{a}": TIP[:, k] for k, a in enumerate("XYZ")}
    return pd.DataFrame(columns | more)


@pytest.mark.parametrize("version", ["v7", "v7.3"])
def test_a_table_of_matlab_is_columns(tmp_path: Path, version: str) -> None:
    import matio
    import pandas as pd

    when = pd.to_datetime("2024-03-01T23:59:00") + pd.to_timedelta(TIME, unit="s")
    objects = {"T": table(Direction=list(BRANCHES), when=when), "operator": "Anna"}
    matio.save_to_mat(str(tmp_path / "run.mat"), objects, version=version)
    series = read(tmp_path / "run.mat", Source())
    assert series.names == ("P1", "P2", "P3", "TipX", "TipY", "TipZ", "Direction", "when")
    assert series.units["when"] == "s" and series.columns["when"][-1] - series.columns["when"][0] == pytest.approx(TIME[-1])
    assert any("operator" in note for note in series.notes)
    made = through(tmp_path / "run.mat")
    check(made)
    assert made.table["branch"].tolist() == ["load", "load", "load", "unload", "unload"] * 6


def test_objects_are_named_where_they_cannot_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import matio

    objects = {"T": table(), "P": PRESSURES.T, "tip_mm": TIP.T}
    matio.save_to_mat(str(tmp_path / "new.mat"), objects, version="v7.3")
    matio.save_to_mat(str(tmp_path / "old.mat"), objects, version="v7")
    monkeypatch.setitem(sys.modules, "matio", None)
    for name, which in (("new", "not read: T;"), ("old", "not read: objects (table")):
        series = read(tmp_path / f"{name}.mat", Source())
        assert any(which in note and "pip install 'softlab[import]'" in note for note in series.notes), series.notes
        assert series.numbers["P.2"].tolist() == PRESSURES[:, 1].tolist()


def test_arrays_on_their_side_structures_and_cells(tmp_path: Path) -> None:
    hidden = np.array([[None if k == 4 else x for k, x in enumerate(TIP[:, 0])]], dtype=object)
    hidden[0, 4] = np.zeros((0, 0))
    savemat(
        tmp_path / "run.mat",
        {
            "t": TIME[None, :], "pressure_kPa": PRESSURES.T, "tip": {"x_mm": hidden, "y_mm": TIP[:, 1], "z_mm": TIP[:, 2]},
            "phase": BRANCHES, "gains": np.eye(3), "name": "finger", "rate": 100.0, "z": 1j * TIME,
        },
    )  # fmt: skip
    series = read(tmp_path / "run.mat", Source())
    assert "pressure_kPa (3 x 30) is read with its rows along the second dimension" in series.notes
    left = next(n for n in series.notes if n.startswith("not read: "))
    assert all(
        word in left for word in ("gains (3 instead of 30 rows)", "name (a text)", "rate (one number)", "z (complex numbers)")
    )
    made = through(tmp_path / "run.mat")
    assert len(made.table) == STATES - 1 and made.table["branch"].tolist()[:4] == ["load", "load", "load", "unload"]
    assert made.table["p3"] / 1e3 == pytest.approx(np.delete(PRESSURES[:, 2], 4), abs=1e-6)


def test_an_array_of_structures_is_a_table(tmp_path: Path) -> None:
    kinds = [(f"P{i}", "O") for i in (1, 2, 3)] + [("tip", "O")]
    rows = np.array([(*p, v[None, :] / 1e3) for p, v in zip(PRESSURES, TIP, strict=True)], dtype=kinds)
    savemat(tmp_path / "run.mat", {"states": rows[None, :]})
    series = read(tmp_path / "run.mat", Source())
    assert series.numbers["states.P2"] == pytest.approx(PRESSURES[:, 1]) and series.numbers["states.tip.3"] == pytest.approx(
        TIP[:, 2] / 1e3
    )


def test_a_file_without_columns_names_what_it_holds(tmp_path: Path) -> None:
    savemat(tmp_path / "run.mat", {"name": "finger", "parts": np.array([np.zeros(3), np.zeros((2, 2))], dtype=object)})
    with pytest.raises(ConfigError, match=r"holds no table of numbers; not read: name \(a text\), parts \(cells that hold more"):
        read(tmp_path / "run.mat", Source())


def test_a_cell_table_and_a_matrix_with_names_are_read_by_column(tmp_path: Path) -> None:
    rows = np.array(sweep())
    cells = np.empty((len(rows) + 1, 7), object)
    cells[0], cells[1:] = list(HEADINGS), rows
    savemat(tmp_path / "a.mat", {"C": cells})
    savemat(tmp_path / "b.mat", {"M": rows, "names": np.array(HEADINGS, object)})
    savemat(tmp_path / "c.mat", {"C": cells[1:]})
    for name, label in (("a", "C"), ("b", "M")):
        series = read(tmp_path / f"{name}.mat", Source())
        assert series.names == tuple(f"{label}.{h}" for h in HEADINGS) and len(series) == len(rows)
        assert series.numbers[f"{label}.Tip Z [mm]"] == pytest.approx(rows[:, 6])
    series = read(tmp_path / "c.mat", Source())
    assert series.names == tuple(f"C.{k}" for k in range(1, 8)) and series.numbers["C.7"] == pytest.approx(rows[:, 6])


def test_a_file_with_elements_of_no_kind_is_refused_and_does_not_end_the_process(tmp_path: Path) -> None:
    for compressed in (False, True):
        savemat(tmp_path / "a.mat", {"p": PRESSURES, "log": {"tip": TIP}}, do_compression=compressed)
        data = (tmp_path / "a.mat").read_bytes()
        assert len(read(tmp_path / "a.mat", Source())) == STATES
        for kind in (8, 10, 99):
            at = 132 if compressed else data.index((9).to_bytes(4, "little"), 180)
            wrong = data[: at - 4 * compressed] + kind.to_bytes(4, "little") + data[at + 4 - 4 * compressed :]
            (tmp_path / "a.mat").write_bytes(wrong)
            with pytest.raises(ConfigError, match=f"is not a MATLAB file .*an element of kind {kind}"):
                read(tmp_path / "a.mat", Source())
