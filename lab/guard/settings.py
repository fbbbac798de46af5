"""When the instruments' settings are read again, and how a jump by a ratio of units of measure shows.

The regulators are vented before each trial, so what is energised for the first time after that begins a trial.
"""

from __future__ import annotations

from typing import Any

from drivers.interfaces import PressureSample

PA = (1.0, 98.0665, 100.0, 133.322, 249.089, 1e3, 3386.39, 6894.757, 98_066.5, 1e5, 101_325.0, 1e6)
"""Pa in the units of measure that panels offer: Pa, cmH2O, mbar, torr, inH2O, kPa, inHg, psi, kg/cm2, bar, atm, MPa."""
# smaller ratios (bar to atm) are no danger, and a pressure that is ramped passes through them
RATIOS = tuple(sorted(a / b for a in PA for b in PA if a / b > 1.5))


def jumps(before: PressureSample, now: PressureSample) -> int:
    """The first channel (from 1) whose pressure jumped by a ratio of units of measure; 0 for none."""
    for channel, pair in enumerate(zip(before.measured, now.measured, strict=True), 1):
        low, high = sorted(map(abs, pair))
        # Pa; below, noise would jump by any ratio. 5 %: noise, and what the pressure did between two readings
        if high > 3e3 and any(abs(high - ratio * low) <= 0.05 * high for ratio in RATIOS):
            return channel
    return 0


class Settings:
    """Which drivers have settings that can change, and which of them are due to be read again."""

    def __init__(self, drivers: dict[str, Any]) -> None:
        self._drivers = drivers
        self._due = set(drivers)
        self._before: PressureSample | None = None
        self._jumped: set[str] = set()
        """Those of whose pressures one has jumped, until they are confirmed."""

    def vented(self) -> None:
        """The regulators are being vented: what is energised next begins a trial."""
        self._due = set(self._drivers)

    def confirm(self, name: str, trial: bool) -> None:
        """Have a driver read its settings, if that is due and it can. Raises InstrumentError, and is then due again.

        `trial`: a trial begins with what is commanded next. Without it only a jump is looked into: a vent passes through ratios
        of units too, and what was read then says nothing of the panel when the next trial begins.
        """
        if name in self._jumped or (trial and name in self._due):
            if (confirm := getattr(self._drivers[name], "confirm_settings", None)) is not None:
                confirm()
            self._jumped.discard(name)
            if trial:
                self._due.discard(name)

    def may_have_changed(self, name: str, sample: Any) -> bool:
        """True when a pressure has jumped by a ratio of units of measure since the reading before, until it is confirmed."""
        if not isinstance(sample, PressureSample):
            return False
        before, self._before = self._before, sample
        if before is not None and len(before.measured) == len(sample.measured) and jumps(before, sample):
            self._jumped.add(name)
        return name in self._jumped
