"""`lab import`: files of other programs, by a map or by a map that is proposed."""

from __future__ import annotations

import json
import pickle
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow.parquet
import pytest
import yaml
from mcap.writer import Writer
from mcap_ros2.writer import Writer as Ros2Writer
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from lab.cli import main
from lab.files.config import ConfigError, load
from lab.imports.formats import read
from lab.imports.headings import heading, quantity
from lab.imports.map_file import Plateaus, Source
from lab.imports.plateaus import plateaus
from model.robot import Robot
from recordings.table_file import read_csv
from recordings.trials import Table

ROBOT = Path(__file__).parent.parent.parent / "examples" / "three_chambers" / "robot.yaml"
LENGTH = 0.15
AZIMUTHS = np.radians([0.0, 120.0, 240.0])
LEVELS = (0.0, 30e3, 60e3, 30e3)


def sweep(repeats: int = 2) -> list[tuple[int, float, tuple[float, ...], np.ndarray, str]]:
    """Trial, s, Pa, m and branch of a sweep of three chambers, one after the other; the tip bends away from them."""
    rows = []
    for trial in range(3 * repeats):
        for step, level in enumerate(LEVELS):
            pressure = [0.0, 0.0, 0.0]
            pressure[trial % 3] = level
            away = -np.array([np.cos(AZIMUTHS[trial % 3]), np.sin(AZIMUTHS[trial % 3])]) * level * 4.5e-7
            tip = np.array([*away, LENGTH - 5 * float(away @ away) / LENGTH])
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


def guessed(file: Path, out: Path) -> Path:
    """The map proposed for a file."""
    assert main(["import", str(file), "--guess", "--robot", str(ROBOT), "--out", str(out)]) == 0
    assert (out / "states.png").exists()
    return out / "map.yaml"


def case(file: Path, map_file: Path, out: Path) -> Table:
    assert main(["import", str(file), "--map", str(map_file), "--out", str(out)]) == 0
    return read_csv(out / "trials.csv")


def test_a_spreadsheet_of_states_needs_nothing_but_its_headings(tmp_path: Path) -> None:
    map_file = guessed(spreadsheet(tmp_path / "messung.csv"), tmp_path / "guess")
    table = case(tmp_path / "messung.csv", map_file, tmp_path / "case")
    truth = sweep()
    assert table["p2"] == pytest.approx([p[1] for _, _, p, _, _ in truth])
    assert np.column_stack([table[a] for a in "xyz"]) == pytest.approx(np.array([tip for *_, tip, _ in truth]), abs=1e-7)
    assert table["branch"].tolist() == ["load", "load", "load", "unload"] * 6
    assert table["repeat"].tolist() == [1] * 12 + [2] * 12
    assert main(["compare", str(tmp_path / "case")]) == 0


