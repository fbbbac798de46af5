"""`lab import`: files of other programs, by a map or by a map that is proposed."""

import json
import pickle
import re
import shlex
import sys
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pyarrow.parquet
import pytest
import yaml
from commands import Cli, refused
from foreign import AZIMUTHS, OWN_TABLE, ROBOT, by_map, plain, through, tips
from mcap.writer import Writer
from scipy.spatial.transform import Rotation
from test_import_matlab import matlab_hdf5

import lab
from diagnosis.edits.reading import read as judged
from lab.files.config import ConfigError, load, read_yaml
from lab.files.map_file import Frame, Plateaus, Source, map_of
from lab.imports.formats import read
from lab.imports.headings import heading, quadruples, quantity
from lab.imports.trials import plateaus
from model.robot import Robot
from recordings.table_file import read_csv
from recordings.trials import Table

LENGTH = 0.15
LEVELS = (0.0, 30e3, 60e3, 30e3)


def sweep(repeats: int = 2) -> list[tuple[int, float, tuple[float, ...], np.ndarray, str]]:
    """Trial, s, Pa, m and branch of a sweep of three chambers, one after the other; the tip goes where the rod has it."""
    rows = []
    for trial in range(3 * repeats):
        for step, level in enumerate(LEVELS):
            pressure = [0.0, 0.0, 0.0]
            pressure[trial % 3] = level
            away = -np.array([np.cos(AZIMUTHS[trial % 3]), np.sin(AZIMUTHS[trial % 3])]) * level * (2.8e-7 + 4.6e-12 * level)
            tip = np.array([*away, LENGTH - 0.5 * float(away @ away) / LENGTH])
            rows.append((trial + 1, 10.0 * len(rows), tuple(pressure), tip, "auf" if step < 3 else "ab"))
    return rows


def spreadsheet(path: Path) -> Path:
    """What a German spreadsheet program saves: semicolons, decimal commas, a title line, Latin-1, kPa and mm."""
    columns = "Druck 1 [kPa];Druck 2 [kPa];Druck 3 [kPa];Spitze X [mm];Spitze Y [mm];Spitze Z [mm]"
    lines = ["Messung am Ger\xe4t", f"Zeit [s];Versuch;{columns};Richtung"]
    for trial, t, pressure, tip, branch in sweep():
        cells = [t, *(p / 1e3 for p in pressure), *(tip * 1e3)]
        text = [f"{c:.4f}".replace(".", ",") for c in cells]
        lines.append(";".join([text[0], str(trial), *text[1:], branch]))
    path.write_text("\n".join(lines), encoding="latin-1")
    return path


def guessed(cli: Cli, file: Path, robot: Path = ROBOT) -> Path:
    """The map proposed for a file."""
    out = file.with_name("guess")
    cli("import", file, "--guess", "--robot", robot, "--out", out)
    assert (out / "states.png").exists()
    return out / "map.yaml"


def case(cli: Cli, file: Path, map_file: Path) -> Table:
    """A file as a case next to it."""
    cli("import", file, "--map", map_file, "--out", file.with_name("case"))
    return read_csv(file.with_name("case") / "trials.csv")


def truth() -> np.ndarray:
    """(n, 3) mm, the tips of the sweep."""
    return 1e3 * np.array([tip for *_, tip, _ in sweep()])


def test_a_spreadsheet_of_states_needs_nothing_but_its_headings(tmp_path: Path, cli: Cli) -> None:
    file = spreadsheet(tmp_path / "messung.csv")
    table = case(cli, file, guessed(cli, file))
    assert table["p2"] == pytest.approx([p[1] for _, _, p, _, _ in sweep()])
    assert tips(table) == pytest.approx(truth(), abs=1e-4)
    assert table["branch"].tolist() == ["load", "load", "load", "unload"] * 6
    assert table["repeat"].tolist() == [1] * 12 + [2] * 12
    cli("compare", tmp_path / "case")


def test_words_for_a_missing_value_are_counted_and_named_by_column_with_the_first_row(tmp_path: Path, cli: Cli) -> None:
    rows = pandas.DataFrame([(*(p / 1e3 for p in pressure), *(1e3 * tip)) for _, _, pressure, tip, _ in sweep()], dtype=object)
    rows.columns = [*(f"p{k} [kPa]" for k in (1, 2, 3)), *(f"{axis} [mm]" for axis in "xyz")]
    rows.iloc[[4, 7, 9], 3], rows.iloc[[2, 3], 4] = ["lost", "occluded", "n/a"], [np.nan, "-"]
    rows.assign(other=rows["x [mm]"]).to_csv(tmp_path / "a.csv", index=False, na_rep="NaN")
    wanted = {name.split()[0]: name for name in rows}
    said = "column 'x [mm]' (columns.x): 3 cells are not numbers (first: {}, 'lost'); read as missing"
    notes = by_map(tmp_path / "a.csv", columns=wanted).notes
    assert [n for n in notes if "are not numbers" in n] == [f"a.csv: {said.format('line 6')}"]
    with pytest.warns(UserWarning, match="are not numbers"):
        told = lab.case(rows, ROBOT, columns=wanted).table.warnings
    assert [n for n in told if "are not numbers" in n] == [f"DataFrame: {said.format('index 4')}"]
    told = cli("import", tmp_path / "a.csv", "--guess", "--map", "my.yaml", "--robot", ROBOT, "--out", tmp_path, code=2).flat
    assert "argument --map: not allowed with argument --guess" in told


