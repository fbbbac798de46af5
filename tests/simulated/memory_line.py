"""A serial line in this process, for fakes and drivers that live in the same simulated clock: two byte queues.

The driver's end is opened by pyserial under a path that no device has, see `protocol_memory`.
"""

from __future__ import annotations

import itertools
import os
from typing import Any

import serial

import timing

MEMORY = "/memory-line/"
LINES: dict[str, MemoryLine] = {}
"""The lines in this process, by their path."""
_NUMBERS = itertools.count(1)

_of_pyserial = serial.serial_for_url


def _opened(port: str, *how: Any, **options: Any) -> Any:
    """See serial.serial_for_url; these paths are lines of this process."""
    if not port.startswith(MEMORY):
        return _of_pyserial(port, *how, **options)
    from .protocol_memory import Serial

    closed = options.pop("do_not_open", False)
    line = Serial(None, *how, **options)
    line.port = port
    if not closed:
        line.open()
    return line


serial.serial_for_url = _opened


class MemoryLine:
    """Stands in for `sim_fakes.pty_fake.PtyLine`; its methods do the same."""

    def __init__(self, name: str) -> None:
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
        return self._plugged

    def plug(self) -> None:
        self._plugged = True
        self.openers.clear()
        self.plugs += 1
        self.to_fake.clear()
        self.to_driver.clear()

    def unplug(self) -> None:
        self._plugged = False
        self.openers.clear()

    def await_bytes(self, longest: float) -> bool:
        return timing.wait(lambda: self.plugged and bool(self.to_fake), longest)

    def read(self) -> bytes:
        if not self.plugged:
            raise OSError("unplugged")
        data = bytes(self.to_fake[:4096])
        del self.to_fake[:4096]
        return data

    def write(self, data: bytes) -> None:
        if self.plugged and self.openers:
            self.to_driver += data

    def close(self) -> None:
        self.unplug()
        LINES.pop(self.port, None)
