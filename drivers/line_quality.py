"""What the exchanges of a serial line show of its cable and adapter: requests repeated, an echo, answers that come late."""

from __future__ import annotations

import os
from collections import deque
from pathlib import Path

import timing

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


REPEATED_OF_LAST, MOST_REPEATED = 40, 10
"""Requests that are judged together, and how many of them may be repeated: a sound line repeats a few in a thousand."""
TIMED = 20
"""Answers that are judged together."""
LATE = 0.005
"""s beyond its time on the line in which a supported instrument answers; adapters with a latency timer take up to 16 ms."""
SHORT_TIMER = 2
"""ms of a latency timer that delays nothing here."""


class LineQuality:
    """One line; each notice is given once."""

    def __init__(self, path: str, byte_time: float) -> None:
        """`byte_time`: s that a byte takes on the line."""
        self._path, self._byte_time = path, byte_time
        self.echoes = False
        """The adapter has returned a request as it was sent."""
        self._bytes_sent = 0
        """Of the request whose answer is awaited."""
        self._repeated: deque[bool] = deque(maxlen=REPEATED_OF_LAST)
        self.repeats = 0
        """Requests repeated in all."""
        self._delays: deque[float] = deque(maxlen=TIMED)
        self._given: set[str] = set()

    def sent(self, count: int) -> None:
        """Note that a request of `count` bytes was sent."""
        self._bytes_sent = count

    def answered(self, since: float, count: int) -> None:
        """Note its first answer: `count` bytes with what came before, waited for since the host time `since` (s)."""
        if self._bytes_sent:
            self._delays.append(timing.now() - since - self._byte_time * (self._bytes_sent + count))
            self._bytes_sent = 0

    def count(self, repeated: bool) -> None:
        """Note a request; whether it was the repetition of one that failed."""
        self._repeated.append(repeated)
        self.repeats += repeated

    def notices(self) -> list[str]:
        """Return what is worth a warning and was not yet given."""
        notices = {}
        if sum(self._repeated) > MOST_REPEATED:
            notices["retries"] = (
                f"{sum(self._repeated)} of the last {len(self._repeated)} requests on {self._path} had to be repeated, "
                f"{self.repeats} in all; check cable, baud rate and adapter"
            )
        if self.echoes:
            notices["echo"] = f"the adapter on {self._path} echoes what is sent; switch its local echo off"
        # three of four, so that neither a busy moment of the computer counts nor a timer that happens to run out early
        if len(self._delays) == TIMED and (delay := sorted(self._delays)[TIMED // 4]) > LATE:
            notices["late"] = self._late(delay)
        new = [text for what, text in notices.items() if what not in self._given]
        self._given |= notices.keys()
        return new

    def _late(self, delay: float) -> str:
        """The notice of answers that come `delay` s later than the line needs, with the remedy for what the computer knows."""
        late = f"answers on {self._path} come {delay * 1e3:.0f} ms later than the line needs"
        timer = latency_timer(self._path)
        if timer is not None and timer <= SHORT_TIMER:
            return (
                f"{late}, although the latency timer of its adapter is {timer} ms: the instrument is slow, or this computer is "
                "busy; ask less often (`poll` in rig.yaml), or end other programs"
            )
        if timer is not None:
            return (
                f"{late}, because the latency timer of its adapter is {timer} ms; set it to 1 ms: echo 1 | sudo tee "
                f"{latency_file(self._path)}"
            )
        if "://" in self._path:
            return f"{late}, by the network or its serial server; set the server's packing time (latency) to the least"
        return (
            f"{late}: most USB adapters hold bytes back for a latency timer of 16 ms, set it to 1 ms (Linux: latency_timer of "
            "the port in /sys/bus/usb-serial/devices; Windows: advanced settings of the port); else the instrument is slow, or "
            "this computer is busy"
        )