def test_one_camera_states_its_plane_and_the_size_of_its_pixels(tmp_path: Path, cli: Cli) -> None:
    rows = [(t, *(p / 1e3 for p in pressure), *(1e3 * tip[[2, 0]])) for _, t, pressure, tip, _ in sweep()]
    table = pandas.DataFrame(rows, columns=["t", "p1 [kPa]", "p2 [kPa]", "p3 [kPa]", "tip z [mm]", "tip x [mm]"])
    table.to_csv(tmp_path / "mm.csv", index=False)
    flat = truth() * (1, 0, 1)
    (map_file := guessed(cli, tmp_path / "mm.csv")).write_text(map_file.read_text().replace("straight: at rest", ""))
    assert yaml.safe_load(map_file.read_text())["constants"] == {"y": "0 mm"}
    assert tips(case(cli, tmp_path / "mm.csv", map_file)) == pytest.approx(flat, abs=1e-4)
    pixels = table.assign(u=412 + 3.62 * table["tip z [mm]"], v=530 - 3.62 * table["tip x [mm]"]).drop(columns=table.columns[4:])
    pixels.to_csv(tmp_path / "px.csv", index=False)
    columns: dict[str, Any] = {"t": "t", **{f"p{k}": f"p{k} [kPa]" for k in (1, 2, 3)}}
    columns |= {"z": {"column": "u", "unit": "mm", "scale": 1 / 3.62, "zero": 412},
                "x": {"column": "v", "unit": "mm", "scale": -1 / 3.62, "zero": 530}}  # fmt: skip
    seen = by_map(tmp_path / "px.csv", columns=columns, constants={"y": "0 mm"}).table
    assert tips(seen) == pytest.approx(flat, abs=1e-4)
    assert tips(lab.case(pixels, ROBOT, columns=columns, constants={"y": "0 mm"}).table) == pytest.approx(flat, abs=1e-4)
    turned = by_map(tmp_path / "px.csv", columns=columns, constants={"y": "2 mm"}, frame={"x": "y", "y": "z", "z": "x"}).table
    assert tips(turned)[:, 0] == pytest.approx(2.0)
    with pytest.raises(ConfigError, match="columns: y is missing, one camera: state the plane .* `constants: {y: 0 mm}`"):
        lab.case(pixels, ROBOT, columns=columns)
    columns["z"] |= {"unit": "px"}
    with pytest.raises(ConfigError, match="columns.z.unit = 'px': .* or write `unit: mm` and `scale`, how many mm are one px"):
        lab.case(pixels, ROBOT, columns=columns, constants={"y": "0 mm"})


def test_a_recording_over_time_is_cut_and_turned(tmp_path: Path, cli: Cli) -> None:
    """Absolute mbar, cameras whose y points up above a hanging robot, markers at the base, noise."""
    rng = np.random.default_rng(3)
    lines = ["time_ms\tp1_mbar\tp2_mbar\tp3_mbar\ttip.x\ttip.y\ttip.z\tbase.x\tbase.y\tbase.z"]
    for _, _, pressure, tip, _ in sweep():
        for _ in range(50):
            x, y, z = tip + rng.normal(0, 5e-5, 3)
            seen = (np.array([y, -z, -x]) + [0.3, 1.2, -0.4]) * 1e3
            held = [(p + 99_870 + rng.normal(0, 50)) / 100 for p in pressure]
            lines.append("\t".join(f"{v:.3f}" for v in (20.0 * (len(lines) - 1), *held, *seen, 300.0, 1200.0, -400.0)))
    (tmp_path / "run.tsv").write_text("\n".join(lines))
    map_file = guessed(cli, tmp_path / "run.tsv")
    assert yaml.safe_load(map_file.read_text())["frame"] == {"x": "-z", "y": "x", "z": "-y"}
    table = case(cli, tmp_path / "run.tsv", map_file)
    assert table["trial"].tolist() == [t for t, *_ in sweep()]
    assert tips(table) == pytest.approx(truth(), abs=0.1)
    assert table["p1"] == pytest.approx([p[0] for _, _, p, _, _ in sweep()], abs=60)
    assert table["branch"].tolist() == ["load", "load", "load", "unload"] * 6
    assert cli("import", tmp_path / "run.tsv", "--map", map_file, "--out", tmp_path / "j", "--json").json["states"] == len(table)


def write_map(path: Path, **values: Any) -> Path:
    path.write_text(yaml.safe_dump({"robot": str(ROBOT)} | values))
    return path


