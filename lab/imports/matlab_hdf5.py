"""MATLAB 7.3 files: HDF5 behind 512 bytes of MATLAB's own.

A variable is a dataset with the attribute MATLAB_class, its dimensions in reverse order; a structure is a group of its fields.
Numbers are taken; text, cells, sparse and complex arrays are passed over, as in older files.
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
CLASS, EMPTY, SPARSE = "MATLAB_class", "MATLAB_empty", "MATLAB_sparse"
OWN = ("#refs#", "#subsystem#")
"""Groups of MATLAB's own bookkeeping."""


def is_hdf5(data: bytes) -> bool:
    """Whether a file is HDF5, at its begin or behind MATLAB's user block."""
    return data.startswith(MAGIC) or data[USER_BLOCK : USER_BLOCK + len(MAGIC)] == MAGIC


def read_hdf5(path: Path, data: bytes) -> Mapping[str, Any]:
    """Arrays by name, a structure's fields as NAME.FIELD; raises ConfigError."""
    library = package("h5py", path)
    try:
        with library.File(io.BytesIO(data), "r") as file:
            found = _variables(library, file)
            # before anything is unpacked: a few kB can hold GB
            demand_bounded(path, sum(8 * one.size for one in found.values()))
            return {name: np.asarray(one[()]).T for name, one in found.items()}
    except ConfigError:
        raise
    except Exception as e:
        raise ConfigError(f"{path}: is not a MATLAB 7.3 file ({type(e).__name__}: {str(e)[:200]})") from e


def _variables(library: Any, file: Any) -> dict[str, Any]:
    """Datasets of numbers by name; links to other files are not followed."""
    found: dict[str, Any] = {}

    def visited(name: str, one: Any) -> None:
        if (
            isinstance(one, library.Dataset)
            and name.partition("/")[0] not in OWN
            and CLASS in one.attrs
            and not one.attrs.get(EMPTY, 0)
            and SPARSE not in one.parent.attrs
            and one.dtype.kind in "fiub"
            and _text(one.attrs[CLASS]) != "char"
            and one.external is None
            and not one.is_virtual
        ):
            found[name.replace("/", ".")] = one

    file.visititems(visited)
    return found


def _text(value: Any) -> str:
    return value.decode("ascii", "replace") if isinstance(value, bytes) else str(value)
