"""Read MATLAB files of any version: SciPy and HDF5 for numbers, mat-io for MATLAB's objects (table, string, datetime ..)."""

from __future__ import annotations

import io
import math
import warnings
import zlib
from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import Any, Literal

import numpy as np

from recordings.bounded import read_bounded

from ..files.config import ConfigError
from ..files.map_file import Source
from .arrays import CELL, columns_of
from .series import LARGEST, Series, demand_bounded, package, readable, reason

SIMPLE = frozenset(
    ["double", "single", "logical", "char", "cell", "struct", "sparse", "int8", "uint8", "int16", "uint16", "int32", "uint32",
     "int64", "uint64", "function"]
)  # fmt: skip
"""Classes of MATLAB that are no objects."""
Order = Literal["little", "big"]
MI_INT32, MI_UINT32, MI_MATRIX, MI_COMPRESSED = 5, 6, 14, 15
"""Kinds of elements: the dimensions, the flags, an array, and one that is compressed."""
MX_STRUCT, MX_OBJECT, MX_SPARSE, MX_OPAQUE = 2, 3, 5, 17
"""Classes of arrays that are not one cell after the other."""
OBJECTS = "__function_workspace__"
"""Where SciPy leaves what objects hold: a file within the file."""
KINDS = frozenset([*range(1, 8), 9, *range(12, 19)])
"""Kinds of elements of a file of version 5; SciPy ends the process at others."""

MAGIC = b"\x89HDF\r\n\x1a\n"
USER_BLOCK = 512
CLASS, EMPTY, SPARSE, DECODE = "MATLAB_class", "MATLAB_empty", "MATLAB_sparse", "MATLAB_object_decode"
OWN = ("#refs#", "#subsystem#")
"""Groups of MATLAB's own bookkeeping."""


def read_matlab(path: Path, source: Source) -> Series:
    """Read a .mat file of version 7.3 (HDF5) or older; raises ConfigError."""
    from scipy.io import loadmat, whosmat

    data = read_bounded(path, LARGEST, ConfigError)
    if data.startswith(MAGIC) or data.startswith(MAGIC, USER_BLOCK):
        variables, object_names = _read_hdf5(path, data)
        objects, notes = _objects(path, object_names)
        return columns_of(path, {**variables, **objects}, source, "MATLAB 7.3", notes)
    with readable(path, "MATLAB"), warnings.catch_warnings(action="ignore"):
        # before anything is unpacked: a few kB can hold GB. The header of version 5 ends with version and byte order
        if data[124:128] in (b"\x00\x01IM", b"\x01\x00MI"):
            order: Order = "little" if data[126:128] == b"IM" else "big"
            demand_bounded(path, _claimed(memoryview(data)[128:], order))
        else:
            demand_bounded(path, sum(8 * math.prod(shape) for _, shape, _ in whosmat(io.BytesIO(data))))
        variables = loadmat(io.BytesIO(data), squeeze_me=False, struct_as_record=True)
        if OBJECTS in variables:
            demand_bounded(path, _claimed(memoryview(variables[OBJECTS].tobytes())[8:], order))  # behind its header
    opaque = OBJECTS in variables  # MATLAB's objects are read by mat-io; SciPy names them None
    variables = {str(n): v for n, v in variables.items() if n and not str(n).startswith("__") and str(n) != "None"}
    objects, notes = _objects(path, None) if opaque else ({}, ())
    return columns_of(path, {**variables, **objects}, source, "MATLAB", notes)


def _objects(path: Path, names: list[str] | None) -> tuple[Mapping[str, Any], tuple[str, ...]]:
    """The variables `names` (None: all) that are objects of MATLAB, by name, or a note on why they are not read."""
    if names == []:
        return {}, ()
    description = "objects (table, string, datetime ..)" if names is None else ", ".join(names)
    try:
        with warnings.catch_warnings(action="ignore"):
            import matio

            if names is None:
                names = [n for n, (_, kind) in matio.whosmat(str(path)).items() if kind not in SIMPLE]
            variables = matio.load_from_mat(str(path), variable_names=names, add_table_attrs=True) if names else {}
    except ImportError:
        return {}, (f"not read: {description}; to read them, pip install 'softlab[import]'",)
    except Exception as e:
        return {}, (f"not read: {description} ({reason(e)}); in MATLAB: writetable(T, 'T.csv'), or save numbers",)
    return {n: v for n, v in variables.items() if not n.startswith("__")}, ()


