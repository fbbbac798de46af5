"""The driver's end of a line in this process: pyserial finds it here for a port `memory://..`."""

from __future__ import annotations

from typing import Any

import serial

import timing

from .lines import LINES, MemoryLine

PAUSE = 0.001
"""Host seconds that pass for who asks again and again whether something has come."""


class Serial(serial.Serial):  # type: ignore[misc]
    """One driver's use of a line."""

    _line: MemoryLine | None = None
    _plugs = 0
    _looks = 0
    """How often it was asked whether something has come, since the last reading."""

    def open(self) -> None:
        """See serial.Serial."""
        line = LINES.get(str(self.port))
        if line is None or not line.plugged:
            raise serial.SerialException(2, f"could not open port {self.port}: nothing is plugged in")
        if line.openers and (line.locked or self.exclusive):
            raise serial.SerialException(
                11, f"could not exclusively lock port {self.port}: another program has it open"
            )
        self._line, self._plugs, line.locked = line, line.plugs, bool(self.exclusive)
        line.openers.append(self)
        self.is_open = True
        line.to_driver.clear()

    def close(self) -> None:
        """See serial.Serial."""
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
        """See serial.Serial."""
        line = self._alive()
        self._looks += 1
        # pymodbus asks again and again, for a time that it counts by the computer's own clock: a busy one may use it up
        # before the fake gets to answer
        within = max(PAUSE, self.timeout or 0.0) if self._looks == 2 else PAUSE
        timing.wait(lambda: bool(line.to_driver) or not line.plugged or line.plugs != self._plugs, within)
        return len(self._alive().to_driver)

    def read(self, size: int = 1) -> bytes:
        """See serial.Serial."""
        line = self._alive()
        within = 1e9 if self.timeout is None else self.timeout
        timing.wait(lambda: len(line.to_driver) >= size or not line.plugged or line.plugs != self._plugs, within)
        line = self._alive()
        data = bytes(line.to_driver[:size])
        del line.to_driver[:size]
        self._looks = 0
        return data

    def write(self, data: Any, /) -> int:
        """See serial.Serial."""
        self._alive().to_fake.extend(bytes(data))
        return len(data)

    def reset_input_buffer(self) -> None:
        """See serial.Serial."""
        self._alive().to_driver.clear()

    def reset_output_buffer(self) -> None:
        """See serial.Serial."""

    def flush(self) -> None:
        """See serial.Serial."""
