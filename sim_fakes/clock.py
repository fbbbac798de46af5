"""The fakes' time: host monotonic time multiplied by a speed factor."""

from __future__ import annotations

import time


class SimClock:
    """Rig time that runs `speed` times faster than the host; speed 1 is real time."""

    def __init__(self, speed: float = 1.0) -> None:
        if not speed > 0:
            raise ValueError(f"speed factor {speed} must be above 0")
        self.speed = speed
        self._start = time.monotonic()

    def now(self) -> float:
        """Rig time since the start, s."""
        return (time.monotonic() - self._start) * self.speed

    def sleep(self, duration: float) -> None:
        """Wait `duration` seconds of rig time."""
        time.sleep(max(0.0, duration) / self.speed)