def test_a_recording_over_time_is_cut_and_turned(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Absolute mbar, cameras whose y points up above a hanging robot, markers at the base, noise."""
    rng = np.random.default_rng(3)
    lines = ["time_ms\tp1_mbar\tp2_mbar\tp3_mbar\ttip.x\ttip.y\ttip.z\tbase.x\tbase.y\tbase.z"]
    for _, _, pressure, tip, _ in sweep():
        for _ in range(50):
            x, y, z = tip + rng.normal(0, 5e-5, 3)
            seen = (np.array([y, -z, -x]) + [0.3, 1.2, -0.4]) * 1e3
            held = [(p + 101_325 + rng.normal(0, 50)) / 100 for p in pressure]
            lines.append("\t".join(f"{v:.3f}" for v in (20.0 * (len(lines) - 1), *held, *seen, 300.0, 1200.0, -400.0)))
    (tmp_path / "run.tsv").write_text("\n".join(lines))
    map_file = guessed(tmp_path / "run.tsv", tmp_path / "guess")
    assert yaml.safe_load(map_file.read_text())["frame"] == {"x": "-z", "y": "x", "z": "-y"}
    table = case(tmp_path / "run.tsv", map_file, tmp_path / "case")
    truth = sweep()
    assert len(table) == len(truth) and table["trial"].tolist() == [t for t, *_ in truth]
    assert np.column_stack([table[a] for a in "xyz"]) == pytest.approx(np.array([tip for *_, tip, _ in truth]), abs=1e-4)
    assert table["p1"] == pytest.approx([p[0] for _, _, p, _, _ in truth], abs=60)
    assert table["branch"].tolist() == ["load", "load", "load", "unload"] * 6
    capsys.readouterr()
    assert main(["import", str(tmp_path / "run.tsv"), "--map", str(map_file), "--out", str(tmp_path / "j"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["states"] == len(truth)


def write_map(path: Path, **values: Any) -> Path:
    path.write_text(yaml.safe_dump({"robot": str(ROBOT)} | values))
    return path


COLUMNS = {
    "t": {"column": "t"}, **{f"p{i}": {"column": f"p{i}"} for i in (1, 2, 3)}, **{a: {"column": a} for a in "xyz"},
}  # fmt: skip


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"columns": COLUMNS | {"p2": {"column": "p2", "unit": "mm"}}}, "columns.p2.unit = 'mm': p2 needs one of Pa"),
        ({"columns": COLUMNS | {"p2": {"column": "druck"}}}, "columns.p2 = 'druck': this column is not there; there are 't'"),
        ({"columns": COLUMNS | {"p2": {"column": 40}}}, "columns.p2 = 40: must be 1 .. 8"),
        ({"columns": COLUMNS, "frame": {"x": "y", "y": "x", "z": "z"}}, "is a mirror image"),
        ({"columns": COLUMNS, "frame": {"x": "x", "y": "y", "z": "up"}}, "z = 'up': must be one of x, -x"),
        ({"columns": {k: v for k, v in COLUMNS.items() if k != "z"}}, "give the tip by x, y and z, or by points.tip"),
        ({"columns": COLUMNS, "constants": {"tip_mass": "3 kPa"}}, "tip_mass: '3 kPa' has the unit 'kPa'"),
        ({"columns": COLUMNS, "sensor": [0.01, 0, 0]}, "needs an orientation"),
        ({"columns": COLUMNS, "forces": "tip"}, "forces: a sensor that turns with the tip needs an orientation"),
        ({"columns": COLUMNS, "states": {"plateaus": {"steady": "1 Pa"}}}, "no pressure stands within 1 Pa for 0.5 s"),
        ({"columns": COLUMNS, "frame": {"x": "-x", "y": "y", "z": "-z"}}, "change the sign of z and of y"),
    ],
)  # fmt: skip
def test_what_a_map_says_wrong_is_told(
    values: dict[str, Any], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = ["t,p1,p2,p3,x,y,z,branch"]
    lines += [",".join(f"{v:.8g}" for v in (t, *p, *tip)) + f",{b}" for _, t, p, tip, b in sweep()]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    map_file = write_map(tmp_path / "map.yaml", **values)
    assert main(["import", str(tmp_path / "a.csv"), "--map", str(map_file), "--out", str(tmp_path / "case")]) == 2
    assert words in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "case" / "trials.csv").exists()


@pytest.mark.parametrize(("sensor", "told"), [((0.0, 0.0, 0.015), False), ((0.0, 0.0, 0.0), True)])
def test_a_sensor_that_contradicts_the_turn_of_the_tip_is_noted(
    sensor: tuple[float, float, float], told: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Arcs towards four sides, read 15 mm beyond the end of the body."""
    lines = ["p1,x,y,z,qw,qx,qy,qz"]
    for i, towards in enumerate(np.radians([0, 0, 90, 180, 270, 45, 200, 310])):
        theta, stretched = (0.0, LENGTH) if i == 0 else (0.2 + 0.12 * i, LENGTH * (1 + 0.01 * i))
        turn = Rotation.from_rotvec([-theta * np.sin(towards), theta * np.cos(towards), 0.0])
        across = stretched * (theta / 2) * np.sinc(theta / 2 / np.pi) ** 2
        end = np.array([across * np.cos(towards), across * np.sin(towards), stretched * np.sinc(theta / np.pi)])
        tip = end + turn.apply([0.0, 0.0, 0.015]) + [0.02, 0.0, 0.3]
        lines.append(",".join(f"{v:.9g}" for v in (1e4 * i, *tip, *turn.as_quat(scalar_first=True))))
    (tmp_path / "a.csv").write_text("\n".join(lines))
    columns = {"p1": {"column": "p1"}} | {a: {"column": a} for a in "xyz"}
    turned = {"columns": ["qw", "qx", "qy", "qz"], "order": "wxyz"}
    map_file = write_map(
        tmp_path / "map.yaml",
        columns=columns,
        constants={"p2": 0, "p3": 0},
        orientation=turned,
        sensor=list(sensor),
        straight="first state",
    )
    assert main(["import", str(tmp_path / "a.csv"), "--map", str(map_file), "--out", str(tmp_path / "case")]) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert ("fit one arc to 0.0 mm for a sensor 15.0 mm beyond the end of the body, but to" in said) == told


def test_a_branch_that_the_map_states_is_not_told_from_pressures(tmp_path: Path) -> None:
    lines = ["t,p1,p2,p3,x,y,z"] + [",".join(f"{v:.8g}" for v in (t, *p, *tip)) for _, t, p, tip, _ in sweep(1)]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    told = case(tmp_path / "a.csv", write_map(tmp_path / "a.yaml", columns=COLUMNS), tmp_path / "told")
    up, down = ["load"] * 2, ["unload"]
    assert told["branch"].tolist() == ["load", *up, *down, *(down + up + down) * 2]
    stated = write_map(tmp_path / "b.yaml", columns=COLUMNS, constants={"branch": "load"})
    assert set(case(tmp_path / "a.csv", stated, tmp_path / "stated")["branch"].tolist()) == {"load"}


def test_a_file_of_objects_is_read_without_running_it(tmp_path: Path) -> None:
    class Harmful:
        def __reduce__(self) -> Any:
            return (Path.write_text, (tmp_path / "ran", "x"))

    np.save(tmp_path / "bad.npy", {"a": Harmful()})  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="cannot be read without running what it holds"):
        read(tmp_path / "bad.npy", Source())
    assert not (tmp_path / "ran").exists()
    (tmp_path / "also.npz").write_bytes(pickle.dumps(Harmful()))
    with pytest.raises(ConfigError, match="is not a NumPy file|holds objects"):
        read(tmp_path / "also.npz", Source())
    assert not (tmp_path / "ran").exists()


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


