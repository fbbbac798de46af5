"""USB adapters of the computer that runs a test, as pyserial finds them in the system."""

from __future__ import annotations

import pytest
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo


class Plugged:
    """One adapter at each port, with a serial number unless `numbered` is False."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, ports: list[str], numbered: bool = True) -> None:
        self.numbers = {port: f"FT{i}" for i, port in enumerate(ports, 1)}
        self.numbered = numbered
        monkeypatch.setattr(list_ports, "comports", self._listed)

    def _listed(self) -> list[ListPortInfo]:
        found = []
        for port, number in self.numbers.items():
            info = ListPortInfo(port)
            info.vid, info.pid, info.location = 0x0403, 0x6014, f"1-{number}"
            info.serial_number = number if self.numbered else None
            found.append(info)
        return found

    def exchange(self, one: str, other: str) -> None:
        """They come back with exchanged names."""
        self.numbers[one], self.numbers[other] = self.numbers[other], self.numbers[one]
