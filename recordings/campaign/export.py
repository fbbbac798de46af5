"""Out of a recording: one CSV file a stream, or a case folder for the diagnosis."""

from __future__ import annotations

import os
import re
from dataclasses import fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import BadTable, MissingStream
from ..events import Request
from ..file.clocks import aligned, has_stamp
from ..file.reader import Recording
from ..messages import SENSORS, STREAMS, Field
from ..own_files import replaced, replacing
from ..table_file import write_csv
from ..trials import COLUMNS, Table
from .replay import table_of


def export_streams(recording: Recording, folder: str | os.PathLike[str]) -> list[Path]:
    """Write each stream that has samples to `<stream>.csv`; returns the files.

    The states that were read are in `trials`, what people asked of the run (notes among it) in `requests`, where there are
    any. `columns` has unit and meaning of every column, and the wall time of t = 0.

    Arrays become columns name_1, name_2, ..; where the instrument stamps its samples a last column t_aligned (s) states
    when they were taken by its clock.

    >>> [path.name for path in export_streams(Recording.open("run.mcap"), "streams")][:2]
    ['pressure.csv', 'spine.csv']
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    if not recording.streams:
        recording.need(*STREAMS)
    table = table_of(recording)
    streams = {_stem(t): _columns(recording, t) for t in recording.streams if len(recording.stream(t))}
    tables = {stem: {c.name: c.values for c in columns} for stem, columns in streams.items()}
    meanings = [(stem, c.name, c.unit, " ".join(c.meaning.split())) for stem, columns in streams.items() for c in columns]
    meanings += [("trials", name, unit, _meaning(name)) for name, unit in table.units.items()]
    if requests := recording.requests:
        tables["requests"] = {f.name: np.array([getattr(request, f.name) for request in requests]) for f in fields(Request)}
    names = ("file", "column", "unit", "meaning")
    tables["columns"] = {name: np.array([row[k] for row in meanings], np.str_) for k, name in enumerate(names)}
    written = [folder / f"{stem}.csv" for stem in tables]
    import pandas  # a second, which recording does not need

    for columns, path in zip(tables.values(), written, strict=True):
        with replacing(path) as (file, _):
            pandas.DataFrame(columns).to_csv(file, index=False, na_rep="nan", lineterminator="\n", mode="wb")
    if len(table):
        write_csv(table, folder / "trials.csv")
        written.insert(-1, folder / "trials.csv")
    return written


class _ExportColumn(NamedTuple):
    name: str
    values: NDArray[Any]
    unit: str
    meaning: str


def _columns(recording: Recording, topic: str) -> list[_ExportColumn]:
    """The columns of a stream, those of arrays one by one."""
    samples, units, out = recording.stream(topic), recording.units(topic), list[_ExportColumn]()
    own_fields = {f.name: f for f in STREAMS[topic].fields} if topic in STREAMS else {}
    for name in samples.dtype.names or ():
        field = own_fields.get(name) or Field(name, "double", doc=f"{name} measured by the sensor {topic.removeprefix(SENSORS)}")
        unit, values = units.get(name, ""), samples[name].reshape(len(samples), -1)
        if samples[name].ndim == 1:
            since = ""
            if name == "t" and recording.metadata.get("recording", {}).get("start_wall_ns"):
                start = datetime.fromtimestamp(recording.start_wall_ns / 1e9, UTC)
                since = f"; t = 0 at {start.isoformat(timespec='milliseconds')}"
            out.append(_ExportColumn(name, samples[name], unit, f"{'rig time' if name == 't' else field.doc}{since}"))
        else:
            part_units, count = unit.split(", "), values.shape[1]
            for i in range(count):
                meaning = f"{_part(field, i)}; {field.doc}"
                out.append(_ExportColumn(f"{name}_{i + 1}", values[:, i], part_units[i * len(part_units) // count], meaning))
    if has_stamp(topic):
        meaning = "rig time at which the sample was taken, by the clock of the instrument"
        out.append(_ExportColumn("t_aligned", aligned(recording, topic), "s", meaning))
    return out


def _part(field: Field, index: int) -> str:
    """Return the name of a component of an array, counted from 0."""
    names = field.parts.split()
    if len(names) < 2:
        return f"{field.parts or 'component'} {index + 1}"
    whole, at = divmod(index, len(names))
    return f"{names[at]} of number {whole + 1}" if len(field.shape) > 1 else names[at]


def _meaning(column: str) -> str:
    """Of a column of the table of trials."""
    of = column.removeprefix("sd_")
    found = next((text for pattern, _, text in COLUMNS if re.fullmatch(pattern, of)), "")
    if of.startswith("sensor_"):
        found = f"{of.removeprefix('sensor_')}: sensor and quantity, averaged"
    return f"standard deviation of {of}" if of != column else found


def _stem(topic: str) -> str:
    return topic.strip("/").replace("/", "_")


def export_case(recording: Recording, folder: str | os.PathLike[str], table: Table | None = None) -> Path:
    """Write a case folder; `table` defaults to the rows as concluded live. Returns the folder.

    Raises `MissingStream` when robot.yaml is not attached, `BadTable` when there is no row.

    >>> case = export_case(Recording.open("run.mcap"), "exported")
    >>> sorted(path.name for path in case.iterdir())
    ['robot.yaml', 'trials.csv']
    """
    table = table_of(recording) if table is None else table
    if not len(table):
        raise BadTable(f"{recording.path} holds no states; try `lab replay` if it asked for some, else export its streams")
    if "robot.yaml" not in recording.attachments:
        raise MissingStream(f"{recording.path} has no attachment robot.yaml; add the robot's file to the folder by hand")
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    replaced(folder / "robot.yaml", recording.attachments["robot.yaml"])
    write_csv(table, folder / "trials.csv")
    return folder
