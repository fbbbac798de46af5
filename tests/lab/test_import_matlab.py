"""Files of MATLAB and of motion capture: tables, cells, structures and arrays on their side; Motive's and Vicon's CSV, C3D."""

import sys
import warnings
import zlib
from pathlib import Path
from typing import Any

import c3d
import h5py
import numpy as np
import pytest
from commands import Cli, refused
from foreign import AZIMUTHS, ROBOT, guessed, pressures, through, tips
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from benchmarks.faults.foreign_tables import HEADINGS, PLATEAUS, STATES, sweep
from lab.files.config import ConfigError, load
from lab.files.map_file import Map, Source
from lab.imports.formats import read

# ------------------------------------------------------------------ MATLAB: columns where they are clear, else named
ROWS = np.array(sweep())
TIME, PRESSURES, TIP = ROWS[:, 0], ROWS[:, 1:4], ROWS[:, 4:]
BRANCHES = np.array([["up", "up", "up", "down", "down"][k % 5] for k in range(STATES)], dtype=object)


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
    _, made = through(tmp_path / "run.mat")
    assert len(made.table) == STATES
    assert tips(made.table) == pytest.approx(TIP, abs=1e-6) and pressures(made.table) == pytest.approx(PRESSURES, abs=1e-6)
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
    phase = np.empty(STATES, object)
    for k, word in enumerate(BRANCHES):  # in a cell within a cell
        phase[k] = np.empty((1, 1), object)
        phase[k][0, 0] = np.array([[word]], object)
    savemat(
        tmp_path / "run.mat",
        {
            "t": TIME[None, :], "pressure_kPa": PRESSURES.T, "tip": {"x_mm": hidden, "y_mm": TIP[:, 1], "z_mm": TIP[:, 2]},
            "phase": phase, "gains": np.eye(3), "name": "finger", "rate": 100.0, "z": 1j * TIME,
        },
    )  # fmt: skip
    series = read(tmp_path / "run.mat", Source())
    assert "pressure_kPa (3 x 30) is read with rows along its second dimension" in series.notes
    left = next(n for n in series.notes if n.startswith("not read: "))
    assert "gains (3 instead of 30 rows)" in left and "name (a text)" in left
    assert "rate (one number)" in left and "z (complex numbers)" in left
    _, made = through(tmp_path / "run.mat")
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
    with pytest.raises(ConfigError, match=r"holds no table of numbers; not read: name \(a text\), parts \(cells with more"):
        read(tmp_path / "run.mat", Source())


def test_a_cell_table_and_a_matrix_with_names_are_read_by_column(tmp_path: Path) -> None:
    cells = np.empty((len(ROWS) + 1, 7), object)
    cells[0], cells[1:] = list(HEADINGS), ROWS
    savemat(tmp_path / "a.mat", {"C": cells})
    savemat(tmp_path / "b.mat", {"M": ROWS, "names": np.array(HEADINGS, object)})
    savemat(tmp_path / "c.mat", {"C": cells[1:]})
    for name, label in (("a", "C"), ("b", "M")):
        series = read(tmp_path / f"{name}.mat", Source())
        assert series.names == tuple(f"{label}.{h}" for h in HEADINGS) and len(series) == len(ROWS)
        assert series.numbers[f"{label}.Tip Z [mm]"] == pytest.approx(ROWS[:, 6])
    series = read(tmp_path / "c.mat", Source())
    assert series.names == tuple(f"C.{k}" for k in range(1, 8)) and series.numbers["C.7"] == pytest.approx(ROWS[:, 6])


def test_a_file_with_elements_of_no_kind_is_refused_and_does_not_end_the_process(tmp_path: Path) -> None:
    for compressed in (False, True):
        savemat(tmp_path / "a.mat", {"p": PRESSURES, "log": {"tip": TIP}}, do_compression=compressed)
        data = (tmp_path / "a.mat").read_bytes()
        assert len(read(tmp_path / "a.mat", Source())) == STATES
        for kind in (8, 10, 99):
            at = 132 if compressed else data.index((9).to_bytes(4, "little"), 180)
            wrong = data[: at - 4 * compressed] + kind.to_bytes(4, "little") + data[at + 4 - 4 * compressed :]
            (tmp_path / "a.mat").write_bytes(wrong)
            refused(f"is not a MATLAB file .*an element of kind {kind}", read, tmp_path / "a.mat", Source())


