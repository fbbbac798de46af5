"""Files of arrays: NumPy's, and what files of MATLAB hold."""

from __future__ import annotations

import io
import pickle
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recordings.bounded import read_bounded

from ..files.config import ConfigError
from .columns import Judged, judge, of_frame
from .map_file import Source
from .series import LARGEST, Array, Series, demand_bounded, of_judged

LAST = ("point", "axis")
"""Dimensions of an array that become columns."""


def columns_of(path: Path, given: Mapping[str, Any], source: Source, form: str, notes: Sequence[str] = ()) -> Series:
    """What can be read as columns of one length; the rest is named in the notes. Raises ConfigError.

    A table (n, k) becomes columns NAME.1 .., or 1 .. when it was asked for; k x n is turned. Tables, cells of numbers or
    words, words, dates and fields of structures become columns.
    """
    if source.axes:
        return Series(path, dict(_by_axes(path, given, source.axes)), form)
    if source.variable is not None:
        given = {source.variable: _held(path, given, source.variable, "source.variable")}
    alone = sum(hasattr(value, "columns") for value in given.values()) == 1
    parts = [(label, part) for name, value in given.items() for label, part in parts_of(name, value, alone)]
    arrays = {label: part for label, part in parts if isinstance(part, np.ndarray) and part.ndim < 3}
    judged = {label: part for label, part in parts if isinstance(part, Judged)}
    left = [f"{label} ({part})" for label, part in parts if isinstance(part, str)]
    deep = {label: part.shape for label, part in parts if isinstance(part, np.ndarray) and part.ndim > 2}
    for name, shape in deep.items():
        left.append(f"{name} (of the shape {shape}: say in source.axes what each dimension counts)")
    if not arrays and not judged:
        if deep:
            name, shape = next(iter(deep.items()))
            raise ConfigError(
                f"{path}: {name} has the shape {shape}; say in source.axes what each dimension counts, such as "
                f"{name}: [trial, time, point, axis]"
            )
        raise ConfigError(f"{path}: holds no table of numbers" + (f"; not read: {', '.join(left)}" if left else ""))
    numbers = [part.values for part in judged.values() if part.values.dtype.kind == "f"]
    rows = _rows([*arrays.values(), *numbers] or [part.values for part in judged.values()])
    named = {len(p.values): p.values.tolist() for p in judged.values() if p.values.dtype.kind == "U" and len(p.values) != rows}
    headed = [n for a in arrays.values() if a.ndim == 2 for n in named if n in a.shape]
    columns: dict[str, Judged] = {}
    told = list(notes)
    for label, part in [(label, part) for label, part in parts if label in arrays or label in judged]:
        if isinstance(part, Judged):
            if len(part.values) == rows:
                columns[label] = part
            elif part.values.dtype.kind == "f" or len(part.values) not in headed:
                left.append(f"{label} ({len(part.values)} instead of {rows} rows)")
            continue
        assert isinstance(part, np.ndarray)
        if len(part) != rows and rows in part.shape:
            told.append(f"{label} ({' x '.join(map(str, part.shape))}) is read with its rows along the second dimension")
            part = part.T
        if len(part) != rows:
            left.append(f"{label} ({len(part)} instead of {rows} rows)")
            continue
        for k, column in enumerate(np.atleast_2d(part.T), 1):
            heading = k if part.ndim == 1 or part.shape[1] not in named else named[part.shape[1]][k - 1] or k
            columns[str(heading) if source.variable else label if part.ndim == 1 else f"{label}.{heading}"] = Judged(column)
    if left:
        told.append(f"not read: {', '.join(left)}")
    made = of_judged(path, columns, form)
    return replace(made, notes=(*told, *made.notes))


