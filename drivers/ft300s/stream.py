"""The FT 300-S's data stream: bytes in, wrenches out, how much was lost on the way, and whether the sensor is at rest.

A frame has 16 bytes: 20 4E, six little-endian int16 (force in N/100, moment in N m/1000), and a Modbus CRC-16 over
those 14 bytes, low byte first. The two leading bytes may also occur inside the data, so only a right CRC makes a frame.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from itertools import pairwise

from pymodbus.framer import FramerRTU

from ..interfaces import Vector6

HEAD = b"\x20\x4e"
FRAME_BYTES = 16
PERIOD = 0.01
"""s of host time between two frames."""


def decode(frame: bytes) -> Vector6 | None:
    """Force (N) and moment (N m) in the sensor's frame from 16 bytes; None when the CRC is wrong."""
    # FramerRTU gives the CRC with its low byte in front when written big-endian
    if frame[14:] != FramerRTU.compute_CRC(frame[:14]).to_bytes(2, "big"):
        return None
    c = struct.unpack("<6h", frame[2:14])
    n, m = 100.0, 1000.0  # counts per N and per N m
    return (c[0] / n, c[1] / n, c[2] / n, c[3] / m, c[4] / m, c[5] / m)


class FrameParser:
    """Cuts a stream of bytes into frames; `damaged` counts the frames that could not be read.

    Every 16 bytes thrown away while looking for the next good frame are one damaged frame, and a rest of eight or more
    is another; stray bytes between good frames are none. What comes before the first good frame is not counted: a
    stream is usually joined in the middle of a frame.
    """

    def __init__(self) -> None:
        self.damaged = 0
        self._buffer = b""
        self._skipped = 0
        self._in_step = False

    def feed(self, data: bytes) -> list[Vector6]:
        """The wrenches completed by these bytes, oldest first."""
        self._buffer += data
        wrenches: list[Vector6] = []
        while True:
            start = self._buffer.find(HEAD)
            if start < 0:
                start = max(0, len(self._buffer) - 1)
            self._skip(start)
            if len(self._buffer) < FRAME_BYTES:
                return wrenches
            wrench = decode(self._buffer[:FRAME_BYTES])
            if wrench is None:
                self._skip(1)
                continue
            self._buffer = self._buffer[FRAME_BYTES:]
            self._settle()
            wrenches.append(wrench)

    def _skip(self, count: int) -> None:
        self._buffer = self._buffer[count:]
        if not self._in_step:
            return
        self._skipped += count
        self.damaged += self._skipped // FRAME_BYTES
        self._skipped %= FRAME_BYTES

    def _settle(self) -> None:
        """A good frame: what was skipped before it is judged, and counting begins."""
        if self._skipped >= FRAME_BYTES // 2:
            self.damaged += 1
        self._skipped = 0
        self._in_step = True


class GapCounter:
    """Counts frames that never came, from the times at which frames arrive (host s); the stream carries no counter.

    A late frame alone proves nothing: adapters and the host hold bytes back and deliver them in bursts. So each frame's
    lateness against a schedule of one frame per `PERIOD` is taken, and the least lateness among `WINDOW` frames is
    judged: bursts bring it back to nothing, missing frames do not. Rounded to whole frames it is what is missing, and
    the schedule is moved by it, so that a sensor clock up to two percent off never adds up to a gap. When a burst
    outlasts a window, its frames come in ahead of the moved schedule later on and are taken off again.
    """

    WINDOW = 25

    def __init__(self) -> None:
        self.missing = 0
        self._due: float | None = None
        self._least = 0.0
        self._count = 0

    def arrived(self, at: float, damaged: int) -> None:
        """One good frame at host time `at`, and how many damaged ones came since the last good one."""
        if self._due is None:
            self._due = at
        self._due += damaged * PERIOD
        lateness = at - self._due
        self._least = lateness if self._count == 0 else min(self._least, lateness)
        self._count += 1
        self._due += PERIOD
        if self._count == self.WINDOW:
            self.missing = max(0, self.missing + round(self._least / PERIOD))
            self._due += self._least
            self._count = 0


AXES = (("fx", "N"), ("fy", "N"), ("fz", "N"), ("mx", "N m"), ("my", "N m"), ("mz", "N m"))
NOISE: Vector6 = (0.1, 0.1, 0.1, 0.005, 0.005, 0.005)
"""Standard deviation of a reading at rest, N and N m."""
SCATTER_SIGMAS, TREND_SIGMAS, PART_SIGMAS = 6.0, 5.0, 6.0
"""Standard errors beyond which scatter, trend or a part's mean is no noise: together fewer than one in 100 000 series at
rest is refused."""
PARTS = 10
"""Equal parts of a series whose means are compared with its own,"""


def unrest(readings: Sequence[Vector6]) -> str:
    """Return the axis that changed most, by how much, and the limit in words; empty for a sensor at rest.

    Each axis is judged by its scatter (a tool that vibrates), by its trend (a load that comes on, a sensor that warms up), and by
    the means of its parts (a step, a slow swing). `readings`: consecutive raw readings, N and N m; one alone cannot be judged.
    """
    worst, text = 1.0, ""
    for (axis, unit), noise, values in zip(AXES, NOISE, zip(*readings, strict=True), strict=True):
        for what, value, limit in _judged(values, noise):
            if value > worst * limit:
                worst, text = value / limit, f"{axis} {what} {value:.3g} {unit}, limit {limit:.2g} {unit}"
    return text


def _judged(values: Sequence[float], noise: float) -> list[tuple[str, float, float]]:
    """Scatter, trend and jump of one axis, each in words with its value and limit; `noise`: standard deviation at rest."""
    n = len(values)
    if n < 2:
        return []
    mean = sum(values) / n
    scatter = math.sqrt(sum((x - mean) ** 2 for x in values) / (n - 1))
    allowed = max(2.0, 1 + SCATTER_SIGMAS / math.sqrt(2 * (n - 1)))
    judged = [("scatters by", scatter, allowed * noise)]
    # Neighbouring readings differ by little but noise, even under a changing load.
    jitter = math.sqrt(sum((b - a) ** 2 for a, b in pairwise(values)) / (2 * (n - 1)))
    sd = min(max(noise, jitter), allowed * noise)
    if n > 2:
        # the rise of the least-squares line over the series
        trend = 12 * sum((i - (n - 1) / 2) * x for i, x in enumerate(values)) / (n * (n + 1))
        judged.append(("drifts by", abs(trend), TREND_SIGMAS * sd * math.sqrt(12 / n)))
    size = n // PARTS
    if size >= 2:
        means = [sum(values[i : i + size]) / size for i in range(0, size * PARTS, size)]
        farthest = max(abs(part - mean) for part in means)
        judged.append(("jumps by", farthest, PART_SIGMAS * sd / math.sqrt(size)))
    return judged
