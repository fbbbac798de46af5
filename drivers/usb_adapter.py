"""What the computer knows of the USB adapter behind a serial port: which one it is, and how long it holds bytes back."""

from __future__ import annotations

import os
from pathlib import Path

TTYS = Path("/sys/class/tty")
"""Where Linux describes its serial ports."""


def latency_file(path: str) -> Path:
    """Return the file that holds the latency timer of the adapter at a port; it exists for adapters that have one."""
    return TTYS / Path(os.path.realpath(path)).name / "device" / "latency_timer"


def latency_timer(path: str) -> int | None:
    """Return the latency timer of the adapter at a port, ms; None where it cannot be read."""
    try:
        return int(latency_file(path).read_text(encoding="ascii"))
    except (OSError, ValueError):
        return None


def adapter(path: str) -> str:
    """Return in words which USB adapter is at a port: its ids and serial number, or its socket where it has no number.

    Empty for what is no USB adapter.
    """
    from serial.tools import list_ports  # a computer without the instruments' libraries has none

    device = os.path.realpath(path)
    for port in list_ports.comports():
        if os.path.realpath(port.device) == device and port.vid is not None and port.pid is not None:
            number = f"serial number {port.serial_number}" if port.serial_number else f"at USB socket {port.location}"
            return f"{port.vid:04x}:{port.pid:04x} {number}"
    return ""
