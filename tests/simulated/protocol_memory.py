"""The driver's end of a line in this process: what opens a port of `MEMORY` gets it."""

from typing import Any

import serial

import timing

from .memory_line import LINES, MemoryLine

PAUSE = 0.001
"""Host seconds that pass for who asks again and again whether something has come, where nothing is expected."""


class Serial(serial.Serial):  # type: ignore[misc]
    """One driver's use of a line, as serial.Serial; there is no speed to set, nothing to flush, no file."""

    _line: MemoryLine | None = None
    _plugs = 0
    _asked = False
    """Something was sent, and neither was anything read since nor has `timeout` passed in vain."""

    def open(self) -> None:
        line = LINES.get(str(self.port))
        if line is None or not line.plugged:
            raise serial.SerialException(2, f"could not open port {self.port}: nothing is plugged in")
        if line.openers and (line.locked or self.exclusive):
            raise serial.SerialException(11, f"could not exclusively lock port {self.port}: another program has it open")
        self._line, self._plugs, line.locked = line, line.plugs, bool(self.exclusive)
        line.openers.append(self)
        self.is_open = True
        line.to_driver.clear()

    def close(self) -> None:
        line, self._line, self.is_open = self._line, None, False
        if line is not None and self in line.openers:
            line.openers.remove(self)

    def _reconfigure_port(self, *_: Any, **__: Any) -> None:
        """Any speed is right."""

    def fileno(self) -> int:
        """See serial.Serial: it has none."""
        raise OSError("a line in memory has no file")

    def _alive(self) -> MemoryLine:
        line = self._line
        if line is None:
            raise serial.PortNotOpenError
        if not line.plugged or line.plugs != self._plugs:
            raise serial.SerialException("device disconnected")
        return line

    @property
    def in_waiting(self) -> int:
        """See serial.Serial. A client that asks again and again until its own clock has run out asks but once: after a request,
        with the answer there or `timeout` over."""
        line = self._alive()
        if not line.to_driver:
            self._wait(1, (self.timeout or 0.0) if self._asked else PAUSE)
            self._asked = bool(line.to_driver)
        return len(self._alive().to_driver)

    def read(self, size: int = 1) -> bytes:
        self._wait(size, 1e9 if self.timeout is None else self.timeout)
        line = self._alive()
        data = bytes(line.to_driver[:size])
        del line.to_driver[:size]
        self._asked = False
        return data

    def write(self, data: Any, /) -> int:
        self._alive().to_fake.extend(bytes(data))
        self._asked = True
        return len(data)

    def _wait(self, size: int, within: float) -> None:
        """Until `size` bytes have come, the line is dead, or `within` host seconds have passed."""
        line = self._alive()
        timing.wait(lambda: len(line.to_driver) >= size or not line.plugged or line.plugs != self._plugs, within)

    def reset_input_buffer(self) -> None:
        self._alive().to_driver.clear()

    def reset_output_buffer(self) -> None:
        """See serial.Serial."""

    def flush(self) -> None:
        """See serial.Serial."""