def matlab_hdf5(path: Path, arrays: dict[str, np.ndarray]) -> Path:
    """A file as MATLAB's save(.., '-v7.3') lays it out: 512 bytes of its own, then HDF5 with dimensions in reverse order."""
    with h5py.File(path, "w", userblock_size=512) as file:

        def put(name: str, array: np.ndarray, kind: str) -> h5py.Dataset:
            made = file.create_dataset(name, data=array.T, compression="gzip" if array.ndim == 2 else None)
            made.attrs["MATLAB_class"] = np.bytes_(kind)
            return made

        for name, array in arrays.items():
            put(name, array, "double")
        file.create_group("robot").attrs["MATLAB_class"] = np.bytes_("struct")
        put("robot/tip", np.arange(12.0).reshape(4, 3), "double")
        put("robot/seen", np.array([[1], [1], [0], [1]], np.uint8), "logical")
        put("robot/name", np.array([[ord(c) for c in "arm1"]], np.uint16), "char")
        put("robot/nothing", np.array([[0, 4]], np.uint64), "double").attrs["MATLAB_empty"] = 1
        held = put("#refs#/a", np.arange(4.0)[:, None], "double")
        cells = file.create_dataset("cells", data=np.array([[held.ref]], h5py.ref_dtype))
        cells.attrs["MATLAB_class"] = np.bytes_("cell")
        sparse = file.create_group("sparse")
        sparse.attrs["MATLAB_class"], sparse.attrs["MATLAB_sparse"] = np.bytes_("double"), 4
        sparse.create_dataset("data", data=np.arange(4.0))
        file["elsewhere"] = h5py.ExternalLink("other.mat", "p")
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64 HDF5 schema 1.00 .".ljust(124) + b"\x00\x02IM"
    with open(path, "r+b") as raw:
        raw.write(head)
    return path


