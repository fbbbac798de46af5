"""Out of a recording: one CSV or Parquet file a stream, one MATLAB file, or a case folder for the diagnosis."""

from __future__ import annotations

import csv
import io
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import fields
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import BadTable, MissingPackage, MissingStream
from ..events import Request
from ..file.clocks import aligned, has_stamp
from ..file.reader import Recording
from ..messages import STREAMS
from ..own_files import replaced, replacing
from ..table_file import write_csv
from ..trials import Table
from .replay import table_of

StreamFormat = Literal["csv", "parquet", "mat"]
ROWS = 10_000
"""Of a table that are written at a time."""
Columns = dict[str, NDArray[Any]]


def export_streams(recording: Recording, folder: str | os.PathLike[str], form: StreamFormat = "csv") -> list[Path]:
    """Write each stream that has samples to `<stream>.csv` or `.parquet`, or all and the trials to one `.mat`; returns the files.

    What people asked of the run, notes among it, is in `requests` where there is any.

    Arrays become columns name_1, name_2, ..; where the instrument stamps its samples a last column t_aligned (s) tells
    when they were taken by its clock. Raises `MissingPackage` when Parquet is asked for without pyarrow.

    >>> [path.name for path in export_streams(Recording.open("run.mcap"), "streams")][:2]
    ['pressure.csv', 'spine.csv']
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    if not recording.streams:
        recording.need(*STREAMS)
    if form == "mat":
        structures = {_stem(t): _columns(recording, t) for t in recording.streams if len(recording.stream(t))}
        table = table_of(recording)
        if len(table):
            structures["trials"] = {name: table[name] for name in table.columns}
        if recording.requests:
            structures["requests"] = {
                name: values.astype(object) if values.dtype.kind == "U" else values
                for name, values in _requests(recording).items()
            }
        return [write_mat(structures, folder / f"{recording.path.stem}.mat")]
    write = _write_csv if form == "csv" else _parquet_writer()
    written = []
    for topic in recording.streams:
        if len(recording.stream(topic)):
            path = folder / f"{_stem(topic)}.{form}"
            write(_columns(recording, topic), path)
            written.append(path)
    if recording.requests:
        written.append(folder / f"requests.{form}")
        write(_requests(recording), written[-1])
    return written


def _requests(recording: Recording) -> Columns:
    """What people asked of the run: one row a request."""
    asked = recording.requests
    return {field.name: np.array([getattr(one, field.name) for one in asked]) for field in fields(Request)}


def _stem(topic: str) -> str:
    return topic.strip("/").replace("/", "_")


def write_mat(structures: Mapping[str, Mapping[str, object]], path: Path) -> Path:
    """A MATLAB file (version 5) of structures of columns; returns it.

    >>> write_mat({"trials": {"x": [0.0, 0.1]}}, Path("case.mat"))
    PosixPath('case.mat')
    """
    from scipy.io import savemat

    plain = {_variable(name): {_variable(k): v for k, v in own.items()} for name, own in structures.items()}
    with replacing(path) as (file, _):
        savemat(file, plain, do_compression=True, long_field_names=True, oned_as="column")
    return path


def _variable(name: str) -> str:
    """A name that MATLAB takes."""
    own = re.sub(r"\W", "_", name)[:63]
    return own if own[:1].isalpha() else f"v{own}"[:63]


def _columns(recording: Recording, topic: str) -> Columns:
    samples = recording.stream(topic)
    out: Columns = {}
    for name in samples.dtype.names or ():
        values = samples[name].reshape(len(samples), -1)
        if samples[name].ndim == 1:
            out[name] = values[:, 0]
        else:
            out |= {f"{name}_{i}": values[:, i - 1] for i in range(1, values.shape[1] + 1)}
    if has_stamp(topic):
        out["t_aligned"] = aligned(recording, topic)
    return out


def _write_csv(columns: Columns, path: Path) -> None:
    with replacing(path) as (data, _):
        file = io.TextIOWrapper(data, encoding="utf-8", newline="")
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        length = len(next(iter(columns.values())))
        for at in range(0, length, ROWS):  # as Python's numbers they take four times the memory
            writer.writerows(zip(*(values[at : at + ROWS].tolist() for values in columns.values()), strict=True))
        file.detach()  # written out, and `data` left open


def _parquet_writer() -> Callable[[Columns, Path], None]:
    try:
        pyarrow, parquet = import_module("pyarrow"), import_module("pyarrow.parquet")
    except ImportError as error:
        raise MissingPackage(
            "Parquet needs pyarrow, which is not installed; pip install pyarrow, or export CSV"
        ) from error

    def write(columns: Columns, path: Path) -> None:
        with replacing(path) as (file, _):
            parquet.write_table(pyarrow.table(columns), file)

    return write


def export_case(recording: Recording, folder: str | os.PathLike[str], table: Table | None = None) -> Path:
    """Write a case folder; `table` defaults to the rows as concluded live. Returns the folder.

    Raises `MissingStream` when robot.yaml is not attached, `BadTable` when there is no row.

    >>> case = export_case(Recording.open("run.mcap"), "exported")
    >>> sorted(path.name for path in case.iterdir())
    ['robot.yaml', 'trials.csv']
    """
    table = table_of(recording) if table is None else table
    if not len(table):
        raise BadTable(f"{recording.path} has no concluded state; try `lab replay` to compute its states again")
    if "robot.yaml" not in recording.attachments:
        raise MissingStream(
            f"{recording.path} has no attachment robot.yaml; add the robot's file to the folder by hand"
        )
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    replaced(folder / "robot.yaml", recording.attachments["robot.yaml"])
    write_csv(table, folder / "trials.csv")
    return folder
