"""`lab export --lerobot`: a LeRobotDataset v3.0, by the format's schema and by its own library."""

import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas
import pytest
from commands import Cli
from pyarrow import parquet

from recordings.campaign.replay import metadata
from recordings.events import Request
from recordings.file.writer import Recorder
from recordings.messages import sensor
from recordings.states.rules import State, Window

WALL = 1_700_000_000 * 10**9
DATA, EPISODES = "data/chunk-000/file-000.parquet", "meta/episodes/chunk-000/file-000.parquet"
COUNTED = {"timestamp": "float", "frame_index": "int64", "episode_index": "int64", "index": "int64", "task_index": "int64"}
STATISTICS = {"min", "max", "mean", "std", "count", "q01", "q10", "q50", "q90", "q99"}
Trials = Sequence[tuple[int, float, float]]


def made(path: Path, trials: Trials, campaign: dict[str, dict[str, str]] | None = None, skip: int = 0) -> Path:
    """Ten seconds with two states of each trial (number, s of the first, s of the last). Pressures (Pa) are rig time (ms); the
    tip is not seen from 3 to 4 s, the force sensor is silent from 5 s on."""
    palm = sensor("palm", {"grip": "N"})
    with Recorder(path, start_wall_ns=WALL, metadata=campaign, chambers=2, sensors=(palm,)) as recorder:
        for k in range(1, 1000):
            t = k / 100
            for trial, *at in trials:
                if t in at:
                    state = State(trial, 1 + at.index(t), "bending", 1, "load", Window(0.5), t, t, 0.0, (0.0, 0.0), 0.1, 0.0)
                    recorder.state(t, state)
            if k % 5 == 0:
                recorder.push("/pressure", t, ((t * 1e3 + 1,) * 2, (t * 1e3,) * 2))
                recorder.push("/sensor/palm", t, (7.0,))
            turn = (1.0, 0.0, 0.0, 0.0) if k % 2 else (-1.0, 0.0, 0.0, 0.0)
            recorder.push("/tip", t, (t, k, (0.1, 0.2, 0.3), turn, 0.0, not 3 <= t < 4, ()))
            if t < 5:
                recorder.push("/force", t, ((3.0,) * 6, (1.0,) * 6))
        if skip:
            recorder.request(Request(9.9, "skip", "page", done=True, trial=skip))
    return path


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made(tmp_path_factory.mktemp("lerobot") / "run.mcap", [(1, 2.0, 6.0), (2, 7.0, 9.0)])


def test_a_dataset_has_the_schema_of_the_format_and_what_was_measured(recording: Path, tmp_path: Path, cli: Cli) -> None:
    out = tmp_path / "set"
    told = cli("export", recording, "--lerobot", "--rate", 20, "--out", out, "--json").json
    info, stats = (json.loads((out / "meta" / f"{name}.json").read_text()) for name in ("info", "stats"))
    assert {str(path.relative_to(out)) for path in out.rglob("*.*")} == {
        DATA, EPISODES, "meta/info.json", "meta/stats.json", "meta/tasks.parquet"
    }  # fmt: skip
    assert (info["codebase_version"], info["fps"], info["splits"]) == ("v3.0", 20, {"train": "0:2"})
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (2, 81 + 41, 1)
    assert (told["episodes"], told["frames"]) == (2, 122)
    assert [info[f"{name}_path"] for name in ("data", "video")] == [
        "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        None,
    ]
    named = info["features"]["observation.state"]["names"]
    assert named == [
        "p1 [Pa]", "p2 [Pa]", "x [m]", "y [m]", "z [m]", "qw [1]", "qx [1]", "qy [1]", "qz [1]", "fx [N]", "fy [N]", "fz [N]",
        "mx [N m]", "my [N m]", "mz [N m]", "sensor_palm_grip [N]",
    ]  # fmt: skip
    assert info["features"]["action"] == {"dtype": "float32", "shape": [2], "names": ["p1 [Pa]", "p2 [Pa]"]}

    file = parquet.ParquetFile(out / DATA)
    types = {field.name: str(field.type).replace("element", "item") for field in file.schema_arrow}
    lists = {"observation.state": f"fixed_size_list<item: float>[{len(named)}]", "action": "fixed_size_list<item: float>[2]"}
    assert types == lists | COUNTED and list(info["features"]) == list(types)
    assert [file.metadata.row_group(k).num_rows for k in range(file.num_row_groups)] == [81, 41]
    data = {name: np.stack(column) for name, column in pandas.read_parquet(out / DATA).items()}
    assert data["index"].tolist() == list(range(122)) and data["episode_index"].tolist() == [0] * 81 + [1] * 41
    assert data["frame_index"].tolist() == [*range(81), *range(41)] and not data["task_index"].any()
    assert np.array_equal(data["timestamp"], (data["frame_index"] / 20).astype(np.float32))
    state = dict(zip(named, data["observation.state"].T, strict=True))
    rig_time = np.where(data["episode_index"], 7, 2) + data["frame_index"] / 20
    assert state["p1 [Pa]"] == pytest.approx(rig_time * 1e3)
    assert data["action"][:, 1] == pytest.approx(rig_time * 1e3 + 1)
    hidden = (rig_time > 3.015) & (rig_time < 3.985)  # when frames of the tip were taken is known to some ms
    assert np.isnan(state["x [m]"][hidden]).all() and not np.isnan(state["x [m]"][(rig_time < 2.985) | (rig_time > 4.015)]).any()
    assert set(state["qw [1]"][~np.isnan(state["qw [1]"])]) == {1.0}
    assert set(state["fz [N]"][rig_time < 5]) == {2.0} and np.isnan(state["fz [N]"][rig_time > 5.02]).all()

    for name, values in data.items():
        of = {key: np.array(value) for key, value in stats[name].items()}
        assert set(of) == STATISTICS and of.pop("count") == [122], name
        flat = values.reshape(122, -1).astype(float)
        assert all(value.shape == (flat.shape[1],) for value in of.values())
        assert of["mean"] == pytest.approx(np.nanmean(flat, axis=0)) and of["std"] == pytest.approx(np.nanstd(flat, axis=0))
        assert of["q90"] == pytest.approx(np.nanquantile(flat, 0.9, axis=0))
    episodes = pandas.read_parquet(out / EPISODES)
    assert episodes["length"].tolist() == [81, 41] and [list(tasks) for tasks in episodes["tasks"]] == [["bending"]] * 2
    assert [episodes[f"dataset_{end}_index"].tolist() for end in ("from", "to")] == [[0, 81], [81, 122]]
    assert not episodes[[f"{place}/{kind}_index" for place in ("data", "meta/episodes") for kind in ("chunk", "file")]].any(
        axis=None
    )
    assert {f"stats/{name}/{key}" for name in data for key in STATISTICS} < set(episodes)
    assert (episodes["recording"].tolist(), episodes["trial"].tolist(), episodes["begin"].tolist()) == (
        ["run.mcap"] * 2,
        [1, 2],
        [2, 7],
    )
    tasks = pandas.read_parquet(out / "meta/tasks.parquet")
    assert (tasks.index.name, tasks.index.tolist(), tasks["task_index"].tolist()) == ("task", ["bending"], [0])


