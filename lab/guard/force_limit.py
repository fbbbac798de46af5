"""What the force sensor's own thread tells the guard with each sample: that it came, and when the load is too much.

Before the sensor has its zero the tool's weight is not told from a load, so the change since the stream began counts, and
the raw reading against the sensor's range; afterwards the load beyond the zero, and the range.
"""

from __future__ import annotations

import math
from statistics import median

import timing
from drivers.configs import ForceConfig
from drivers.interfaces import WrenchSample

from ..files.rig_file import Limits, RigFile
from .pulse import FORCE, FORCE_RANGE, FRESH, MOMENT, MOMENT_RANGE, Pulse

NO_ZERO = (0.0,) * 6
AGREE = 2
"""Samples in a row that must be beyond the limit: one may be a knock."""
FIRST = 5
"""Samples at the stream's beginning whose median is the unloaded tool; fewer until they have come."""


class ForceLimit:
    """Judges each sample where it arrives; the guard stops the arm and lands."""

    def __init__(self, limits: Limits, sensor: ForceConfig, pulse: Pulse) -> None:
        self._limits, self._sensor, self._pulse = limits, sensor, pulse
        self._over = 0
        self._first: list[tuple[float, ...]] = []

    def begin(self) -> None:
        """A new stream begins: what it shows first is the tool's weight."""
        self._over = 0
        self._first = []

    def judge(self, sample: WrenchSample) -> None:
        """Take one sample."""
        self._pulse.send(FRESH, timing.now())
        found = self._beyond(sample)
        self._over = self._over + 1 if found else 0
        if found and self._over >= AGREE:  # as long as it lasts: what the guard lets pass at rest must not move later
            self._pulse.send(*found)

    def _beyond(self, sample: WrenchSample) -> tuple[bytes, float] | None:
        """The kind of record and the value (N or N m) beyond its limit."""
        force, moment = (max(map(abs, half)) for half in (sample.raw[:3], sample.raw[3:]))
        if force > self._sensor.max_force:
            return FORCE_RANGE, force
        if moment > self._sensor.max_moment:
            return MOMENT_RANGE, moment
        if len(self._first) < FIRST:
            self._first.append(sample.raw)
        unloaded = [median(axis) for axis in zip(*self._first, strict=True)]
        load = sample.wrench if sample.zero != NO_ZERO else [a - b for a, b in zip(sample.raw, unloaded, strict=True)]
        force, moment = math.hypot(*load[:3]), math.hypot(*load[3:])
        if force > self._limits.max_force:
            return FORCE, force
        return (MOMENT, moment) if moment > self._limits.max_moment else None


def overload(kind: bytes, value: float, rig: RigFile) -> str:
    """What a record says of the load (N or N m); empty when it is about something else."""
    sensor, limits = rig.instruments.force, rig.limits
    if kind == FORCE:
        return f"force {value:.1f} N, limits.max_force is {limits.max_force:g} N"
    if kind == MOMENT:
        return f"moment {value:.2f} N m, limits.max_moment is {limits.max_moment:g} N m"
    if kind == FORCE_RANGE and sensor is not None:
        return f"raw force {value:.1f} N, the sensor's range (max_force) is {sensor.max_force:g} N"
    if kind == MOMENT_RANGE and sensor is not None:
        return f"raw moment {value:.2f} N m, the sensor's range (max_moment) is {sensor.max_moment:g} N m"
    return ""
