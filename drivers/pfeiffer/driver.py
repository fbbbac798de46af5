"""Vacuum gauge at the spine: a Pfeiffer CPT 100 or RPT 100 on RS-485, by pfeiffer-vacuum-protocol.

The family's Pirani gauges hardly resolve the range of jamming, 10 kPa to ambient, and are refused.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import pfeiffer_vacuum_protocol as protocol
from pydantic import Field, model_validator

import timing
from timing import Clock

from ..configs import GaugeConfig
from ..errors import BadReply, DeviceFault, InstrumentError, NoReply, WrongDevice
from ..interfaces import GaugeSample, Identity
from ..serial_line import SerialLine, meeting, show
from ..spec import Driver

SUITABLE = ("CPT 100", "RPT 100")
HEALTH_EVERY = 20
"""Readings between two checks of the gauge's error code and correction factor."""
END, CONTROL = b"\r", b"10"
"""The end of a telegram, and the mark after the address of one that sets a parameter: its acknowledgment is the same again."""
LACKS = b"NO_DEF"
"""Answer of a gauge that has no such parameter."""
T = TypeVar("T")
Query = Callable[["_Wire", int], T]


class Config(GaugeConfig):
    """Vacuum gauge by Pfeiffer Vacuum Protocol."""

    port: str
    baud: int = Field(default=9600, ge=1200, le=115200, json_schema_extra={"unit": "Bd"})
    address: int = Field(default=1, ge=1, le=255, json_schema_extra={"unit": ""})
    lowest: float = Field(default=100.0, ge=0, le=1e5, json_schema_extra={"unit": "Pa"})
    """Absolute; lower readings are refused."""
    highest: float = Field(default=120e3, gt=0, le=1e6, json_schema_extra={"unit": "Pa"})
    """Absolute; higher readings are refused."""
    timeout: float = Field(default=0.3, gt=0, le=2, json_schema_extra={"unit": "s"})

    @model_validator(mode="after")
    def _range_is_one(self) -> Config:
        if self.lowest >= self.highest:
            raise ValueError(f"lowest {self.lowest} Pa is not below highest {self.highest} Pa; swap or correct them")
        return self


class _Wire:
    """The serial line as the library wants it: one byte at a time. Keeps the telegram that it heard."""

    def __init__(self, line: SerialLine) -> None:
        self._line = line
        self.heard = b""
        self._given = 0

    def write(self, data: bytes) -> None:
        """Send one request; an answer that came too late for the last one is dropped."""
        self.heard, self._given = b"", 0
        self._line.flush()
        self._line.write(data, repeated=data[3:5] == CONTROL)

    def read(self, count: int) -> bytes:
        """`count` bytes of the answer. Raises NoReply, BadReply when no whole one comes."""
        if not self.heard:
            self.heard = self._line.read_until(END) + END
        self._given += count
        return self.heard[self._given - count : self._given]


class PfeifferGauge:
    """Vacuum gauge; see the module's text."""

    def __init__(self, name: str, config: Config, clock: Clock) -> None:
        self.name = name
        self._config = config
        self._clock = clock
        self._line = SerialLine(name, config.port, config.baud, config.timeout, skip_echo=True)
        self._wire = _Wire(self._line)
        self._lock = timing.RLock()
        self._readings = 0

    def open(self) -> Identity:
        """Connect and check the gauge's type and health. Raises `Unreachable`, `WrongDevice` or `DeviceFault`."""
        with self._lock:
            self._line.open()
            with meeting(self.name, self._line.close, "not a supported Pfeiffer gauge"):
                return self._meet()

    def close(self) -> None:
        """Disconnect; the gauge only measures, so there is nothing to land."""
        self._line.close()

    def read(self) -> GaugeSample:
        """Poll. Raises `DeviceFault` when the gauge reports an error or the reading cannot be true."""
        with self._lock:
            absolute = 1e5 * self._query("pressure", protocol.read_pressure)
            t = self._clock.now()
            plausible = self._config.lowest <= absolute <= self._config.highest
            if not plausible or self._readings % HEALTH_EVERY == 0:
                self._check_health()
            self._readings += 1
            if not plausible:
                raise DeviceFault(
                    self.name,
                    f"reads {absolute:.6g} Pa absolute, outside of {self._config.lowest:g} to "
                    f"{self._config.highest:g} Pa; check the gauge's range and that it is connected to the spine",
                )
            return GaugeSample(t, absolute)

    def take_notices(self) -> list[str]:
        """See the module `interfaces`."""
        return self._line.take_notices()

    def _meet(self) -> Identity:
        model = self._query("gauge type", protocol.read_gauge_type)
        if model not in SUITABLE:
            raise WrongDevice(
                self.name,
                f"{model} at address {self._config.address} does not resolve pressures near ambient; use one of "
                f"{', '.join(SUITABLE)}",
            )
        version = self._query("software version", protocol.read_software_version)
        self._check_health()
        return Identity("Pfeiffer Vacuum", model, firmware=".".join(str(part) for part in version))

    def _check_health(self) -> None:
        """Raises `DeviceFault` for an error of the gauge; writes a correction factor that is not 1."""
        code = self._query("error code", protocol.read_error_code)
        if code is not protocol.ErrorCode.NO_ERROR:
            what = code.name.lower().replace("_", " ")
            raise DeviceFault(self.name, f"reports a {what}; power-cycle it, and replace it if the error persists")
        found = self._correction()
        if found is not None and found != 1.0:
            self._query("correction factor", lambda wire, address: protocol.write_correction_value(wire, address, 1.0))
            if (now := self._correction()) != 1.0:
                raise WrongDevice(
                    self.name,
                    f"correction factor (parameter 742) was {found:g}, is {now:g} and must be 1: it multiplies the pressure; "
                    "set it to 1.00, and keep other programs off the line",
                )

    def _correction(self) -> float | None:
        """The factor for other gases; None for a gauge without one."""
        try:
            return float(self._query("correction factor", protocol.read_correction_value))
        except BadReply:
            if LACKS in self._wire.heard:
                return None
            raise

    def _query(self, what: str, query: Query[T]) -> T:
        """Ask, once more after silence or noise."""
        return self._line.twice(lambda: self._ask(what, query))

    def _ask(self, what: str, query: Query[T]) -> T:
        address = self._config.address
        try:
            return query(self._wire, address)
        except (NoReply, BadReply) as e:
            raise type(e)(self.name, f"address {address}, asked for its {what}: {e.message}") from e
        except (ValueError, protocol.InvalidCharError) as e:
            if isinstance(e, InstrumentError):
                raise
            raise BadReply(
                self.name,
                f"address {address} on {self._config.port} answered {show(self._wire.heard)} to a request for its {what} ({e}); "
                "check the cable",
            ) from e


DRIVER = Driver("gauge", Config, PfeifferGauge)
