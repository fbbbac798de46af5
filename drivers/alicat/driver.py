"""Alicat PC/PCD pressure controllers: up to 26 units on one RS-485 line, each called by its letter.

The units hold their set-points: nothing expires when the host dies, so a rig needs a vent valve in hardware as well.
"""

from __future__ import annotations

import contextlib
import math
import re
import time
from collections.abc import Callable, Sequence
from typing import Literal, TypeVar

from pydantic import Field, model_validator

from ..chambers import PAPER_WIRING, ChamberMap
from ..configs import RegulatorsConfig
from ..errors import BadReply, DeviceFault, InstrumentError, NoReply, StaleReading, Unreachable, WrongDevice
from ..interfaces import Clock, Identity, PressureSample
from ..pressure_limits import PressureLimits
from ..serial_line import SerialLine
from ..spec import Driver
from .wire import COUNTS, FAULT_CODES, UNITS, AlicatUnit, Frame

T = TypeVar("T")
GAUGE_PRESSURE, GAUGE_SETPOINT = 6, 38
"""Alicat's numbers for the gauge pressure reading and for the loop that controls it."""
KNOWS_FULL_SCALE = (6, 0)
KNOWS_SETPOINT_SOURCE = (10, 5)
"""First firmware that answers FPF, and LSS."""
TRIAL_COUNTS = 160
"""Set-point with which a unit that does not tell its unit of measure is tried, of 64000: 5 kPa on a unit of 2 MPa, the widest
that rig.yaml takes, and less on any other."""
TRIAL_SHARE = 0.25
"""By which what it shows may differ from what rig.yaml makes of that: nominal ranges are rounded, units lie further apart."""
SERIAL = "S"
SOURCES = {SERIAL: "the serial line", "A": "its analog input", "U": "its front panel"}
VENTED = 5e3
"""Pa; `close` waits for all channels to fall below this,"""
BRISK = 0.05
"""Host seconds that a unit has for its answer in the first round of a vent: a sound one takes a few ms, and a silent one
must not keep the others inflated."""
VENT_WAIT = 0.5
"""but not longer than this, s of host time."""


class Config(RegulatorsConfig):
    """How to reach the units, their range, and what may be asked of them."""

    port: str
    """Serial port of the RS-485 adapter."""
    baud: Literal[19200, 38400, 57600, 115200] = Field(115200, json_schema_extra={"unit": "Bd"})
    units: tuple[str, ...] = ("A", "B", "C")
    """Unit letters, in channel order."""
    chambers: tuple[tuple[int, ...], ...] = PAPER_WIRING
    """Chambers (1..9) on each channel."""
    full_scale: float = Field(400e3, gt=0, le=2e6, json_schema_extra={"unit": "Pa"})
    """Range of the units; `open` compares it with what they say."""
    unit: Literal["Pa", "hPa", "kPa", "MPa", "mbar", "bar", "psi"] | None = None
    """What the units' displays show. When not given, kPa is needed; firmware before 6v00 does not tell, so then it must be."""
    timeout: float = Field(0.25, ge=0.05, le=2, json_schema_extra={"unit": "s"})
    """How long a unit may take to answer, host time; a failed request is repeated once."""
    max_age: float = Field(1.0, gt=0, le=10, json_schema_extra={"unit": "s"})
    """How old the first unit's reading may be when the last one's arrives, host time."""

    @model_validator(mode="after")
    def _fits_together(self) -> Config:
        ChamberMap(self.chambers)
        if len(self.units) != len(self.chambers):
            raise ValueError(
                f"{len(self.units)} units but {len(self.chambers)} lists of chambers; give one unit for each list"
            )
        for unit in self.units:
            if not re.fullmatch("[A-Z]", unit) or self.units.count(unit) > 1:
                raise ValueError(f"units {', '.join(self.units)}: {unit!r} must be one letter A to Z, used once")
        if self.max_pressure > self.full_scale:
            raise ValueError(
                f"max_pressure {self.max_pressure:g} Pa is above the units' full_scale {self.full_scale:g} Pa; lower it"
            )
        return self


