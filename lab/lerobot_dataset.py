"""Write recordings as a LeRobotDataset v3.0 (https://huggingface.co/docs/lerobot/lerobot-dataset-v3): one episode for each
trial, or for each recording without states; frames at a fixed rate, without video.

A frame holds the newest sample of each stream that was taken by then, as a policy sees it, and NaN where that sample is
older than a gap of its stream (`GAP` usual intervals). Nothing is interpolated.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas
from numpy.typing import NDArray

from recordings.campaign.replay import campaigns, first_trial
from recordings.file.budget import Cost, ReadingBudget
from recordings.file.clocks import aligned, has_stamp
from recordings.file.counts import GAP
from recordings.file.reader import Recording
from recordings.messages import STREAMS
from recordings.own_files import replaced
from recordings.states.concluding import of_sensor, sensor_column
from recordings.states.rules import LARGEST

from .files.config import ConfigError

OBSERVED = (
    ("/pressure", "measured", ("p{} [Pa]",)),
    ("/tip", "position", ("x [m]", "y [m]", "z [m]")),
    ("/tip", "orientation", ("qw [1]", "qx [1]", "qy [1]", "qz [1]")),
    ("/tip", "markers", ("m{}x [m]", "m{}y [m]", "m{}z [m]")),
    ("/force", "raw", ("fx [N]", "fy [N]", "fz [N]", "mx [N m]", "my [N m]", "mz [N m]")),
    ("/arm", "joints", ("joint{} [rad]",)),
    ("/arm", "tcp_pose", ("tcp_x [m]", "tcp_y [m]", "tcp_z [m]")),
    ("/spine", "length", ("spine_length [m]",)),
    ("/vacuum", "absolute", ("spine_pressure_absolute [Pa]",)),
    ("/valve", "on", ("spine_vacuum_on [1]",)),
)
"""Stream, field, and names of its components with their unit; `{}` is the number of the chamber, marker or joint. Rotation
vectors are left out, because they jump."""
COMMANDED = (("/pressure", "setpoint", ("p{} [Pa]",)), ("/spine", "goal", ("spine_length [m]",)))
STATE, ACTION = "observation.state", "action"
DATA, EPISODES, TASKS = (
    "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
    "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
    "meta/tasks.parquet",
)
FIRST = {"chunk_index": 0, "file_index": 0}


class Episode(NamedTuple):
    """Frames of a trial (0: of a whole recording) at rig times (s)."""

    recording: Recording
    trial: int
    task: str
    times: NDArray[np.float64]

    def values(self, fields: Sequence[tuple[str, str, tuple[str, ...]]]) -> dict[str, NDArray[np.float32]]:
        """Return the values of each component that was measured in some frame, by name."""
        out: dict[str, NDArray[np.float32]] = {}
        for topic, field, names in fields:
            if topic not in self.recording.streams or len(samples := self.recording.stream(topic)) < 2:
                continue
            values = samples[field].reshape(len(samples), -1).astype(np.float64)
            if field == "raw":
                values -= samples["zero"]
            if field in ("position", "orientation"):
                values[~samples["valid"]] = np.nan
            if field == "orientation":
                values *= np.where(values[:, :1] < 0, -1.0, 1.0)  # q and -q are one attitude
            values[~(np.abs(values) < LARGEST)] = np.nan
            numbered = (name.replace("{}", str(k)) for k in count(1) for name in names)
            columns = self._held(topic, values).T
            own = zip(numbered if "{}" in names[0] else names, columns, strict=False)
            out |= {name: column for name, column in own if not np.isnan(column).all()}
        return out

    def _held(self, topic: str, values: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return the newest of a stream's values at each frame."""
        t = aligned(self.recording, topic) if has_stamp(topic) else self.recording.stream(topic)["t"]
        order = np.argsort(t, kind="stable")
        t = t[order]
        newest = np.searchsorted(t, self.times, side="right") - 1
        fresh = (newest >= 0) & (self.times - t[newest] <= GAP * np.median(np.diff(t)))
        return np.where(fresh[:, None], values[order[newest]], np.nan).astype(np.float32)


def episodes(recordings: Sequence[Recording], rate: int) -> Iterator[Episode]:
    """Yield the episodes: no trial that a person skipped, and of one that was begun again in a later recording only the last."""
    for group in campaigns(recordings):
        parts = sorted(group, key=lambda recording: (first_trial(recording), recording.start_wall_ns))
        for recording, again in zip(parts, [*map(first_trial, parts[1:]), None], strict=True):
            yield from (e for e in _of_recording(recording, rate) if again is None or e.trial < again)


def _of_recording(recording: Recording, rate: int) -> Iterator[Episode]:
    """Yield its trials, each from the begin of its first state to its last reading."""
    if not recording.streams:
        recording.need(*STREAMS)
    stamps = np.concatenate([recording.stream(topic)["t"] for topic in recording.streams])
    stamps, budget = stamps[np.abs(stamps) < LARGEST], ReadingBudget(str(recording.path), recording.contents.size)
    first, last = (stamps.min(), stamps.max()) if len(stamps) else (0.0, -1.0)
    spans, tasks = dict[int, list[float]](), {0: "no protocol"}
    for state in recording.states:
        spans.setdefault(state.state.trial, []).extend((state.state.t_start, state.t))
        tasks[state.state.trial] = ", ".join(filter(None, (state.state.protocol, state.state.specimen)))
    for event in recording.trials:
        spans.setdefault(event.row.trial, []).append(event.t)
    skipped = {request.trial for request in recording.requests if request.kind == "skip" and request.done}
    for trial, times in (spans or {0: [first, last]}).items():
        begin = max(first, min(times))
        frames = int((min(last, max(times)) - begin) * rate + 1)
        if trial not in skipped and frames > 0:
            budget.take(Cost.LOOKED_AT, 10 * frames)  # a frame costs about as much as ten samples
            yield Episode(recording, trial, tasks.get(trial, tasks[0]), begin + np.arange(frames) / rate)