def parts_of(name: str, value: Any, alone: bool) -> Iterator[tuple[str, Array | Judged | str]]:
    """Arrays of numbers, columns, or why there is none, of one variable; `alone`: a table's columns keep their names."""
    import pandas as pd

    if isinstance(value, pd.DataFrame):
        value = (
            value.reset_index() if pd.api.types.is_datetime64_any_dtype(value.index) or value.index.dtype.kind == "m" else value
        )
        units = dict(zip(value.columns, value.attrs.get("VariableUnits", ()), strict=False))
        for label in value.columns:
            for own, part in parts_of(str(label) if alone else f"{name}.{label}", value[label].to_numpy(), alone):
                unit = str(units.get(label, ""))
                yield own, replace(part, unit=part.unit or unit) if isinstance(part, Judged) else part
        return
    array = np.asarray(value)
    if array.dtype.names and array.size == 1:
        for field in array.dtype.names:
            yield from parts_of(f"{name}.{field}", array.reshape(-1)[0][field], alone)
    elif array.dtype.names and type(array).__name__ not in ("MatlabOpaque", "MatlabFunction"):
        for field in array.dtype.names:
            yield f"{name}.{field}", _cells(array[field].reshape(-1))
    elif array.dtype.kind in "fiub":
        array = np.asarray(array, np.float64).squeeze()
        yield name, array if array.size > 1 else "one number" if array.size else "empty"
    elif array.dtype.kind in "Mm":
        yield name, of_frame(pd.Series(array.reshape(-1)))
    elif array.dtype.kind == "O" and array.ndim == 2 and min(array.shape) > 1:
        above = [np.asarray(cell).squeeze() for cell in array[0]]
        named = all(a.dtype.kind == "U" and a.size == 1 for a in above)
        for k, cells in enumerate(array[named:].T):
            yield f"{name}.{above[k] if named else k + 1}", _cells(cells)
    elif array.dtype.kind == "O" and array.size > 1:
        yield name, _cells(array.reshape(-1))
    elif array.dtype.kind == "U" and array.size > 1:
        yield name, judge(pd.Series(array.reshape(-1), dtype=str))
    else:
        kinds = {"U": "a text", "S": "bytes", "c": "complex numbers"}
        yield name, kinds.get(array.dtype.kind, f"of the kind {type(value).__name__}")


def _cells(cells: NDArray[np.object_]) -> Array | Judged | str:
    """A column of cells that each hold one number or one text; of equal arrays a table."""
    import pandas as pd

    found = [np.asarray(cell).squeeze() for cell in cells.tolist()]
    if all(f.dtype.kind in "fiub" and f.ndim == 1 and f.size == found[0].size > 1 for f in found):
        return np.array(found, np.float64)
    words = []
    for one in found:
        if one.size == 1 and one.dtype.kind == "O":
            one = np.asarray(one.reshape(-1)[0]).squeeze()
        if one.size > 1 or one.dtype.kind not in "fiubUO":
            return "cells that hold more than one number or text"
        one = one.reshape(-1)
        words.append("" if not one.size or one[0] is None else str(one[0]) if one.dtype.kind == "U" else repr(float(one[0])))
    return judge(pd.Series(words, dtype=str))


def _rows(arrays: Sequence[NDArray[Any]]) -> int:
    """How many rows arrays have: those of a single column say it, else the size that all share."""
    shapes = [a.shape for a in arrays]
    single = {s[0] for s in shapes if len(s) == 1}
    if not single:
        first, second = {s[0] for s in shapes}, {s[1] for s in shapes}
        on_side = len(second) == 1 and min(second) > max(first) if len(shapes) > 1 else _lies_on_its_side(arrays[0])
        single = second if on_side else first if len(first) == 1 else {max(s) for s in shapes}
    return max(single, key=lambda n: (sum(n in s for s in shapes), n))


def _lies_on_its_side(table: Array) -> bool:
    """Whether the rows of a table alone run along its second dimension: it is very wide, or time does."""
    high, wide = table.shape
    rises = [len(line) > 1 and bool((np.diff(line) > 0).all()) for line in (table[0], table[:, 0])]
    # an array alone that is this wide lies on its side
    return wide >= 20 * high or (wide > high and rises == [True, False])


def _held(path: Path, given: Mapping[str, Any], name: str, place: str) -> Any:
    if name not in given:
        raise ConfigError(f"{path}: holds no {name!r} ({place}); it holds {', '.join(given) or 'nothing'}")
    return given[name]