@pytest.mark.parametrize("kind", ["cell", "struct", "char"])
def test_an_array_within_a_matlab_variable_that_claims_more_than_it_holds_is_refused(kind: str, tmp_path: Path) -> None:
    held = np.empty((1, 3), object)
    held[:] = 1.0
    inner = {"cell": held, "struct": np.zeros((1, 3), [("a", object), ("b", object)]), "char": "abc"}[kind]
    savemat(tmp_path / "a.mat", {"log": {"inner": inner}, "p": PRESSURES})
    assert "p.1" in read(tmp_path / "a.mat", Source()).names
    data = (tmp_path / "a.mat").read_bytes()
    shape = np.array([1, 3], "<i4").tobytes()
    assert data.count(shape) == 1
    (tmp_path / "a.mat").write_bytes(data.replace(shape, np.array([20_000, 20_000], "<i4").tobytes()))
    refused(r"an array claims \d+00000000 cells and has \d{2,4} bytes", read, tmp_path / "a.mat", Source())


def test_many_small_arrays_within_a_matlab_variable_are_bounded(tmp_path: Path) -> None:
    flags, shape = np.array([6, 8, 1, 0], "<u4").tobytes(), np.array([5, 8, 200_000, 1], "<u4").tobytes()
    body = flags + shape + np.array([1, 1, 97, 0], "<u4").tobytes() + np.array([14, 0], "<u4").tobytes() * 200_000
    packed = zlib.compress(np.array([14, len(body)], "<u4").tobytes() + body)
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    (tmp_path / "a.mat").write_bytes(head + np.array([15, len(packed)], "<u4").tobytes() + packed)
    assert (tmp_path / "a.mat").stat().st_size < 100_000
    refused("unpacked it has 5. MB, at most 32 MB are read", read, tmp_path / "a.mat", Source())


