"""Read files of arrays: NumPy's, and the variables of MATLAB files."""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recordings.bounded import read_bounded

from ..files.config import ConfigError
from ..files.map_file import Source
from .columns import Judged, judge, of_frame
from .series import LARGEST, Array, Series, demand_bounded, demand_columns, of_judged, readable

LAST = ("point", "axis")
"""Dimensions of an array that become columns."""


def columns_of(path: Path, given: Mapping[str, Any], source: Source, form: str, notes: Sequence[str] = ()) -> Series:
    """The variables of a file (`given`, by name) that can be read as columns of one length; the notes name the rest.

    A table (n, k) becomes columns NAME.1 .., or 1 .. when `source.variable` asks for it; k x n is transposed. Tables, cells of
    numbers or words, words, dates and fields of structures become columns. `form` names the kind of file. Raises ConfigError."""
    if source.axes:
        return Series(path, dict(_by_axes(path, given, source.axes)), form)
    if source.variable is not None:
        given = {source.variable: _held(path, given, source.variable, "source.variable")}
    alone = sum(hasattr(value, "columns") for value in given.values()) == 1  # the only table: labels leave out its name
    # a part is an array, a column already read (Judged), or a text that says why it is neither
    parts = [(label, part) for name, value in given.items() for label, part in parts_of(name, value, alone)]
    arrays = {label: part for label, part in parts if isinstance(part, np.ndarray) and part.ndim < 3}
    judged = {label: part for label, part in parts if isinstance(part, Judged)}
    unread = [f"{label} ({part})" for label, part in parts if isinstance(part, str)]
    for name, part in parts:
        if isinstance(part, np.ndarray) and part.ndim > 2:
            axes = f"say in source.axes what each dimension counts, such as {name}: [trial, time, point, axis]"
            unread.append(f"{name} (of the shape {part.shape}: {axes})")
    if not arrays and not judged:
        raise ConfigError(f"{path}: holds no table of numbers" + (f"; not read: {', '.join(unread)}" if unread else ""))
    numbers = [part.values for part in judged.values() if part.values.dtype.kind == "f"]
    rows = _rows([*arrays.values(), *numbers] or [part.values for part in judged.values()])
    # a list of words that is as long as a matrix is wide names the columns of the matrix
    lists_of_words = [p.values.tolist() for p in judged.values() if p.values.dtype.kind == "U" and len(p.values) != rows]
    words_by_length = {len(words): words for words in lists_of_words}
    used_as_names = [n for a in arrays.values() if a.ndim == 2 for n in words_by_length if n in a.shape]
    columns: dict[str, Judged] = {}
    all_notes = list(notes)
    for label, part in [(label, part) for label, part in parts if label in arrays or label in judged]:
        if isinstance(part, Judged):
            if len(part.values) == rows:
                columns[label] = part
            elif part.values.dtype.kind == "f" or len(part.values) not in used_as_names:
                unread.append(f"{label} ({len(part.values)} instead of {rows} rows)")
            continue
        assert isinstance(part, np.ndarray)
        if len(part) != rows and rows in part.shape:
            all_notes.append(f"{label} ({' x '.join(map(str, part.shape))}) is read with rows along its second dimension")
            part = part.T
        if len(part) != rows:
            unread.append(f"{label} ({len(part)} instead of {rows} rows)")
            continue
        demand_columns(path, len(columns) + part[0].size)
        for k, column in enumerate(np.atleast_2d(part.T), 1):
            words = words_by_length.get(part.shape[1]) if part.ndim == 2 else None
            heading = str(words[k - 1] if words and words[k - 1] else k)
            of_variable = label if part.ndim == 1 else f"{label}.{heading}"
            columns[heading if source.variable else of_variable] = Judged(column)
    if unread:
        all_notes.append(f"not read: {', '.join(unread)}")
    return of_judged(path, columns, form, all_notes)


