"""Reading files from outside: regular files only, and never more of small ones than makes sense."""

from __future__ import annotations

import os
import stat


def regular(path: str | os.PathLike[str], error: type[Exception]) -> int:
    """A regular file, open for reading; raises `error` for any other: nobody waits for a named pipe."""
    if "\0" in str(path):
        raise error(f"{str(path)!r}: is not a file name")
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as problem:
        raise error(f"{path}: cannot be read ({problem.strerror}); check the path") from problem
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise error(f"{path}: is not a file")
    return handle


def read_bounded(path: str | os.PathLike[str], most: int, error: type[Exception]) -> bytes:
    """The bytes of a regular file of `most` bytes at most; raises `error` for any other."""
    try:
        with open(regular(path, error), "rb") as file:
            data = file.read(most + 1)
    except OSError as problem:
        raise error(f"{path}: cannot be read ({problem.strerror}); check the path") from problem
    if len(data) > most:
        raise error(f"{path}: has more than {most / 1e6:g} MB, too large for a file of this kind")
    return data