def test_an_episode_is_a_trial_that_counts_or_a_recording_without_trials(tmp_path: Path, cli: Cli) -> None:
    first = made(tmp_path / "1.mcap", [(1, 2.0, 6.0), (2, 7.0, 9.0)], metadata("c", "j", 1))
    second = made(tmp_path / "2.mcap", [(2, 1.0, 2.0), (3, 4.0, 5.0), (4, 6.0, 7.0)], metadata("c", "j", 2), skip=3)
    alone = made(tmp_path / "3.mcap", [])
    cli("export", second, first, alone, "--lerobot", "--out", tmp_path / "set")
    episodes = pandas.read_parquet(tmp_path / "set" / EPISODES)
    found = list(zip(episodes["recording"], episodes["trial"], episodes["length"], strict=True))
    assert found == [("1.mcap", 1, 41), ("2.mcap", 2, 11), ("2.mcap", 4, 11), ("3.mcap", 0, 100)]
    assert [list(tasks) for tasks in episodes["tasks"]] == [["bending"]] * 3 + [["no protocol"]]


@pytest.mark.parametrize("rate", [0, 1001])
def test_the_rate_has_limits(rate: int, recording: Path, tmp_path: Path, cli: Cli) -> None:
    said = cli("export", recording, "--lerobot", "--rate", rate, "--out", tmp_path / "set", code=2).flat_err
    assert f"--rate {rate}: must be 1 to 1000 frames per second" in said


PYTHON = os.environ.get("LEROBOT_PYTHON", sys.executable if importlib.util.find_spec("lerobot") else "")
"""An interpreter with the library `lerobot`."""
LOADED = """
import json, sys
from lerobot.datasets.lerobot_dataset import LeRobotDataset
ahead = LeRobotDataset("lab/set", root=sys.argv[1], delta_timestamps={"action": [0.0, 0.1, 0.2]})
frame = ahead[45]
print(json.dumps([len(ahead), ahead.num_episodes, ahead.fps, frame["task"], frame["observation.state"][:2].tolist(),
                  frame["action"][:, 0].tolist(), ahead.meta.stats["action"]["max"].tolist(), frame["index"].item()]))
"""


@pytest.mark.skipif(not PYTHON, reason="lerobot is not installed; LEROBOT_PYTHON may name an interpreter that has it")
def test_the_library_loads_it(recording: Path, tmp_path: Path, cli: Cli) -> None:
    cli("export", recording, "--lerobot", "--out", tmp_path / "set")
    env = {**os.environ, "HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path / "home")}
    words = [PYTHON, "-c", LOADED, tmp_path / "set"]
    done = subprocess.run(words, env=env, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    frames, episodes, fps, task, state, action, highest, index = json.loads(done.stdout.splitlines()[-1])
    assert (frames, episodes, fps, task, index) == (41 + 21, 2, 10, "bending", 45)
    assert state == [7400.0, 7400.0] and action == [7401.0, 7501.0, 7601.0] and highest == [9001.0, 9001.0]
