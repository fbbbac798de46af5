"""Files that the software itself names: locks, journals, caches, what replaces a file at once, and all that goes into a
folder that a person names.

None of them goes through a symbolic link or into a pipe or device: whoever can write to the folder could otherwise have
a file elsewhere overwritten. Files that a person names (`--out`, `--report`) are opened as usual.
"""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import shutil
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO


def opened(path: Path, flags: int, mode: int = 0o644) -> int:
    """`os.open` for a regular file that is no symbolic link; any other raises an OSError that says so."""
    try:
        # A pipe without a reader must not block; a regular file does not care.
        handle = os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, mode)
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.EMLINK):
            raise OSError(errno.ELOOP, "is a symbolic link, which is not followed here; remove it", str(path)) from None
        raise
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise OSError(errno.EINVAL, "is not a regular file; remove it", str(path))
    return handle


def created(path: Path, mode: int = 0o644) -> int:
    """A new file, open for writing; FileExistsError where there is anything of that name, a symbolic link too."""
    return opened(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, mode)


@contextlib.contextmanager
def replacing(path: Path, mode: int = 0o644) -> Iterator[tuple[BinaryIO, Path]]:
    """A new file and its name, in the folder of `path`, which takes that name, synced, when the block ends without error.

    What stood there before is replaced at once; a symbolic link is replaced itself, never what it points to.
    """
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.new")
    try:
        handle = created(temporary, mode)
        with open(handle, "wb") as file:
            yield file, temporary
            if not file.closed:
                file.flush()
                os.fsync(handle)
        os.replace(temporary, path)
    except BaseException as error:
        with contextlib.suppress(OSError):
            temporary.unlink()
        if isinstance(error, OSError) and str(error.filename) == str(temporary):  # a name that nobody gave
            raise OSError(error.errno, error.strerror, str(path)) from None
        raise


def replaced(path: Path, text: str | bytes, mode: int = 0o644) -> None:
    """Replace a file by this text at once, or leave it as it was."""
    with replacing(path, mode) as (file, _):
        file.write(text if isinstance(text, bytes) else text.encode("utf-8"))


def copied(source: Path, target: Path) -> None:
    """Copy a file to another name, unless it is there under that name already."""
    if target.is_symlink() or not (target.exists() and target.samefile(source)):
        with replacing(target) as (file, _), open(source, "rb") as data:
            shutil.copyfileobj(data, file)


def folder_in(folder: Path, name: str) -> Path:
    """A folder within a folder, made where it is missing; raises an OSError where a symbolic link leads elsewhere."""
    path = folder / name
    path.mkdir(exist_ok=True)
    if path.is_symlink():
        raise OSError(errno.ELOOP, "is a symbolic link, which is not followed here; remove it", str(path))
    return path


def displaced(path: str, handle: int, size: int) -> str:
    """How the open file no longer stands at its absolute path with the `size` bytes that were written; empty while it does."""
    opened_file = os.fstat(handle)
    try:
        at_path = os.stat(path)
    except (FileNotFoundError, NotADirectoryError):
        return "was renamed or moved" if opened_file.st_nlink else "was deleted"
    except OSError as error:
        return f"cannot be reached ({error.strerror})"
    if not os.path.samestat(at_path, opened_file):
        return "was replaced by another file"
    if opened_file.st_size < size:
        return f"was truncated to {opened_file.st_size} of {size} bytes"
    return "was written to by another program" if opened_file.st_size > size else ""
