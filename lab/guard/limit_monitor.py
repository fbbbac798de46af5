"""Checks commands and readings against the rig's limits: set-points are clipped, readings outside the limits reported.

The guard lands the rig at once, except for `NotHeld`: the experiment pauses and can go on.
The instruments' settings are read again when a trial begins (the regulators are vented before each, so what is energised first
after that begins one), and when a pressure jumps by a ratio of units of measure.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from drivers.chambers import ChamberMap
from drivers.errors import DeviceFault
from drivers.interfaces import GaugeSample, PressureSample, SpineSample
from recordings.ambient import AMBIENT

from ..files.rig_file import RigFile

FOLLOWS_AFTER = 1.0
"""s near its set-point after which a channel follows it again."""


class PressureEnvelope:
    """Bounds (Pa gauge) of one channel, and since when it has been away from its set-point.

    A chamber follows its set-point s as  dp/dt = (s - p) / tau'  with any tau' up to the regulator's time constant tau. Such a
    pressure stays between two bounds: the upper one jumps up with s and falls towards it with tau, the lower one falls with s
    and rises towards it with tau. A pressure outside them by more than noise does not follow its
    set-point, whatever the other set-points do.

    The time of a set-point between two readings is not known. The bounds hold the earlier reading's set-point until the later
    reading, so that a ramp with few readings is not mistaken for a jump; and assume that each set-point in between (`command`)
    may have held throughout, so that a channel which went down and up again is not mistaken for a slow one.
    """

    def __init__(self, time_constant: float, error: float, patience: float) -> None:
        """`time_constant` of the regulator (s), `error` that is tolerated (Pa), for how long (`patience`, s of `t`)."""
        self._tau, self._error, self._patience = time_constant, error, patience
        self._low = self._high = math.nan
        """Bounds at the last reading, Pa."""
        self._setpoint = self._t = math.nan
        """Of the last reading: Pa and s."""
        self._off_since = self._near_since = math.inf
        """Times s since which it has been away from its set-point, or near it."""
        self._outside = 0
        """Readings in a row outside of the bounds."""
        self._lowest, self._highest = math.inf, -math.inf
        """Range of the set-points sent since the last reading."""

    def command(self, setpoint: float) -> None:
        """A set-point (Pa) that was, or may have been, sent since the last reading."""
        self._lowest, self._highest = min(self._lowest, setpoint), max(self._highest, setpoint)

    def update(self, t: float, setpoint: float, measured: float) -> bool:
        """Take a reading at time t (s); True when the channel has been too far from its set-point for too long."""
        if math.isnan(self._t):  # the earlier set-point is not known: the pressure may still be approaching it
            self._low, self._high = min(setpoint, measured), max(setpoint, measured)
        else:
            decay = math.exp(-max(0.0, t - self._t) / self._tau)
            lowest, highest = min(self._setpoint, self._lowest), max(self._setpoint, self._highest)
            self._low = min(setpoint, lowest + min(0.0, self._low - lowest) * decay)
            self._high = max(setpoint, highest + max(0.0, self._high - highest) * decay)
        self._t, self._setpoint = t, setpoint
        self._lowest, self._highest = math.inf, -math.inf
        if abs(measured - setpoint) <= self._error:
            self._outside, self._near_since = 0, min(self._near_since, t)
            # near for a while: in a ramp the set-point merely passes a stuck channel
            if t - self._near_since >= FOLLOWS_AFTER:
                self._off_since = math.inf
            return False
        self._off_since, self._near_since = min(self._off_since, t), math.inf
        outside = not self._low - self._error <= measured <= self._high + self._error
        self._outside = self._outside + 1 if outside else 0
        # one reading may have been taken out of order
        return self._outside >= 2 and t - self._off_since >= self._patience


ROUNDED = 2e3
"""Pa by which regulators may round the set-points that they hold."""
SLACK = 0.01
"""m beyond max_length that an encoder may show before the spine counts as out of control."""


class NotHeld(DeviceFault):
    """A pressure stays below its set-point: low supply, a leak or a burst chamber."""


class LimitMonitor:
    """Limits of one rig."""

    def __init__(self, rig: RigFile) -> None:
        self._rig = rig
        self._limits = rig.limits
        pressure = rig.instruments.pressure
        self.chambers = ChamberMap(pressure.chambers if pressure is not None else ())
        self._sizes = [len(group) for group in self.chambers.channels]  # number of chambers on each channel
        lag = pressure.time_constant if pressure is not None else math.inf
        error, patience = self._limits.pressure_error, self._limits.pressure_error_time
        self._envelopes = [PressureEnvelope(lag, error, patience) for _ in self._sizes]
        self.setpoints_confirmed: tuple[float, ...] | None = None
        """Set-points that the regulators confirmed last, Pa; None while they are not known."""
        self._differed: set[int] = set()  # channels whose last reading showed another set-point than the confirmed one

    def confirmed(self, setpoints: Sequence[float]) -> None:
        """The regulators confirmed these set-points (Pa a channel)."""
        self.setpoints_confirmed = tuple(setpoints)
        self.may_have_taken(setpoints)

    def may_have_taken(self, setpoints: Sequence[float]) -> None:
        """These set-points (Pa a channel) were sent; whether each regulator took its own is not known."""
        for envelope, setpoint in zip(self._envelopes, setpoints, strict=True):
            envelope.command(setpoint)

    def vented(self) -> None:
        """Zero is being sent to all channels; this monitor does not wait for their confirmation."""
        self.setpoints_confirmed = None
        self.may_have_taken((0.0,) * len(self._envelopes))

    def setpoints(self, pressures: Sequence[float]) -> tuple[float, ...]:
        """Set-points (Pa a channel), scaled down together when their sum over the chambers is beyond the limit."""
        if len(pressures) != len(self._sizes) or not all(math.isfinite(p) for p in pressures):
            return tuple(pressures)  # the driver refuses it with a better message
        total = sum(max(0.0, p) * n for p, n in zip(pressures, self._sizes, strict=True))
        share = min(1.0, self._limits.max_total_pressure / total) if total > 0 else 1.0
        return tuple(p * share for p in pressures)

    def check(self, name: str, sample: Any) -> DeviceFault | None:
        """The first limit that a reading of the instrument `name` is beyond; None where there is none."""
        if isinstance(sample, PressureSample):
            return self._pressure(name, sample)
        if isinstance(sample, GaugeSample):
            lowest = AMBIENT - self._limits.max_vacuum
            if not math.isfinite(sample.absolute) or sample.absolute < lowest:
                return DeviceFault(
                    name,
                    f"{sample.absolute / 1e3:.1f} kPa absolute is below {lowest / 1e3:.1f} kPa, the lowest by "
                    "limits.max_vacuum; turn the supply down",
                )
        if isinstance(sample, SpineSample) and sample.homed:
            most = self._rig.instruments.spine.max_length + SLACK if self._rig.instruments.spine else math.inf
            if not -SLACK <= sample.length <= most:
                return DeviceFault(
                    name,
                    f"length {sample.length * 1e3:.1f} mm is outside {-SLACK * 1e3:.0f} to {most * 1e3:.0f} mm; "
                    "check drum and encoder, then home it",
                )
        return None

    def _pressure(self, name: str, sample: PressureSample) -> DeviceFault | None:
        """The first that is wrong: a channel, the sum over chambers, a set-point lost, a channel that does not follow its own."""
        pressure = self._rig.instruments.pressure
        if pressure is None:
            return None
        for channel, (p, limit) in enumerate(zip(sample.measured, pressure.limits, strict=True), 1):
            highest = limit + self._limits.pressure_error
            if not math.isfinite(p):
                return DeviceFault(name, f"channel {channel} measures {p} Pa; check the regulator's sensor")
            if p > highest:
                return DeviceFault(
                    name, f"channel {channel} measures {p / 1e3:.1f} kPa, limit {highest / 1e3:.1f} kPa; check the regulator"
                )
        total = sum(p * n for p, n in zip(sample.measured, self._sizes, strict=True))
        if total > self._limits.max_total_pressure + self._limits.pressure_error * sum(self._sizes):
            return DeviceFault(
                name,
                f"the chambers' pressures sum to {total / 1e3:.0f} kPa, limits.max_total_pressure is "
                f"{self._limits.max_total_pressure / 1e3:.0f} kPa; check the regulators",
            )
        return self._setpoint_lost(name, sample) or self._holds(name, sample)

    def _setpoint_lost(self, name: str, sample: PressureSample) -> DeviceFault | None:
        """Land if a regulator holds another set-point than it confirmed; while none are confirmed nothing is lost."""
        last_confirmed = self.setpoints_confirmed or sample.setpoint
        differing = [
            (channel, confirmed, held)
            for channel, (confirmed, held) in enumerate(zip(last_confirmed, sample.setpoint, strict=True), 1)
            if abs(confirmed - held) > ROUNDED
        ]
        twice = [state for state in differing if state[0] in self._differed]  # a single reading of a channel may be wrong
        self._differed = {channel for channel, _, _ in differing}
        if not twice:
            return None
        channel, confirmed, held = twice[0]
        return DeviceFault(
            name,
            f"channel {channel} was set to {confirmed / 1e3:.1f} kPa but its set-point is {held / 1e3:.1f} kPa: it "
            "restarted (power failure?) or something else set it (front panel, second program); check its supply",
        )

    def _holds(self, name: str, sample: PressureSample) -> DeviceFault | None:
        """The channel that is farthest above its set-point, else below it (NotHeld), of those that do not follow theirs."""
        channels = enumerate(zip(self._envelopes, sample.setpoint, sample.measured, strict=True), 1)
        deviating = [(p, asked, i) for i, (envelope, asked, p) in channels if envelope.update(sample.t, asked, p)]
        if not deviating:
            return None
        p, asked, channel = max(deviating, key=lambda state: state[0] - state[1])  # too high is the more dangerous
        text = (
            f"channel {channel} measures {p / 1e3:.1f} kPa instead of its set-point of {asked / 1e3:.1f} kPa for more than "
            f"{self._limits.pressure_error_time:g} s"
        )
        if p < asked:
            return NotHeld(name, f"{text}; check for low supply pressure, a leak or a burst chamber")
        return DeviceFault(name, f"{text}; the regulator does not vent: shut off its supply")


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


class DriverSettings:
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
        """Have a driver read its settings, if due and supported. Raises InstrumentError, and is then due again.

        `trial`: a trial begins with what is commanded next. Without it only a jump is looked into: a vent passes through ratios
        of units too, and what was read then says nothing of the panel when the next trial begins."""
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
