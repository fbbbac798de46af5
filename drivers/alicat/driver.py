"""Alicat PC/PCD pressure controllers: up to 26 units on one RS-485 line, each called by its letter."""

from __future__ import annotations

import contextlib
import functools
import math
import re
from collections.abc import Callable, Sequence
from typing import Literal

from pydantic import Field, model_validator

import timing
from timing import Clock

from ..chambers import PAPER_WIRING, ChamberMap
from ..configs import RegulatorsConfig
from ..errors import BadReply, DeviceFault, InstrumentError, NoReply, StaleReading, Unreachable, WrongDevice
from ..interfaces import Identity, PressureSample
from ..pressure_limits import PressureLimits, let_off
from ..registry import Driver
from ..serial_line import SerialLine, show
from .settings import WRITTEN, Measure, check_loop, check_source, put_right
from .wire import FAULT_CODES, LOCKED, ROUNDING, AlicatUnit, Readout


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
    """Range of the units, compared at `open`."""
    unit: Literal["Pa", "hPa", "kPa", "MPa", "mbar", "bar", "psi"] | None = None
    """Unit of the displays, by default kPa; required with firmware before 6v00."""
    timeout: float = Field(0.25, ge=0.05, le=2, json_schema_extra={"unit": "s"})
    """Of an answer, host time; a failed request is repeated once."""
    max_age: float = Field(1.0, gt=0, le=10, json_schema_extra={"unit": "s"})
    """Of the first unit's reading when the last one's arrives, host time."""

    @model_validator(mode="after")
    def _fits_together(self) -> Config:
        if len(self.units) != len(self.chambers):
            raise ValueError(f"{len(self.units)} units but {len(self.chambers)} lists of chambers; give one unit for each list")
        for unit in self.units:
            if not re.fullmatch("[A-Z]", unit) or self.units.count(unit) > 1:
                raise ValueError(f"units {', '.join(self.units)}: {unit!r} must be one letter A to Z, used once")
        return self


UNASKED = 0.2
"""Host seconds in which a unit in streaming mode sends by itself; by default every 50 ms."""


def find_units(name: str, line: SerialLine, units: Sequence[AlicatUnit], twice: Callable[[Callable[[], str]], str]) -> list[str]:
    """Firmware of each unit; `twice` makes a request that may be repeated.

    Raises `Unreachable` naming the silent ones, `WrongDevice` for foreign answers and for what sends unasked.
    """
    firmwares: dict[str, str] = {}
    for unit in units:
        with contextlib.suppress(NoReply):
            try:
                firmwares[unit.letter] = twice(unit.firmware)
            except BadReply as e:
                raise _foreign(name, line, unit, e) from e
    silent = [unit.letter for unit in units if unit.letter not in firmwares]
    if silent:
        answered = ", ".join(firmwares) or "none"
        raise Unreachable(
            name,
            f"no answer from unit {', '.join(silent)} on {line.port} at {line.baud} Bd (answered: {answered}); check power, "
            "cable, and the letter and baud rate in the unit's menu",
        )
    return list(firmwares.values())


def _foreign(name: str, line: SerialLine, unit: AlicatUnit, e: BadReply) -> WrongDevice:
    line.flush()
    if heard := line.listen(UNASKED):
        return WrongDevice(
            name,
            f"something on {line.port} sends {show(heard)} without being asked: a unit in streaming mode (stop it with "
            f"`@@ {unit.letter}`) or another device; check port and baud rate in rig.yaml",
        )
    return WrongDevice(
        name,
        f"the device on {line.port} at {line.baud} Bd is not Alicat unit {unit.letter} ({e.message}); check port and baud "
        "rate in rig.yaml",
    )


def pressure_controller(name: str, unit: AlicatUnit) -> tuple[str, str]:
    """Model and serial number of a unit; raises `WrongDevice` when it controls no pressure."""
    model, serial = unit.model_and_serial()
    if not re.match(r"E?PC|IVC", model):
        raise WrongDevice(
            name, f"unit {unit.letter} is a {model or 'device without a model name'}; a pressure controller (PC, PCD) is needed"
        )
    return model, serial


