"""Whether a file that is being written is still what its path names: by path, inode and size."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Protocol


class Companion(Protocol):
    """A file that is kept with the recording: its journal."""

    path: Path

    def displaced(self) -> str:
        """What happened to it, see `displaced`; empty while it is in place."""

    def renew(self) -> bool:
        """Write it anew where it was; False where that cannot be done."""

    def follow(self, before: Path, recording: Path) -> bool:
        """Go on next to another recording; False where that cannot be done."""


def displaced(path: str, handle: int, size: int) -> str:
    """How the open file no longer stands at its absolute path with the `size` bytes that were written; empty while it does."""
    own = os.fstat(handle)
    try:
        there = os.stat(path)
    except (FileNotFoundError, NotADirectoryError):
        return "was renamed or moved" if own.st_nlink else "was deleted"
    except OSError as error:
        return f"cannot be reached ({error.strerror})"
    if (there.st_dev, there.st_ino) != (own.st_dev, own.st_ino):
        return "was replaced by another file"
    if own.st_size < size:
        return f"was truncated to {own.st_size} of {size} bytes"
    return "was written to by another program" if own.st_size > size else ""
