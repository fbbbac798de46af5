"""The maps of the examples, on files made up in the formats of the real ones."""

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

SENSOR, GLUED = np.array([0.014514, 0.0, 0.0]), Rotation.from_rotvec([0.0, np.pi, 0.0])
"""Of stiff_flop: where the sensor sits at the tip, m, and how it is turned there."""
EXAMPLES = Path(__file__).parent.parent.parent / "examples"


def write_c3d(path: Path, points: np.ndarray, labels: list[str], rate: float = 100.0) -> None:
    """A C3D file by the library's own writer; frames (n, k, 3) m."""
    writer = c3d.Writer(point_rate=rate, point_scale=-1.0)
    writer.set_point_labels(labels)
    for frame in points:
        writer.add_frames([(np.concatenate([frame, np.zeros((len(labels), 2))], axis=1), np.zeros((0, 0)))])
    with warnings.catch_warnings(action="ignore"), open(path, "wb") as file:
        writer.write(file)


def imported(given: Path, folder: str, out: Path) -> Table:
    """What `lab import` makes of it by the example's map."""
    assert main(["import", str(given), "--map", str(EXAMPLES / folder / "map.yaml"), "--out", str(out)]) == 0
    return read_csv(out / "trials.csv")


@pytest.mark.parametrize("folder", ["stiff_flop", "sopra_segment", "silicone_beam", "braided_module", "fabric_arm"])
def test_each_robot_file_is_a_robot(folder: str) -> None:
    assert load(EXAMPLES / folder / "robot.yaml", Robot).spine is None


def test_a_sensor_beside_the_axis_is_moved_back_to_the_body_s_end(tmp_path: Path) -> None:
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
        data[i, 11:14] = 1e3 * ((end if bent[i] else np.array([0, 0, 0.05])) + r.apply(SENSOR) + [0.003, 0.002, 0.1])
        data[i, 14:18] = (r * GLUED).as_quat(scalar_first=True)
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
    np.savez(tmp_path / "segment.npz", p=np.array([[50], [75]]), data=frames)
    rows = imported(tmp_path / "segment.npz", "sopra_segment", tmp_path / "case").rows
    assert [(r.trial, r.step, round(r.pressures[0], 6)) for r in rows] == [(1, 1, 0), (1, 2, 5e3), (2, 1, 0), (2, 2, 7.5e3)]
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


def test_a_hand_s_force_is_turned_from_the_tip_s_axes_into_the_base_s(tmp_path: Path) -> None:
    files = tmp_path / "loads"
    files.mkdir()
    turn, end = Rotation.from_rotvec([np.pi / 2, 0.0, 0.0]), np.array([0.0, -0.03, 0.03])
    for name, bent in (("Load1", False), ("Load2", True)):
        data = np.zeros((120, 30))
        data[:, 6] = 0.05 * np.arange(120)
        data[:, 7:10], data[1:, 7] = 1.02, 1.02 + 0.8 * bent
        data[:, 10:13] = [10.0, 6.0, -157.0]
        data[:, 24:27] = [0.02, -0.07, 0.01]  # not zeroed
        data[40:80, 26] -= 0.5 * bent
        data[80:, 24] += 0.3 * bent
        for i in range(120):
            r, p = (turn, end) if bent and i else (Rotation.identity(), np.array([0, 0, 0.05]))
            data[i, 17:20] = data[i, 10:13] + 1e3 * (p + r.apply(SENSOR) + [0.003, 0.002, 0.016])
            data[i, 20:24] = (r * GLUED).as_quat(scalar_first=True)
        savemat(files / f"{name}.mat", {name: data})
    table = imported(files, "stiff_flop_load", tmp_path / "case")
    assert table.trial.tolist() == [1, 2, 2, 2]
    np.testing.assert_allclose(table.tip, [(0, 0, 0.05), *[end] * 3], atol=1e-9)
    np.testing.assert_allclose(table.pressures[1:], [[1e5, 1e5, 0, 0, 0, 0]] * 3, atol=1e-6)
    np.testing.assert_allclose(table.tip_force, [[0, 0, 0], [0, 0, 0], [0, 0.5, 0], [0.3, 0, 0]], atol=1e-9)


