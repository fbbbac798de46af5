"""Vacuum gauge at the spine: a Pfeiffer CPT 100 or RPT 100 on RS-485, by pfeiffer-vacuum-protocol.

The family's Pirani gauges hardly resolve the range of jamming, 10 kPa to ambient, and are refused.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TypeVar

import pfeiffer_vacuum_protocol as protocol
from pydantic import Field, model_validator

import timing
from timing import Clock

from ..configs import GaugeConfig
from ..errors import BadReply, DeviceFault, InstrumentError, NoReply, Refused, WrongDevice
from ..interfaces import GaugeSample, Identity
from ..registry import Driver
from ..serial_line import SerialLine, meeting, show

SUITABLE = ("CPT 100", "RPT 100")
HEALTH_EVERY = 20
"""Readings between two checks of the gauge's error code and correction factor."""
END, CONTROL = b"\r", b"10"
"""The end of a telegram, and the mark after the address of one that sets a parameter: its acknowledgment is the same again."""
LACKS = "NO_DEF"
"""Answer of a gauge that has no such parameter."""
REFUSALS = {LACKS: "it has no such parameter", "_RANGE": "the value is out of its range", "_LOGIC": "it does not allow that now"}
WARNING = "Wrn"
"""How the error code of a gauge begins that warns and goes on measuring."""
ERROR_CODE = 303
"""Parameter."""
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
        self._request = b""

    def write(self, data: bytes) -> None:
        """Send one request; an answer that came too late for the last one is dropped."""
        self.heard, self._given, self._request = b"", 0, data
        self._line.flush()
        self._line.write(data, repeated=data[3:5] == CONTROL)

    def read(self, count: int) -> bytes:
        """`count` bytes of the answer. Raises NoReply, BadReply when no whole one comes."""
        if not self.heard:
            self.heard = self._line.read_until(END) + END
        self._given += count
        return self.heard[self._given - count : self._given]

    def telegram(self) -> tuple[int, str] | None:
        """Address and data of what was heard; None when its checksum is wrong, or when it answers another request."""
        match = re.fullmatch(r"(\d{3})\d\d(\d{3})\d\d(.*)(\d{3})\r", self.heard.decode("ascii", "replace"))
        if match is None or sum(self.heard[:-4]) % 256 != int(match[4]) or match[2].encode() != self._request[5:8]:
            return None
        return int(match[1]), match[3]


def _error_code(wire: _Wire, address: int) -> str:
    """The gauge's error code, empty where it reports none. Raises what the library raises for a damaged answer."""
    try:
        code = protocol.read_error_code(wire, address)
    except ValueError:
        sender, data = wire.telegram() or (0, "")
        if sender != address or data in REFUSALS:
            raise
        return data
    return "" if code is protocol.ErrorCode.NO_ERROR else code.name.lower().replace("_", " ")


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
        self._warnings: dict[str, bool] = {}
        """Warnings of the gauge, and whether they were passed on."""

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
        new = [text for text, passed_on in self._warnings.items() if not passed_on]
        self._warnings |= dict.fromkeys(new, True)
        return new + self._line.take_notices()

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
        code = self._query("error code", _error_code)
        if code.startswith(WARNING):
            self._warnings.setdefault(
                f"the gauge at address {self._config.address} warns with {code} (parameter {ERROR_CODE}) and goes on measuring; "
                "see its manual",
                False,
            )
        elif code:
            raise DeviceFault(
                self.name, f"reports {code} (parameter {ERROR_CODE}); power-cycle it, and replace it if the error persists"
            )
        factor = self._correction()
        if factor is not None and factor != 1.0:
            self._query("correction factor", lambda wire, address: protocol.write_correction_value(wire, address, 1.0))
            if (now := self._correction()) != 1.0:
                raise WrongDevice(
                    self.name,
                    f"correction factor (parameter 742) was {factor:g}, is {now:g} and must be 1: it multiplies the pressure; "
                    "set it to 1.00, and keep other programs off the line",
                )

    def _correction(self) -> float | None:
        """The factor for other gases; None for a gauge without one."""
        try:
            return float(self._query("correction factor", protocol.read_correction_value))
        except Refused:
            if self._wire.telegram() == (self._config.address, LACKS):
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
            raise self._not_understood(what, e) from e

    def _not_understood(self, what: str, error: Exception) -> BadReply:
        """The error of an answer that the library rejects: only a wrong checksum speaks against the line."""
        where, telegram = f"address {self._config.address} on {self._config.port}", self._wire.telegram()
        if telegram is None:
            answer = f"answered {show(self._wire.heard)} to a request for its {what} ({error})"
            return BadReply(self.name, f"{where} {answer}; check the cable")
        sender, data = telegram
        if sender != self._config.address:
            asked = f"{where} was asked for its {what}"
            return BadReply(self.name, f"{asked}, but address {sender} answered; check the addresses on the line")
        reason = REFUSALS.get(data, "this driver does not know that")
        return Refused(self.name, f"{where} answered {data!r} to a request for its {what}: {reason}; see the gauge's manual")


DRIVER = Driver("gauge", Config, PfeifferGauge)