def test_a_matlab_7_3_file_is_read_as_its_older_form(tmp_path: Path) -> None:
    table = np.arange(8.0).reshape(4, 2)
    both = {"t": np.arange(4.0)[:, None], "p": table}
    matlab_hdf5(tmp_path / "other.mat", {"p": np.zeros((4, 1))})
    new = read(matlab_hdf5(tmp_path / "new.mat", both), Source())
    savemat(tmp_path / "old.mat", both | {"robot": {"tip": np.arange(12.0).reshape(4, 3), "seen": np.array([1, 1, 0, 1])}})
    old = read(tmp_path / "old.mat", Source())
    assert new.form == "MATLAB 7.3" and set(new.names) == set(old.names)
    assert all((new.numbers[n] == old.numbers[n]).all() for n in old.names)
    assert new.numbers["p.2"].tolist() == [1, 3, 5, 7] and new.numbers["robot.tip.3"].tolist() == [2, 5, 8, 11]
    deep = np.arange(24.0).reshape(2, 3, 4)
    axes = read(matlab_hdf5(tmp_path / "deep.mat", {"m": deep}), Source(axes={"m": ("trial", "time", "point")}))
    assert axes.numbers["m.2"].tolist() == deep[:, :, 1].ravel().tolist()


def test_a_matlab_7_3_file_that_is_too_large_or_damaged_is_refused(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "large.mat", "w", userblock_size=512) as file:
        large = file.create_dataset("p", (10**6, 10**3), np.float64, chunks=(1000, 10), compression="gzip")
        large.attrs["MATLAB_class"] = np.bytes_("double")
    assert (tmp_path / "large.mat").stat().st_size < 10_000
    with pytest.raises(ConfigError, match="unpacked it has 8000 MB, at most 500 MB are read"):
        read(tmp_path / "large.mat", Source())
    whole = matlab_hdf5(tmp_path / "whole.mat", {"p": np.arange(4000.0)[:, None]}).read_bytes()
    (tmp_path / "half.mat").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ConfigError, match="is not a MATLAB 7.3 file"):
        read(tmp_path / "half.mat", Source())


def parquet(path: Path) -> Path:
    """A sweep as a table of another program: kPa and mm, times of the clock, words."""
    rows = sweep()
    columns: dict[str, Any] = {"at": [np.datetime64("2026-03-01T12:00:00.000") + int(1e3 * t) for _, t, *_ in rows]}
    columns |= {f"p{i}": np.array([p[i - 1] for _, _, p, _, _ in rows], np.float32) / 1e3 for i in (1, 2, 3)}
    columns |= {a: [1e3 * tip[k] for *_, tip, _ in rows] for k, a in enumerate("xyz")}
    columns |= {"branch": [b for *_, b in rows], "trial": np.array([n for n, *_ in rows], np.int64)}
    pyarrow.parquet.write_table(pyarrow.table(columns), path, compression="zstd")
    return path


