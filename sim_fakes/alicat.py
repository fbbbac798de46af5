"""Fake Alicat PC pressure controllers: several units on one RS-485 line.

Stricter than the instrument: a request must be exactly right, and one that comes before the answer to the last one has
left the line is answered by nobody. Commands obey the firmware's dialect: LS and LSS lock the display of firmware
before 8v00 (8v00 on: `?` until 9v00 and 10v05), FPF is known from 6v00 on.

Faults of its own, in `faults.extra` (letters of units: "B" or "BC"):
    dead      these units do not answer
    miss      {"B": n}: this unit does not answer its next n requests
    stuck     these units repeat the pressure that they showed when the fault began
    ignore    these units keep their set-point whatever is sent
    refuse    these units answer everything with `?`
    reading   pressure (Pa) that all units show instead of the measured one
    status    {"A": "OVR"}: status codes shown by a unit
    swap      these units answer under the next letter
The back door `device["A"]` is a unit's state: its set-point, range, model, firmware, source, unit of measure, holds.
"""

from __future__ import annotations

import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from .clock import SimClock
from .plant import Plant
from .pty_fake import Device, PtyFake

UNIT_NAMES = {2: "Pa", 3: "hPa", 4: "kPa", 5: "MPa", 6: "mbar", 7: "bar", 10: "PSI"}
UNITS = ("Pa", "hPa", "kPa", "MPa", "mbar", "bar", "psi")
"""The same as rig.yaml spells them."""
PA_PER_UNIT = {2: 1.0, 3: 100.0, 4: 1e3, 5: 1e6, 6: 100.0, 7: 1e5, 10: 6894.757}
NOISE = 100.0
"""Standard deviation of a reading, Pa."""
IDLE_BYTES = 3.5
"""Silence after a request before a unit acts on it, in byte times."""


@dataclass
class AlicatDevice(Device):
    """One controller without its wire; pressures are Pa."""

    plant: Plant
    chambers: tuple[int, ...]
    full_scale: float
    decimals: int = 2
    setpoint: float = 0.0
    held: str = ""
    """"" controlling, "HP" valve held where it is, "HC" valve held closed, "EXH" exhaust open."""
    held_at: float = 0.0
    """Pressure shut in by a held valve."""
    locked: bool = False
    model: str = "PC-60PSIG-D"
    serial: str = "521641"
    firmware: str = "10v20.0-R24"
    source: str = "S"
    unit_code: int = 4
    loop: int = 38

    @property
    def version(self) -> tuple[int, int]:
        """Firmware as numbers."""
        major, minor = re.findall(r"\d+", self.firmware)[:2]
        return int(major), int(minor)

    @property
    def pressure(self) -> float:
        """Mean pressure of its chambers, without noise."""
        with self.plant.lock:
            return float(np.mean([self.plant.chamber_pressure[c - 1] for c in self.chambers]))

    def process(self, dt: float) -> None:
        """Drive the chambers' regulators."""
        target = {"": self.setpoint, "EXH": 0.0}.get(self.held, self.held_at)
        with self.plant.lock:
            for chamber in self.chambers:
                self.plant.regulator[chamber - 1] = target

    def take(self, setpoint: float) -> None:
        """A set-point from the serial line: clamped to the range, ignored when another source is chosen."""
        if self.source == "S":
            self.setpoint = max(0.0, min(self.full_scale, setpoint))

    def hold(self, how: str) -> None:
        """Hold the valves, open the exhaust, or ("") control again."""
        self.held, self.held_at = how, self.pressure


