"""Files of arrays: MATLAB and NumPy."""

from __future__ import annotations

import io
import math
import pickle
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from recordings.bounded import read_bounded

from ..files.config import ConfigError
from .map_file import Source
from .matlab_hdf5 import is_hdf5, read_hdf5
from .series import LARGEST, Array, Series, demand_bounded

LAST = ("point", "axis")
"""Dimensions of an array that become columns."""


def columns_of(path: Path, given: Mapping[str, Any], source: Source, form: str) -> Series:
    """Arrays of one length as columns; a table (n, k) as columns NAME.1 .., or 1 .. when it was asked for."""
    if source.axes:
        return Series(path, dict(_by_axes(path, given, source.axes)), form)
    if source.variable is not None:
        given = {source.variable: _held(path, given, source.variable, "source.variable")}
    tables = {name: np.asarray(value) for name, value in given.items()}
    tables = {name: a.squeeze() for name, a in tables.items() if a.dtype.kind in "fiub" and a.size > 1}
    if not tables:
        raise ConfigError(f"{path}: holds no table of numbers")
    if (deep := next((n for n, a in tables.items() if a.ndim > 2), None)) is not None:
        raise ConfigError(
            f"{path}: {deep} has the shape {tables[deep].shape}; say in source.axes what each dimension counts, such as "
            f"{deep}: [trial, time, point, axis]"
        )
    length = len(max(tables.values(), key=len))
    numbers: dict[str, Array] = {}
    for name, table in tables.items():
        if len(table) == length:
            for k, column in enumerate(np.atleast_2d(table.T).astype(np.float64), 1):
                numbers[str(k) if source.variable else name if table.ndim == 1 else f"{name}.{k}"] = column
    return Series(path, numbers, form)


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


def read_matlab(path: Path, source: Source) -> Series:
    """A .mat file of any version."""
    from scipy.io import loadmat, whosmat

    data = read_bounded(path, LARGEST, ConfigError)
    if is_hdf5(data):
        return columns_of(path, read_hdf5(path, data), source, "MATLAB 7.3")
    try:
        # before anything is unpacked: a few kB can hold GB
        size = sum(8 * math.prod(shape) for _, shape, _ in whosmat(io.BytesIO(data)))
        demand_bounded(path, size)
        found = loadmat(io.BytesIO(data), squeeze_me=False, struct_as_record=True)
    except ConfigError:
        raise
    except Exception as e:
        raise ConfigError(f"{path}: is not a MATLAB file ({type(e).__name__}: {e})") from e
    arrays: dict[str, Any] = {}
    for name, value in found.items():
        if not name.startswith("__"):
            _unpacked(name, value, arrays)
    return columns_of(path, arrays, source, "MATLAB")


def _unpacked(name: str, value: Any, out: dict[str, Any]) -> None:
    """A structure's fields as NAME.FIELD."""
    array = np.asarray(value)
    if array.dtype.names and array.size == 1:
        for own in array.dtype.names:
            _unpacked(f"{name}.{own}", array.reshape(-1)[0][own], out)
    else:
        out[name] = array


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