def _by_axes(path: Path, given: Mapping[str, Any], axes: Mapping[str, tuple[str, ...]]) -> Iterator[tuple[str, Array]]:
    """Arrays whose dimensions have names: `point` and `axis` become columns NAME.1.x, all others rows, and their number a
    column."""
    arrays: dict[str, Array] = {}
    sizes: dict[str, int] = {}
    for name, dimensions in axes.items():
        array = np.asarray(_held(path, given, name, "source.axes"), np.float64)
        arrays[name] = array.squeeze() if array.ndim > len(dimensions) else array
        if arrays[name].ndim != len(dimensions):
            raise ConfigError(f"{path}: {name} has the shape {array.shape}, source.axes names {', '.join(dimensions)}")
        for dimension, size in zip(dimensions, arrays[name].shape, strict=True):
            if sizes.setdefault(dimension, size) != size:
                raise ConfigError(f"{path}: {name} has {size} in {dimension!r}, another array {sizes[dimension]}")
    rows = [d for d in sizes if d not in LAST]
    at = dict(zip(rows, np.indices([sizes[d] for d in rows]).reshape(len(rows), -1), strict=True))
    yield from ((dimension, (index + 1).astype(np.float64)) for dimension, index in at.items())
    for name, array in arrays.items():
        last = [d for d in axes[name] if d in LAST]
        for k in np.ndindex(*(sizes[d] for d in last)):
            place = at | dict(zip(last, k, strict=True))
            label = ("xyz"[i] if d == "axis" and i < 3 else str(i + 1) for d, i in zip(last, k, strict=True))
            yield ".".join([name, *label]), array[tuple(place[d] for d in axes[name])]


def read_numpy(path: Path, source: Source) -> Series:
    """A .npy or .npz file; of one that holds a table of arrays nothing is run."""
    data = read_bounded(path, LARGEST, ConfigError)
    try:
        if zipfile.is_zipfile(io.BytesIO(data)):
            demand_bounded(path, sum(one.file_size for one in zipfile.ZipFile(io.BytesIO(data)).infolist()))
        elif not data.startswith(b"\x93NUMPY"):
            raise ConfigError(f"{path}: is not a NumPy file")
        elif path.suffix.lower() == ".npy" and _holds_objects(data):
            return columns_of(path, _pickled(path, data), source, "NumPy, a table of arrays")
        found = np.load(io.BytesIO(data), allow_pickle=False)
        if isinstance(found, np.lib.npyio.NpzFile):
            return columns_of(path, {name: found[name] for name in found.files}, source, "NumPy")
        return columns_of(path, {source.variable or path.stem: found}, source, "NumPy")
    except (ValueError, MemoryError, OSError, zipfile.BadZipFile) as e:
        why = "holds objects; save its arrays as numbers" if "allow_pickle" in str(e) else f"is not a NumPy file ({e})"
        raise ConfigError(f"{path}: {why}") from e


def _header(stream: io.BytesIO) -> Any:
    """The type of a .npy file's array; `stream` is then at its values."""
    version = np.lib.format.read_magic(stream)
    reader = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    return reader(stream)[2]


def _holds_objects(data: bytes) -> bool:
    return bool(_header(io.BytesIO(data)).hasobject)


class _Arrays(pickle.Unpickler):
    """Reads arrays and what they are made of, and nothing that could run."""

    ALLOWED = frozenset(
        (module, name)
        for core in ("numpy.core", "numpy._core")
        for module, name in ((f"{core}.multiarray", "_reconstruct"), (f"{core}.multiarray", "scalar"), ("numpy", "ndarray"),
                             ("numpy", "dtype"), (f"{core}.numeric", "_frombuffer"))
    )  # fmt: skip

    def find_class(self, module: str, name: str) -> Any:
        """Only what an array needs."""
        if (module, name) not in self.ALLOWED:
            raise pickle.UnpicklingError(f"holds {module}.{name}, which is no array")
        return super().find_class(module, name)


def _pickled(path: Path, data: bytes) -> Mapping[str, Any]:
    """A table of arrays, as np.save writes one."""
    stream = io.BytesIO(data)
    try:
        _header(stream)
        table = np.asarray(_Arrays(stream).load()).reshape(-1)[0]
    except Exception as e:
        raise ConfigError(f"{path}: cannot be read without running what it holds ({e}); save its arrays as .npz") from e
    if not isinstance(table, dict):
        raise ConfigError(f"{path}: holds {type(table).__name__}, not arrays by name; save its arrays as .npz")
    return {str(name): value for name, value in table.items()}