def test_a_parquet_table_becomes_a_case(tmp_path: Path) -> None:
    columns: dict[str, Any] = {"t": {"column": "at"}, "trial": {"column": "trial"}}
    columns |= {f"p{i}": {"column": f"p{i}", "unit": "kPa"} for i in (1, 2, 3)}
    columns |= {a: {"column": a, "unit": "mm"} for a in "xyz"}
    columns["branch"] = {"column": "branch", "values": {"auf": "load", "ab": "unload"}}
    map_file = write_map(tmp_path / "map.yaml", columns=columns)
    table = case(parquet(tmp_path / "run.parquet"), map_file, tmp_path / "case")
    truth = sweep()
    assert table["trial"].tolist() == [n for n, *_ in truth]
    assert table["t"] == pytest.approx([t for _, t, *_ in truth])
    assert table["p2"] == pytest.approx([p[1] for _, _, p, _, _ in truth], rel=1e-6)
    assert np.column_stack([table[a] for a in "xyz"]) == pytest.approx(np.array([tip for *_, tip, _ in truth]))
    assert table["branch"].tolist() == ["load", "load", "load", "unload"] * 6
    (tmp_path / "bad.parquet").write_bytes(b"PAR1 and nothing more")
    with pytest.raises(ConfigError, match="is not a Parquet file"):
        read(tmp_path / "bad.parquet", Source())


@pytest.mark.parametrize(("name", "library"), [("a.mat", "h5py"), ("a.parquet", "pyarrow.parquet"), ("a.c3d", "c3d")])
def test_a_reader_that_is_not_installed_is_named(
    name: str, library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    matlab_hdf5(tmp_path / name, {"p": np.ones((4, 2))})
    monkeypatch.setitem(sys.modules, library, None)
    map_file = write_map(tmp_path / "map.yaml", columns=COLUMNS)
    assert main(["import", str(tmp_path / name), "--map", str(map_file), "--out", str(tmp_path / "case")]) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert f"is read with {library}, which is not installed; pip install 'softlab[import]'" in told


def test_a_ros_2_bag_is_read(tmp_path: Path) -> None:
    with open(tmp_path / "bag.mcap", "wb") as file:
        writer = Ros2Writer(file)
        point = "float64 x\nfloat64 y\nfloat64 z"
        schema = writer.register_msgdef("geometry_msgs/msg/Point", point)
        for i in range(3):
            writer.write_message("/tip", schema, {"x": 0.1 * i, "y": 0.0, "z": 0.4}, log_time=i * 10**9, publish_time=i * 10**9)
        writer.finish()
    assert read(tmp_path / "bag.mcap", Source()).numbers["/tip.x"] == pytest.approx([0, 0.1, 0.2])


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
        ("Spine length / mm", (("spine", "length"), "mm")),
    ],
)  # fmt: skip
def test_headings(name: str, said: tuple[tuple[str, ...], str]) -> None:
    assert (heading(name).words, heading(name).unit) == said

    assert quantity(heading("Payload [g]")) == "tip_mass" and quantity(heading("colour")) is None


def test_which_way_cameras_look_follows_from_how_chambers_bend(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot, file, out = load(ROBOT, Robot), tmp_path / "far.csv", tmp_path / "map"
    lines = ["P1 [kPa],P2 [kPa],P3 [kPa],Tip X [mm],Tip Y [mm],Tip Z [mm]"]
    for chamber, azimuth in enumerate(np.radians(robot.actuators.azimuths_deg)):
        for level in (0.0, 20.0, 40.0, 20.0, 0.0):
            bent = 0.01 * level
            x, y, z = -bent * np.cos(azimuth) * 80, -bent * np.sin(azimuth) * 80, 150 - 30 * bent**2
            # the cameras' Y points down along the robot, their Z along its -y; they stand elsewhere
            read_here = (400 + x, -35 + z, 1500 - y)
            lines.append(",".join(f"{v:.3f}" for v in (*(level * (k == chamber) for k in range(3)), *read_here)))
    file.write_text("\n".join(lines))
    assert main(["import", str(file), "--guess", "--robot", str(ROBOT), "--out", str(out)]) == 0
    assert yaml.safe_load((out / "map.yaml").read_text())["frame"] == {"x": "x", "y": "-z", "z": "y"}
    assert (
        "where the tip rests does not tell which axis of the file is the base's z, from base to tip; taken as the file's y"
        in " ".join(capsys.readouterr().err.split())
    )
