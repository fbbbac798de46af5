"""Exports of motion capture are recognised without a map: Motive's CSV, Vicon's CSV, C3D with analog channels."""

from __future__ import annotations

import warnings
from pathlib import Path

import c3d
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_import_tables import ROBOT, guessed

from benchmarks.faults.foreign_tables import PLATEAUS, sweep
from lab.cli import main
from lab.files.config import ConfigError, load
from lab.imports.formats import read
from lab.imports.map_file import Map, Source
from lab.imports.table import Imported, imported
from model.robot import Robot

ROWS = np.array(sweep(40, 0.02))
BASE = np.array([300.0, 1200.0, -400.0])
"""mm, of the base in the cameras' frame."""


def seen(tip: np.ndarray) -> np.ndarray:
    """mm, a tip of a hanging robot in the frame of cameras whose y points up."""
    return np.column_stack([tip[:, 1], -tip[:, 2], -tip[:, 0]]) + BASE


def turns() -> Rotation:
    """Of the tip, in the robot's frame."""
    bends = 0.013 * ROWS[:, 1:4].clip(min=0)
    azimuth = np.radians([0, 120, 240])
    return Rotation.from_rotvec(bends @ np.column_stack([np.sin(azimuth), -np.cos(azimuth), 0 * azimuth]))


def motive(path: Path, rotation: str = "Quaternion", unit: str = "Millimeters") -> Path:
    """What Motive writes of two rigid bodies, one of them with a marker; in some frames the tip is not seen."""
    scale = {"Millimeters": 1.0, "Meters": 1e-3}[unit]
    frame = Rotation.from_matrix([[0, 1, 0], [0, 0, -1], [-1, 0, 0]])
    turned = frame * turns() * frame.inv()
    angles = turned.as_quat() if rotation == "Quaternion" else turned.as_euler("xyz", degrees=True)
    axes = ["X", "Y", "Z", "W"][: angles.shape[1]]
    n = len(axes)
    bodies = [("Base plate", "1F"), ("Finger tip", "2A")]
    body = [
        ("Rigid Body", name, key, kind, axis)
        for name, key in bodies
        for kind, axis in [
            *(("Rotation", a) for a in axes),
            *(("Position", a) for a in "XYZ"),
            ("Mean Marker Error", ""),
        ]
    ]
    marker = [("Rigid Body Marker", "Finger tip:Marker1", "2B", "Position", a) for a in "XYZ"]
    columns = [*body, *marker]
    about = "Format Version,1.23,Take Name,Take 2024-03-01 12.00.00 PM,Take Notes,,Capture Frame Rate,50.000000,Export Frame "
    about += "Rate,50.000000,Capture Start Time,2024-03-01 12.00.00.000 PM,Capture Start Frame,0,Total Frames in Take,1200,"
    about += f"Total Exported Frames,1200,Rotation Type,{rotation},Length Units,{unit},Coordinate Space,Global"
    lines = [about, ""]
    lines += [",".join(["", label, *(c[i] for c in columns)]) for i, label in ((0, "Type"), (1, "Name"), (2, "ID"), (3, ""))]
    lines.append(",".join(["Frame", "Time (Seconds)", *(c[4] for c in columns)]))
    tips = seen(ROWS[:, 4:]) * scale
    for k in range(len(ROWS)):
        still = [*([0, 0, 0, 1] if n == 4 else [0, 0, 0]), *(BASE * scale), 0.0001]
        tip = [*angles[k], *tips[k], 0.0002, *(tips[k] + 11 * scale)]
        cells = [f"{v:.6f}" for v in still] + ([f"{v:.6f}" for v in tip] if k % 50 < 45 else [""] * len(tip))
        lines.append(",".join([str(k), f"{ROWS[k, 0]:.6f}", *cells]))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(("rotation", "unit"), [("Quaternion", "Millimeters"), ("XYZ", "Meters")])
