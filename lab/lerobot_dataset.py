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
import pandas as pd

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

Fields = tuple[tuple[str, str, tuple[str, ...]], ...]
"""Stream, field, and names of its components with their unit; `{}` is the number of the chamber, marker or joint."""
OBSERVED: Fields = (
    ("/pressure", "measured", ("p{} [Pa]",)),
    ("/tip", "position", ("x [m]", "y [m]", "z [m]")),
    ("/tip", "orientation", ("qw [1]", "qx [1]", "qy [1]", "qz [1]")),
    ("/tip", "markers", ("m{}x [m]", "m{}y [m]", "m{}z [m]")),
    ("/force", "raw", ("fx [N]", "fy [N]", "fz [N]", "mx [N m]", "my [N m]", "mz [N m]")),
    ("/arm", "joints", ("joint{} [rad]",)),
    ("/arm", "tcp_pose", ("tcp_x [m]", "tcp_y [m]", "tcp_z [m]")),  # not its rotation vector, which jumps
    ("/spine", "length", ("spine_length [m]",)),
    ("/vacuum", "absolute", ("spine_pressure_absolute [Pa]",)),
    ("/valve", "on", ("spine_vacuum_on [1]",)),
)
COMMANDED: Fields = (("/pressure", "setpoint", ("p{} [Pa]",)), ("/spine", "goal", ("spine_length [m]",)))
FIRST = "chunk-000/file-000.parquet"
PLACES = ("data", "meta/episodes")


class Episode(NamedTuple):
    """Frames of a trial (0: of a whole recording) at rig times (s)."""

    recording: Recording
    trial: int
    task: str
    times: np.ndarray


def episodes(recordings: Sequence[Recording], rate: int) -> Iterator[Episode]:
    """Yield the trials, each from the begin of its first state to its last reading, as a table of trials has them: none that a
    person skipped, and of one that was begun again in a later recording the last."""
    for group in campaigns(recordings):
        parts = sorted(group, key=lambda recording: (first_trial(recording), recording.start_wall_ns))
        for recording, again in zip(parts, [*map(first_trial, parts[1:]), None], strict=True):
            if not recording.streams:
                recording.need(*STREAMS)
            stamps = np.concatenate([recording.stream(topic)["t"] for topic in recording.streams])
            stamps = stamps[np.abs(stamps) < LARGEST]
            first, last = (stamps.min(), stamps.max()) if len(stamps) else (0.0, -1.0)
            spans, tasks = dict[int, list[float]](), dict[int, str]()
            for asked in recording.states:
                spans.setdefault(asked.state.trial, []).extend((asked.state.t_start, asked.t))
                tasks[asked.state.trial] = ", ".join(filter(None, (asked.state.protocol, asked.state.specimen)))
            for read in recording.trials:
                spans.setdefault(read.row.trial, []).append(read.t)
            budget = ReadingBudget(str(recording.path), recording.contents.size)
            for trial, times in (spans or {0: [first, last]}).items():
                begin = max(first, min(times))
                frames = int((min(last, max(times)) - begin) * rate + 1)
                if frames > 0 and trial not in recording.skipped and (again is None or trial < again):
                    budget.take(Cost.LOOKED_AT, 10 * frames)  # a frame costs about as much as ten samples
                    yield Episode(recording, trial, tasks.get(trial, "no protocol"), begin + np.arange(frames) / rate)


def held(episode: Episode, fields: Fields) -> pd.DataFrame:
    """Return the newest values of fields in each frame, a column for each component."""
    recording, frames = episode.recording, pd.DataFrame({"t": episode.times})
    for topic, field, names in fields:
        if topic not in recording.streams or len(samples := recording.stream(topic)) < 2:
            continue
        values = samples[field].reshape(len(samples), -1).astype(float)
        if topic == "/force":
            values -= samples["zero"]
        if topic == "/tip" and field != "markers":
            values[~samples["valid"]] = np.nan
        if field == "orientation":
            values *= np.where(values[:, :1] < 0, -1.0, 1.0)  # q and -q are one attitude
        values[~(np.abs(values) < LARGEST)] = np.nan
        numbered = (name.replace("{}", str(k)) for k in count(1) for name in names)
        columns = dict(zip(numbered if "{}" in names[0] else names, values.T, strict=False))
        columns["t"] = aligned(recording, topic) if has_stamp(topic) else samples["t"]
        stream = pd.DataFrame(columns).dropna(subset="t").sort_values("t", kind="stable")
        frames = pd.merge_asof(frames, stream, on="t", tolerance=GAP * float(np.median(np.diff(stream["t"]))))
    return frames.drop(columns="t").astype(np.float32)