def _claimed(data: memoryview, order: Order, depth: int = 0) -> int:
    """Bytes of memory that the elements of a file of version 5 take once they are read; no more are counted beyond `LARGEST`.
    Raises ValueError where an element, or one within it, is of no known kind, or where an array claims more cells than its
    element has bytes, and zlib.error where a packed element is damaged."""
    size = 0
    for kind, body in _elements(data, order):
        if kind not in KINDS or depth > 50:
            raise ValueError(f"an element of kind {kind}, nested {depth} deep")
        if kind == MI_COMPRESSED:
            unpacked = zlib.decompressobj().decompress(body, LARGEST + 1)
            size += (
                len(unpacked) if len(unpacked) > LARGEST else max(len(unpacked), _claimed(memoryview(unpacked), order, depth + 1))
            )
        elif kind == MI_MATRIX:
            size += CELL + 8 * _cells(body, order) + _claimed(body, order, depth + 1)
        if size > LARGEST:
            break
    return size


def _elements(data: memoryview, order: Order) -> Iterator[tuple[int, memoryview]]:
    """Kind and content of each element."""
    at = 0
    while at + 8 <= len(data):
        kind = int.from_bytes(data[at : at + 4], order)
        if small := kind >> 16:
            yield kind & 0xFFFF, data[at + 4 : at + 4 + small]
            at += 8
        else:
            length = int.from_bytes(data[at + 4 : at + 8], order)
            yield kind, data[at + 8 : at + 8 + length]
            at += 8 + length + (0 if kind == MI_COMPRESSED else -length % 8)


def _cells(matrix: memoryview, order: Order) -> int:
    """Cells that an array claims, of a structure those of all fields; raises ValueError where it has fewer bytes."""
    head = list(islice(_elements(matrix, order), 6))
    if not head:
        return 0
    flags = head[0][1]
    if head[0][0] != MI_UINT32 or len(flags) != 8 or len(matrix) < 16:
        raise ValueError("an array without its flags")
    array_class = int.from_bytes(flags[:4], order) & 0xFF
    if array_class in (MX_SPARSE, MX_OPAQUE):
        return 0
    kind, dimensions = head[1] if len(head) > 1 else (0, flags)
    if kind not in (MI_INT32, MI_UINT32):
        raise ValueError("an array without its dimensions")
    cells = math.prod(int.from_bytes(dimensions[k : k + 4], order) for k in range(0, len(dimensions), 4))
    # of fields: the element with the bytes that each name takes, and behind it the one with the names
    name_length = {MX_STRUCT: 3, MX_OBJECT: 4}.get(array_class)
    if name_length is not None and len(head) > name_length + 1:
        cells *= len(head[name_length + 1][1]) // max(int.from_bytes(head[name_length][1], order), 1)
    if cells > len(matrix):
        raise ValueError(f"an array claims {cells} cells and has {len(matrix)} bytes")
    return cells


# ------------------------------------------------------------------ MATLAB 7.3
# A variable is a dataset with the attribute MATLAB_class, its dimensions in reverse order; a structure is a group of its fields.
def _read_hdf5(path: Path, data: bytes) -> tuple[Mapping[str, Any], list[str]]:
    """Arrays by name, a structure's fields as NAME.FIELD, and names of further variables; raises ConfigError."""
    library = package("h5py", path)
    with readable(path, "MATLAB 7.3"), library.File(io.BytesIO(data), "r") as file:
        datasets, sizes = _variables(library, file)
        # before anything is unpacked: a few kB can hold GB
        demand_bounded(path, sum(sizes))
        arrays = {name: np.asarray(dataset[()]).T for name, dataset in datasets.items()}
        read = {name.partition(".")[0] for name in datasets}
        # variables that lie in this file: links to others are not followed
        own = [n for n in file if n not in OWN and isinstance(file.get(n, getlink=True), library.HardLink)]
        variables = [n for n in own if CLASS in file[n].attrs and not file[n].attrs.get(EMPTY, 0)]
        return arrays, [n for n in variables if n not in read]


def _variables(library: Any, file: Any) -> tuple[dict[str, Any], list[int]]:
    """Datasets of numbers by name (NAME.FIELD), and bytes of memory of all datasets; ValueError for one in another file."""
    numeric: dict[str, Any] = {}
    sizes: list[int] = []

    def visit(name: str, item: Any) -> None:
        if not isinstance(item, library.Dataset):
            return
        if item.external is not None or item.is_virtual:
            raise ValueError(f"{name} lies in another file")
        # a chunk is unpacked as a whole, however small its part of the array is
        sizes.append(max(8, item.dtype.itemsize) * max(item.size, math.prod(item.chunks or (0,))))
        if (
            name.partition("/")[0] not in OWN
            and CLASS in item.attrs
            and not item.attrs.get(EMPTY, 0)
            and SPARSE not in item.parent.attrs
            and item.dtype.kind in "fiub"
            and str(item.attrs[CLASS]) not in ("char", "b'char'")
            and DECODE not in item.attrs
        ):
            numeric[name.replace("/", ".")] = item

    file.visititems(visit)
    return numeric, sizes
