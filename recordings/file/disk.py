"""The file under the MCAP writer: every write goes to the kernel at once, and what is committed can be gone back to."""

from __future__ import annotations

import contextlib
import os
import threading
from pathlib import Path
from typing import Protocol

from ..errors import WriteFailed
from ..own_files import created


class Disk:
    """An output for `McapFile` that survives a crash of the process and, soon after, of the machine.

    Nothing is held back in this process. `commit` marks the end of whole records and has them synced to the disk by a
    thread of its own, because a sync may take long and must not hold up writing.
    """

    def __init__(self, path: Path) -> None:
        try:
            self._fd = created(path)
        except FileExistsError:
            raise WriteFailed(f"{path} exists; recordings are never overwritten, choose another name") from None
        except OSError as error:
            raise WriteFailed(f"{path} cannot be created: {error.strerror}") from error
        self.path = path
        self._place = os.path.abspath(path)
        self.position = self._committed = 0
        """Bytes written, and those of whole records."""
        self._failure: OSError | None = None
        self._wake = threading.Event()
        self._closing = False
        self._syncer = threading.Thread(target=self._sync, name="recording-sync", daemon=True)
        self._syncer.start()

    # -- what the MCAP writer needs
    def write(self, data: bytes) -> int:
        """All of it or OSError."""
        if self._failure is not None:
            raise self._failure
        view = memoryview(data)
        while view:
            done = os.write(self._fd, view)
            self.position += done
            view = view[done:]
        return len(data)

    # -- safety
    def commit(self) -> None:
        """Everything written so far is whole records; sync it soon."""
        if self.position > self._committed:
            self._committed = self.position
            self._wake.set()

    def displaced(self) -> str:
        """How the file is no longer what its path names; empty while it is. See the function `displaced`."""
        return displaced(self._place, self._fd, self.position)

    def read(self, start: int, size: int) -> bytes:
        """What the open file holds there, wherever its name is now; fewer bytes where it ends before, none where it fails."""
        try:
            return os.pread(self._fd, size, start)
        except OSError:
            return b""

    def sync(self) -> None:
        """Return when everything written so far is on the disk; OSError when it did not get there."""
        os.fsync(self._fd)

    def _sync(self) -> None:
        while not self._closing:
            self._wake.wait()
            self._wake.clear()
            try:
                os.fsync(self._fd)
            except OSError as error:
                self._failure = error
                return

    def _stop(self) -> None:
        self._closing = True
        self._wake.set()
        self._syncer.join()

    def close(self) -> None:
        """Sync and close; OSError when the data did not reach the disk."""
        self._stop()
        try:
            if self._failure is not None:
                raise self._failure
            os.fsync(self._fd)
        finally:
            os.close(self._fd)

    def give_up(self, cut: bool = True) -> None:
        """Close without an error. `cut`: cut off what is not committed, so that the file ends with a whole record; a file that
        is no longer what its path names is left as it is."""
        self._stop()
        with contextlib.suppress(OSError):
            if cut:
                os.ftruncate(self._fd, min(self._committed, os.fstat(self._fd).st_size))
                os.fsync(self._fd)
        with contextlib.suppress(OSError):
            os.close(self._fd)

    def sync_name(self) -> None:
        """Sync the directory, so that the file is found after a power cut."""
        directory = os.open(self.path.parent, os.O_RDONLY)
        try:
            os.fsync(directory)
        finally:
            os.close(directory)


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
    if not os.path.samestat(there, own):
        return "was replaced by another file"
    if own.st_size < size:
        return f"was truncated to {own.st_size} of {size} bytes"
    return "was written to by another program" if own.st_size > size else ""
