"""The import scripts of the examples, on files made up in the formats of the real ones."""

from __future__ import annotations

import importlib.util
import struct
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from lab.files.config import load
from model.robot import Robot

EXAMPLES = Path(__file__).parent.parent.parent / "examples"
sys.path.insert(0, str(EXAMPLES))


def script(folder: str) -> ModuleType:
    """An import script as a module."""
    path = EXAMPLES / folder / f"import_{folder}.py"
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def write_c3d(path: Path, points: np.ndarray, rate: float = 100.0) -> None:
    """A minimal C3D file of floats: header, one parameter block, frames (n, k, 3)."""
    frames, markers = points.shape[:2]
    header = struct.pack("<BB5HfHHf", 2, 80, markers, 0, 1, frames, 10, -1.0, 3, 0, rate).ljust(512, b"\0")
    parameters = bytes([1, 80, 1, 84]).ljust(512, b"\0")
    rows = np.concatenate([points, np.zeros((frames, markers, 1))], axis=2).astype("<f4")
    path.write_bytes(header + parameters + rows.tobytes())


@pytest.mark.parametrize("folder", ["stiff_flop", "sopra_segment", "silicone_beam"])
def test_each_robot_file_is_a_robot(folder: str) -> None:
    assert load(EXAMPLES / folder / "robot.yaml", Robot).spine is None


# ------------------------------------------------------------------ STIFF-FLOP
def test_a_sensor_beside_the_axis_is_moved_back_to_the_body_s_end(tmp_path: Path) -> None:
    m = script("stiff_flop")
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
        tip = (end if bent[i] else np.array([0, 0, 0.05])) + r.apply(m.SENSOR) + [0.003, 0.002, 0.1]
        data[i, 11:14] = 1e3 * tip
        data[i, 14:18] = (r * glued).as_quat(scalar_first=True)
    savemat(tmp_path / "NoLoad.mat", {"NoLoad": data})
    first, second = m.states(tmp_path / "NoLoad.mat")
    assert first.tip == pytest.approx((0, 0, 0.05), abs=1e-9) and first.pressures == pytest.approx((0,) * 6, abs=1e-6)
    assert second.tip == pytest.approx(tuple(end), abs=1e-9)
    assert second.pressures == pytest.approx((1e5, 1e5, 0, 0, 0, 0), abs=1e-6)
    assert second.orientation == pytest.approx(turn.as_quat(canonical=True, scalar_first=True), abs=1e-9)
    assert (first.trial, first.step, second.trial, second.step) == (1, 1, 1, 2)


def test_another_mat_file_is_refused(tmp_path: Path) -> None:
    savemat(tmp_path / "NoLoad.mat", {"Load1": np.zeros((3, 24))})
    with pytest.raises(ValueError, match="no table NoLoad"):
        script("stiff_flop").states(tmp_path / "NoLoad.mat")


# ------------------------------------------------------------------ arm segment
def test_each_pressure_step_gives_its_rest_and_its_end(tmp_path: Path) -> None:
    m = script("sopra_segment")
    base = np.array([[0.0, 0.02, 0.0], [0.0, -0.02, 0.0], [0.0, 0.0, 0.02], [0.0, 0.0, -0.02]])
    tip = np.array([[0.104, 0.02, 0.0], [0.104, -0.01, 0.0], [0.104, 0.0, 0.02]])
    frames = np.tile(np.concatenate([base, tip]), (2, 150, 1, 1))
    frames[:, 100:, 4:] += [-0.002, 0.001, 0.010]
    np.save(tmp_path / "blackframe_25mbarIntervals.npy", {"p": np.array([[50], [75]]), "data": frames})  # type: ignore[arg-type]
    rows = m.states(tmp_path / "blackframe_25mbarIntervals.npy")
    assert [(r.trial, r.step, r.pressures[0]) for r in rows] == [(1, 1, 0.0), (1, 2, 5e3), (2, 1, 0.0), (2, 2, 7.5e3)]
    assert rows[0].tip == pytest.approx((0, 0, 0.1)) and rows[1].tip == pytest.approx((0.001, 0.010, 0.098))
    assert rows[1].orientation == pytest.approx((1, 0, 0, 0), abs=1e-9)


# ------------------------------------------------------------------ cantilever
def test_a_c3d_file_is_read_frame_by_frame_with_gaps_as_nan(tmp_path: Path) -> None:
    from c3d_points import read_points

    points = np.random.default_rng(1).normal(size=(7, 6, 3))
    write_c3d(tmp_path / "a.c3d", points)
    rate, found = read_points(tmp_path / "a.c3d")
    assert rate == 100.0 and found == pytest.approx(points, abs=1e-6)
    (tmp_path / "b.c3d").write_bytes(b"\x02\x51" + bytes(2000))
    with pytest.raises(ValueError, match="not a C3D file"):
        read_points(tmp_path / "b.c3d")


def test_the_beam_s_stiffness_rows_hold_what_the_weights_add_to_its_own_sag(tmp_path: Path) -> None:
    m = script("silicone_beam")
    still = np.zeros((120, 6, 3))
    still[:, :3, 2] = 0.095
    for letter in m.REPEATS:
        for name, sag in (("gravity", 0.006), ("load52", 0.016), ("load101", 0.026)):
            points = still.copy()
            points[40:, :3, 0] -= sag
            write_c3d(tmp_path / f"beam_{name}_V2_{letter}.c3d", points)
    rows = m.rows(tmp_path)
    stiff = [r for r in rows if r.protocol == "stiffness"]
    assert [(r.force, round(float(r.deflection), 6)) for r in stiff] == [(0.51, 0.01), (1.0006, 0.02)] * 2
    tips = [r for r in rows if r.protocol == "bending"]
    assert len(tips) == 6 and tips[2].tip == pytest.approx((-0.026, 0, 0.1), abs=1e-7)
    assert tips[2].tip_mass == pytest.approx(0.102, abs=1e-5)