def test_what_motive_exports_is_recognised(rotation: str, unit: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    take = motive(tmp_path / "Take 1.csv", rotation, unit)
    series = read(take, Source())
    assert {
        "Frame",
        "Time (Seconds)",
        "Finger tip Position X",
        "Base plate Rotation Y",
        "Finger tip:Marker1 Position Z",
    } <= set(series.names)
    assert main(["import", str(take), "--guess", "--robot", str(ROBOT), "--out", str(tmp_path / "g")]) == 0
    told = " ".join(capsys.readouterr().err.split())
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
    tips = seen(ROWS[:, 4:])
    for k, tip in enumerate(tips):
        points = np.zeros((2, 5))
        points[0, :3], points[1, :3] = tip, BASE
        points[0, 3] = -1 if k % 50 > 44 else 0
        writer.add_frames([(points, factor * np.repeat(ROWS[k, 1:4, None], 4, axis=1))])
    with warnings.catch_warnings(), open(path, "wb") as file:
        warnings.simplefilter("ignore")
        writer.write(file)
    return path


def through(file: Path) -> Imported:
    _, place = guessed(file)
    return imported([file], load(place, Map), load(ROBOT, Robot))


def test_c3d_with_analog_pressures_is_recognised(tmp_path: Path) -> None:
    series = read(write_c3d(tmp_path / "take.c3d"), Source())
    assert series.names[0] == "time" and series.units["Pressure2"] == "kPa" and series.units["Rig:Tip.x"] == "mm"
    made = through(tmp_path / "take.c3d")
    assert len(made.table) == PLATEAUS
    assert np.abs(made.table["z"] - 0.14).max() < 0.011 and max(made.table["p2"]) == pytest.approx(35e3, abs=30)


def test_pressures_in_volt_are_asked_about(tmp_path: Path) -> None:
    made, _ = guessed(write_c3d(tmp_path / "take.c3d", "V", 0.1))
    assert any("read in V: write the sensor's scale" in d for d in made.doubts)


@pytest.mark.parametrize("cut", [100, 600, 2000])
def test_a_torn_c3d_file_is_refused_or_read_as_far_as_it_goes(cut: int, tmp_path: Path) -> None:
    data = write_c3d(tmp_path / "take.c3d").read_bytes()
    (tmp_path / "take.c3d").write_bytes(data[:cut])
    with pytest.raises(ConfigError, match=r"take.c3d: .*export"):
        read(tmp_path / "take.c3d", Source())


def test_headings_of_two_lines_name_marker_and_axis(tmp_path: Path) -> None:
    """As Vicon writes them: the name above the first of three axes, units below."""
    lines = [
        "Trajectories",
        "50",
        ",,P1,P2,P3,Rig:Tip,,,Rig:Base,,",
        "Frame,Time,,,,X,Y,Z,X,Y,Z",
        ",s,kPa,kPa,kPa,mm,mm,mm,mm,mm,mm",
    ]
    for k, (tip, row) in enumerate(zip(seen(ROWS[:, 4:]), ROWS, strict=True)):
        lines.append(",".join([str(k + 1), *(f"{v:.4f}" for v in (*row[:4], *tip, *BASE))]))
    (tmp_path / "take.csv").write_text("\n".join(lines))
    made = through(tmp_path / "take.csv")
    assert len(made.table) == PLATEAUS and np.abs(made.table["z"] - 0.14).max() < 0.011


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
    for k, tip in enumerate(seen(ROWS[:100, 4:]) / 10):
        lines.append(",".join([str(k), f"{k / 50:.4f}", *(f"{v:.5f}" for v in (*tip, *BASE / 10)), "", "", ""]))
    (tmp_path / "take.csv").write_text("\n".join(lines))
    series = read(tmp_path / "take.csv", Source())
    assert series.form == "Motive's export" and series.common_units == {"m": "cm"}
    assert series.names[2] == "Rig:Tip Position X" and series.names[10] == "Unlabeled 7 Position Z"
    assert guessed(tmp_path / "take.csv")[0].values["points"]["tip"]["unit"] == "cm"
