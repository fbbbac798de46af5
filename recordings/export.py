"""Out of a recording: one CSV a stream, or a case folder (robot.yaml and trials.csv) for the diagnosis."""

from __future__ import annotations

import csv
import os
from pathlib import Path

from .errors import BadTable, MissingStream
from .messages import STREAMS
from .reader import Recording
from .replay import table_of
from .table_file import write_csv
from .trials import Table


def export_streams(recording: Recording, folder: str | os.PathLike[str]) -> list[Path]:
    """Write each stream that has samples to `<stream>.csv`; arrays become columns name_1, name_2, .. Returns the
    files."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for topic in recording.topics:
        if topic in STREAMS and len(recording.stream(topic)):
            path = folder / f"{topic.strip('/').replace('/', '_')}.csv"
            _write_stream(recording, topic, path)
            written.append(path)
    return written


def _write_stream(recording: Recording, topic: str, path: Path) -> None:
    samples = recording.stream(topic)
    names: list[str] = []
    columns: list[list[object]] = []
    for name in samples.dtype.names or ():
        values = samples[name].reshape(len(samples), -1)
        alone = samples[name].ndim == 1
        names += [name] if alone else [f"{name}_{i}" for i in range(1, values.shape[1] + 1)]
        columns += values.T.tolist()
    with open(path, "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        writer.writerows(zip(*columns, strict=True))


def export_case(recording: Recording, folder: str | os.PathLike[str], table: Table | None = None) -> Path:
    """Write a case folder; `table` defaults to the rows as concluded live. Returns the folder.

    Raises `MissingStream` when robot.yaml is not attached, `BadTable` when there is no row.
    """
    table = table_of(recording) if table is None else table
    if not len(table):
        raise BadTable(f"{recording.path} has no concluded state; try `lab replay` to read its states again")
    if "robot.yaml" not in recording.attachments:
        raise MissingStream(
            f"{recording.path} has no attachment robot.yaml; add the robot's file to the folder by hand"
        )
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.yaml").write_bytes(recording.attachments["robot.yaml"])
    write_csv(table, folder / "trials.csv")
    return folder
