"""Reading small files from outside: regular files only, and never more of them than makes sense."""

from __future__ import annotations

import os
import stat
from pathlib import Path


def read_bounded(path: str | os.PathLike[str], most: int, error: type[Exception]) -> bytes:
    """The bytes of a regular file of `most` bytes at most; raises `error` for any other."""
    path = Path(path)
    if "\0" in str(path):
        raise error(f"{str(path)!r}: is not a file name")
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise error(f"{path}: is not a file")
        with open(path, "rb") as file:
            data = file.read(most + 1)
    except OSError as problem:
        raise error(f"{path}: cannot be read ({problem.strerror}); check the path") from problem
    if len(data) > most:
        raise error(f"{path}: has more than {most / 1e6:g} MB, too large for a file of this kind")
    return data