class Alicat:
    """Pressure regulators (see `PressureRegulators`), one channel a unit."""

    def __init__(self, name: str, config: Config, clock: Clock) -> None:
        self.name = name
        self.config = config
        self.channels = len(config.units)
        self.chambers = ChamberMap(config.chambers)
        self._clock = clock
        self._line = SerialLine(name, config.port, config.baud, config.timeout)
        self._unit = config.unit or "kPa"
        self._pa = UNITS[self._unit][1]
        self._units = [AlicatUnit(name, self._line, letter, self._pa) for letter in config.units]
        self._untried: set[int] = set()
        """Channels whose unit of measure was only read from rig.yaml."""
        self._limits = PressureLimits(name, self.channels, config.max_pressure, config.max_rate, clock)
        self._confirmed = [0.0] * self.channels
        self._decimals = [0] * self.channels

    def connect(self) -> None:
        """Open the line and ask nothing: enough for `vent`, which must not wait for a unit that is dead; what else is on the
        line gives way. Raises Unreachable."""
        with self._line.lock.stopping():
            self._line.open()

    def open(self) -> Identity:
        """Connect and check each unit: that it answers, controls gauge pressure in the unit of rig.yaml, and obeys the line."""
        self._line.open()
        try:
            firmwares = self._find_units()
            about = [self._check(unit, firmware) for unit, firmware in zip(self._units, firmwares, strict=True)]
            for channel, unit in enumerate(self._units):
                frame = self._twice(unit.poll)
                self._confirmed[channel], self._decimals[channel] = frame.setpoint, frame.decimals
        except InstrumentError:
            self._line.close()
            raise
        self._limits.start_from(self._confirmed)
        return Identity(
            "Alicat",
            ", ".join(dict.fromkeys(model for model, _ in about)),
            ", ".join(f"{unit.letter}:{serial}" for unit, (_, serial) in zip(self._units, about, strict=True)),
            ", ".join(dict.fromkeys(firmwares)),
        )

    def set(self, pressures: Sequence[float]) -> tuple[float, ...]:
        """Set all channels (Pa gauge), clipped to range and rate; returns the set-points the units confirmed.

        Raises `BadReply` or `DeviceFault` at the first unit that does not take its set-point; later units keep theirs.
        """
        with self._line.lock:
            self._need_open()
            for channel, pressure in enumerate(self._limits.allow(pressures)):
                self._set_channel(channel, pressure)
                self._limits.sent(channel, pressure)
            return tuple(self._confirmed)

    def read(self) -> PressureSample:
        """Poll all units; raises `DeviceFault` when one reports a status with which its pressure is not controlled."""
        with self._line.lock:
            self._need_open()
            frames, arrived = [], []
            for unit in self._units:
                frames.append(self._twice(unit.poll))
                arrived.append(time.monotonic())
            if (age := arrived[-1] - arrived[0]) > self.config.max_age:
                raise StaleReading(
                    self.name,
                    f"the reading of unit {self._units[0].letter} was {age:.2f} s old when the last one came, limit "
                    f"{self.config.max_age:g} s; raise the baud rate, or find the unit that answers late",
                )
            for unit, frame in zip(self._units, frames, strict=True):
                self._raise_fault(unit, frame)
            return PressureSample(
                self._clock.now(), tuple(f.setpoint for f in frames), tuple(f.measured for f in frames)
            )

    def vent(self) -> None:
        """All set-points to zero, not rate-limited, held valves released; whatever else is on the line gives way.

        A brisk round first, so that no silent unit keeps the others waiting; who did not confirm is asked twice again.
        Needs no more than `connect`. Raises `InstrumentError` naming the units that did not confirm zero.
        """
        with self._line.lock.stopping():
            self._need_open()
            failed = dict.fromkeys(range(self.channels), "")
            for patience in (min(BRISK, self.config.timeout), self.config.timeout, self.config.timeout):
                for channel in list(failed):
                    try:
                        self._vent_channel(channel, patience)
                    except InstrumentError as e:
                        failed[channel] = e.message
                    else:
                        del failed[channel]
                if not failed:
                    return
                if patience < self.config.timeout:
                    self._line.listen(self.config.timeout)  # a late answer must not be taken for the next unit's
            units = "; ".join(f"{self._units[channel].letter}: {why}" for channel, why in failed.items())
            raise InstrumentError(self.name, f"did not vent {units}. Shut off the supply and vent these by hand")

    def close(self) -> None:
        """Vent, wait shortly for the pressure to fall, disconnect."""
        with self._line.lock:
            if not self._line.is_open:
                return
            with contextlib.suppress(InstrumentError):
                self.vent()
            with contextlib.suppress(InstrumentError):
                deadline = time.monotonic() + VENT_WAIT
                while time.monotonic() < deadline and any(unit.poll().measured > VENTED for unit in self._units):
                    time.sleep(0.02)
            self._line.close()

    # -- opening
    def _find_units(self) -> list[str]:
        """Firmware of each unit; raises `Unreachable` naming the silent ones, `WrongDevice` for foreign answers."""
        firmwares: dict[str, str] = {}
        for unit in self._units:
            with contextlib.suppress(NoReply):
                try:
                    firmwares[unit.letter] = self._twice(unit.firmware)
                except BadReply as e:
                    raise WrongDevice(
                        self.name,
                        f"the device on {self.config.port} at {self.config.baud} Bd is not Alicat unit {unit.letter} "
                        f"({e.message}); check port and baud rate in rig.yaml",
                    ) from e
        silent = [unit.letter for unit in self._units if unit.letter not in firmwares]
        if silent:
            answered = ", ".join(firmwares) or "none"
            raise Unreachable(
                self.name,
                f"no answer from unit {', '.join(silent)} on {self.config.port} at {self.config.baud} Bd (answered: "
                f"{answered}); check power, cable, and the letter and baud rate in the unit's menu",
            )
        return list(firmwares.values())

    def _check(self, unit: AlicatUnit, firmware: str) -> tuple[str, str]:
        """Model and serial number of a unit that can be used; raises `WrongDevice` naming what was found instead."""

        def wrong(found: str, do: str) -> WrongDevice:
            return WrongDevice(self.name, f"unit {unit.letter} {found}; {do}")

        model, serial = self._twice(unit.model_and_serial)
        if not re.match(r"E?PC|IVC", model):
            raise wrong(f"is a {model or 'device without a model name'}", "a pressure controller (PC, PCD) is needed")
        loop = self._twice(unit.loop_variable)
        if loop != GAUGE_SETPOINT:
            raise wrong(
                f"controls variable {loop}, not gauge pressure ({GAUGE_SETPOINT})",
                "choose gauge pressure as its control variable",
            )
        match = re.match(r"(\d+)v(\d+)", firmware)
        version = (int(match[1]), int(match[2])) if match else (0, 0)
        if version >= KNOWS_FULL_SCALE:
            value, code, unit_name = self._twice(lambda: unit.full_scale(GAUGE_PRESSURE))
            if code != UNITS[self._unit][0]:
                raise wrong(
                    f"shows {unit_name or 'unit of measure'} (code {code})",
                    f"set its pressure unit to {self._unit}, or write in rig.yaml which `unit` it shows",
                )
            if not math.isclose(value * self._pa, self.config.full_scale, rel_tol=1e-3):
                raise wrong(
                    f"has a full scale of {value * self._pa / 1e3:g} kPa, rig.yaml says {self.config.full_scale / 1e3:g} kPa",
                    "correct full_scale in rig.yaml, or fit the right unit",
                )
        else:
            if self.config.unit is None:
                raise wrong(
                    f"has firmware {firmware}, which does not report its unit of measure",
                    f"write what its display shows in rig.yaml: instruments.{self.name}.unit: one of {', '.join(UNITS)}",
                )
            self._untried.add(self._units.index(unit))
        if version >= KNOWS_SETPOINT_SOURCE and (source := self._twice(unit.setpoint_source)) != SERIAL:
            raise wrong(
                f"takes its set-point from {SOURCES.get(source, source)}",
                "set its set-point source to serial",
            )
        return model, serial

    # -- one channel
    def _set_channel(self, channel: int, pressure: float) -> None:
        """Send one set-point (Pa) and hold the unit to it."""
        unit, decimals = self._units[channel], self._decimals[channel]
        digit = self._pa * 10.0**-decimals
        if channel in self._untried and pressure > 0:
            self._try_unit(channel, digit)
        # rounding to the unit's digits must not lead above the limit
        pressure = min(round(pressure / digit), math.floor(self.config.max_pressure / digit + 1e-6)) * digit
        frame = self._twice(lambda: unit.set(pressure, decimals))
        before, self._confirmed[channel] = self._confirmed[channel], frame.setpoint
        if abs(frame.setpoint - pressure) > 0.6 * digit:
            asked = f"unit {unit.letter} was set to {pressure / 1e3:.2f} kPa but holds {frame.setpoint / 1e3:.2f} kPa"
            if abs(frame.setpoint - before) <= 0.6 * digit:
                raise DeviceFault(
                    self.name, f"{asked} as before: it ignores the serial line; set its set-point source to serial"
                )
            raise BadReply(self.name, f"{asked}: it was clamped or misread; check its set-point limits and the cable")
        self._raise_fault(unit, frame)

    def _try_unit(self, channel: int, digit: float) -> None:
        """Before the first pressure: a small set-point sent as a share of the full scale shows what the display counts in.

        Raises WrongDevice when that is not what rig.yaml says; the unit is let off again.
        """
        unit = self._units[channel]
        frame = self._twice(lambda: unit.set_share(TRIAL_COUNTS))
        wanted = TRIAL_COUNTS / COUNTS * self.config.full_scale
        if abs(frame.setpoint - wanted) <= max(TRIAL_SHARE * wanted, 0.6 * digit):
            self._untried.discard(channel)
            return
        self._twice(lambda: unit.set(0.0, self._decimals[channel]))
        shown = frame.setpoint / self._pa
        fits = [name for name, (_, pa) in UNITS.items() if abs(shown * pa - wanted) <= TRIAL_SHARE * wanted]
        raise WrongDevice(
            self.name,
            f"unit {unit.letter} shows {shown:g} for {wanted / self._pa:.4g} {self._unit}, sent as a share of its range: it "
            f"does not show {self._unit}{f' but {fits[0]}' if fits else ''}, or its range is not "
            f"{self.config.full_scale / 1e3:g} kPa; correct unit or full_scale in rig.yaml. Nothing else was set",
        )

    def _vent_channel(self, channel: int, timeout: float) -> None:
        """Set-point 0 on one unit, read back, valves released. One try; `timeout` for the first answer, s of host time."""
        unit = self._units[channel]
        frame = unit.set(0.0, self._decimals[channel], timeout)
        if {"HLD", "EXH"} & set(frame.codes):
            frame = unit.cancel_hold()
        if frame.setpoint != 0:
            raise DeviceFault(self.name, f"set-point still {frame.setpoint / 1e3:.2f} kPa")
        self._confirmed[channel] = 0.0
        self._limits.sent(channel, 0.0)

    def _raise_fault(self, unit: AlicatUnit, frame: Frame) -> None:
        for code in frame.codes:
            if code in FAULT_CODES:
                raise DeviceFault(
                    self.name,
                    f"unit {unit.letter} reports {code} at {frame.measured / 1e3:.2f} kPa: {FAULT_CODES[code]}",
                )

    # -- the line
    def _twice(self, request: Callable[[], T]) -> T:
        """Every request can be repeated without harm, and is, once, after a disturbed line."""
        try:
            return request()
        except (NoReply, BadReply):
            self._line.listen(self.config.timeout)  # an answer that is only late must not be taken for the next one's
            return request()

    def _need_open(self) -> None:
        if not self._line.is_open:
            raise self._line.watch.not_open()


DRIVER = Driver("pressure", Config, Alicat)
