"""Driver of the PR-4."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

from pydantic import Field

from drivers.configs import Framing, RegulatorsConfig
from drivers.errors import BadReply, DeviceFault, InstrumentError, NoReply, NotReady, Unreachable, WrongDevice
from drivers.interfaces import Identity, PressureSample
from drivers.pressure_limits import PressureLimits
from drivers.registry import Driver
from drivers.serial_line import SerialLine, show
from timing import Clock

from . import BAUD, COUNT


class Config(RegulatorsConfig):
    """How the box is reached, and how many channels it has; the rest every regulator has."""

    chambers: tuple[tuple[int, ...], ...] = Field(max_length=4)
    port: str
    full_scale: float = Field(500e3, gt=0, le=500e3, json_schema_extra={"unit": "Pa"})
    timeout: float = Field(0.25, ge=0.05, le=2, json_schema_extra={"unit": "s"})
    settle: float = Field(0.0, ge=0, le=10, json_schema_extra={"unit": "s"})
    """How long a board is deaf that resets when its port opens, such as an Arduino Uno: 2 s."""
    framing: Framing = "8N1"


class Pr4:
    """Pressure regulators (see `drivers.interfaces.PressureRegulators`)."""

    def __init__(self, name: str, config: Config, clock: Clock) -> None:
        self.name, self.channels = name, len(config.chambers)
        self._port, self._clock = config.port, clock
        self._line = SerialLine(name, config.port, BAUD, config.timeout, settle=config.settle, framing=config.framing)
        self._limits = PressureLimits(name, self.channels, config.max_pressure, config.max_rate, clock)
        self._held = (0.0,) * self.channels

    def connect(self) -> None:
        """Open the line and ask nothing: enough for `vent`."""
        with self._line.lock.stopping():
            self._line.open()

    def open(self) -> Identity:
        """Connect and look who answers."""
        self._line.open()
        try:
            maker, serial, firmware = self._identity()
            self._held = self._numbers(b"SP?", b"SP ")
        except NoReply as e:
            self._line.close()
            raise Unreachable(self.name, e.message) from e
        except InstrumentError:
            self._line.close()
            raise
        self._limits.start_from(self._held)
        return Identity("Bench", maker, serial, firmware)

    def set(self, pressures: Sequence[float]) -> tuple[float, ...]:
        """Set all channels, clipped to range and rate."""
        with self._line.lock:
            self._need_open()
            allowed = self._limits.allow(pressures)
            self._send(allowed)
            for channel, pressure in enumerate(allowed):
                self._limits.sent(channel, pressure)
            return self._held

    def read(self) -> PressureSample:
        """Poll all channels."""
        with self._line.lock:
            self._need_open()
            measured = self._numbers(b"PV?", b"PV ")
            return PressureSample(self._clock.now(), self._held, measured)

    def vent(self) -> None:
        """All set-points to zero, at once; what else is under way gives way."""
        with self._line.lock.stopping():
            self._need_open()
            self._send((0.0,) * self.channels)
            self._limits.start_from(self._held)

    def close(self) -> None:
        """Vent and disconnect."""
        if self._line.is_open:
            with contextlib.suppress(InstrumentError):
                self.vent()
        self._line.close()

    def _need_open(self) -> None:
        if not self._line.is_open:
            raise NotReady(self.name, "is not open; call open() first")

    def _identity(self) -> tuple[str, str, str]:
        answer = self._line.ask(b"ID?\n", b"\n")
        parts = answer.decode("ascii", "replace").split(",")
        if len(parts) != 3 or parts[0] != "PR4":
            raise WrongDevice(self.name, f"the device on {self._port} is not a PR-4: it answered {show(answer)}; check the port")
        return parts[0], parts[1], parts[2]

    def _send(self, pressures: Sequence[float]) -> None:
        counts = [int(p / COUNT) for p in pressures]
        self._held = self._numbers(b"SP " + ",".join(map(str, counts)).encode(), b"SP ")
        if any(held != count * COUNT for held, count in zip(self._held, counts, strict=True)):
            raise DeviceFault(self.name, f"was set to {counts} x {COUNT:g} Pa but holds {self._held} Pa")

    def _numbers(self, request: bytes, head: bytes) -> tuple[float, ...]:
        """Ask, once more where the first answer fails."""
        try:
            return self._parsed(self._line.ask(request + b"\n", b"\n"), head)
        except (NoReply, BadReply):
            return self._parsed(self._line.ask(request + b"\n", b"\n"), head)

    def _parsed(self, answer: bytes, head: bytes) -> tuple[float, ...]:
        parts = answer.removeprefix(head).split(b",")
        if not answer.startswith(head) or len(parts) != self.channels or not all(p.isdigit() for p in parts):
            raise BadReply(self.name, f"{self._port} answers {show(answer)}, expected {self.channels} numbers; check the cable")
        return tuple(int(p) * COUNT for p in parts)


DRIVER = Driver("pressure", Config, Pr4)
