"""The maps of the examples, on files made up in the formats of the real ones."""

from __future__ import annotations

import shutil
import warnings
from pathlib import Path

import c3d
import numpy as np
import pytest
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from lab.cli import main
from lab.files.config import load
from model.robot import Robot
from recordings.table_file import read_csv
from recordings.trials import Table

EXAMPLES = Path(__file__).parent.parent.parent / "examples"


def write_c3d(path: Path, points: np.ndarray, labels: list[str], rate: float = 100.0) -> None:
    """A C3D file by the library's own writer; frames (n, k, 3) m."""
    writer = c3d.Writer(point_rate=rate, point_scale=-1.0)
    writer.set_point_labels(labels)
    for frame in points:
        writer.add_frames([(np.concatenate([frame, np.zeros((len(labels), 2))], axis=1), np.zeros((0, 0)))])
    with warnings.catch_warnings(), open(path, "wb") as file:
        warnings.simplefilter("ignore")
        writer.write(file)


def imported(given: Path, folder: str, out: Path) -> Table:
    """What `lab import` makes of it by the example's map."""
    assert main(["import", str(given), "--map", str(EXAMPLES / folder / "map.yaml"), "--out", str(out)]) == 0
    assert (out / "states.png").stat().st_size > 10_000
    return read_csv(out / "trials.csv")


@pytest.mark.parametrize("folder", ["stiff_flop", "sopra_segment", "silicone_beam"])
def test_each_robot_file_is_a_robot(folder: str) -> None:
    assert load(EXAMPLES / folder / "robot.yaml", Robot).spine is None


def test_a_sensor_beside_the_axis_is_moved_back_to_the_body_s_end(tmp_path: Path) -> None:
    sensor = np.array([0.014514, 0.0, 0.0145])
    glued = Rotation.from_rotvec([0.0, np.pi, 0.0])
    turn = Rotation.from_rotvec([0.5, 0.0, 0.0])
    end = np.array([0.001, -0.02, 0.045])
    t = np.arange(200) * 0.05
    bent = t >= 5.0
    data = np.zeros((200, 18))
    data[:, 0] = t
    data[:, 1:4] = 1.02
    data[bent, 1] += 0.8
    for i in range(200):
        r = turn if bent[i] else Rotation.identity()
        data[i, 11:14] = 1e3 * ((end if bent[i] else np.array([0, 0, 0.05])) + r.apply(sensor) + [0.003, 0.002, 0.1])
        data[i, 14:18] = (r * glued).as_quat(scalar_first=True)
    savemat(tmp_path / "NoLoad.mat", {"NoLoad": data})
    table = imported(tmp_path / "NoLoad.mat", "stiff_flop", tmp_path / "case")
    first, second = table.rows
    assert first.tip == pytest.approx((0, 0, 0.05), abs=1e-9) and first.pressures == pytest.approx((0,) * 6, abs=1e-6)
    assert second.tip == pytest.approx(tuple(end), abs=1e-9)
    assert second.pressures == pytest.approx((1e5, 1e5, 0, 0, 0, 0), abs=1e-6)
    assert second.orientation == pytest.approx(turn.as_quat(canonical=True, scalar_first=True), abs=1e-9)
    assert (first.trial, first.step, second.trial, second.step) == (1, 1, 1, 2)


def test_another_mat_file_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    savemat(tmp_path / "NoLoad.mat", {"Load1": np.zeros((3, 24))})
    map_file = EXAMPLES / "stiff_flop" / "map.yaml"
    assert main(["import", str(tmp_path / "NoLoad.mat"), "--map", str(map_file), "--out", str(tmp_path / "c")]) == 2
    assert "holds no 'NoLoad' (source.variable); it holds Load1" in capsys.readouterr().err


def test_each_pressure_step_gives_its_rest_and_its_end(tmp_path: Path) -> None:
    base = np.array([[0.0, 0.02, 0.0], [0.0, -0.02, 0.0], [0.0, 0.0, 0.02], [0.0, 0.0, -0.02]])
    tip = np.array([[0.104, 0.02, 0.0], [0.104, -0.01, 0.0], [0.104, 0.0, 0.02]])
    frames = np.tile(np.concatenate([base, tip]), (2, 150, 1, 1))
    frames[:, 100:, 4:] += [-0.0002, 0.0001, 0.0010]
    np.save(tmp_path / "steps.npy", {"p": np.array([[50], [75]]), "data": frames})  # type: ignore[arg-type]
    rows = imported(tmp_path / "steps.npy", "sopra_segment", tmp_path / "case").rows
    assert [(r.trial, r.step, round(r.pressures[0], 6)) for r in rows] == [
        (1, 1, 0),
        (1, 2, 5e3),
        (2, 1, 0),
        (2, 2, 7.5e3),
    ]
    assert rows[0].tip == pytest.approx((0, 0, 0.1)) and rows[1].tip == pytest.approx((0.0001, 0.0010, 0.0998))
    assert rows[1].orientation == pytest.approx((1, 0, 0, 0), abs=1e-9)
    assert [r.repeat for r in rows] == [1, 1, 1, 1]


def test_the_beam_s_stiffness_rows_hold_what_the_weights_add_to_its_own_sag(tmp_path: Path) -> None:
    files = tmp_path / "beam"
    files.mkdir()
    still = np.zeros((120, 6, 3))
    still[:, :3, 2] = 0.095
    labels = [f"{place} - {i}" for place in ("Tip", "Base") for i in (1, 2, 3)]
    for letter in "ab":
        for name, sag in (("gravity", 0.006), ("load52", 0.016), ("load101", 0.026)):
            points = still.copy()
            points[40:, :3, 0] -= sag
            write_c3d(files / f"beam_{name}_V2_{letter}.c3d", points, labels)
    shutil.copy(__file__, files / "notes.txt")
    table = imported(files, "silicone_beam", tmp_path / "case")
    stiff = [r for r in table if r.protocol == "stiffness"]
    found = [(r.repeat, r.force, round(float(r.deflection or 0), 6)) for r in stiff]
    assert sorted(found) == [(1, 0.51, 0.01), (1, 1.0006, 0.02), (2, 0.51, 0.01), (2, 1.0006, 0.02)]
    tips = [r for r in table if r.protocol == "bending"]
    assert len(tips) == 6 and sorted({(round(r.tip_mass or 0, 6), round(r.tip[0], 5)) for r in tips if r.tip}) == [
        (0.0, -0.006), (0.052, -0.016), (0.102, -0.026),
    ]  # fmt: skip