class AlicatFake(PtyFake):
    """The units on one pty; `units` are their letters, `chambers` the plant's chambers (1..9) of each."""

    own_faults: ClassVar[Mapping[str, tuple[str, Any]]] = {
        "wrong_id": ("swap", "ABCDEFGHI"),
        "nak": ("refuse", "ABCDEFGHI"),
        "stuck": ("stuck", "ABCDEFGHI"),
        "over_range": ("reading", 450e3),
    }

    def __init__(
        self,
        plant: Plant,
        clock: SimClock,
        units: Sequence[str] = ("A", "B", "C"),
        chambers: Sequence[Sequence[int]] = ((9, 1, 2), (3, 4, 5), (6, 7, 8)),
        baud: int = 115200,
        seed: int = 0,
        full_scale: float = 400e3,
        firmware: str = "10v20.0-R24",
        unit: str = "kPa",
    ) -> None:
        """`full_scale` in Pa; `unit` of measure on display and wire, which firmware before 6v00 tells nobody."""
        super().__init__("alicat", clock, baud, seed)
        code = next(code for code, name in UNIT_NAMES.items() if name.lower() == unit.lower())
        self.device = {
            letter: AlicatDevice(
                plant, tuple(group), full_scale, serial=str(521641 + i), firmware=firmware, unit_code=code
            )
            for i, (letter, group) in enumerate(zip(units, chambers, strict=True))
        }
        self._stuck: dict[str, float] = {}

    def process(self, dt: float) -> None:
        """Advance all units."""
        for unit in self.device.values():
            unit.process(dt)

    def restart(self) -> None:
        """Set-points and holds are forgotten."""
        for unit in self.device.values():
            unit.setpoint, unit.held, unit.locked = 0.0, "", False

    def feed(self) -> bool:
        """Answer one line."""
        line, end, rest = self.buffer.partition(b"\r")
        if not end:
            return False
        self.buffer = rest
        self.requests.append(line + end)
        if rest:
            return True  # the next request came before this one's answer: the line is jammed and nobody answers
        text = line.decode("ascii", "replace")
        letter, words = text[:1].upper(), text[1:].strip().upper()
        unit = self.device.get(letter)
        if unit is None or self._has("dead", letter) or self._misses(letter):
            return True
        answer = "?" if self._has("refuse", letter) else self._answer(letter, unit, words)
        if answer != "?":
            shown = chr(ord(letter) + 1) if self._has("swap", letter) else letter
            answer = "\r".join(f"{shown} {row}" for row in answer.split("\r"))
        # a set-point works on the plant before its answer is out
        if not self.faults.freeze:
            unit.process(0.0)
        time.sleep(IDLE_BYTES * self.byte_time)
        self.send(answer.encode("ascii") + b"\r")
        return True

    # -- what a unit says
    def _answer(self, letter: str, unit: AlicatDevice, words: str) -> str:
        """The answer without the unit's letter; rows are parted by CR."""
        if words == "":
            return self._frame(letter, unit)
        if match := re.fullmatch(r"S\s*([+-]?\d+(?:\.\d+)?)", words):
            return self._set(letter, unit, float(match[1]) * PA_PER_UNIT[unit.unit_code])
        if re.fullmatch(r"\d+", words) and int(words) <= 64000:
            return self._set(letter, unit, int(words) / 64000 * unit.full_scale)
        if words.startswith("L"):
            return self._loop_words(letter, unit, words)
        if words in ("HP", "HC", "E", "C"):
            unit.hold({"E": "EXH", "C": ""}.get(words, words))
            return self._frame(letter, unit)
        if words == "U":
            unit.locked = False
            return self._frame(letter, unit)
        return self._about(unit, words)

    def _loop_words(self, letter: str, unit: AlicatDevice, words: str) -> str:
        """LS and LSS where the firmware has them; L locks the display."""
        if words == "L" or unit.version < (8, 0):
            unit.locked = True
            return self._frame(letter, unit)
        if unit.version >= (10, 5) and (match := re.fullmatch(r"LSS(?: ([SAU]))?", words)):
            unit.source = match[1] or unit.source
            return unit.source
        if unit.version >= (9, 0) and (match := re.fullmatch(r"LS(?: (\d+(?:\.\d+)?))?", words)):
            if match[1]:
                self._set(letter, unit, float(match[1]) * PA_PER_UNIT[unit.unit_code])
            shown = self._shown(unit, unit.setpoint)
            return f"{shown} {shown} {unit.unit_code:02d} {UNIT_NAMES[unit.unit_code]}"
        return "?"

    def _about(self, unit: AlicatDevice, words: str) -> str:
        """What a unit tells of itself."""
        if words == "VE":
            return f"  {unit.firmware} Jan  9 2025,15:04:07"
        if words == "R122":
            return f"  122 = {unit.loop}"
        if words == "??M*":
            return self._manufacturer(unit)
        if words == "FPF 6" and unit.version >= (6, 0):
            full_scale = self._shown(unit, unit.full_scale)
            return f"{full_scale} {unit.unit_code:02d} {UNIT_NAMES[unit.unit_code]}"
        return "?"

    def _manufacturer(self, unit: AlicatDevice) -> str:
        rows = (
            "ALICAT SCIENTIFIC",
            "www.example.com",
            "Ph   555-0100",
            "info@example.com",
            f"Model Number {unit.model}",
            f"Serial Number {unit.serial}",
            "Date Manufactured 03/02/2025",
            "Date Calibrated   03/02/2025",
            "Calibrated By     BL",
            f"Software Revision {unit.firmware}",
        )
        return "\r".join(f" M{i:02d} {row}" for i, row in enumerate(rows))

    def _set(self, letter: str, unit: AlicatDevice, pressure: float) -> str:
        if not self._has("ignore", letter):
            unit.take(pressure)
        return self._frame(letter, unit)

    def _frame(self, letter: str, unit: AlicatDevice) -> str:
        measured = unit.pressure
        codes = ["POV"] if measured > 1.1 * unit.full_scale else []
        codes += {"HP": ["HLD"], "HC": ["HLD"], "EXH": ["EXH"]}.get(unit.held, [])
        codes += ["LCK"] if unit.locked else []
        status = self.faults.extra.get("status")
        if isinstance(status, dict) and letter in status:
            codes.append(str(status[letter]))
        reading = self.random.gauss(measured, NOISE)
        if isinstance(shown := self.faults.extra.get("reading"), float):
            reading = shown
        if self._has("stuck", letter):
            reading = self._stuck.setdefault(letter, reading)
        else:
            self._stuck.pop(letter, None)
        return " ".join([self._shown(unit, reading), self._shown(unit, unit.setpoint), *codes])

    def _shown(self, unit: AlicatDevice, pressure: float) -> str:
        """A pressure (Pa) as the display shows it: sign, three digits at least, the unit's decimals."""
        value = round(pressure / PA_PER_UNIT[unit.unit_code], unit.decimals)
        return f"{value:+0{5 + unit.decimals}.{unit.decimals}f}"

    def _misses(self, letter: str) -> bool:
        left = self.faults.extra.get("miss")
        if not isinstance(left, dict) or not left.get(letter):
            return False
        left[letter] -= 1
        return True

    def _has(self, fault: str, letter: str) -> bool:
        return letter in str(self.faults.extra.get(fault, ""))