# ------------------------------------------------------------------ MATLAB 7.3
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
    both = {"t": np.arange(4.0)[:, None], "p": np.arange(8.0).reshape(4, 2)}
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
    with h5py.File(tmp_path / "chunk.mat", "w", userblock_size=512) as file:
        few = file.create_dataset("p", (4, 1), np.float64, maxshape=(None, 1), chunks=(10**7, 1), scaleoffset=3)
        few.attrs["MATLAB_class"] = np.bytes_("double")
    for name, size in (("large", 8000), ("chunk", 80)):
        assert (tmp_path / f"{name}.mat").stat().st_size < 10_000
        refused(f"unpacked it has {size} MB, at most 32 MB are read", read, tmp_path / f"{name}.mat", Source())
    whole = matlab_hdf5(tmp_path / "whole.mat", {"p": np.arange(4000.0)[:, None]}).read_bytes()
    (tmp_path / "half.mat").write_bytes(whole[: len(whole) // 2])
    refused("is not a MATLAB 7.3 file", read, tmp_path / "half.mat", Source())


# ------------------------------------------------------------------ motion capture, recognised without a map
FRAMES = np.array(sweep(40, 0.02))
BASE = np.array([300.0, 1200.0, -400.0])
"""mm, of the base in the cameras' frame."""


def seen(tip: np.ndarray) -> np.ndarray:
    """mm, a tip of a hanging robot in the frame of cameras whose y points up."""
    return np.column_stack([tip[:, 1], -tip[:, 2], -tip[:, 0]]) + BASE


def motive(path: Path, rotation: str = "Quaternion", unit: str = "Millimeters") -> Path:
    """What Motive writes of two rigid bodies, one of them with a marker; in some frames the tip is not seen."""
    scale = {"Millimeters": 1.0, "Meters": 1e-3}[unit]
    frame = Rotation.from_matrix([[0, 1, 0], [0, 0, -1], [-1, 0, 0]])
    bends = 0.013 * FRAMES[:, 1:4].clip(min=0) @ np.column_stack([np.sin(AZIMUTHS), -np.cos(AZIMUTHS), 0 * AZIMUTHS])
    turned = frame * Rotation.from_rotvec(bends) * frame.inv()
    angles = turned.as_quat() if rotation == "Quaternion" else turned.as_euler("xyz", degrees=True)
    axes = ["X", "Y", "Z", "W"][: angles.shape[1]]
    n = len(axes)
    bodies = [("Base plate", "1F"), ("Finger tip", "2A")]
    body = [
        ("Rigid Body", name, key, kind, axis)
        for name, key in bodies
        for kind, axis in [*(("Rotation", a) for a in axes), *(("Position", a) for a in "XYZ"), ("Mean Marker Error", "")]
    ]
    columns = [*body, *[("Rigid Body Marker", "Finger tip:Marker1", "2B", "Position", a) for a in "XYZ"]]
    about = "Format Version,1.23,Take Name,Take 2024-03-01 12.00.00 PM,Take Notes,,Capture Frame Rate,50.000000,Export Frame "
    about += "Rate,50.000000,Capture Start Time,2024-03-01 12.00.00.000 PM,Capture Start Frame,0,Total Frames in Take,1200,"
    about += f"Total Exported Frames,1200,Rotation Type,{rotation},Length Units,{unit},Coordinate Space,Global"
    lines = [about, ""]
    lines += [",".join(["", label, *(c[i] for c in columns)]) for i, label in ((0, "Type"), (1, "Name"), (2, "ID"), (3, ""))]
    lines.append(",".join(["Frame", "Time (Seconds)", *(c[4] for c in columns)]))
    tips = seen(FRAMES[:, 4:]) * scale
    for k in range(len(FRAMES)):
        still = [*([0, 0, 0, 1] if n == 4 else [0, 0, 0]), *(BASE * scale), 0.0001]
        tip = [*angles[k], *tips[k], 0.0002, *(tips[k] + 11 * scale)]
        cells = [f"{v:.6f}" for v in still] + ([f"{v:.6f}" for v in tip] if k % 50 < 45 else [""] * len(tip))
        lines.append(",".join([str(k), f"{FRAMES[k, 0]:.6f}", *cells]))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(("rotation", "unit"), [("Quaternion", "Millimeters"), ("XYZ", "Meters")])
def test_what_motive_exports_is_recognised(rotation: str, unit: str, tmp_path: Path, cli: Cli) -> None:
    take = motive(tmp_path / "Take 1.csv", rotation, unit)
    series = read(take, Source())
    assert {"Frame", "Time (Seconds)", "Finger tip Position X", "Base plate Rotation Y", "Finger tip:Marker1 Position Z"} <= set(
        series.names
    )
    told = cli("import", take, "--guess", "--robot", ROBOT, "--out", tmp_path / "g").flat_err
    assert "constants.p1: '?' is not a number with a unit; write for example '50 kPa'" in told
    place = tmp_path / "g" / "map.yaml"
    place.write_text(place.read_text().replace("'?'", "0 kPa"))
    wanted = load(place, Map)
    tip, base = [f"Finger tip Position {a}" for a in "XYZ"], [f"Base plate Position {a}" for a in "XYZ"]
    assert wanted.points["tip"].of == (tuple(tip),) and wanted.points["tip"].against == (tuple(base),)
    assert wanted.points["tip"].unit == {"Millimeters": "mm", "Meters": "m"}[unit]
    assert wanted.orientation is not None and all(str(c).startswith("Finger tip Rotation") for c in wanted.orientation.columns)
    assert wanted.orientation.order == ("wxyz" if rotation == "Quaternion" else "euler xyz")


def write_c3d(path: Path, unit: str = "kPa", factor: float = 1.0) -> Path:
    """Two markers at 50 Hz and three pressures at 200 Hz; the tip is not seen in some frames."""
    writer = c3d.Writer(point_rate=50.0, analog_rate=200.0, point_scale=-1.0, point_units="mm  ")
    writer.set_point_labels(["Rig:Tip", "Rig:Base"])
    writer.set_analog_labels(["Pressure1", "Pressure2", "Pressure3"])
    writer.analog_group.add_str("UNITS", "units", "".join(unit.ljust(4) for _ in range(3)), 4, 3)
    for k, tip in enumerate(seen(FRAMES[:, 4:])):
        points = np.zeros((2, 5))
        points[0, :3], points[1, :3] = tip, BASE
        points[0, 3] = -1 if k % 50 > 44 else 0
        writer.add_frames([(points, factor * np.repeat(FRAMES[k, 1:4, None], 4, axis=1))])
    with warnings.catch_warnings(action="ignore"), open(path, "wb") as file:
        writer.write(file)
    return path


def test_c3d_with_analog_pressures_is_recognised(tmp_path: Path) -> None:
    series = read(write_c3d(tmp_path / "take.c3d"), Source())
    assert series.names[0] == "time" and series.units["Pressure2"] == "kPa" and series.units["Rig:Tip.x"] == "mm"
    _, made = through(tmp_path / "take.c3d")
    assert len(made.table) == PLATEAUS
    assert np.abs(made.table["z"] - 0.14).max() < 0.011 and max(made.table["p2"]) == pytest.approx(35e3, abs=30)


def test_pressures_in_volt_are_asked_about(tmp_path: Path) -> None:
    made, _ = guessed(write_c3d(tmp_path / "take.c3d", "V", 0.1))
    assert any("read in V: write the sensor's scale" in d for d in made.doubts)


@pytest.mark.parametrize("cut", [100, 600, 2000])
def test_a_torn_c3d_file_is_refused_or_read_as_far_as_it_goes(cut: int, tmp_path: Path) -> None:
    data = write_c3d(tmp_path / "take.c3d").read_bytes()
    (tmp_path / "take.c3d").write_bytes(data[:cut])
    refused(r"take.c3d: .*export", read, tmp_path / "take.c3d", Source())


def test_a_c3d_file_whose_frames_hold_nothing_is_refused(tmp_path: Path) -> None:
    data = bytearray(write_c3d(tmp_path / "take.c3d").read_bytes())
    data[2:6], data[18:20] = bytes(4), bytes(2)  # markers, analog values and samples of a frame, in the header
    for group, name, value in ((b"POINT", b"USED", bytes(2)), (b"ANALOG", b"RATE", bytes(4))):
        at = data.index(name, data.index(group)) + 8
        data[at : at + len(value)] = value
    (tmp_path / "take.c3d").write_bytes(data)
    refused("has neither markers nor analog channels", read, tmp_path / "take.c3d", Source())


@pytest.mark.parametrize("parent", [True, False])
def test_a_few_markers_of_motive_keep_their_names_and_the_unit_of_the_take(parent: bool, tmp_path: Path) -> None:
    markers = [m for m in ("Rig:Tip", "Rig:Base", "Unlabeled 7") for _ in "XYZ"]
    lines = [
        "Format Version,1.24,Take Name,T 1,Export Frame Rate,50.0,Rotation Type,Quaternion,Length Units,Centimeters,Space,Global",
        ",".join(["", "Type", *["Marker"] * 9]),
        ",".join(["", "Name", *markers]),
        *([",".join(["", "Parent", *[""] * 9])] if parent else []),
        ",".join(["", "", *["Position"] * 9]),
        ",".join(["Frame", "Time (Seconds)", *"XYZXYZXYZ"]),
    ]
    for k, tip in enumerate(seen(FRAMES[:100, 4:]) / 10):
        lines.append(",".join([str(k), f"{k / 50:.4f}", *(f"{v:.5f}" for v in (*tip, *BASE / 10)), "", "", ""]))
    (tmp_path / "take.csv").write_text("\n".join(lines))
    series = read(tmp_path / "take.csv", Source())
    assert series.form == "Motive's export" and series.common_units == {"m": "cm"}
    assert series.names[2] == "Rig:Tip Position X" and series.names[10] == "Unlabeled 7 Position Z"
    assert guessed(tmp_path / "take.csv")[0].values["points"]["tip"]["unit"] == "cm"