def _observed(recording: Recording) -> Fields:
    """Return `OBSERVED` and all quantities of sensors of the lab's own."""
    units = {topic: recording.units(topic) for topic in recording.streams if of_sensor(topic)}
    quantities = [(topic, name) for topic in units for name in units[topic] if name != "t"]
    return OBSERVED + tuple((t, name, (f"{sensor_column(t, name)} [{units[t][name]}]",)) for t, name in quantities)


def write_dataset(recordings: Sequence[Recording], folder: Path, rate: int) -> dict[str, Any]:
    """Write the dataset; return numbers of episodes and frames, and the share of missing values by name. Raises ConfigError."""
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError as error:
        raise ConfigError("--lerobot: needs pyarrow, which is not installed; pip install 'softlab[import]'") from error
    found = list(episodes(recordings, rate))
    if not found:
        raise ConfigError(f"{recordings[0].path}: has no samples in a trial that was not skipped, so there is no episode")
    frame = np.concatenate([np.arange(len(e.times)) for e in found])
    episode, tasks = np.cumsum(frame == 0) - 1, pd.Index(dict.fromkeys(e.task for e in found), name="task")
    parts = {"observation.state": [held(e, _observed(e.recording)) for e in found], "action": [held(e, COMMANDED) for e in found]}
    signals = {key: pd.concat(tables, ignore_index=True).dropna(axis=1, how="all") for key, tables in parts.items()}
    counted = {
        "timestamp": (frame / rate).astype(np.float32), "frame_index": frame, "episode_index": episode,
        "index": np.arange(len(frame)), "task_index": tasks.get_indexer([e.task for e in found])[episode],
    }  # fmt: skip
    data = {key: table for key, table in signals.items() if len(table.columns)} | {k: pd.DataFrame(v) for k, v in counted.items()}
    arrays = {key: table.to_numpy() for key, table in data.items()}
    features = {
        key: {"dtype": str(values.dtype), "shape": [values.shape[1]], "names": list(data[key]) if key in signals else None}
        for key, values in arrays.items()
    }
    info = {
        "codebase_version": "v3.0", "robot_type": None, "total_episodes": len(found), "total_frames": len(frame),
        "total_tasks": len(tasks), "chunks_size": 1000, "data_files_size_in_mb": 100, "video_files_size_in_mb": 200, "fps": rate,
        "splits": {"train": f"0:{len(found)}"}, "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None, "features": features,
    }  # fmt: skip
    for place in PLACES:
        (folder / place / FIRST).parent.mkdir(parents=True)
    for name, content in (("info", info), ("stats", {key: _statistics(table) for key, table in data.items()})):
        replaced(folder / f"meta/{name}.json", json.dumps(content, indent=1) + "\n")
    pd.DataFrame({"task_index": range(len(tasks))}, tasks).to_parquet(folder / "meta/tasks.parquet")
    table = pa.table({  # a list of one number is a number
        key: pa.FixedSizeListArray.from_arrays(values.ravel(), values.shape[1]) if values.shape[1] > 1 else values[:, 0]
        for key, values in arrays.items()
    })  # fmt: skip
    rows = []
    with parquet.ParquetWriter(folder / "data" / FIRST, table.schema) as file:
        for k, e in enumerate(found):
            begin, end = np.searchsorted(episode, (k, k + 1)).tolist()
            file.write_table(table.slice(begin, end - begin))  # a row group for each episode
            rows.append({
                "episode_index": k, "tasks": [e.task], "length": end - begin, "dataset_from_index": begin,
                "dataset_to_index": end, **{f"{place}/{part}_index": 0 for place in PLACES for part in ("chunk", "file")},
                **{f"stats/{key}/{name}": v for key in data for name, v in _statistics(data[key][begin:end]).items()},
                "recording": e.recording.path.name, "trial": e.trial, "begin": float(e.times[0]),
            })  # fmt: skip
    parquet.write_table(pa.Table.from_pylist(rows), folder / "meta/episodes" / FIRST)
    missing = {key: table.isna().mean().round(4).to_dict() for key, table in signals.items()}
    return {"episodes": len(found), "frames": len(frame), "missing": missing}


def _statistics(table: pd.DataFrame) -> dict[str, list[float]]:
    """Return the statistics of each column that the format asks for, without missing values."""
    values = table.astype(np.float64)
    found = {"min": values.min(), "max": values.max(), "mean": values.mean(), "std": values.std(ddof=0)}
    found |= {f"q{percent:02d}": values.quantile(percent / 100) for percent in (1, 10, 50, 90, 99)}
    return {name: column.tolist() for name, column in found.items()} | {"count": [len(values)]}
