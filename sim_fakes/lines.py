"""The two ends of a serial line: a pty that any program opens, or a pair of byte queues for a driver in this process.

The driver's end of the queues is opened by pyserial under `memory://NAME`, see `protocol_memory`.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import pty
import tempfile
import tty
from pathlib import Path
from typing import Protocol

import timing

MEMORY = "memory://"
LINES: dict[str, MemoryLine] = {}
"""The lines in this process, by their path."""
_NUMBERS = itertools.count(1)


class Line(Protocol):
    """The fake's end of a serial line."""

    port: str
    """What a driver opens; nothing is there while the cable is out."""

    @property
    def plugged(self) -> bool:
        """Whether the cable is in."""

    def plug(self) -> None:
        """Put the cable in: a new line under the same path."""

    def unplug(self) -> None:
        """Pull the cable out."""

    def await_bytes(self, longest: float) -> bool:
        """Whether something has come, after at most `longest` host seconds. Raises OSError when unplugged meanwhile."""

    def read(self) -> bytes:
        """What has come. Raises OSError."""

    def write(self, data: bytes) -> None:
        """Send; what nobody reads is lost."""

    def close(self) -> None:
        """Free what it holds."""


def line(name: str) -> Line:
    """A line for a fake of this name: in memory where its driver lives in the same simulated clock."""
    return MemoryLine(name) if timing.together() else PtyLine(name)


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
        """See Line."""
        return self._master >= 0

    def plug(self) -> None:
        """See Line."""
        self._master, self._slave = pty.openpty()
        tty.setraw(self._master)
        tty.setraw(self._slave)
        # what nobody reads is lost, as on a real line; a blocking write would stop the fake for ever
        os.set_blocking(self._master, False)
        os.symlink(os.ttyname(self._slave), self.port)

    def unplug(self) -> None:
        """See Line."""
        Path(self.port).unlink(missing_ok=True)
        for fd in (self._master, self._kept):
            with contextlib.suppress(OSError):
                os.close(fd)
        self._kept = self._slave
        self._master = self._slave = -1

    def await_bytes(self, longest: float) -> bool:
        """See Line."""
        return bool(timing.readable([self._master] if self._master >= 0 else [], longest))

    def read(self) -> bytes:
        """See Line."""
        return os.read(self._master, 4096)

    def write(self, data: bytes) -> None:
        """See Line."""
        with contextlib.suppress(OSError):
            os.write(self._master, data)

    def close(self) -> None:
        """See Line."""
        self.unplug()
        with contextlib.suppress(OSError):
            os.close(self._kept)
        self._kept = -1
        self._folder.cleanup()


class MemoryLine:
    """Two byte queues in this process."""

    def __init__(self, name: str) -> None:
        import serial  # fakes on ptys do without

        if __package__ not in serial.protocol_handler_packages:
            serial.protocol_handler_packages.append(__package__)
        # another process has lines of its own, and one rig must not be taken for the other
        self.port = f"{MEMORY}{os.getpid()}-{next(_NUMBERS)}/softlab-{name}"
        self._plugged = False
        self.plugs = 0
        """How often the cable was put in: who opened it before holds a dead end."""
        self.openers: list[object] = []
        """Who has it open."""
        self.locked = False
        """One of them wants it alone."""
        self.to_fake, self.to_driver = bytearray(), bytearray()
        LINES[self.port] = self

    @property
    def plugged(self) -> bool:
        """See Line."""
        return self._plugged

    def plug(self) -> None:
        """See Line."""
        self._plugged = True
        self.openers.clear()
        self.plugs += 1
        self.to_fake.clear()
        self.to_driver.clear()

    def unplug(self) -> None:
        """See Line."""
        self._plugged = False
        self.openers.clear()

    def await_bytes(self, longest: float) -> bool:
        """See Line."""
        return timing.wait(lambda: self.plugged and bool(self.to_fake), longest)

    def read(self) -> bytes:
        """See Line."""
        if not self.plugged:
            raise OSError("unplugged")
        data = bytes(self.to_fake[:4096])
        del self.to_fake[:4096]
        return data

    def write(self, data: bytes) -> None:
        """See Line."""
        if self.plugged and self.openers:
            self.to_driver += data

    def close(self) -> None:
        """See Line."""
        self.unplug()
        LINES.pop(self.port, None)
