"""`lab export --lerobot`: a LeRobotDataset v3.0, by the format's schema and by its own library."""

import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from commands import Cli
from pyarrow import parquet

from recordings.campaign.replay import metadata
from recordings.events import Request
from recordings.file.writer import Recorder
from recordings.messages import sensor
from recordings.states.rules import State, Window

DATA, EPISODES = "data/chunk-000/file-000.parquet", "meta/episodes/chunk-000/file-000.parquet"
NAMES = [f"{n} [{unit}]" for names, unit in (("p1 p2", "Pa"), ("x y z", "m"), ("qw qx qy qz", "1"), ("fx fy fz", "N"),
         ("mx my mz", "N m"), ("sensor_palm_grip", "N")) for n in names.split()]  # fmt: skip
COUNTED = {"timestamp": "float", "frame_index": "int64", "episode_index": "int64", "index": "int64", "task_index": "int64"}


def made(path: Path, *trials: Sequence[float], campaign: dict[str, dict[str, str]] | None = None, skip: int = 0) -> Path:
    """Ten seconds with two states of each trial (number, s of the first, s of the last). Pressures (Pa) are rig time (ms); the
    tip is not seen from 3 to 4 s, its marker never; the force sensor is silent from 5 s on."""
    palm = sensor("palm", {"grip": "N"})
    with Recorder(path, start_wall_ns=10**18, metadata=campaign, chambers=2, markers=1, sensors=[palm]) as recorder:
        for k in range(1, 1000):
            t = k / 100
            for trial in (int(trial) for trial, *at in trials if t in at):
                recorder.state(t, State(trial, 1, "bending", 1, "load", Window(0.5), t, t, 0.0, (0.0, 0.0), 0.1, 0.0))
            if k % 5 == 0:
                recorder.push("/pressure", t, ((t * 1e3 + 1,) * 2, (t * 1e3,) * 2))
                recorder.push("/sensor/palm", t, (7.0,))
            recorder.push("/tip", t, (t, k, (0.1, 0.2, 0.3), ((-1.0) ** k, 0.0, 0.0, 0.0), 0.0, not 3 <= t < 4, [(np.nan,) * 3]))
            if t < 5:
                recorder.push("/force", t, ((3.0,) * 6, (1.0,) * 6))
        if skip:
            recorder.request(Request(9.9, "skip", "page", done=True, trial=skip))
    return path


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made(tmp_path_factory.mktemp("lerobot") / "run.mcap", (1, 2.0, 6.0), (2, 7.0, 9.0))


def test_a_dataset_has_the_schema_of_the_format_and_what_was_measured(recording: Path, tmp_path: Path, cli: Cli) -> None:
    out = tmp_path / "set"
    told = cli("export", recording, "--lerobot", "--rate", 20, "--out", out, "--json").json
    info, stats = (json.loads((out / "meta" / f"{name}.json").read_text()) for name in ("info", "stats"))
    assert (told["episodes"], told["frames"], len(told["files"]), told["missing"]["action"]["p1 [Pa]"]) == (2, 122, 5, 0.0)
    facts = ("codebase_version", "fps", "splits", "total_episodes", "total_frames", "total_tasks", "video_path")
    assert [info[name] for name in facts] == ["v3.0", 20, {"train": "0:2"}, 2, 122, 1, None]
    assert info["data_path"].format(chunk_index=0, file_index=0) == DATA
    file = parquet.ParquetFile(out / DATA)
    types = {field.name: str(field.type).replace("element", "item") for field in file.schema_arrow}
    lists = {"observation.state": "fixed_size_list<item: float>[16]", "action": "fixed_size_list<item: float>[2]"}
    assert types == lists | COUNTED and list(info["features"]) == list(types)
    shapes = {name: (feature["shape"], feature["names"]) for name, feature in info["features"].items()}
    assert shapes == {"observation.state": ([16], NAMES), "action": ([2], NAMES[:2])} | dict.fromkeys(COUNTED, ([1], None))
    assert [file.metadata.row_group(k).num_rows for k in range(file.num_row_groups)] == [81, 41]

    data = {name: np.stack(column) for name, column in pd.read_parquet(out / DATA).items()}
    assert data["index"].tolist() == list(range(122)) and data["episode_index"].tolist() == [0] * 81 + [1] * 41
    assert data["frame_index"].tolist() == [*range(81), *range(41)] and not data["task_index"].any()
    assert np.array_equal(data["timestamp"], (data["frame_index"] / 20).astype(np.float32))
    state = dict(zip(NAMES, data["observation.state"].T, strict=True))
    t = np.where(data["episode_index"], 7, 2) + data["frame_index"] / 20
    assert state["p1 [Pa]"] == pytest.approx(t * 1e3) and data["action"][:, 1] == pytest.approx(t * 1e3 + 1)
    hidden, at_edge = (t > 3) & (t < 4), (np.abs(t - 3) < 0.015) | (np.abs(t - 4) < 0.015)  # cameras' clock: to some ms
    assert np.array_equal(np.isnan(state["x [m]"])[~at_edge], hidden[~at_edge])
    assert set(state["qw [1]"][~np.isnan(state["qw [1]"])]) == {1.0}
    assert set(state["fz [N]"][t < 5]) == {2.0} and np.isnan(state["fz [N]"][t > 5.02]).all()

    for name, values in data.items():
        flat = pd.DataFrame(values.reshape(122, -1).astype(float))
        shares = {f"q{100 * q:02.0f}": flat.quantile(q) for q in (0.01, 0.1, 0.5, 0.9, 0.99)}
        expected = {"min": flat.min(), "max": flat.max(), "mean": flat.mean(), "std": flat.std(ddof=0)} | shares
        assert stats[name] == {key: pytest.approx(of.tolist()) for key, of in expected.items()} | {"count": [122]}, name
    episodes = pd.read_parquet(out / EPISODES)
    assert {f"stats/{name}/{key}" for name in data for key in stats[name]} < set(episodes)
    spans = episodes[["length", "dataset_from_index", "dataset_to_index", "begin"]]
    assert spans.to_numpy().tolist() == [[81, 0, 81, 2], [41, 81, 122, 7]]
    files = episodes.filter(regex="^(data|meta/episodes)/(chunk|file)_index$")
    assert files.shape == (2, 4) and not files.any(axis=None)
    assert pd.read_parquet(out / "meta/tasks.parquet").to_dict() == {"task_index": {"bending": 0}}


