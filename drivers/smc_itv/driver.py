"""SMC ITV1050/2050/3050 electro-pneumatic regulators with RS-232C: one unit a port, no address."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from pydantic import Field, model_validator

import timing
from timing import Clock

from ..chambers import ChamberMap
from ..configs import RegulatorsConfig
from ..errors import BadReply, DeviceFault, InstrumentError, NoReply, Unreachable, WrongDevice
from ..interfaces import Identity, PressureSample
from ..pressure_limits import PressureLimits, let_off
from ..registry import Driver
from ..serial_line import SerialLine, show
from ..stop_first import StopFirst


class Config(RegulatorsConfig):
    """How to reach the units, their range, and what may be asked of them."""

    ports: tuple[str, ...] = Field(min_length=1)
    """Serial ports, in channel order."""
    chambers: tuple[tuple[int, ...], ...] = ((1,), (2,), (3,), (4,), (5,), (6,), (7,), (8,), (9,))
    """Chambers (1..9) on each channel."""
    full_scale: float = Field(
        gt=0,
        le=1e6,
        json_schema_extra={
            "unit": "Pa",
            "write": "the units cannot report it; see their label: ITV_01_ 100 kPa, ITV_03_ 500 kPa, ITV_05_ 900 kPa",
        },
    )
    """Pressure at 1023 counts; readings do not show a wrong one."""
    timeout: float = Field(0.25, ge=0.05, le=2, json_schema_extra={"unit": "s"})
    """Of an answer, host time; a failed request is repeated once."""
    poll_interval: float = Field(0.1, ge=0.0, le=5, json_schema_extra={"unit": "s"})
    """Shortest time between two polls of one unit, host time."""

    widest: ClassVar[float | None] = 900e3

    @model_validator(mode="after")
    def _fits_together(self) -> Config:
        if len(self.ports) != len(self.chambers):
            raise ValueError(f"{len(self.ports)} ports but {len(self.chambers)} lists of chambers; give one port for each list")
        if len(set(self.ports)) != len(self.ports):
            raise ValueError(f"ports {', '.join(self.ports)}: a port is listed twice")
        return self


__all__ = ["DRIVER", "Config", "SmcItv"]

BAUD = 9600
END = b"\r\n"
STEPS = 1023
"""Counts at full scale."""
OUT_OF_RANGE, UNKNOWN_COMMAND = b"OUT OF RANGE", b"UNKNOWN COMMAND"
MARK = b"WHO"
"""Not a command: answered by UNKNOWN COMMAND, and by that known from every other answer."""
QUIET = 1.2
"""Host seconds of silence on a line after which answers that are owed no longer come."""
REREAD_EVERY = 10
"""Readings between two checks that each unit still holds the set-point that it confirmed: that takes a poll of its own."""


@dataclass
class _Behind:
    """A line on which an answer was late; a mark behind the next request tells it apart, else the line is `held` until quiet."""

    held: bool = False
    sent: bytes = b""
    """The set-point that went out last while it was held."""
    last: float = 0.0
    """When the line was last used, host time."""


class SmcItv:
    """Pressure regulators (see `PressureRegulators`), one channel a port.

    Commands end in CR LF: `SET n` and `REQ` answer the set-point, `MON` the measured pressure, all as n of 0..1023 over the full
    scale: 0.98 kPa on a 1 MPa unit. The units hold their set-points when the host dies, so a rig needs a vent valve in hardware.
    """

    def __init__(self, name: str, config: Config, clock: Clock) -> None:
        self.name = name
        self.config = config
        self.channels = len(config.ports)
        self.chambers = ChamberMap(config.chambers)
        self._clock = clock
        self._lock = StopFirst(name)
        self._lines = [SerialLine(name, port, BAUD, config.timeout, lock=self._lock, skip_echo=True) for port in config.ports]
        self._limits = PressureLimits(name, self.channels, config.max_pressure, config.max_rate, clock)
        self._counts = [0] * self.channels
        self._unsure: set[int] = set()
        """Channels whose last set-point was sent and not confirmed: either may hold."""
        self._readings = 0
        self._polled_at = 0.0
        self._behind: dict[int, _Behind] = {}
        self._highest = [int(most / config.full_scale * STEPS) for most in config.limits]

    @property
    def step(self) -> float:
        """What one count is worth, Pa."""
        return self.config.full_scale / STEPS

    def connect(self) -> None:
        """Open those ports that can be opened and ask nothing: enough for `vent`, which must not wait for a dead unit;
        what else is under way gives way.

        Raises Unreachable when there is none.
        """
        with self._lock.stopping():
            failed: list[Unreachable] = []
            for channel, line in enumerate(self._lines):
                was_lost = bool(line.lost)
                try:
                    line.open()
                    if was_lost:  # what was asked before is not answered by the new port; the next answer is marked all the same
                        self._behind[channel] = _Behind()
                except Unreachable as e:
                    failed.append(e)
            if len(failed) == len(self._lines):
                raise failed[0]

    def open(self) -> Identity:
        """Connect all units; raises `Unreachable` naming silent ports, `WrongDevice` for what answers otherwise.

        The units tell neither model nor serial number: they are known by how they refuse an unknown command.
        """
        with self._lock:
            try:
                for line in self._lines:
                    line.open()
                self._recognise()
                counts = self._polled(b"REQ")
            except InstrumentError:
                self._disconnect()
                raise
            self._counts = [counts[channel] for channel in range(self.channels)]
            self._limits.start_from(self._confirmed())
        return Identity("SMC", f"ITV, {self.channels} units")

    def set(self, pressures: Sequence[float]) -> tuple[float, ...]:
        """Set all channels (Pa gauge), clipped to range and rate, in whole counts; returns the set-points confirmed.

        Raises `BadReply`, `NoReply` or `DeviceFault` for the first channel that failed; the others have been set.
        """
        with self._lock:
            self._need_open()
            allowed = self._limits.allow(pressures)
            counts = [min(round(p / self.step), most) for p, most in zip(allowed, self._highest, strict=True)]
            done, errors = self._send_setpoints(dict(enumerate(counts)))
            for channel in done:
                self._limits.sent(channel, allowed[channel])
            if errors:
                raise errors[min(errors)]
            return self._confirmed()

    def read(self) -> PressureSample:
        """Poll the measured pressures, waiting first until `poll_interval` has passed since the last poll.

        Raises WrongDevice as `confirm_settings` does.
        """
        with self._lock:
            self._readings += 1
            if self._readings % REREAD_EVERY == 0:
                self.confirm_settings()
            counts = self._polled(b"MON")
            measured = tuple(counts[channel] * self.step for channel in range(self.channels))
            return PressureSample(self._clock.now(), self._confirmed(), measured)

    def confirm_settings(self) -> None:
        """Read the set-points back: a unit reports no other setting.

        Raises WrongDevice when one is not what was confirmed: changed at the panel, by another program, or by a loss of power.
        """
        with self._lock:
            counts = self._polled(b"REQ")
            for channel, needed in enumerate(self._counts):
                if channel not in self._unsure and (held := counts[channel]) != needed:
                    raise WrongDevice(
                        self.name,
                        f"channel {channel + 1}: set-point (REQ) is {held} counts ({held * self.step / 1e3:.1f} kPa), "
                        f"{needed} ({needed * self.step / 1e3:.1f} kPa) was confirmed: its panel, another program or a loss "
                        "of power changed it; lock its keys, check its supply, then run again",
                    )

    def take_notices(self) -> list[str]:
        """See the module `interfaces`."""
        return [notice for line in self._lines for notice in line.take_notices()]

    def vent(self) -> None:
        """Set all set-points to zero, without rate limit; all other exchanges give way.

        A unit that fails is tried again, and does not keep the others. Needs no more than `connect`. Raises
        `InstrumentError` naming the ports that did not confirm zero.
        """
        with self._lock.stopping():
            if not any(line.is_open for line in self._lines):
                self._lines[0].demand_open()
            done, errors = self._send_setpoints(dict.fromkeys(range(self.channels), 0))
            for channel in done:
                self._limits.sent(channel, 0.0)
            if errors:
                ports = "; ".join(f"channel {channel + 1}: {e.message}" for channel, e in sorted(errors.items()))
                raise InstrumentError(self.name, f"did not vent {ports}. Shut off the supply and vent these by hand")

    def close(self) -> None:
        """Vent, wait shortly for the pressure to fall, disconnect."""
        with self._lock:
            if any(line.is_open for line in self._lines):
                let_off(self.vent, lambda: self.read().measured)
            self._disconnect()

    # -- opening
    def _recognise(self) -> None:
        """Raise WrongDevice for a unit that answers an unknown command otherwise than an ITV, Unreachable for silent ports."""
        answers, errors = self._ask_each(dict.fromkeys(range(self.channels), MARK))
        foreign = {channel: show(answer) for channel, answer in answers.items() if answer != UNKNOWN_COMMAND}
        foreign |= {channel: e.message for channel, e in errors.items() if isinstance(e, BadReply)}
        for channel, what in foreign.items():
            raise WrongDevice(
                self.name,
                f"the device on {self.config.ports[channel]} is not an ITV: it should answer an unknown command with "
                f"{UNKNOWN_COMMAND!r}, but gave {what}; check the port in rig.yaml",
            )
        silent = [self.config.ports[channel] for channel in errors]
        if silent:
            raise Unreachable(
                self.name, f"no answer on {', '.join(silent)} at {BAUD} Bd; check the unit's power and the RS-232C cable"
            )

    def _disconnect(self) -> None:
        for line in self._lines:
            line.close()
        self._behind.clear()

    def _need_open(self) -> None:
        for line in self._lines:
            line.demand_open()

    # -- all channels at once
    def _confirmed(self) -> tuple[float, ...]:
        return tuple(count * self.step for count in self._counts)

    def _polled(self, request: bytes) -> dict[int, int]:
        """Ask each unit for a number when `poll_interval` has passed since the last poll; raises the first error."""
        self._need_open()
        self._lock.sleep(self._polled_at + self.config.poll_interval - timing.now())
        counts, errors = self._numbers(dict.fromkeys(range(self.channels), request))
        self._polled_at = timing.now()
        if errors:
            raise errors[min(errors)]
        return counts

    def _send_setpoints(self, counts: dict[int, int]) -> tuple[list[int], dict[int, InstrumentError]]:
        """Send set-points in counts; returns the channels that confirmed and the errors of the others."""
        answers, errors = self._numbers({channel: b"SET %d" % n for channel, n in counts.items()})
        self._unsure = (self._unsure - answers.keys()) | errors.keys()
        for channel, answer in answers.items():
            count_before, self._counts[channel] = self._counts[channel], answer
            if answer != counts[channel]:
                same = " as before: it ignores the serial line, take it out of local operation" if answer == count_before else ""
                errors[channel] = DeviceFault(
                    self.name,
                    f"{self.config.ports[channel]} was set to {counts[channel] * self.step / 1e3:.2f} kPa but holds "
                    f"{answer * self.step / 1e3:.2f} kPa{same}; check its set-point limits",
                )
        return [channel for channel in answers if channel not in errors], errors

    def _numbers(self, requests: dict[int, bytes]) -> tuple[dict[int, int], dict[int, InstrumentError]]:
        """Ask for numbers 0..1023, twice where the first try fails; returns those that came and the errors, by channel."""
        numbers: dict[int, int] = {}
        errors: dict[int, InstrumentError] = {}
        for attempt in range(2):
            if attempt and errors:
                self._lock.sleep(self.config.poll_interval)
            answers, errors = self._ask_each({c: r for c, r in requests.items() if c not in numbers})
            for channel, answer in answers.items():
                self._lines[channel].quality.count(attempt > 0)
                if answer.isdigit() and int(answer) <= STEPS:
                    numbers[channel] = int(answer)
                else:
                    errors[channel] = self._refusal(channel, requests[channel], answer)
        return numbers, errors

    def _ask_each(self, requests: dict[int, bytes]) -> tuple[dict[int, bytes], dict[int, InstrumentError]]:
        """Send to all ports, then collect the answers: the units work at the same time."""
        answers: dict[int, bytes] = {}
        errors: dict[int, InstrumentError] = {}
        for channel, request in requests.items():
            try:
                self._send(channel, request)
            except InstrumentError as e:
                errors[channel] = e
        asked = sorted(requests.keys() - errors.keys())
        self._mark([channel for channel in asked if channel in self._behind])
        deadline = timing.now() + self.config.timeout
        for channel in asked:
            try:
                answers[channel] = self._answer(channel, deadline)
            except InstrumentError as e:
                errors[channel] = e
                self._behind[channel] = _Behind(held=channel in self._behind, last=timing.now())
        return answers, errors

    def _send(self, channel: int, request: bytes) -> None:
        """Send a request; NoReply while answers cannot be matched (see `_Behind`), a new set-point is sent even so."""
        line, state = self._lines[channel], self._behind.get(channel)
        if state is not None and state.held:
            now = timing.now()
            if line.read_some():
                state.last = now
            state.held = now - state.last < QUIET
            if state.held:
                if request.startswith(b"SET") and request != state.sent:
                    state.sent = request
                    line.write(request + END)
                raise NoReply(
                    self.name,
                    f"answers on {self.config.ports[channel]} are late or missing and cannot be matched to requests until it "
                    f"has been quiet for {QUIET:g} s; " + timing.busy_or("check its cable and adapter"),
                )
        line.flush()
        line.write(request + END)

    def _mark(self, channels: Sequence[int]) -> None:
        if channels:
            with contextlib.suppress(NoReply):  # given up for a stop: reading shows it
                self._lock.sleep(self.config.poll_interval)  # a unit may not take two lines at once
        for channel in channels:
            with contextlib.suppress(InstrumentError):  # reading shows it
                self._lines[channel].write(MARK + END)

    def _answer(self, channel: int, deadline: float) -> bytes:
        """The answer to the last request. Raises NoReply, BadReply."""
        line, answer = self._lines[channel], b""
        while True:
            text = line.read_until(END, max(0.01, deadline - timing.now()))
            if channel not in self._behind:
                return text
            if text == UNKNOWN_COMMAND:
                break
            answer = text
        if not answer:
            raise NoReply(self.name, f"the answer on {self.config.ports[channel]} was lost; " + timing.busy_or("check its cable"))
        del self._behind[channel]
        return answer

    def _refusal(self, channel: int, request: bytes, answer: bytes) -> BadReply:
        hint = {
            OUT_OF_RANGE: "the unit allows less than full_scale in rig.yaml",
            UNKNOWN_COMMAND: "it did not understand the request; check the cable",
        }.get(answer, f"expected a number from 0 to {STEPS}; see the unit's manual for that answer, else check cable and port")
        return BadReply(self.name, f"{self.config.ports[channel]} answers {show(request)} with {show(answer)}; {hint}")


DRIVER = Driver("pressure", Config, SmcItv)