def parts_of(name: str, value: Any, alone: bool) -> Iterator[tuple[str, Array | Judged | str]]:
    """What a variable holds, as (label, content): an array of numbers, a column as `judge` has it, or a text that says why it is
    neither. A table, a structure and a table of cells have several; `alone`: the labels of a table leave out its name."""
    import pandas as pd

    if isinstance(value, pd.DataFrame):  # of a timetable the index is the time, a column here
        value = (
            value.reset_index() if pd.api.types.is_datetime64_any_dtype(value.index) or value.index.dtype.kind == "m" else value
        )
        units = dict(zip(value.columns, value.attrs.get("VariableUnits", ()), strict=False))
        for label in value.columns:
            for column, part in parts_of(str(label) if alone else f"{name}.{label}", value[label].to_numpy(), alone):
                yield column, replace(part, unit=part.unit or str(units.get(label, ""))) if isinstance(part, Judged) else part
        return
    array = np.asarray(value)
    if array.dtype.names and array.size == 1:
        for field in array.dtype.names:
            yield from parts_of(f"{name}.{field}", array.reshape(-1)[0][field], alone)
    elif array.dtype.names and type(array).__name__ not in ("MatlabOpaque", "MatlabFunction"):
        for field in array.dtype.names:
            if array.dtype.hasobject:
                yield f"{name}.{field}", _cells(array[field].reshape(-1))
            else:
                yield from parts_of(f"{name}.{field}", array[field].reshape(array.size, -1), alone)
    elif array.dtype.kind in "fiub":
        array = np.asarray(array, np.float64).squeeze()
        yield name, array if array.size > 1 else "one number" if array.size else "empty"
    elif array.dtype.kind in "Mm":
        yield name, of_frame(pd.Series(array.reshape(-1)))
    elif array.dtype.kind == "O" and array.ndim == 2 and min(array.shape) > 1:
        first_row = [np.asarray(cell).squeeze() for cell in array[0]]
        has_headings = all(a.dtype.kind == "U" and a.size == 1 for a in first_row)
        for k, cells in enumerate(array[has_headings:].T):
            yield f"{name}.{first_row[k] if has_headings else k + 1}", _cells(cells)
    elif array.dtype.kind == "O" and array.size > 1:
        yield name, _cells(array.reshape(-1))
    elif array.dtype.kind == "U" and array.size > 1:
        yield name, judge(pd.Series(array.reshape(-1), dtype=str))
    else:
        kinds = {"U": "a text", "S": "bytes", "c": "complex numbers"}
        yield name, kinds.get(array.dtype.kind, f"of the kind {type(value).__name__}")


def _cells(cells: NDArray[np.object_]) -> Array | Judged | str:
    """A column of cells with one number or text each; a table (n, k) of cells with k numbers each; else the reason (text)."""
    import pandas as pd

    contents = [np.asarray(cell).squeeze() for cell in cells.tolist()]
    if all(c.dtype.kind in "fiub" and c.ndim == 1 and c.size == contents[0].size > 1 for c in contents):
        return np.array(contents, np.float64)
    words = []
    for content in contents:
        while content.size == 1 and isinstance(content.item(), np.ndarray | np.generic):  # cells within cells
            content = np.asarray(content.item()).squeeze()
        value = content.item() if content.size == 1 else None
        if content.size > 1 or content.dtype.kind not in "fiubUO" or not isinstance(value, bool | int | float | str | None):
            return "cells with more than one number or text"
        words.append("" if value is None else value if isinstance(value, str) else repr(float(value)))
    return judge(pd.Series(words, dtype=str))


def _rows(arrays: Sequence[NDArray[Any]]) -> int:
    """How many rows arrays have: the length of those of a single column, else the size that all share."""
    shapes = [a.shape for a in arrays]
    single = {s[0] for s in shapes if len(s) == 1}
    if not single:
        first, second = {s[0] for s in shapes}, {s[1] for s in shapes}
        on_side = len(second) == 1 and min(second) > max(first)
        if len(shapes) == 1:  # an array alone lies on its side if it is very wide, or if time runs along its second dimension
            (table,), ((high, wide),) = arrays, shapes
            rises = [len(line) > 1 and bool((np.diff(line) > 0).all()) for line in (table[0], table[:, 0])]
            on_side = wide >= 20 * high or (wide > high and rises == [True, False])
        single = second if on_side else first if len(first) == 1 else {max(s) for s in shapes}
    return max(single, key=lambda n: (sum(n in s for s in shapes), n))


def _held(path: Path, given: Mapping[str, Any], name: str, place: str) -> Any:
    if name not in given:
        raise ConfigError(f"{path}: holds no {name!r} ({place}); it holds {', '.join(given) or 'nothing'}")
    return given[name]


