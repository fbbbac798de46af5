"""A noisy made-up run: a robot that is inflated, creeps to rest, and is looked at by streams of different rates."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

Message = tuple[str, float, tuple[object, ...]]
SIGNS = (-1, 1)
TARGETS = (80e3, 80e3, 80e3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Run:
    """Pressure ramps for `ramp` s to TARGETS, the tip follows with time constant `lag` (s); noise is gaussian."""

    seed: int = 1
    duration: float = 12.0
    ramp: float = 3.0
    lag: float = 0.8
    hidden: tuple[float, float] = (0.0, 0.0)
    dropout: float = 0.0

    def messages(self) -> Iterator[Message]:
        """All messages in the order in which they arrive."""
        random = np.random.default_rng(self.seed)
        out: list[Message] = []
        for topic, rate in (
            ("/pressure", 10),
            ("/tip", 100),
            ("/spine", 10),
            ("/vacuum", 5),
            ("/force", 100),
            ("/arm", 125),
        ):
            stamps = np.arange(0.01, self.duration, 1 / rate)
            stamps += random.uniform(0, 0.3 / rate, len(stamps))
            for k, t in enumerate(stamps.tolist()):
                out.append((topic, t, self._values(topic, k, t, random)))
        return iter(sorted(out, key=lambda message: message[1]))

    def level(self, t: float) -> float:
        """Share of the target pressures."""
        return min(1.0, t / self.ramp)

    def tip(self, t: float) -> tuple[float, float, float]:
        """True tip position, m."""
        x = 0.1 * (self.level(t) if t < self.ramp else 1.0) * (1 - math.exp(-t / self.lag))
        return (x, 0.0, 0.4 - x * x)

    def _values(self, topic: str, k: int, t: float, random: np.random.Generator) -> tuple[object, ...]:
        if topic == "/pressure":
            asked = tuple(self.level(t) * p for p in TARGETS)
            return (asked, tuple(p + random.normal(0, 100) for p in asked))
        if topic == "/tip":
            seen = not (self.hidden[0] <= t <= self.hidden[1]) and random.random() >= self.dropout
            place = tuple(c + random.normal(0, 0.3e-3) for c in self.tip(t))
            turn = np.array([1.0, 0.0, 0.3 * self.level(t), 0.0]) + random.normal(0, 1e-3, 4)
            turn = tuple((turn / math.sqrt(turn @ turn) * SIGNS[random.integers(2)]).tolist())
            markers = ((0.0, 0.0, 0.1), (math.nan,) * 3 if k % 7 == 0 else (0.01, 0.0, 0.2))
            return (t, k, place, turn, 1e-4, bool(seen), markers)
        if topic == "/spine":
            return (0.2 + random.normal(0, 1e-5), 0.0, 0.2, False, True)
        if topic == "/vacuum":
            return (21e3 + random.normal(0, 50),)
        if topic == "/force":
            return (tuple(random.normal(0, 0.05, 6) + [0.0, 0.0, 2.5, 0.0, 0.0, 0.0]), (0.0, 0.0, 0.5, 0.0, 0.0, 0.0))
        pose = (0.4, 0.1, 0.305 + random.normal(0, 1e-5), math.pi * SIGNS[random.integers(2)], 0.0, 0.0)
        return (t, (0.0,) * 6, pose, (0.0,) * 6, 1, True)