def test_settings_in_no_order_are_trials_of_their_own_read_where_robot_yaml_says(tmp_path: Path) -> None:
    levels = np.array([[102e3, 102.5e3, 101e3], [150e3, 110e3, 101e3], [120e3, 180e3, 130e3]])
    tips = np.array([[0.001, -0.01, 0.066], [-0.02, -0.008, 0.060], [0.02, -0.04, 0.055]])
    rows = np.hstack([np.repeat(levels, 120, axis=0), np.repeat(tips, 120, axis=0)])
    np.savetxt(tmp_path / "p_rho_DataPoints_Dynamic.csv", rows, delimiter=",", fmt="%.6g")
    table = imported(tmp_path / "p_rho_DataPoints_Dynamic.csv", "braided_module", tmp_path / "case")
    assert [(r.trial, r.step, r.branch) for r in table] == [(1, 1, "load"), (2, 1, "load"), (3, 1, "load")]
    assert table.rows[1].pressures == pytest.approx((48e3, 48e3, 7.5e3, 7.5e3, 0, 0), abs=1e-6)
    assert [r.tip for r in table] == [pytest.approx(tuple(t - tips[0] + [0, 0, 0.044 + 0.010])) for t in tips]
    assert main(["compare", str(tmp_path / "case")]) == 0


def test_steps_up_and_down_are_load_and_unload_and_folders_are_read_together(tmp_path: Path) -> None:
    turn, below = Rotation.from_rotvec([0.0, 0.4, 0.0]), np.array([0.0, 0.0, -0.010])
    for day in ("Jan 10-3", "Jan 10-4"):
        (tmp_path / day).mkdir()
        data = np.zeros((1200, 38))
        data[:, 0] = np.arange(1200) / 30
        data[:, 4:7] = [0.9, 1.6, 2.3]
        data[:, 17:20] = [0.01, -0.2, 0.56]
        data[:, 24:27], data[:, 27:31] = [0.01, -0.2, 0.40], [0, 0, 0, 1]
        for a in (1, 600):  # 10 s of 9 psi more, 10 s of the baseline, twice
            data[a : a // 600 * 600 + 300, 4] += 9.0
            data[a : a // 600 * 600 + 300, 24:27] += np.array([0.03, 0.002, 0.01]) + turn.apply(below) - below
            data[a : a // 600 * 600 + 300, 27:31] = turn.as_quat()
        np.savetxt(tmp_path / day / "data_collect_1.txt", data, delimiter=", ", fmt="%.8e")
        (tmp_path / day / "readMe.txt").write_text("offset_1 37.21\nseg1 31.92 mm\n")
    case, map_file = tmp_path / "case", EXAMPLES / "fabric_arm" / "map.yaml"
    days = [str(tmp_path / day) for day in ("Jan 10-3", "Jan 10-4")]
    assert main(["import", *days, "--map", str(map_file), "--out", str(case)]) == 0
    rows = read_csv(case / "trials.csv").rows
    assert [(r.trial, r.repeat, r.branch) for r in rows] == [
        (t, t, b) for t in (1, 2) for b in ("load", "unload", "load", "unload")
    ]
    up, rest = rows[0], rows[1]
    assert rest.tip == pytest.approx((0, 0, 0.095)) and rest.pressures == pytest.approx((0, 0, 0, 0), abs=1e-6)
    assert up.tip == pytest.approx((0.03, -0.002, 0.085)) and up.pressures == pytest.approx((62052.8, 0, 0, 0), abs=0.1)
    # cameras' z up, robot's z down: a turn about y is one about -y
    assert up.orientation == pytest.approx(tuple(Rotation.from_rotvec([0, -0.4, 0]).as_quat(scalar_first=True)), abs=1e-9)