COLUMNS = plain(**{name: name for name in ("t", "p1", "p2", "p3", "x", "y", "z")})


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"columns": COLUMNS | {"p2": {"column": "p2", "unit": "mm"}}}, "map.yaml: columns.p2.unit = 'mm': p2 needs one of Pa"),
        ({"columns": COLUMNS | {"p2": {"column": "p2", "unit": "N"}}}, "kgf/cm2, N/cm^2; the robot has chambers"),
        ({"columns": COLUMNS | {"p2": {"column": "druck"}}}, "columns.p2 = 'druck': no such column; there are 't'"),
        ({"columns": COLUMNS | {"repeat": {"column": "branch"}}}, "write `values: {auf: 1, ab: 2}`, with your numbers, under"),
        ({"columns": COLUMNS | {"repeat": {"column": "branch", "values": {"auf": 1, "ab": "b"}}}}, "'b': write numbers"),
        ({"columns": COLUMNS | {"p2": {"column": 40}}}, "columns.p2 = 40: must be 1 .. 8"),
        ({"columns": COLUMNS, "frame": {"x": "y", "y": "x", "z": "z"}}, "is a mirror image"),
        ({"columns": COLUMNS, "frame": {"x": "x", "y": "y", "z": "up"}}, "z = 'up': must be one of x, -x"),
        ({"columns": COLUMNS, "frame": {"x": [1, 0, 0], "y": [0.1, 1, 0], "z": "z"}}, "axes are 5.7 deg off a right angle"),
        ({"columns": {k: v for k, v in COLUMNS.items() if k != "z"}}, "give the tip by x, y and z, or by points.tip"),
        ({"columns": COLUMNS, "constants": {"tip_mass": "3 kPa"}}, "tip_mass: '3 kPa' has the unit 'kPa'"),
        ({"columns": COLUMNS, "sensor": [0.01, 0, 0]}, "needs an orientation"),
        ({"columns": COLUMNS, "forces": "tip"}, "forces: a sensor that turns with the tip needs an orientation"),
        ({"columns": COLUMNS, "states": {"plateaus": {"steady": "1 Pa"}}}, "read as Pa, stands within 0.001 kPa for 0.5 s"),
        ({"columns": COLUMNS, "trials": {"below": "5 gf"}}, "'5 gf' has the unit 'gf', but a value in Pa is needed"),
    ],
)  # fmt: skip
def test_what_a_map_says_wrong_is_told(values: dict[str, Any], words: str, tmp_path: Path, cli: Cli) -> None:
    lines = ["t,p1,p2,p3,x,y,z,branch"]
    lines += [",".join(f"{v:.8g}" for v in (t, *p, *tip)) + f",{b}" for _, t, p, tip, b in sweep()]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    map_file = write_map(tmp_path / "map.yaml", **values)
    assert words in cli("import", tmp_path / "a.csv", "--map", map_file, "--out", tmp_path / "case", code=2).flat_err
    assert not (tmp_path / "case" / "trials.csv").exists()


@pytest.mark.parametrize("mounted", [False, True])
def test_a_sensor_beyond_the_end_of_the_body_is_moved_back_to_it(mounted: bool, tmp_path: Path, cli: Cli) -> None:
    lines, ends, mount = ["p1,x,y,z,qw,qx,qy,qz"], [], Rotation.from_rotvec([0.3, 1.2, -0.8] if mounted else [0.0, 0.0, 0.0])
    for i, towards in enumerate(np.radians([0, 0, 90, 180, 270, 45, 200, 310])):
        theta, stretched = (0.0, LENGTH) if i == 0 else (0.2 + 0.12 * i, LENGTH * (1 + 0.01 * i))
        turn = Rotation.from_rotvec([-theta * np.sin(towards), theta * np.cos(towards), 0.0])
        across = stretched * (theta / 2) * np.sinc(theta / 2 / np.pi) ** 2
        end = np.array([across * np.cos(towards), across * np.sin(towards), stretched * np.sinc(theta / np.pi)])
        ends.append(1e3 * end)
        tip = end + turn.apply([0.0, 0.0, 0.015]) + [0.02, 0.0, 0.3]
        lines.append(",".join(f"{v:.9g}" for v in (1e4 * i, *tip, *(turn * mount.inv()).as_quat(scalar_first=True))))
    (tmp_path / "a.csv").write_text("\n".join(lines))
    given: dict[str, Any] = {"columns": plain(p1="p1", y="y"), "constants": {"p2": 0, "p3": 0}, "sensor": [0.0, 0.0, 0.015]}
    given["columns"] |= {axis: {"column": axis, "zero": zero, "unit": "m"} for axis, zero in (("x", 0.02), ("z", 0.3))}
    given["orientation"] = {"columns": ["qw", "qx", "qy", "qz"], "mount": mount.as_quat(scalar_first=True).tolist()}
    map_file = write_map(tmp_path / "map.yaml", straight="as recorded" if mounted else "first state", **given)
    assert tips(case(cli, tmp_path / "a.csv", map_file)) == pytest.approx(np.array(ends), abs=1e-6)
    assert map_of(read_yaml(map_file), load(ROBOT, Robot).actuators.words).mapped(None).base == (0.02, 0.0, 0.3)


