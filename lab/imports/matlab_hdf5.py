"""MATLAB 7.3 files: HDF5 behind 512 bytes of MATLAB's own.

A variable is a dataset with the attribute MATLAB_class, its dimensions in reverse order; a structure is a group of its fields.
Numbers are read here; names of anything else are returned.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..files.config import ConfigError
from .series import demand_bounded, package

MAGIC = b"\x89HDF\r\n\x1a\n"
USER_BLOCK = 512
CLASS, EMPTY, SPARSE, DECODE = "MATLAB_class", "MATLAB_empty", "MATLAB_sparse", "MATLAB_object_decode"
OWN = ("#refs#", "#subsystem#")
"""Groups of MATLAB's own bookkeeping."""


def is_hdf5(data: bytes) -> bool:
    """Whether a file is HDF5, at its begin or behind MATLAB's user block."""
    return data.startswith(MAGIC) or data[USER_BLOCK : USER_BLOCK + len(MAGIC)] == MAGIC


def read_hdf5(path: Path, data: bytes) -> tuple[Mapping[str, Any], list[str]]:
    """Arrays by name, a structure's fields as NAME.FIELD, and names of further variables; raises ConfigError."""
    library = package("h5py", path)
    try:
        with library.File(io.BytesIO(data), "r") as file:
            found, sizes = _variables(library, file)
            # before anything is unpacked: a few kB can hold GB
            demand_bounded(path, sum(sizes))
            arrays = {name: np.asarray(one[()]).T for name, one in found.items()}
            read = {name.partition(".")[0] for name in found}
            return arrays, [n for n in _own(library, file) if n not in read]
    except ConfigError:
        raise
    except Exception as e:
        raise ConfigError(f"{path}: is not a MATLAB 7.3 file ({type(e).__name__}: {str(e)[:200]})") from e


def _own(library: Any, file: Any) -> list[str]:
    """Variables that lie in this file: links to others are not followed."""
    names = [n for n in file if n not in OWN and isinstance(file.get(n, getlink=True), library.HardLink)]
    return [n for n in names if CLASS in file[n].attrs and not file[n].attrs.get(EMPTY, 0)]


def _variables(library: Any, file: Any) -> tuple[dict[str, Any], list[int]]:
    """Datasets of numbers by name, and the bytes of all that there are."""
    found: dict[str, Any] = {}
    sizes: list[int] = []

    def visited(name: str, one: Any) -> None:
        if not isinstance(one, library.Dataset):
            return
        if one.external is not None or one.is_virtual:
            raise ValueError(f"{name} lies in another file")
        sizes.append(8 * one.size)
        if (
            name.partition("/")[0] not in OWN
            and CLASS in one.attrs
            and not one.attrs.get(EMPTY, 0)
            and SPARSE not in one.parent.attrs
            and one.dtype.kind in "fiub"
            and _text(one.attrs[CLASS]) != "char"
            and DECODE not in one.attrs
        ):
            found[name.replace("/", ".")] = one

    file.visititems(visited)
    return found, sizes


def _text(value: Any) -> str:
    return value.decode("ascii", "replace") if isinstance(value, bytes) else str(value)
