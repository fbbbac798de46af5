"""The rig's time: host monotonic time, multiplied by a speed factor when the whole rig runs faster than real."""

from __future__ import annotations

import time


class RigClock:
    """Seconds of the rig since `start` (a value of time.monotonic(), the same in every process of the host)."""

    def __init__(self, speed: float = 1.0, start: float | None = None) -> None:
        self.speed = speed
        self.start = time.monotonic() if start is None else start

    def now(self) -> float:
        """Rig time, s."""
        return (time.monotonic() - self.start) * self.speed

    def sleep(self, duration: float) -> None:
        """Wait `duration` seconds of rig time."""
        time.sleep(max(0.0, duration) / self.speed)
