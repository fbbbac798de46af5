"""Judging from position and current whether a motor pushes without moving."""

from __future__ import annotations


class StallWatch:
    """A motor is stalled when it pushed with nearly all it may while it stayed in place for `duration` seconds."""

    SHARE = 0.8
    """Share of the allowed current that counts as pushing with all it may."""
    READINGS = 3
    """Readings that must agree, so that one late reading is not taken for a long stall."""

    def __init__(self, allowed: float, window: float, duration: float) -> None:
        """`allowed` current and `window` (how far a standing motor may creep) in units of `update`; `duration` in s."""
        self._threshold = self.SHARE * allowed
        self._window = window
        self._duration = duration
        self._anchor = 0.0
        self._since = 0.0
        self._readings = 0

    def update(self, t: float, position: float, current: float) -> bool:
        """Take one reading at time t (s); True once the motor is stalled."""
        if abs(current) < self._threshold or self._readings == 0 or abs(position - self._anchor) > self._window:
            self._anchor, self._since = position, t
            self._readings = 1 if abs(current) >= self._threshold else 0
            return False
        self._readings += 1
        return self._readings >= self.READINGS and t - self._since >= self._duration