def write_dataset(recordings: Sequence[Recording], folder: Path, rate: int) -> dict[str, Any]:
    """Write the dataset; return numbers of episodes and frames, and the share of missing values by name. Raises ConfigError."""
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError as e:
        raise ConfigError("--lerobot: needs pyarrow, which is not installed; pip install 'softlab[import]'") from e
    found = list(episodes(recordings, rate))
    if not found:
        raise ConfigError(f"{recordings[0].path}: has no samples in a trial that was not skipped, so there is no episode")
    tasks = list(dict.fromkeys(episode.task for episode in found))
    names, data = _frames(found, tasks, rate)
    whole = {key: np.concatenate([part[key] for part in data]) for key in data[0]}
    statistics = {key: _statistics(values) for key, values in whole.items()}
    rows: list[dict[str, Any]] = [
        {
            "episode_index": number, "tasks": [episode.task], "length": len(episode.times), "data/chunk_index": 0,
            "data/file_index": 0, "dataset_from_index": int(part["index"][0]), "dataset_to_index": int(part["index"][-1]) + 1,
            "meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0,
            **{f"stats/{key}/{n}": value for key, values in part.items() for n, value in _statistics(values).items()},
            "recording": episode.recording.path.name, "trial": episode.trial, "begin": float(episode.times[0]),
        }
        for number, (episode, part) in enumerate(zip(found, data, strict=True))
    ]  # fmt: skip
    features = {
        key: {"dtype": str(values.dtype), "shape": [len(names.get(key, "1"))], "names": names.get(key)}
        for key, values in whole.items()
    }
    info = {
        "codebase_version": "v3.0", "robot_type": None, "total_episodes": len(found), "total_frames": len(whole["index"]),
        "total_tasks": len(tasks), "chunks_size": 1000, "data_files_size_in_mb": 100, "video_files_size_in_mb": 200, "fps": rate,
        "splits": {"train": f"0:{len(found)}"}, "data_path": DATA, "video_path": None, "features": features,
    }  # fmt: skip
    for place in (DATA, EPISODES):
        (folder / place.format(**FIRST)).parent.mkdir(parents=True)
    parquet.write_table(pa.Table.from_pylist(rows), folder / EPISODES.format(**FIRST))
    pandas.DataFrame({"task_index": range(len(tasks))}, pandas.Index(tasks, name="task")).to_parquet(folder / TASKS)
    tables = [
        pa.table(
            {
                key: values.ravel()
                if features[key]["shape"] == [1]
                else pa.FixedSizeListArray.from_arrays(values.ravel(), values.shape[1])
                for key, values in part.items()
            }
        )
        for part in data
    ]
    with parquet.ParquetWriter(folder / DATA.format(**FIRST), tables[0].schema) as file:
        for table in tables:  # a row group for each episode
            file.write_table(table)
    for name, content in (("info", info), ("stats", statistics)):
        replaced(folder / "meta" / f"{name}.json", json.dumps(content, indent=1) + "\n")
    missing = {
        key: {n: round(float(np.isnan(column).mean()), 4) for n, column in zip(named, whole[key].T, strict=True)}
        for key, named in names.items()
    }
    return {"episodes": len(found), "frames": len(whole["index"]), "missing": missing}


def _frames(
    found: Sequence[Episode], tasks: Sequence[str], rate: int
) -> tuple[dict[str, list[str]], list[dict[str, NDArray[Any]]]]:
    """Return the names of the components of state and action, and the frames of each episode by feature."""
    sensors = tuple(
        (topic, quantity, (f"{sensor_column(topic, quantity)} [{unit}]",))
        for topic, units in {t: e.recording.units(t) for e in found for t in e.recording.streams if of_sensor(t)}.items()
        for quantity, unit in units.items()
        if quantity != "t"
    )
    measured = {key: [e.values(fields) for e in found] for key, fields in ((STATE, OBSERVED + sensors), (ACTION, COMMANDED))}
    names = {key: list(dict.fromkeys(name for values in parts for name in values)) for key, parts in measured.items()}
    data: list[dict[str, NDArray[Any]]] = []
    begin = 0
    for number, episode in enumerate(found):
        frame = np.arange(len(episode.times))
        missing = np.full(len(frame), np.nan, np.float32)
        values = {key: [measured[key][number].get(name, missing) for name in names[key]] for key in names}
        counted = {"timestamp": (frame / rate).astype(np.float32), "frame_index": frame, "episode_index": 0 * frame + number,
                   "index": begin + frame, "task_index": 0 * frame + tasks.index(episode.task)}  # fmt: skip
        data.append({key: np.column_stack(columns) for key, columns in values.items() if columns} | counted)
        begin += len(frame)
    return {key: named for key, named in names.items() if named}, data


def _statistics(values: NDArray[Any]) -> dict[str, list[float]]:
    """Return the statistics of each component that the format asks for, without missing values."""
    table = pandas.DataFrame(values.astype(np.float64))
    found = {"min": table.min(), "max": table.max(), "mean": table.mean(), "std": table.std(ddof=0)}
    found |= {f"q{percent:02d}": table.quantile(percent / 100) for percent in (1, 10, 50, 90, 99)}
    return {name: column.tolist() for name, column in found.items()} | {"count": [len(table)]}