def _by_axes(path: Path, given: Mapping[str, Any], axes: Mapping[str, tuple[str, ...]]) -> Iterator[tuple[str, Array]]:
    """Columns by label of arrays with named dimensions: a row for each combination of all but `point` and `axis`."""
    arrays: dict[str, Array] = {}
    sizes: dict[str, int] = {}
    for name, dimensions in axes.items():
        array = np.asarray(_held(path, given, name, "source.axes"))
        if array.dtype.kind not in "fiub":
            raise ConfigError(f"{path}: {name} (source.axes) holds no numbers")
        array = np.asarray(array, np.float64)
        arrays[name] = array.squeeze() if array.ndim > len(dimensions) else array
        if arrays[name].ndim != len(dimensions):
            raise ConfigError(f"{path}: {name} has the shape {array.shape}, source.axes names {', '.join(dimensions)}")
        for dimension, size in zip(dimensions, arrays[name].shape, strict=True):
            if sizes.setdefault(dimension, size) != size:
                raise ConfigError(f"{path}: {name} has {size} in {dimension!r}, another array {sizes[dimension]}")
    row_axes = [d for d in sizes if d not in LAST]
    demand_bounded(path, 8 * math.prod(sizes[d] for d in row_axes) * (len(row_axes) + len(arrays)))
    index_of = dict(zip(row_axes, np.indices([sizes[d] for d in row_axes]).reshape(len(row_axes), -1), strict=True))
    yield from ((dimension, (index + 1).astype(np.float64)) for dimension, index in index_of.items())
    for name, array in arrays.items():
        column_axes = [d for d in axes[name] if d in LAST]
        for k in np.ndindex(*(sizes[d] for d in column_axes)):
            indices = index_of | dict(zip(column_axes, k, strict=True))
            label = ("xyz"[i] if d == "axis" and i < 3 else str(i + 1) for d, i in zip(column_axes, k, strict=True))
            yield ".".join([name, *label]), array[tuple(indices[d] for d in axes[name])]


def read_numpy(path: Path, source: Source) -> Series:
    """A .npy or .npz file of plain arrays; what it claims must fit what it holds. Raises ConfigError."""
    data = read_bounded(path, LARGEST, ConfigError)
    with readable(path, "NumPy"):
        arrays = {source.variable or path.stem: data} if data.startswith(NPY) else dict(_members(path, data))
        types = {name: _claimed(array) for name, array in arrays.items() if array.startswith(NPY)}
        objects = [name for name, (dtype, _) in types.items() if dtype.hasobject]
        if objects and (len(objects) == len(types) or {source.variable, *source.axes} & set(objects)):
            raise ConfigError(f"{path}: {', '.join(objects)[:200]} {OBJECTS}")
        # before arrays are made of the bytes: a few bytes of text take hundreds as a cell
        demand_bounded(path, sum(count * _size(dtype) for dtype, count in types.values() if not dtype.hasobject))
        given = {name: np.load(io.BytesIO(arrays[name]), allow_pickle=False) for name in types if name not in objects}
    return columns_of(path, given, source, "NumPy", [f"not read: {name} {OBJECTS}" for name in objects])


NPY = b"\x93NUMPY"
OBJECTS = "holds Python objects, which could run code; save columns, a .npz of plain arrays, or Parquet instead"
CELL = 256
"""Bytes of memory of a text, a nested cell or an array within a variable, about, besides what it holds."""


def _members(path: Path, data: bytes) -> Iterator[tuple[str, bytes]]:
    """The files of a .npz by name; raises ConfigError where they unpack to too much, ValueError where one is packed unusually."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = archive.infolist()
        demand_bounded(path, sum(member.file_size for member in members))
        for member in members:
            if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise ValueError(f"{member.filename[:80]} is not packed as np.savez does")
            yield member.filename.removesuffix(".npy"), archive.read(member)


def _claimed(data: bytes) -> tuple[np.dtype[Any], int]:
    """Type and number of the cells that a .npy file claims; raises ValueError where it does not hold as many."""
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    reader = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = reader(stream)
    count, held = math.prod(shape), len(data) - stream.tell()
    if min(shape, default=0) < 0 or (not dtype.hasobject and count * max(dtype.itemsize, 1) > held):
        raise ValueError(f"claims {' x '.join(map(str, shape)) or 1} cells of {dtype.itemsize} bytes but holds {held} bytes")
    return dtype, count


def _size(dtype: np.dtype[Any]) -> int:
    """Bytes of memory of a cell once it is in columns."""
    if dtype.subdtype is not None:
        return math.prod(dtype.subdtype[1]) * _size(dtype.subdtype[0])
    if dtype.names is not None:
        return sum(_size(dtype[name]) for name in dtype.names)
    return dtype.itemsize + CELL if dtype.kind == "U" else max(dtype.itemsize, 8)
