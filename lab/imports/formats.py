"""Read files of other programs as columns of numbers, by their ending."""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from recordings.bounded import read_bounded

from ..files.config import ConfigError
from ..files.inputs import TABLES
from ..files.map_file import Source
from .arrays import read_numpy
from .columns import Judged, of_frame
from .headings import heading
from .joining import of_rows_in_turn
from .matlab import read_matlab
from .series import FRAME, LARGEST, Series, demand_bounded, demand_columns, flat, of_judged, package, readable, reason, unique
from .text_tables import read_text

if TYPE_CHECKING:
    import pandas as pd


def read(paths: Path | Sequence[Path], source: Source, named: Collection[str] | None = None) -> Series:
    """Columns of a file by the reader for its ending, or of a recording's parts; `named`: those wanted. Raises ConfigError."""
    parts = (paths,) if isinstance(paths, Path) else paths
    path = parts[0]
    if path.suffix.lower() == RECORDING:
        from .recording_topics import read_topics

        series = read_topics(parts, source, named)
    else:
        reader = READERS.get(path.suffix.lower())
        if reader is None:
            remedy = REMEDIES.get(path.suffix.lower(), "export it as CSV")
            raise ConfigError(f"{path}: files of this kind cannot be read; known kinds are {', '.join(KNOWN)}; {remedy}")
        series = reader(path, source)
    series = of_rows_in_turn(series, source.missing)
    if not len(series):
        raise ConfigError(f"{path}: has no rows of numbers")
    demand_columns(path, len(series.names))
    return series


def _parquet(path: Path, source: Source) -> Series:
    """The columns of a Parquet file, as `_of_columns` has them; raises ConfigError, before unpacking where it holds too much."""
    parquet = package("pyarrow.parquet", path)
    read_bounded(path, LARGEST, ConfigError)
    with readable(path, "Parquet"):
        file = parquet.ParquetFile(path)
        names, metadata = file.schema_arrow.names, file.metadata
        groups = [metadata.row_group(g) for g in range(metadata.num_row_groups)]
        values = sum(group.column(c).num_values for group in groups for c in range(group.num_columns))
        size = max(8 * values, sum(group.total_byte_size for group in groups))
    demand_bounded(path, max(size, 8 * metadata.num_rows * len(names)))  # a value that repeats takes no bytes
    try:
        columns = file.read().columns
    except Exception:  # one column is broken: `cells` reads them one by one, so that it alone is left out
        columns = None

    def cells(k: int) -> pd.Series[Any]:
        return _of_arrow(columns[k] if columns else file.read(columns=[names[k]]).column(0))

    types = enumerate(zip(names, file.schema_arrow.types, strict=True))
    return _of_columns(path, "Parquet", [(name, str(kind), partial(cells, k)) for k, (name, kind) in types], source.missing)


def _of_arrow(column: Any) -> pd.Series[Any]:
    """A column of Arrow; raises ValueError where it holds bytes."""
    import pandas as pd
    import pyarrow as pa

    if isinstance(column.type, pa.BaseExtensionType):
        column = pa.chunked_array([chunk.storage for chunk in column.chunks], column.type.storage_type)
    if pa.types.is_nested(column.type):
        return pd.Series(column.to_pylist(maps_as_pydicts="lossy"), dtype=object)
    if column.type.id in (pa.binary().id, pa.large_binary().id, pa.binary(1).id, pa.binary_view().id):
        raise ValueError("it holds bytes, not measurements; write numbers or text")
    return cast("pd.Series[Any]", column.to_pandas())


def of_data_frame(frame: pd.DataFrame, missing: Sequence[str | float] = ()) -> Series:
    """The columns of a DataFrame, and its index where it has a name or holds times; raises ConfigError."""
    import pandas as pd

    index = frame.index
    if any(name is not None for name in index.names) or index.dtype.kind in "mM" or isinstance(index.dtype, pd.DatetimeTZDtype):
        frame = frame.reset_index()
    names = [" ".join(map(str, name)) if isinstance(name, tuple) else str(name) for name in frame.columns]
    columns = [(name, str(kind), partial(frame.iloc.__getitem__, (slice(None), k)))
               for k, (name, kind) in enumerate(zip(names, frame.dtypes, strict=True))]  # fmt: skip
    stated_units = {str(name): str(unit) for name, unit in dict(frame.attrs.get("units", {})).items()}
    series = _of_columns(Path(FRAME), FRAME, columns, missing)
    return replace(series, units={**stated_units, **series.units}, lines=index.to_numpy())


