"""Fake Pfeiffer gauge: telegrams of the Pfeiffer Vacuum Protocol on RS-485.

Stricter than the device: a telegram must match to the last digit; other addresses and wrong checksums meet silence.

Faults by name in `faults.extra`:
- "error" (str): the gauge's own error code, "Err001" or "Err002".
- "value" (float): pressure shown instead of the true one, Pa.
- "refuse" (str): every request is answered with this: "NO_DEF", "_RANGE" or "_LOGIC".
- "wrong_address" (bool): answers carry the next address.
- "keeps_correction" (bool): a new correction factor is acknowledged and not taken.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from enum import IntEnum
from typing import Any, ClassVar

from timing import RigClock

from .plant import Plant
from .pty_fake import PtyFake


class GaugeParameter(IntEnum):
    """Parameters of the gauge."""

    ERROR = 303
    VERSION = 312
    NAME = 349
    PRESSURE = 740
    CORRECTION = 742


def checksum(text: str) -> str:
    """Sum of the characters modulo 256, three digits."""
    return f"{sum(text.encode()) % 256:03d}"


def pressure_digits(pascal: float) -> str:
    """mmmmee: pressure = mmmm / 1000 * 10^(ee - 20) hPa."""
    hpa = max(pascal / 100.0, 1e-10)
    exponent = math.floor(math.log10(hpa))
    mantissa = round(hpa / 10**exponent * 1000)
    if mantissa == 10000:
        mantissa, exponent = 1000, exponent + 1
    return f"{mantissa:04d}{exponent + 20:02d}"


class PfeifferFake(PtyFake):
    """A gauge that sees `plant.vacuum_absolute` with `noise` (share of the reading, one sigma)."""

    own_faults: ClassVar[Mapping[str, tuple[str, Any]]] = {
        "wrong_id": ("wrong_address", True),
        "nak": ("refuse", "_LOGIC"),
        "over_range": ("value", 5e6),
    }
    checked: ClassVar[slice | None] = slice(0, -4)

    def __init__(
        self,
        plant: Plant,
        clock: RigClock,
        address: int = 1,
        kind: str = "    A1",
        noise: float = 0.005,
        baud: int = 9600,
        seed: int = 0,
    ) -> None:
        """`kind` is the name the gauge gives: "    A1" is a CPT 100, "    A2" an RPT 100, "    A3" a PPT 100."""
        super().__init__("pfeiffer", clock, baud, seed)
        self.plant = plant
        self.address = address
        self.kind = kind
        self.noise = noise
        self.correction: int | None = 100
        """Hundredths by which the pressure is multiplied, kept without power; None: it has no such parameter."""
        self.seen = plant.vacuum_absolute
        """Pressure at the gauge's cell, Pa absolute; stands still while frozen."""

    def process(self, dt: float) -> None:
        self.seen = self.plant.vacuum_absolute

    def begin(self, fault: str) -> Callable[[], None] | None:
        """It repeats what it shows now."""
        if fault != "stuck":
            return None
        self.faults.extra["value"] = float(self.plant.vacuum_absolute)
        return lambda: None

    def feed(self) -> bool:
        """Take one telegram; answer it where address and checksum are right."""
        line, end, rest = self.buffer.partition(b"\r")
        if not end:
            return False
        self.buffer = rest
        self.requests.append(line)
        text = line.decode("ascii", "replace")
        match = re.fullmatch(r"(\d{3})00(\d{3})02=\?(\d{3})", text)  # a query
        if match and int(match[1]) == self.address and match[3] == checksum(text[:-3]):
            self._answer(int(match[2]))
        match = re.fullmatch(r"(\d{3})1074206(\d{6})(\d{3})", text)  # a new correction factor, parameter 742
        if match and int(match[1]) == self.address and match[3] == checksum(text[:-3]):
            if self.correction is not None and not self.faults.extra.get("keeps_correction"):
                self.correction = int(match[2])
            self._send(GaugeParameter.CORRECTION, match[2] if self.correction is not None else "NO_DEF")
        return True

    def _answer(self, parameter: int) -> None:
        extra = self.faults.extra
        value = extra.get("value")
        pascal = value if isinstance(value, float) else self.seen * (1 + self.noise * self.random.gauss(0, 1))
        pascal *= 1.0 if self.correction is None else self.correction / 100
        answers: dict[int, str] = {
            GaugeParameter.ERROR: str(extra.get("error", "000000")),
            GaugeParameter.VERSION: "010100",
            GaugeParameter.NAME: self.kind,
            GaugeParameter.PRESSURE: pressure_digits(pascal),
            GaugeParameter.CORRECTION: "NO_DEF" if self.correction is None else f"{self.correction:06d}",
        }
        self._send(parameter, answers.get(parameter, "NO_DEF"))

    def _send(self, parameter: int, data: str) -> None:
        extra = self.faults.extra
        data = str(extra.get("refuse", data))
        sender = self.address + bool(extra.get("wrong_address"))
        text = f"{sender:03d}10{parameter:03d}{len(data):02d}{data}"
        self.send(f"{text}{checksum(text)}\r".encode())
