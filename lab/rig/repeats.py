"""Tells a gauge that has frozen from one that is at rest: a noisy gauge does not repeat itself to the last digit for long."""

from __future__ import annotations

from collections import deque
from itertools import pairwise
from statistics import fmean, stdev

LEARNED = 40
"""Latest readings before a run of equal ones that tell how noisy the gauge is there; half of them are enough."""


class Repeats:
    """Counts the equal readings in a row of one gauge."""

    def __init__(self) -> None:
        self._before: deque[float] = deque(maxlen=LEARNED)
        """Latest readings before the run of equal ones that is under way."""
        self._value, self._count = 0.0, 0
        """Of that run."""
        self._since = self._at = 0.0
        """Host times of its first and newest reading, s."""

    def take(self, value: float, at: float) -> None:
        """One reading, at host time `at` (s)."""
        if self._count and value == self._value:
            self._count += 1
        else:
            self._before.extend([self._value] * min(self._count, LEARNED))
            self._value, self._count, self._since = value, 1, at
        self._at = at

    def forget(self) -> None:
        """Start anew."""
        self._before.clear()
        self._count = 0

    @property
    def stuck(self) -> float:
        """Host seconds for which a gauge has repeated itself that scattered before; 0 for one that may be at rest."""
        # with a quarter of equal neighbours, such a run comes in one series of 10^12
        if self._count < 20 or len(self._before) < LEARNED / 2:
            return 0.0
        steps = [b - a for a, b in pairwise(self._before)]
        equal = sum(step == 0 for step in steps) / len(steps)
        turns = sum(a * b < 0 for a, b in pairwise(steps)) / (len(steps) - 1)
        near = abs(self._value - fmean(self._before)) <= 5.0 * stdev(self._before)
        # Where more than a quarter of neighbours are equal, for a noise of one digit or less, equal readings tell nothing.
        # Noise turns two thirds of the readings, a changing pressure none.
        return self._at - self._since if near and equal <= 0.25 and turns >= 1 / 3 else 0.0