def test_a_branch_that_the_map_states_is_not_told_from_pressures(tmp_path: Path) -> None:
    lines = ["t,p1,p2,p3,x,y,z"] + [",".join(f"{v:.8g}" for v in (t, *p, *tip)) for _, t, p, tip, _ in sweep(1)]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    told = by_map(tmp_path / "a.csv", columns=COLUMNS).table
    up, down = ["load"] * 2, ["unload"]
    assert told["branch"].tolist() == ["load", *up, *down, *(down + up + down) * 2]
    stated = by_map(tmp_path / "a.csv", columns=COLUMNS, constants={"branch": "load"}).table
    assert set(stated["branch"].tolist()) == {"load"}


OBJECTS = "holds Python objects, which could run code; save columns, a .npz of plain arrays, or Parquet instead"


def test_python_objects_in_a_numpy_file_are_refused_and_not_opened(tmp_path: Path) -> None:
    class Harmful:
        def __reduce__(self) -> Any:
            return (Path.write_text, (tmp_path / "ran", "x"))

    np.save(tmp_path / "bad.npy", {"a": Harmful()})  # type: ignore[arg-type]
    np.save(tmp_path / "numbers.npy", {"p": np.ones(4)})  # type: ignore[arg-type]
    np.savez(tmp_path / "mixed.npz", p=np.ones((4, 2)), log=np.array([Harmful()]))
    (tmp_path / "also.npz").write_bytes(pickle.dumps(Harmful()))
    for name in ("bad", "numbers"):
        refused(f"{name} {OBJECTS}", read, tmp_path / f"{name}.npy", Source())
    mixed = read(tmp_path / "mixed.npz", Source())
    assert mixed.names == ("p.1", "p.2") and f"not read: log {OBJECTS}" in mixed.notes
    refused(f"log {OBJECTS}", read, tmp_path / "mixed.npz", Source(variable="log"))
    refused("is not a NumPy file", read, tmp_path / "also.npz", Source())
    assert not (tmp_path / "ran").exists()


def npy(descr: str, shape: tuple[int, ...], data: bytes = bytes(64)) -> bytes:
    """A .npy file that claims an array."""
    header = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}}}\n".encode()
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + data


@pytest.mark.parametrize(
    ("descr", "shape"),
    [
        ("'<f8'", (500_000_000,)), ("'<U0'", (10**12,)), ("'|V0'", (10**12,)), ("'<U500000000'", ()),
        ("[('p', '<f8', (50000000,))]", (1,)), ("[('p', [('q', 'u1', (6000, 6000))])]", (1,)), ("'<f8'", (-1, -8)),
    ],
)  # fmt: skip
def test_a_numpy_file_that_claims_more_than_it_holds_is_refused(descr: str, shape: tuple[int, ...], tmp_path: Path) -> None:
    (tmp_path / "a.npy").write_bytes(npy(descr, shape))
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("p.npy", npy(descr, shape))
    for name in ("a.npy", "a.npz"):
        refused(r"claims .* cells of \d+ bytes but holds 64 bytes", read, tmp_path / name, Source())