def _of_columns(
    path: Path, form: str, columns: Sequence[tuple[str, str, Callable[[], pd.Series[Any]]]], missing: Sequence[str | float]
) -> Series:
    """Judge columns (name, type, function that returns the cells) one by one. Raises ConfigError where none can be read."""
    judged: dict[str, Judged] = {}
    notes = []
    for k, name in enumerate(unique([name for name, _, _ in columns], len(columns))):
        try:
            for label, cells in flat(name, columns[k][2]()):
                column = of_frame(cells, missing)
                unit = column.unit or (heading(name).unit if column.values.dtype.kind == "f" and label != name else "")
                judged[label if label not in judged else f"{label} ({k + 1})"] = replace(column, unit=unit)
        except Exception as e:  # whatever a library raises about a column
            notes.append(f"column {name!r} ({columns[k][1]}) is left out: {reason(e)}")
    if not judged:
        raise ConfigError(f"{path}: no column can be read; {'; '.join(notes) or 'it has none'}")
    return of_judged(path, judged, form, notes)


# ------------------------------------------------------------------ C3D
RATES = (0.01, 1e5)
"""Hz of cameras that can be."""


def _c3d(path: Path, source: Source) -> Series:
    """Columns `time` (s), LABEL.x .. of each marker and the mean of each analog channel over a frame; raises ConfigError."""
    library = package("c3d", path)
    with readable(path, "C3D"), warnings.catch_warnings(action="ignore"), np.errstate(all="ignore"):
        reader = library.Reader(io.BytesIO(read_bounded(path, LARGEST, ConfigError)))
        # frames of no bytes would be read as often as the file claims
        if not reader.point_used and not reader.analog_used * reader.analog_per_frame:
            raise ConfigError(f"{path}: has neither markers nor analog channels; export the take again")
        frames = [(points, analog) for _, points, analog in reader.read_frames(copy=True)]
        labels, channels = _labels(reader, "POINT"), _labels(reader, "ANALOG")
        unit, units = "".join(_texts(reader, "POINT:UNITS")[:1]), _texts(reader, "ANALOG:UNITS")
        rate = float(reader.point_rate or 0.0)
    if not frames:
        raise ConfigError(f"{path}: has no frames; export the take again")
    if not RATES[0] <= rate <= RATES[1]:
        raise ConfigError(f"{path}: states {rate:g} frames per second, more than any camera; export the take again")
    points = np.array([p for p, _ in frames], np.float64)
    places = np.where(points[:, :, 3:4] < 0, np.nan, points[:, :, :3])  # a residual below 0: the marker was not seen
    columns = {"time": np.arange(len(places)) / rate}
    for k, label in enumerate(unique(labels, places.shape[1])):
        columns |= {f"{label}.{axis}": places[:, k, i] for i, axis in enumerate("xyz")}
    unit_of = dict.fromkeys([c for c in columns if c != "time"], unit) if unit else {}
    if frames[0][1].size:
        means = np.array([a.mean(axis=1) for _, a in frames], np.float64)
        for k, label in enumerate(unique(channels, means.shape[1])):
            name = label if label not in columns else f"{label} (analog)"
            columns[name] = means[:, k]
            if k < len(units) and units[k]:
                unit_of[name] = units[k]
    return Series(path, columns, f"C3D, {rate:g} Hz", unit_of)


def _texts(reader: Any, key: str) -> list[str]:
    """Texts of a parameter, none where it is missing or no text."""
    found = reader.get(key)
    if found is None:
        return []
    try:
        return [str(t).strip(" \0") for t in found.string_array.reshape(-1)]
    except (TypeError, ValueError, AttributeError, UnicodeDecodeError):
        return []


def _labels(reader: Any, group: str) -> list[str]:
    """Labels of more than 255 markers go on in LABELS2 .."""
    return [t for k in ("", *range(2, 10)) for t in _texts(reader, f"{group}:LABELS{k}")]


READERS: Mapping[str, Callable[[Path, Source], Series]] = dict.fromkeys(TABLES, read_text) | {
    ".mat": read_matlab, ".npz": read_numpy, ".npy": read_numpy, ".c3d": _c3d, ".parquet": _parquet,
}  # fmt: skip
RECORDING = ".mcap"
REMEDIES: Mapping[str, str] = (
    dict.fromkeys((".zstd", ".zst", ".lz4", ".gz", ".zip"), "unpack it first")
    | dict.fromkeys((".bag", ".db3"), "convert it with `mcap convert`")
    | dict.fromkeys((".xlsx", ".xls", ".ods"), "save the sheet as CSV")
)
""".. by ending, where a table is not the remedy."""
KNOWN = (*READERS, RECORDING)