def test_an_episode_is_a_trial_that_counts_or_a_recording_without_trials(tmp_path: Path, cli: Cli) -> None:
    first = made(tmp_path / "1.mcap", (1, 2.0, 6.0), (2, 7.0, 9.0), campaign=metadata("c", "j", 1))
    more = made(tmp_path / "2.mcap", (2, 1.0, 2.0), (3, 4.0, 5.0), (4, 6.0, 7.0), campaign=metadata("c", "j", 2), skip=3)
    cli("export", more, first, made(tmp_path / "3.mcap"), "--lerobot", "--out", tmp_path / "set")
    episodes = pd.read_parquet(tmp_path / "set" / EPISODES)
    found = list(zip(episodes["recording"], episodes["trial"], episodes["length"], map(",".join, episodes["tasks"]), strict=True))
    assert found == [("1.mcap", 1, 41, "bending"), ("2.mcap", 2, 11, "bending"), ("2.mcap", 4, 11, "bending"),
                     ("3.mcap", 0, 100, "no protocol")]  # fmt: skip


@pytest.mark.parametrize(("rate", "form"), [(0, "--lerobot"), (1001, "--lerobot"), (20, "--case")])
def test_the_rate_has_limits_and_belongs_to_this_format(rate: int, form: str, recording: Path, tmp_path: Path, cli: Cli) -> None:
    said = cli("export", recording, form, "--rate", rate, "--out", tmp_path / "set", code=2).flat_err
    assert f"--rate {rate}: {'must be 1 to 1000' if form == '--lerobot' else 'only --lerobot writes'} frames" in said


PYTHON = os.environ.get("LEROBOT_PYTHON", sys.executable if importlib.util.find_spec("lerobot") else "")
"""An interpreter with the library `lerobot`."""
LOADED = """
import json, sys
from lerobot.datasets.lerobot_dataset import LeRobotDataset
data = LeRobotDataset("lab/set", root=sys.argv[1], delta_timestamps={"action": [0.0, 0.1, 0.2]})
frame = data[45]
print(json.dumps([len(data), data.num_episodes, data.fps, frame["task"], frame["observation.state"][0].item(),
                  frame["action"][:, 0].tolist(), data.meta.stats["action"]["max"].tolist(), frame["index"].item()]))
"""


@pytest.mark.skipif(not PYTHON, reason="lerobot is not installed; LEROBOT_PYTHON may name an interpreter that has it")
def test_the_library_loads_it(recording: Path, tmp_path: Path, cli: Cli) -> None:
    cli("export", recording, "--lerobot", "--out", tmp_path / "set")
    env, words = {**os.environ, "HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path)}, [PYTHON, "-c", LOADED, tmp_path / "set"]
    done = subprocess.run(words, env=env, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1]) == [62, 2, 10, "bending", 7400.0, [7401.0, 7501.0, 7601.0], [9001.0] * 2, 45]