def test_a_small_numpy_file_that_unpacks_to_much_is_refused(tmp_path: Path) -> None:
    most = np.zeros(5_000_000, np.int8)  # 40 MB as numbers
    np.savez_compressed(tmp_path / "numbers.npz", p=most)
    np.savez_compressed(tmp_path / "words.npz", p=np.full(200_000, "a"))
    np.savez_compressed(tmp_path / "columns.npz", p=np.zeros((600, 6000), np.int8))
    with zipfile.ZipFile(tmp_path / "packed.npz", "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("p.npy", npy("'<f8'", (8,)))
    said = {"numbers": "40 MB, at most 32 MB are read of 0.005", "words": "52 MB", "columns": "has 6000 columns"}
    for name, why in (said | {"packed": "is not packed"}).items():
        assert (tmp_path / f"{name}.npz").stat().st_size < 100_000
        refused(why, read, tmp_path / f"{name}.npz", Source())


def test_axes_that_multiply_small_arrays_are_bounded(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", p=np.zeros(30_000), tip=np.zeros(30_000))
    refused("unpacked it has 28800 MB", read, tmp_path / "a.npz", Source(axes={"p": ("trial",), "tip": ("time",)}))


def test_a_table_of_structures_keeps_its_rows(tmp_path: Path) -> None:
    rows = np.zeros(4, [("t", "f8"), ("p", "f4", (2,)), ("name", "U4"), ("tip", [("x", "f8"), ("y", "f8")])])
    rows["p"], rows["tip"]["y"], rows["name"] = [[1, 2]] * 4, range(4), "up"
    np.save(tmp_path / "a.npy", rows)
    table = read(tmp_path / "a.npy", Source())
    assert table.names == ("a.t", "a.p.1", "a.p.2", "a.name", "a.tip.x", "a.tip.y")
    assert table.numbers["a.p.2"].tolist() == [2] * 4 and table.numbers["a.tip.y"].tolist() == [0, 1, 2, 3]


def test_a_parquet_table_of_a_value_that_repeats_is_bounded(tmp_path: Path) -> None:
    table = pyarrow.table({"p": pyarrow.DictionaryArray.from_arrays(np.zeros(7_000_000, np.int8), pyarrow.array([1.0]))})
    pyarrow.parquet.write_table(table, tmp_path / "a.parquet")
    assert (tmp_path / "a.parquet").stat().st_size < 400_000
    refused("unpacked it has 56 MB, at most 32 MB", read, tmp_path / "a.parquet", Source())


def test_arrays_and_topics_become_columns(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", t=np.arange(4.0), p=np.ones((4, 2)), short=np.zeros(2))
    assert read(tmp_path / "a.npz", Source()).names == ("t", "p.1", "p.2")
    with open(tmp_path / "json.mcap", "wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        pose, pressure = (writer.register_channel(topic, "json", schema) for topic in ("/pose", "/pressure"))
        for i in range(5):
            writer.add_message(pose, i * 10**8, json.dumps({"position": {"x": i, "y": 0, "z": 1}}).encode(), i * 10**8)
            writer.add_message(pressure, i * 10**8 + 5 * 10**7, json.dumps({"data": [10.0 * i, 0]}).encode(), i * 10**8)
        writer.finish()
    topics = read(tmp_path / "json.mcap", Source()).numbers
    assert topics["/pose.position.x"].tolist() == [0, 1, 2, 3, 4] and topics["time"] == pytest.approx([0, 0.1, 0.2, 0.3, 0.4])
    assert topics["/pressure.data.1"] == pytest.approx([0, 5, 15, 25, 35])  # between its own readings


def nested(rows: list[Any], odd: dict[str, Any]) -> Any:
    """The sweep with times of the clock, lists, structures and words, and columns that are no measurements."""
    pressures = [[v / 1e3 for v in p] for _, _, p, _, _ in rows]
    bodies = [[{"name": "tip", "at": dict(zip("xyz", (1e3 * tip).tolist(), strict=True))}, {"name": "base", "at": None}]
              for *_, tip, _ in rows]  # fmt: skip
    bodies = [b[::-1] if i % 2 else b for i, b in enumerate(bodies)]  # told by their names, not by their order
    at = [np.datetime64("2026-03-01T12:00:00.000") + int(1e3 * t) for _, t, *_ in rows]
    columns = {"time": at, "pressure_kPa": pyarrow.array(pressures, pyarrow.list_(pyarrow.float32()))}
    return pyarrow.table(columns | {"bodies_mm": bodies, "branch": [b for *_, b in rows]} | odd)


def test_lists_and_structures_of_a_parquet_table_become_columns_and_odd_ones_cost_themselves_alone(tmp_path: Path) -> None:
    rows = sweep()
    many = len(rows)
    odd = {
        "image": pyarrow.array([b"x"] * many),
        "wide": [list(range(600))] * many,
        "ragged": [[1.0, 2.0][: i % 3] or None for i in range(many)],
        "gains": pyarrow.array([[("kp", 0.5)]] * many, pyarrow.map_(pyarrow.string(), pyarrow.float64())),
        "cells": [[[1, 2], [3]]] * many,
        "blob": [[b"x"]] * many,
    }
    pyarrow.parquet.write_table(nested(rows, odd), tmp_path / "run.parquet")
    found = read(tmp_path / "run.parquet", Source())
    names = ("time", *(f"pressure_kPa.{k}" for k in (1, 2, 3)), *(f"bodies_mm.tip.at.{a}" for a in "xyz"))
    assert set(names) <= set(found.names) and found.units["pressure_kPa.2"] == "kPa" and found.units["bodies_mm.tip.at.x"] == "mm"
    assert {"ragged.1", "ragged.2", "gains.kp", "cells.1.2", "cells.2.1"} <= set(found.names)
    assert np.isnan(found.numbers["ragged.2"][:2]).all() and found.numbers["ragged.2"][2] == 2
    for name, why in (("image", "bytes, not measurements"), ("wide", "500 or more values in a row"), ("blob", "no number")):
        assert any(f"column {name!r}" in n and why in n for n in found.notes)
    columns = plain(t="time", **{f"p{k}": f"pressure_kPa.{k}" for k in (1, 2, 3)}) | {
        a: {"column": f"bodies_mm.tip.at.{a}"} for a in "xyz"
    }
    columns["branch"] = {"column": "branch", "values": {"auf": "load", "ab": "unload"}}
    table = by_map(tmp_path / "run.parquet", columns=columns, trials={"begin": "rest"}).table
    assert table["p2"] == pytest.approx([p[1] for _, _, p, _, _ in rows], rel=1e-6)
    assert tips(table) == pytest.approx(truth()) and table["t"] == pytest.approx([t for _, t, *_ in rows])
    assert table["trial"].tolist() == [n for n, *_ in rows] and set(table["branch"][3::4]) == {"unload"} != set(table["branch"])
    (tmp_path / "bad.parquet").write_bytes(b"PAR1 and nothing more")
    refused("is not a Parquet file", read, tmp_path / "bad.parquet", Source())


def test_a_damaged_column_of_a_parquet_table_costs_itself_alone(tmp_path: Path) -> None:
    file = tmp_path / "run.parquet"
    columns = {"time": np.arange(99.0), "odd": np.arange(99.0) ** 2}
    pyarrow.parquet.write_table(pyarrow.table(columns), file, compression="gzip", use_dictionary=False)
    begin = pyarrow.parquet.ParquetFile(file).metadata.row_group(0).column(1).data_page_offset
    data = bytearray(file.read_bytes())
    data[begin + 30 : begin + 90] = bytes(60)
    file.write_bytes(data)
    found = read(file, Source())
    assert found.numbers["time"].tolist() == list(range(99)) and found.names == ("time",)
    assert any("column 'odd' (double) is left out" in n for n in found.notes)


@pytest.mark.parametrize(("name", "library"), [("a.mat", "h5py"), ("a.parquet", "pyarrow.parquet"), ("a.c3d", "c3d")])
def test_a_reader_that_is_not_installed_is_named(
    name: str, library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    matlab_hdf5(tmp_path / name, {"p": np.ones((4, 2))})
    monkeypatch.setitem(sys.modules, library, None)
    map_file = write_map(tmp_path / "map.yaml", columns=COLUMNS)
    told = cli("import", tmp_path / name, "--map", map_file, "--out", tmp_path / "case", code=2).flat_err
    assert f"is read with {library}, which is not installed; pip install 'softlab[import]'" in told


def test_plateaus_are_where_every_pressure_stands() -> None:
    t = np.arange(0, 10, 0.02)
    p = np.interp(t, [0, 2, 3, 5, 5.2, 5.4, 7, 10], [0, 0, 50e3, 50e3, 60e3, 50e3, 50e3, 80e3])[:, None]
    found = plateaus(Plateaus(steady=1e3, shortest=0.5, settling=0.2), t, p, np.zeros(len(t), np.int64))
    assert len(found) == 3
    assert [round(float(p[c.rows].mean()) / 1e3) for c in found] == [0, 50, 50]
    assert all(np.ptp(p[c.rows]) < 1.5e3 for c in found)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("Tip X [mm]", (("tip", "x"), "mm")), ("p1_kPa", (("p1",), "kPa")), ("Druck 3 (bar)", (("druck", "3"), "bar")),
        ("time_ms", (("time",), "ms")), ("tipPos.z", (("tip", "pos", "z"), "")),
        ("Spine length / mm", (("spine", "length"), "mm")), ("weight_g", (("weight",), "g")),
        ("tension_2_N", (("tension", "2"), "N")), ("clock_s", (("clock",), "s")), ("y_m", (("y",), "m")),
        ("mode_g", (("mode", "g"), "")), ("run_in", (("run", "in"), "")), ("plate_X_in", (("plate", "x"), "in")),
    ],
)  # fmt: skip
def test_headings(name: str, said: tuple[tuple[str, ...], str]) -> None:
    assert (heading(name).words, heading(name).unit) == said

    assert quadruples([heading(n) for n in ("q0", "qx", "qy", "qz", "tip_q0")]) == [("q0", "qx", "qy", "qz")]
    assert quadruples([heading(f"Tip quat{k}") for k in (1, 2, 3, 0)]) == [tuple(f"Tip quat{k}" for k in range(4))]
    assert quantity(heading("Payload [g]")) == "tip_mass" and quantity(heading("colour")) is None


FRAME = {"x": "x", "y": "-z", "z": "y"}
"""y of the cameras points down along the robot."""


def seen(
    path: Path,
    away: Sequence[float] = (0, 0, 0),
    levels: Sequence[float] = (0, 40, 80, 40, 0),
    chambers: int = 3,
    markers: Sequence[float] = (),
    frame: Mapping[str, Any] = FRAME,
) -> Path:
    """Where the model's tip and points at `markers` (m from the base) are when chambers are inflated in turn to levels (kPa),
    with the base `away` (robot lengths, base's axes) from the cameras' origin."""
    robot, scatter = lab.load_robot(ROBOT), np.random.default_rng(1)
    inflated = np.array([level * np.eye(3)[k] for k in range(chambers) for level in levels])
    found = lab.predict(robot, 1e3 * inflated, arcs=markers)
    places = np.concatenate([found.tip[:, None], found.shape], axis=1) + robot.length * np.array(away)
    places += scatter.normal(0, 1e-4, places.shape)
    rows = np.column_stack([inflated, 1e3 * (places @ Frame(**frame).matrix).reshape(len(inflated), -1)])
    names = [f"{name} {axis} [mm]" for name in ("Tip", *"ABCD"[: len(markers)]) for axis in "XYZ"]
    pandas.DataFrame(rows, columns=[*(f"P{k} [kPa]" for k in (1, 2, 3)), *names]).to_csv(path, index=False, float_format="%.3f")
    return path


@pytest.mark.parametrize("levels", [(0, 40, 80, 40, 0), (30, 50, 80, 50, 30)], ids=["with rests", "never at rest"])
@pytest.mark.parametrize("away", [(0, 0, 0), (3, -1, 2), (0, 0, -2), (0, 0, -1.85), (0.1, 0.6, -1)])
def test_the_frame_is_guessed_by_how_the_tip_moves_wherever_the_origin_is_and_its_map_is_taken(
    away: tuple[float, ...], levels: tuple[float, ...], tmp_path: Path, cli: Cli
) -> None:
    file = seen(tmp_path / "table.csv", away, levels)
    proposed = yaml.safe_load((map_file := guessed(cli, file)).read_text())
    assert proposed["frame"] == FRAME and ("straight" in proposed) == any(away)
    # two lengths behind the base, the resting body lies along the other direction
    assert ("frame.z" in str(proposed.get("unconfirmed"))) == (away in ((0, 0, -2), (0, 0, -1.85)))
    model = lab.predict(lab.load_robot(ROBOT), np.array([[1e3 * levels[0], 0, 0]])).tip[0]
    assert tips(case(cli, file, map_file))[0] == pytest.approx(1e3 * model, abs=1)


def test_a_frame_that_little_movement_does_not_show_is_unconfirmed(tmp_path: Path, cli: Cli) -> None:
    file = seen(tmp_path / "table.csv", (3, -1, 2), (0, 5, 10, 5, 0), chambers=1)
    assert "frame.z: neither the resting tip nor its movement" in guessed(cli, file).read_text()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("across", [0.0, 0.9, 30.0])
def test_a_turn_that_nothing_recorded_shows_is_named_with_what_to_measure(across: float, tmp_path: Path, cli: Cli) -> None:
    """`across`: mm by which the tip leaves a line, along which it is mirrored, and a tenth of that of a marker off theirs."""
    lines = ["p1 [kPa],p2 [kPa],p3 [kPa]," + ",".join(f"{m}_{axis} [mm]" for m in "abc" for axis in "xyz")]
    for p in [0, 20, 40, 60, 40, 20] * 3:
        x, z = -across * p / 60, -(150 + 0.1 * p)
        lines.append(f"{p},0,0,{x},0,{z},{x + 10},{across / 10},{z},{x + 20},0,{z}")
    (file := tmp_path / "line.csv").write_text("\n".join(lines))
    columns = {name: f"{name} [kPa]" for name in ("p1", "p2", "p3")}
    made = by_map(file, columns=columns | {axis: f"a_{axis} [mm]" for axis in "xyz"})
    assert judged(lab.load_robot(ROBOT), made.table).asked  # as a mirror image, for which it is turned
    said = "do not determine the frame's turn about this line; add some in which one chamber is inflated"
    assert any(said in question for question in made.questions) == (across == 0)
    turning = write_map(tmp_path / "map.yaml", columns=columns, points={"tip": {"of": ["a", "b", "c"], "turn": True}})
    told = cli("import", file, "--map", turning, "--robot", ROBOT, "--out", tmp_path / "case", code=0 if across > 1 else 2).flat
    said = "markers lie on one line in 18 of 18 rows (first: line 2), so that the turn about it is not determined; add a marker"
    assert (said in told) == (across < 1)


def test_swapped_chambers_do_not_turn_the_base_round(tmp_path: Path, cli: Cli) -> None:
    gentle = (0, 20, 40, 20, 0)  # the movement alone fits a base that is upside down
    for away, levels, markers in (((0, 0, 0), (0, 40, 80), ()), ((3, -1, 2), (0, 40, 80), ()), ((3, -1, 2), gentle, (0.05, 0.1))):
        file = seen(tmp_path / "table.csv", away, levels, markers=markers)
        assert (proposed := yaml.safe_load(guessed(cli, file).read_text()))["frame"] == FRAME
        assert "frame" not in str(proposed.get("unconfirmed"))
        file.write_text(file.read_text().replace("P2 [kPa],P3", "P3 [kPa],P2", 1))
        proposed = yaml.safe_load(guessed(cli, file).read_text())
        assert proposed["frame"]["z"] == "y" and "Two columns of the tip or of the actuators" in str(proposed["unconfirmed"])
        assert ("whether chambers are exchanged" in str(proposed["unconfirmed"])) == bool(markers)


def test_forces_along_the_file_s_axes_are_turned_as_places_are_and_those_along_unstated_axes_noted(tmp_path: Path) -> None:
    file = seen(tmp_path / "table.csv")
    pandas.read_csv(file).assign(Fx_N=0.0, Fy_N=0.0, Fz_N=0.5).to_csv(file, index=False)
    values = through(file)[0].values
    values["columns"] |= {f"force_{axis}": f"F{axis}_N" for axis in "xyz"}
    turned, kept = by_map(file, **values, forces="file"), by_map(file, **values)
    assert turned.table.tip_force[0] == pytest.approx([0.0, -0.5, 0.0]) and not any("forces" in n for n in turned.notes)
    assert kept.table.tip_force[0] == pytest.approx([0.0, 0.0, 0.5]) and any("write `forces: file`" in n for n in kept.notes)


ASKEW: dict[str, Any] = {"x": [0.8, 0.6, 0], "y": "z", "z": [0.6, -0.8, 0]}
"""A base that points horizontally between the cameras' axes."""


@pytest.mark.parametrize(
    ("wrong", "right"),
    [({"x": "x", "y": "z", "z": "-y"}, FRAME), (ASKEW | {"x": [-0.8, -0.6, 0], "y": "-z"}, ASKEW),
     *(pytest.param({"x": x, "y": "z", "z": z}, FRAME, marks=pytest.mark.long) for x, z in (("y", "x"), ("-x", "y")))],
)  # fmt: skip
def test_the_line_that_is_said_of_a_wrong_frame_is_that_of_the_right_one(
    wrong: dict[str, Any], right: dict[str, Any], tmp_path: Path, cli: Cli
) -> None:
    file = seen(tmp_path / "table.csv", frame=right)
    values = yaml.safe_load((map_file := guessed(cli, file)).read_text()) | {"frame": wrong, "straight": "at rest"}
    values.pop("unconfirmed", None)
    map_file.write_text(yaml.safe_dump(values))
    said = cli("import", file, "--map", map_file, "--out", tmp_path / "case", code=(0, 2)).flat_err
    line = re.search("write `(frame: .*?)` in map.yaml", said)
    assert line is not None and yaml.safe_load(line[1]) == {"frame": right}, said
    columns = {f"p{k}": f"P{k} [kPa]" for k in (1, 2, 3)} | {a.lower(): f"Tip {a} [mm]" for a in "XYZ"}
    keys: dict[str, Any] = {"columns": columns, "frame": wrong, "straight": "at rest"}
    try:
        said = " ".join(lab.case(pandas.read_csv(file), ROBOT, **keys).table.warnings)
    except ConfigError as e:
        said = str(e)
    argument = re.search("write frame=(.*?) in lab.case", said)
    assert argument is not None and json.loads(argument[1]) == right
    assert not lab.case(pandas.read_csv(file), ROBOT, **keys | {"frame": right}).table.warnings


def test_exchanged_columns_of_the_tip_are_asked_about_before_the_order_of_its_angles(tmp_path: Path, cli: Cli) -> None:
    file = tmp_path / "swapped.csv"
    file.write_text((OWN_TABLE / "sweep.csv").read_text().replace("tip x,tip y", "tip y,tip x", 1))
    said = guessed(cli, file, OWN_TABLE / "robot.yaml").read_text()
    assert "No order fits: two columns of the tip" in said and "Check the order" not in said


@pytest.mark.parametrize("least", [0, 14])
def test_deviations_are_no_marker_at_the_base_and_a_mass_may_lack_the_stated_one(least: int, tmp_path: Path, cli: Cli) -> None:
    lines = ["P1 [kPa],x1 [mm],y1 [mm],z1 [mm],sx [mm],sy [mm],sz [mm],payload [g]"]
    lines += [f"{p},{-p},0,{150 - p**2 / 300:.2f},0.01,0.0{p % 3},0.01,{least + p}" for p in (0, 10, 20, 30, 20, 10, 0)]
    (tmp_path / "means.csv").write_text("\n".join(lines))
    (robot := tmp_path / "robot.yaml").write_text(ROBOT.read_text().replace("tip_mass: 0.0", "tip_mass: 14 g"))
    said = guessed(cli, tmp_path / "means.csv", robot).read_text()
    assert "not used: sx [mm]/sy" in said and "marker at the base" not in said
    assert ("tip_mass of 14 g: if they count only what was added, write `zero: -14`" in said) == (least < 14)


def test_the_line_that_comes_next_can_be_typed_whatever_the_file_is_called(tmp_path: Path, cli: Cli) -> None:
    folder = tmp_path / "Jan 10-2 with a name that is longer than a line of a terminal"
    folder.mkdir()
    file, out = spreadsheet(folder / "sweep.csv"), folder / "map"
    last = cli("import", file, "--guess", "--robot", ROBOT, "--out", out).out.splitlines()[-1]
    assert shlex.split(last) == ["lab", "import", str(file), "--map", str(out / "map.yaml"), "--out", "CASE"]
    last = cli("import", file, "--map", out / "map.yaml", "--out", folder / "case").out.splitlines()[-1]
    assert shlex.split(last.partition("then: ")[2]) == ["lab", "diagnose", str(folder / "case")]


def test_the_picture_of_many_states_holds_no_more_artists_than_that_of_few(
    tmp_path: Path, drawn: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    from lab.pages import import_figure

    counts: list[int] = []
    monkeypatch.setattr(import_figure, "save", lambda figure, path: counts.append(len(figure.findobj(lambda a: a.get_visible()))))
    for repeats in (4, 40):
        file = tmp_path / "sweeps.csv"
        rows = [(trial, t, *(p / 1e3 for p in pressure), *(1e3 * tip)) for trial, t, pressure, tip, _ in sweep(repeats)]
        units = {"t": "s", "p1": "kPa", "p2": "kPa", "p3": "kPa", "x": "mm", "y": "mm", "z": "mm"}
        names = {"trial": "trial", **{name: f"{name} [{unit}]" for name, unit in units.items()}}
        np.savetxt(file, rows, delimiter=",", comments="", header=",".join(names.values()))
        import_figure.draw(by_map(file, columns=plain(**names)), load(ROBOT, Robot), tmp_path / "states.png")
    assert counts[1] < 1.3 * counts[0]  # ticks differ by a few