def version_of(firmware: str) -> tuple[int, int]:
    """Firmware as numbers; the oldest has none."""
    match = re.match(r"(\d+)v(\d+)", firmware)
    return (int(match[1]), int(match[2])) if match else (0, 0)


__all__ = ["DRIVER", "Alicat", "Config"]
JUMP_ABOVE = 3e3
"""Pa; below this a jump does not show in the noise, so that the unit of measure is asked before every set-point."""
BRISK = 0.05
"""Host seconds that a unit has for its answer in the first round of a vent: a sound one takes a few ms, and a silent one
must not keep the others inflated."""


class Alicat:
    """Pressure regulators (see `PressureRegulators`), one channel a unit.

    The units hold their set-points when the host dies, so a rig needs a vent valve in hardware.
    """

    def __init__(self, name: str, config: Config, clock: Clock) -> None:
        self.name = name
        self.config = config
        self.channels = len(config.units)
        self.chambers = ChamberMap(config.chambers)
        self._clock = clock
        self._line = SerialLine(name, config.port, config.baud, config.timeout, skip_echo=True)
        self._units = [AlicatUnit(name, self._line, letter) for letter in config.units]
        self._measures = [Measure(name, unit, config.unit, config.full_scale) for unit in self._units]
        self._versions: list[tuple[int, int]] = []
        self._doubtful: set[int] = set()
        """Channels whose unit of measure is asked again before the next reading is believed."""
        self._locked: set[int] = set()
        """Channels whose front panel is locked."""
        self._twice = self._line.twice
        self._notices: list[str] = []
        self._told: set[str] = set()
        self._limits = PressureLimits(name, self.channels, config.max_pressure, config.max_rate, clock)
        self._confirmed = [0.0] * self.channels
        self._measured = [0.0] * self.channels

    def connect(self) -> None:
        """Open the line and ask nothing, enough for `vent`; what else is on the line gives way. Raises Unreachable."""
        with self._line.lock.stopping():
            self._line.open()

    def open(self) -> Identity:
        """Connect, check each unit (it answers, controls gauge pressure in the unit of rig.yaml, obeys the line), set its
        persistent settings right, and lock its front panel."""
        self._line.open()
        try:
            firmwares = find_units(self.name, self._line, self._units, self._twice)
            self._versions = [version_of(firmware) for firmware in firmwares]
            models = [self._check(channel, firmware) for channel, firmware in enumerate(firmwares)]
            for channel, unit in enumerate(self._units):
                frame = self._twice(unit.poll)
                self._confirmed[channel], self._measured[channel] = frame.setpoint, frame.measured
            self._lock_panels()
        except InstrumentError:
            self._line.close()
            raise
        self._limits.start_from(self._confirmed)
        return Identity(
            "Alicat",
            ", ".join(dict.fromkeys(model for model, _ in models)),
            ", ".join(f"{unit.letter}:{serial}" for unit, (_, serial) in zip(self._units, models, strict=True)),
            ", ".join(dict.fromkeys(firmwares)),
        )

    def set(self, pressures: Sequence[float]) -> tuple[float, ...]:
        """Set all channels (Pa gauge), clipped to range and rate; returns the set-points the units confirmed.

        Raises `BadReply` or `DeviceFault` at the first unit that does not take its set-point; later units keep theirs.
        """
        with self._line.lock:
            self._line.demand_open()
            allowed = self._limits.allow(pressures)
            if max(allowed) > 0:
                self._refuse_wrong()
            for channel, pressure in enumerate(allowed):
                self._set_channel(channel, pressure)
                self._limits.sent(channel, pressure)
            return tuple(self._confirmed)

    def read(self) -> PressureSample:
        """Poll all units.

        Raises `DeviceFault` when one reports a status with which its pressure is not controlled, and `WrongDevice`, once,
        when one has changed its unit of measure while inflated; readings are in Pa all the same, so that a vent can be
        read back.
        """
        with self._line.lock:
            self._line.demand_open()
            wrong_before = self._wrong()
            frames, arrived = [], []
            for channel in range(self.channels):
                frames.append(self._polled(channel))
                arrived.append(timing.now())
            if max(self._confirmed) > 0 and self._wrong() != wrong_before:
                self._refuse_wrong()
            if (age := arrived[-1] - arrived[0]) > self.config.max_age:
                raise StaleReading(
                    self.name,
                    f"the reading of unit {self._units[0].letter} was {age:.2f} s old when the last one came, limit "
                    f"{self.config.max_age:g} s; raise the baud rate, or find the unit that answers late",
                )
            for unit, frame in zip(self._units, frames, strict=True):
                self._raise_fault(unit, frame)
            return PressureSample(self._clock.now(), tuple(f.setpoint for f in frames), tuple(f.measured for f in frames))

    def vent(self) -> None:
        """Set all set-points to zero without rate limit and release held valves; all other exchanges give way.

        A brisk round first, so that no silent unit keeps the others waiting; who did not confirm is asked twice again.
        Needs no more than `connect`. Raises `InstrumentError` naming the units that did not confirm zero.
        """
        with self._line.lock.stopping():
            self._line.demand_open()
            failed = dict.fromkeys(range(self.channels), "")
            self._doubtful |= set(range(self.channels)) if self._versions else set()
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
        """Vent, wait shortly for the pressure to fall, unlock the front panels, disconnect."""
        with self._line.lock:
            if not self._line.is_open:
                return
            let_off(self.vent, lambda: [unit.poll().measured for unit in self._units])
            for channel in self._locked:
                with contextlib.suppress(InstrumentError):
                    self._units[channel].unlock(min(BRISK, self.config.timeout))
            self._locked.clear()
            self._line.close()

    def confirm_settings(self) -> None:
        """Read again what a panel can change, and lock the panels again. See the module `interfaces`."""
        with self._line.lock:
            self._line.demand_open()
            for channel in range(self.channels):
                self._check_settings(channel)
            self._lock_panels()

    def take_notices(self) -> list[str]:
        """See the module `interfaces`."""
        notices, self._notices = self._notices + self._line.take_notices(), []
        return notices

    # -- opening
    def _check(self, channel: int, firmware: str) -> tuple[str, str]:
        """Model and serial number of a unit that can be used; raises `WrongDevice` naming what was found instead."""
        unit, measure = self._units[channel], self._measures[channel]
        model, serial = self._twice(lambda: pressure_controller(self.name, unit))
        measure.begin(firmware, self._versions[channel])
        self._check_settings(channel)
        return model, serial

    def _check_settings(self, channel: int) -> None:
        """Check what a unit controls, its unit of measure, range and set-point source; write the other settings."""
        unit, version, measure = self._units[channel], self._versions[channel], self._measures[channel]
        self._twice(lambda: check_loop(self.name, unit))
        self._twice(measure.ask)
        if measure.wrong:
            raise WrongDevice(self.name, measure.wrong)
        measure.check_range()
        if short := self._twice(lambda: check_source(self.name, unit, version)):
            self._notice(short)
        self._twice(lambda: put_right(self.name, unit, version, WRITTEN))

    def _lock_panels(self) -> None:
        for channel, unit in enumerate(self._units):
            try:
                locked = self._twice(unit.lock)
            except NoReply:  # firmware that ignores the command answers everything else
                self._twice(unit.poll)
                locked = False
            if locked:
                self._locked.add(channel)
            else:
                self._notice(
                    f"unit {unit.letter} does not lock its front panel (command {unit.letter}L, status {LOCKED}): nobody may "
                    "change its settings during a run"
                )

    def _notice(self, text: str) -> None:
        if text not in self._told:
            self._told.add(text)
            self._notices.append(text)

    # -- settings that change while it is open
    def _wrong(self) -> str:
        return "; ".join(measure.wrong for measure in self._measures if measure.wrong)

    def _refuse_wrong(self) -> None:
        if wrong := self._wrong():
            raise WrongDevice(self.name, wrong)

    def _polled(self, channel: int) -> Readout:
        """One reading in Pa; the unit of measure is asked first where it may have changed."""
        unit = self._units[channel]
        frame = self._twice(unit.poll)
        unlocked = channel in self._locked and LOCKED not in frame.codes
        setpoint_moved = abs(frame.setpoint - self._confirmed[channel]) > ROUNDING * unit.digit
        if channel in self._doubtful or unlocked or setpoint_moved or self._jumps(channel, frame):
            pa_before = unit.pa
            self._ask_measure(channel)
            self._doubtful.discard(channel)
            if unlocked:
                self._locked.discard(channel)
                self._lock_panels()
            if unit.pa != pa_before:
                frame = self._twice(unit.poll)
        self._measured[channel] = frame.measured
        return frame

    def _jumps(self, channel: int, frame: Readout) -> bool:
        """Whether a reading has changed as much as by another unit of measure."""
        low, high = sorted((abs(self._measured[channel]), abs(frame.measured)))
        return high > JUMP_ABOVE and high > 1.5 * low  # units of measure that could be confused lie further apart

    def _ask_measure(self, channel: int) -> None:
        measure, unit, setpoint = self._measures[channel], self._units[channel], self._confirmed[channel]
        if measure.tells or setpoint <= 0:
            self._twice(measure.ask)
            return
        self._twice(lambda: measure.try_out(setpoint))
        if not measure.wrong:
            self._twice(lambda: unit.set(setpoint))  # the share was rounded

    # -- one channel
    def _set_channel(self, channel: int, pressure: float) -> None:
        """Send one set-point (Pa) and hold the unit to it; above 0 only in a unit of measure that is known to be right."""
        unit, measure = self._units[channel], self._measures[channel]
        digit = unit.digit
        if pressure > 0:
            if measure.untried:
                self._twice(measure.try_out)
            elif measure.tells and (channel in self._doubtful or abs(self._measured[channel]) < JUMP_ABOVE):
                self._twice(measure.ask)
            self._let_off_wrong()
        # rounding to the unit's digits must not lead above the limit
        pressure = min(round(pressure / digit), math.floor(self._limits.highest[channel] / digit + 1e-6)) * digit
        frame = self._twice(lambda: unit.set(pressure))
        setpoint_before, self._confirmed[channel] = self._confirmed[channel], frame.setpoint
        if pressure > 0 and self._jumps(channel, frame):
            self._ask_measure(channel)
            self._let_off_wrong()
        self._measured[channel] = frame.measured
        if abs(frame.setpoint - pressure) > ROUNDING * digit:
            asked = f"unit {unit.letter} was set to {pressure / 1e3:.2f} kPa but holds {frame.setpoint / 1e3:.2f} kPa"
            if abs(frame.setpoint - setpoint_before) <= ROUNDING * digit:
                raise DeviceFault(self.name, f"{asked} as before: it ignores the serial line; set its set-point source to serial")
            raise BadReply(self.name, f"{asked}: it was clamped or misread; check its set-point limits and the cable")
        self._raise_fault(unit, frame)

    def _let_off_wrong(self) -> None:
        """Let units off whose unit of measure is wrong: zero is zero in each. Raises WrongDevice when there are any."""
        for channel, measure in enumerate(self._measures):
            if measure.wrong:
                self._twice(functools.partial(self._units[channel].set, 0.0))
                self._confirmed[channel] = 0.0
        self._refuse_wrong()

    def _vent_channel(self, channel: int, timeout: float) -> None:
        """Set-point 0 on one unit, read back, valves released. One try; `timeout` for the first answer, s of host time."""
        unit = self._units[channel]
        frame = unit.set(0.0, timeout)
        if {"HLD", "EXH"} & set(frame.codes):
            frame = unit.cancel_hold()
        if frame.setpoint != 0:
            raise DeviceFault(self.name, f"set-point still {frame.setpoint / 1e3:.2f} kPa")
        self._confirmed[channel] = 0.0
        self._limits.sent(channel, 0.0)

    def _raise_fault(self, unit: AlicatUnit, frame: Readout) -> None:
        for code in frame.codes:
            if code in FAULT_CODES:
                raise DeviceFault(
                    self.name, f"unit {unit.letter} reports {code} at {frame.measured / 1e3:.2f} kPa: {FAULT_CODES[code]}"
                )


DRIVER = Driver("pressure", Config, Alicat)
