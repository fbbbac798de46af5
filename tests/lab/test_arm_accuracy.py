"""An arm that is not built as drawn: a run of `arm_accuracy` measures it, and a stand that states its error is right with it."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas
import pytest
from commands import SOUND, Cli
from virtual_lab import lab, meanwhile, press_ctrl_c, recorded, settings

from drivers.frames import alignment, vector_from_rotation
from lab.calibration import calibrate
from lab.files.inputs import read_case
from lab.verbs.fakes import write_rig
from protocols.arm_accuracy import ArmAccuracy, distance
from recordings.file.reader import Recording
from sim_fakes.motive import BODY_ON_FLANGE
from sim_fakes.rig import SEEDS, FakeRig
from sim_fakes.ur.kinematics import TrueArm
from sim_fakes.virtual_robot.truth import TABLE_II, RobotTruth
from tests.simulated.clock import SimulatedClock

SEED, ERRORS = 4, 1.0
ON_FLANGE = {"instruments": {"mocap": {"body": "Flange", "markers": []}}}
SHORT = settings("poses=10", "average=0.5 s")


@pytest.fixture(scope="module")
def stand(shared_clock: SimulatedClock, tmp_path_factory: pytest.TempPathFactory) -> Iterator[FakeRig]:
    with FakeRig(speed=20.0, seed=SEED, truth=RobotTruth(arm_errors=ERRORS)) as fakes:
        yield fakes


@pytest.fixture
def rig(stand: FakeRig, tmp_path: Path) -> Path:
    write_rig(stand, tmp_path / "rig.yaml", ON_FLANGE)
    return tmp_path / "rig.yaml"


def test_a_run_hands_over_where_the_joints_have_brought_the_flange(rig: Path, tmp_path: Path, cli: Cli) -> None:
    done = cli("run", "arm_accuracy", "--rig", rig, *SHORT, "--out", tmp_path, "--json", code=SOUND).json
    poses = pandas.read_csv(done["poses"])
    assert [*poses] == [f"q{k}" for k in range(1, 7)] + ["x", "y", "z", "qw", "qx", "qy", "qz", "repeat"]
    assert poses["repeat"].tolist() == [1] * 10 + [2] * 9
    joints, seen = poses.iloc[:, :6].to_numpy(), poses[["x", "y", "z"]].to_numpy()
    assert (joints[:9] == joints[:9:-1]).all()  # a pose that is visited again has the same angles: rows are repeats
    flange = [TrueArm(SEED + SEEDS["arm"], ERRORS).flange(q) for q in joints]
    nominal = [TrueArm(0, 0.0).flange(q) for q in joints]
    true, drawn = (
        alignment(np.array([[*p[:3, 3], *vector_from_rotation(p[:3, :3])] for p in at]), seen) for at in (flange, nominal)
    )
    assert true.rmse < 0.3e-3 < 2 * true.rmse < drawn.rmse == pytest.approx(np.sqrt(3) * done["position_sd"], rel=1e-2)
    assert true.point == pytest.approx(BODY_ON_FLANGE[:3], abs=0.5e-3)
    assert done["tool"] == pytest.approx(BODY_ON_FLANGE[:3], abs=5e-3)
    assert np.linalg.norm(drawn.shift) < 3e-3  # x, y, z count from the base of the arm
    assert cli("replay", done["file"], "--json").json["equal"]


def test_a_body_that_is_not_on_the_flange_ends_the_run(stand: FakeRig, tmp_path: Path, cli: Cli) -> None:
    write_rig(stand, rig := tmp_path / "rig.yaml", {"instruments": {"mocap": {"body": "Base", "markers": []}}})
    told = cli("run", "arm_accuracy", "--rig", rig, *SHORT, "--out", tmp_path, code=1).err
    assert "from where the flange has brought it" in told and "mocap.body" in told
    recording = Recording.open(recorded(tmp_path))
    assert recording.metadata["outcome"]["safe_state"] == "confirmed" and len(recording.trials) == 8


def test_ctrl_c_leaves_the_arm_standing_and_the_run_is_resumed(stand: FakeRig, rig: Path, tmp_path: Path, cli: Cli) -> None:
    assert stand.ur is not None
    meanwhile(lambda: any(tmp_path.glob("*.journal")) and max(map(abs, stand.ur.backdoor()["tcp_speed"][:3])) > 0.03,
              press_ctrl_c, press_ctrl_c)  # fmt: skip
    told = cli("run", "arm_accuracy", "--rig", rig, *settings("poses=8", "passes=1", "speed=4 cm/s"), "--out", tmp_path, code=1)
    assert "stopped" in told.both and max(map(abs, stand.ur.backdoor()["tcp_speed"])) < 1e-6
    file = recorded(tmp_path)
    assert Recording.open(file).metadata["outcome"]["safe_state"] == "confirmed"
    done = cli("run", "--resume", file, "--rig", rig, "--json", code=SOUND).json
    assert done["outcome"] == "completed" and done["rows"] == 8


@pytest.mark.parametrize(
    ("setting", "told"),
    [
        ("box=[[-0.9, -0.9, 0.02], [0.9, 0.9, 0.9]]", "outside the workspace of instruments.arm"),
        ("keep_out_radius=1 mm", "below stand.standoff = 8 cm"),
        ("speed=0.2 m/s", "above instruments.arm.max_speed = 10 cm/s"),
        ("sector_deg=1", "poses have a free way"),
    ],
)
def test_a_plan_beyond_what_the_rig_allows_is_refused(rig: Path, cli: Cli, setting: str, told: str) -> None:
    how = settings("poses=200", "nearest=0.2 m", "reach=1.2 m", "margin=0 m", setting)
    assert told in cli("plan", "arm_accuracy", "--rig", rig, *how, code=2).err


@pytest.mark.parametrize("seed", range(5))
def test_every_way_keeps_its_distances(seed: int) -> None:
    line = [(0.5, 0.0, 0.7), (0.5, 0.0, 0.3)]
    p = ArmAccuracy(seed=seed, poses=60, keep_out=line)
    places = np.array(p.drawn)[:, :3]
    ways = np.linspace(places[:-1], places[1:], 33).reshape(-1, 3)
    assert (ways > np.add(p.box[0], p.margin)).all() and (ways < np.subtract(p.box[1], p.margin)).all()
    assert np.hypot(ways[:, 0], ways[:, 1]).min() >= p.nearest and np.linalg.norm(ways, axis=1).max() <= p.reach
    assert distance(ways, line).min() > p.keep_out_radius - 1e-3


def test_an_arm_that_stands_too_near_leaves_and_comes_no_nearer() -> None:
    p = ArmAccuracy(keep_out=[(0.5, 0.0, 0.7), (0.5, 0.0, 0.3)])
    beside = (0.46, 0.0, 0.5)  # 4 cm from the line
    for index in range(p.poses):
        way = p.way(beside, index)
        room = p.room(beside, way[0][:3])
        assert way[-1] == p.drawn[index] and room[0] < 0 and (room >= room[0]).all()


def test_a_stated_error_of_the_stand_covers_what_a_bad_arm_does_to_a_modulus(stand: FakeRig, tmp_path: Path) -> None:
    how = settings("steps=4", "min_samples=40", "spine_lengths=[0.05]")
    write_rig(stand, tmp_path / "rig.yaml", {"stand": {"position_sd": 1.5e-3}})
    assert lab("run", "stiffness", "--rig", tmp_path / "rig.yaml", *how, "--out", tmp_path) in SOUND
    case = read_case([recorded(tmp_path)])
    assert case.robot.uncertainty.push_place == 1.5e-3
    (stated,) = calibrate(case).spine_modulus.values()
    exact = case.robot.model_copy(update={"uncertainty": type(case.robot.uncertainty)()})
    (unstated,) = calibrate(type(case)(exact, case.table)).spine_modulus.values()
    assert stated.interval[0] < TABLE_II[0.05] < stated.interval[1]
    assert not unstated.interval[0] < TABLE_II[0.05] < unstated.interval[1]
