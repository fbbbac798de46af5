"""Checks commands and readings against the rig's limits: set-points are clipped, readings outside the limits reported.

A finding calls for "land" (the guard lands the rig at once) or "pause" (the experiment pauses and can go on).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from drivers.chambers import ChamberMap
from drivers.errors import DeviceFault
from drivers.interfaces import GaugeSample, PressureSample, SpineSample
from recordings.ambient import AMBIENT

from ..files.rig_file import RigFile
from .pressure_envelope import PressureEnvelope

SLACK = 0.01
"""m beyond max_length that an encoder may show before the spine counts as out of control."""


class NotHeld(DeviceFault):
    """A pressure stays below its set-point: low supply, a leak or a burst chamber."""


@dataclass(frozen=True)
class Finding:
    """What is wrong and what it calls for."""

    act: Literal["land", "pause"]
    error: DeviceFault


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

    def check(self, name: str, sample: Any) -> Finding | None:
        """The first thing that is wrong with a reading."""
        if isinstance(sample, PressureSample):
            return self._pressure(name, sample)
        if isinstance(sample, GaugeSample):
            lowest = AMBIENT - self._limits.max_vacuum
            if not math.isfinite(sample.absolute) or sample.absolute < lowest:
                return _landing(
                    name,
                    f"{sample.absolute / 1e3:.1f} kPa absolute is below {lowest / 1e3:.1f} kPa, the lowest by "
                    "limits.max_vacuum; turn the supply down",
                )
        if isinstance(sample, SpineSample) and sample.homed:
            most = self._rig.instruments.spine.max_length + SLACK if self._rig.instruments.spine else math.inf
            if not -SLACK <= sample.length <= most:
                return _landing(
                    name,
                    f"length {sample.length * 1e3:.1f} mm is outside {-SLACK * 1e3:.0f} to {most * 1e3:.0f} mm; "
                    "check drum and encoder, then home it",
                )
        return None

    def _pressure(self, name: str, sample: PressureSample) -> Finding | None:
        pressure = self._rig.instruments.pressure
        if pressure is None:
            return None
        highest = pressure.max_pressure + self._limits.pressure_error
        for channel, p in enumerate(sample.measured, 1):
            if not math.isfinite(p):
                return _landing(name, f"channel {channel} measures {p} Pa; check the regulator's sensor")
            if p > highest:
                return _landing(
                    name,
                    f"channel {channel} measures {p / 1e3:.1f} kPa, limit {highest / 1e3:.1f} kPa; check the regulator",
                )
        total = sum(p * n for p, n in zip(sample.measured, self._sizes, strict=True))
        most = self._limits.max_total_pressure + self._limits.pressure_error * sum(self._sizes)
        if total > most:
            return _landing(
                name,
                f"the chambers' pressures sum to {total / 1e3:.0f} kPa, limits.max_total_pressure is "
                f"{self._limits.max_total_pressure / 1e3:.0f} kPa; check the regulators",
            )
        return self._setpoint_lost(name, sample) or self._holds(name, sample)

    def _setpoint_lost(self, name: str, sample: PressureSample) -> Finding | None:
        """Land if a regulator holds another set-point than it confirmed: it has restarted, or something else commands it too.
        While none are confirmed (a command is under way) nothing is lost."""
        known = self.setpoints_confirmed or sample.setpoint
        differing = [
            (channel, confirmed, held)
            for channel, (confirmed, held) in enumerate(zip(known, sample.setpoint, strict=True), 1)
            # Pa; regulators round the set-points that they hold
            if abs(confirmed - held) > 2e3
        ]
        twice = [found for found in differing if found[0] in self._differed]  # a single reading of a channel may be wrong
        self._differed = {channel for channel, _, _ in differing}
        if not twice:
            return None
        channel, confirmed, held = twice[0]
        return _landing(
            name,
            f"channel {channel} was set to {confirmed / 1e3:.1f} kPa but its set-point is {held / 1e3:.1f} kPa: it "
            "restarted (power failure?) or something else set it (front panel, second program); check its supply",
        )

    def _holds(self, name: str, sample: PressureSample) -> Finding | None:
        """Whether each channel follows its own set-point, whatever the others do."""
        channels = enumerate(zip(self._envelopes, sample.setpoint, sample.measured, strict=True), 1)
        deviating = [(p, asked, i) for i, (envelope, asked, p) in channels if envelope.update(sample.t, asked, p)]
        if not deviating:
            return None
        p, asked, channel = max(deviating, key=lambda found: found[0] - found[1])  # one too high calls for more
        text = (
            f"channel {channel} measures {p / 1e3:.1f} kPa instead of its set-point of {asked / 1e3:.1f} kPa for more than "
            f"{self._limits.pressure_error_time:g} s"
        )
        if p < asked:
            return Finding("pause", NotHeld(name, f"{text}; check for low supply pressure, a leak or a burst chamber"))
        return _landing(name, f"{text}; the regulator does not vent: shut off its supply")


def _landing(name: str, text: str) -> Finding:
    return Finding("land", DeviceFault(name, text))
