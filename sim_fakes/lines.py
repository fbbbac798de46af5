"""The fake's end of a serial line, whose other end any program opens: a pty."""

from __future__ import annotations

import contextlib
import os
import pty
import tempfile
import tty
from pathlib import Path

import timing


class PtyLine:
    """A pty; `port` is a link to it, as `/dev/serial/by-id` has them, which stays while the pty behind it changes."""

    def __init__(self, name: str) -> None:
        self._master = self._slave = self._kept = -1
        """Ends of the line; the end kept from the last one that was unplugged."""
        self._folder = tempfile.TemporaryDirectory(prefix="softlab-")
        os.chmod(self._folder.name, 0o755)  # who may use a line is said at its pty
        self.port = str(Path(self._folder.name) / name)

    @property
    def plugged(self) -> bool:
        """Whether the cable is in."""
        return self._master >= 0

    def plug(self) -> None:
        """Put the cable in: a new line under the same path."""
        self._master, self._slave = pty.openpty()
        tty.setraw(self._master)
        tty.setraw(self._slave)
        # what nobody reads is lost, as on a real line; a blocking write would stop the fake for ever
        os.set_blocking(self._master, False)
        os.symlink(os.ttyname(self._slave), self.port)

    def unplug(self) -> None:
        """Pull the cable out."""
        Path(self.port).unlink(missing_ok=True)
        for fd in (self._master, self._kept):
            with contextlib.suppress(OSError):
                os.close(fd)
        self._kept = self._slave
        self._master = self._slave = -1

    def await_bytes(self, longest: float) -> bool:
        """Whether something has come, after at most `longest` host seconds. Raises OSError when unplugged meanwhile."""
        return bool(timing.readable([self._master] if self._master >= 0 else [], longest))

    def read(self) -> bytes:
        """What has come. Raises OSError."""
        return os.read(self._master, 4096)

    def write(self, data: bytes) -> None:
        """Send; what nobody reads is lost."""
        with contextlib.suppress(OSError):
            os.write(self._master, data)

    def close(self) -> None:
        """Free what it holds."""
        self.unplug()
        with contextlib.suppress(OSError):
            os.close(self._kept)
        self._kept = -1
        self._folder.cleanup()
