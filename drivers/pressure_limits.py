"""The limits of a regulator's set-points: their range, and their rate."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence

import timing
from timing import Clock

from .errors import InstrumentError, LimitExceeded

VENTED = 5e3
"""Pa; a chamber below this counts as vented."""
VENT_WAIT = 0.5
"""s of host time that a driver's `close` waits for all channels to fall below `VENTED`."""
LONGEST_CREDIT = 1.0
"""Rig seconds of pause that count for the rate limit: after a longer pause a set-point moves by one second's worth."""


def let_off(vent: Callable[[], None], measured: Callable[[], Sequence[float]]) -> None:
    """Vent, and wait shortly for the measured pressures (Pa) to fall; an error of either ends it."""
    with contextlib.suppress(InstrumentError):
        vent()
    with contextlib.suppress(InstrumentError):
        deadline = timing.now() + VENT_WAIT
        while timing.now() < deadline and max(measured()) > VENTED:
            timing.sleep(0.02)


class PressureLimits:
    """Clips set-points (Pa gauge) to 0..max_pressure, one or one a channel, and to max_rate (Pa/s of the rig's clock).

    The rate is judged on the values allowed before, not on what the instrument made of them: rounding to its steps
    would otherwise hold a slow ramp at its start for ever.
    """

    def __init__(self, name: str, channels: int, max_pressure: float | Sequence[float], max_rate: float, clock: Clock) -> None:
        self.name = name
        self.highest = (max_pressure,) * channels if isinstance(max_pressure, (int, float)) else tuple(max_pressure)
        """Pa, of each channel."""
        self.max_rate = max_rate
        self._clock = clock
        self._allowed = [0.0] * channels
        self._at = clock.now()

    def start_from(self, setpoints: Sequence[float]) -> None:
        """Take set-points (Pa) that the instrument holds as the ones from which the rate is judged."""
        self._allowed = list(setpoints)
        self._at = self._clock.now()

    def allow(self, pressures: Sequence[float]) -> tuple[float, ...]:
        """The pressures (Pa) after clipping; starts the time of the next step.

        Raises `LimitExceeded` for a wrong number of values or one that is not finite.
        """
        if len(pressures) != len(self._allowed):
            raise LimitExceeded(
                self.name, f"{len(pressures)} pressures for {len(self._allowed)} channels; give one per channel, in Pa"
            )
        for channel, pressure in enumerate(pressures):
            if not math.isfinite(pressure):
                raise LimitExceeded(
                    self.name, f"channel {channel + 1}: {pressure} Pa is not a pressure; give 0 to {self.highest[channel]:g} Pa"
                )
        now = self._clock.now()
        step = self.max_rate * min(LONGEST_CREDIT, max(0.0, now - self._at))
        self._at = now
        slow = (min(old + step, max(old - step, float(p))) for p, old in zip(pressures, self._allowed, strict=True))
        return tuple(min(most, max(0.0, p)) for p, most in zip(slow, self.highest, strict=True))

    def sent(self, channel: int, pressure: float) -> None:
        """The instrument took this value (Pa, as `allow` gave it or 0 at a vent)."""
        self._allowed[channel] = pressure
