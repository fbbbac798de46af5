"""Fake Alicat PC pressure controllers: several units on one RS-485 line.

Stricter than the instrument: a request must be exactly right, and one that comes before the answer to the last one has
left the line is answered by nobody. Commands obey the firmware's dialect: LS and LSS lock the display of firmware
before 8v00 (8v00 on: `?` until 9v00 and 10v05), FPF is known from 6v00 on, SR from 7v11 on, LCZA, ZCA and ZCP from
10v05 on. Firmware GP wants `$$` before commands that change
something; every other takes them with and without.

Faults of its own, in `faults.extra` (letters of units: "B" or "BC"):
    dead      these units do not answer
    miss      {"B": n}: this unit does not answer its next n requests
    stuck     these units repeat the pressure that they showed when the fault began
    ignore    these units ignore set-points
    refuse    these units answer everything with `?`
    no_lock   what units without a panel lock answer to `L`: {"B": "?"}, "" for nothing
    reading   pressure (Pa) that all units show instead of the measured one
    status    {"A": "OVR"}: status codes shown by a unit
    swap      these units answer under the next letter
    keep      these units ignore settings that are sent (a person may still change them)
    tail      bytes that a breakout box puts behind every line, such as "\\0"
The back door `device["A"]` is a unit's state (`AlicatDevice`): its set-point, range, model, firmware and settings;
`panel("A", "unit", "psi")` is a person at a front panel. A unit in streaming mode (`A@ @`) sends a frame without its letter
every 50 ms and has no letter until it is given one (`@@ A`).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

import timing
from timing import RigClock

from .plant import AMBIENT, Plant
from .pty_fake import Device, PtyFake

UNIT_NAMES = {
    2: "Pa", 3: "hPa", 4: "kPa", 5: "MPa", 6: "mbar", 7: "bar", 9: "kg/cm2", 10: "PSI", 13: "torr", 15: "inHg", 18: "cmH2O",
    20: "inH2O", 22: "atm",
}  # fmt: skip
UNITS = ("Pa", "hPa", "kPa", "MPa", "mbar", "bar", "psi")
"""The same as rig.yaml spells them."""
PA_PER_UNIT = {
    2: 1.0, 3: 100.0, 4: 1e3, 5: 1e6, 6: 100.0, 7: 1e5, 9: 98_066.5, 10: 6894.757, 13: 133.322, 15: 3386.39, 18: 98.0665,
    20: 249.089, 22: 101_325.0,
}  # fmt: skip
ABSOLUTE_LOOP = 34
"""Control variable of a unit that controls absolute pressure."""


@dataclass
class AlicatDevice(Device):
    """Pressures are Pa."""

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
    """The buttons of its front panel; forgotten without power."""
    model: str = "PC-60PSIG-D"
    serial: str = "521641"
    firmware: str = "10v20.0-R24"
    source: str = "S"
    """"A" analog input, "S" serial line, kept without power, "U" serial line, forgotten without power."""
    unit_code: int = 4
    loop: int = 38
    ramp: float = 0.0
    """Fastest change of its set-point, Pa/s; 0 at once."""
    zero_active: bool = True
    """At a set-point of 0 it vents; else it shuts its valves."""
    auto_tare: bool = False
    tare_delay: float = 2.0
    """s at a set-point of 0 after which an automatic tare is done."""
    power_up_tare: bool = False
    offset: float = 0.0
    """Pressure that it takes for zero."""
    _driven: float = 0.0
    _at_zero: float = 0.0

    @property
    def version(self) -> tuple[int, int]:
        """Firmware as numbers; the oldest, GP, has none."""
        match = re.match(r"(\d+)v(\d+)", self.firmware)
        return (int(match[1]), int(match[2])) if match else (0, 0)

    @property
    def pressure(self) -> float:
        """Mean pressure of its chambers, without noise."""
        with self.plant.lock:
            return float(np.mean([self.plant.chamber_pressure[c - 1] for c in self.chambers]))

    def process(self, dt: float) -> None:
        """Drive the chambers' regulators."""
        step = self.ramp * dt if self.ramp else float("inf")
        self._driven += max(-step, min(step, self.setpoint - self._driven))
        target = {"": self._controlled(), "EXH": 0.0}.get(self.held, self.held_at)
        self._at_zero = self._at_zero + dt if self.setpoint == 0 else 0.0
        if self.auto_tare and self._at_zero > self.tare_delay:
            self.offset = self.pressure
        with self.plant.lock:
            for chamber in self.chambers:
                self.plant.regulator[chamber - 1] = target

    def _controlled(self) -> float:
        """Pressure that its control loop drives to."""
        if self._driven == 0 and not self.zero_active:
            return self.pressure
        if self.loop == ABSOLUTE_LOOP:
            return max(0.0, self._driven - AMBIENT)
        return self._driven + self.offset

    def take(self, setpoint: float) -> None:
        """A set-point from the serial line: clamped to the range, ignored when it comes from the analog input."""
        if self.source != "A":
            self.setpoint = max(0.0, min(self.full_scale, setpoint))
            if not self.ramp:
                self._driven = self.setpoint

    def hold(self, how: str) -> None:
        """Hold the valves, open the exhaust, or ("") control again."""
        self.held, self.held_at = how, self.pressure

    def panel(self, setting: str, value: object = None) -> bool:
        """A person changes a setting at the front panel; False when its buttons are locked. "unlock" is all four buttons held.

        `setting`: "unit" (its name), "source", "loop", "ramp", "zero_active", "auto_tare", "power_up_tare", "setpoint" (Pa).
        """
        if setting == "unlock":
            self.locked = False
            return True
        if self.locked:
            return False
        if setting == "unit":
            codes = {name.lower(): code for code, name in UNIT_NAMES.items()}
            if str(value).lower() not in codes:
                raise ValueError(f"a panel has no unit {value!r}; one of {', '.join(UNIT_NAMES.values())}")
            self.unit_code = codes[str(value).lower()]
        elif setting in ("source", "loop", "ramp", "zero_active", "auto_tare", "power_up_tare", "setpoint"):
            setattr(self, setting, value)
        else:
            raise ValueError(f"a panel has no {setting!r}")
        return True

    def restart(self) -> None:
        """A loss of power: holds and the lock are forgotten, the set-point unless it is kept, settings never."""
        if self.source != "S" or self.version < (10, 5):
            self.setpoint = 0.0
        self.held, self.locked = "", False
        self._driven = self.setpoint
        if self.power_up_tare:
            self.offset = self.pressure

    def frame_format(self) -> str:
        """Rows of ??D*: what stands in a data frame. Before 6v00 in its older form."""
        name = UNIT_NAMES[self.unit_code]
        codes = ("ADC", "OPL", "POV", "TOV", "OVR", "HLD", "EXH", "LCK")
        if self.version < (6, 0):
            top = f"{self.full_scale / PA_PER_UNIT[self.unit_code]:+07.2f}"
            rows = [" D00 NAME_______ TYPE_____ MinVal_  MaxVal_  UNITS__", " D01 Unit ID     char         A         Z       na"]
            rows += [
                f" D02 Pressure    signed    +000.00  {top}  {name:>7}",
                f" D03 SetPoint    signed    +000.00  {top}  {name:>7}",
            ]
            labels = ("Error", *("Status",) * (len(codes) - 1))
            rows += [
                f" D{i:02d} {what:<11} string         na      {code}       na"
                for i, (what, code) in enumerate(zip(labels, codes, strict=True), 4)
            ]
            return "\r".join(rows)
        unit = f"7/{self.decimals} {self.unit_code:03d} {self.decimals:02d} {name}"
        sign = "s decimal  " if self.version >= (8, 0) else "decimal    "
        rows = ["D00 ID_ NAME______________________ TYPE_______ WIDTH NOTES___________________"]
        rows += [f"D01 700 {'Unit ID':<26} string          1", f"D02 006 {'Gauge Press':<26} s decimal     {unit}"]
        rows += [f"D03 038 {'Gauge Press Setpt':<26} {sign}   {unit}", f"D04 701 {'*Error':<26} string          3 {codes[0]}"]
        rows += [f"D{i:02d} 702 {'*Status':<26} string          3 {code}" for i, code in enumerate(codes[1:], 5)]
        return "\r".join(rows)


__all__ = ["PA_PER_UNIT", "UNITS", "AlicatDevice", "AlicatFake"]
STREAM_PERIOD = 0.05
"""Host seconds between two frames of a unit in streaming mode."""
SECONDS = {"3": 1e-3, "4": 1.0, "5": 60.0, "6": 3600.0, "7": 86400.0}
"""Of the units of time of a ramp, by their number."""
IDLE_BYTES = 3.5
"""Silence after a request before a unit acts on it, in byte times."""


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
        clock: RigClock,
        units: Sequence[str] = ("A", "B", "C"),
        chambers: Sequence[Sequence[int]] = ((9, 1, 2), (3, 4, 5), (6, 7, 8)),
        baud: int = 115200,
        seed: int = 0,
        full_scale: float = 400e3,
        firmware: str = "10v20.0-R24",
        unit: str = "kPa",
    ) -> None:
        """`full_scale` in Pa; `unit` of measure on display and wire, which firmware before 6v00 does not report."""
        super().__init__("alicat", clock, baud, seed)
        code = next(code for code, name in UNIT_NAMES.items() if name.lower() == unit.lower())
        self.device = {
            letter: AlicatDevice(plant, tuple(group), full_scale, serial=str(521641 + i), firmware=firmware, unit_code=code)
            for i, (letter, group) in enumerate(zip(units, chambers, strict=True))
        }
        self._streams: list[AlicatDevice] = []
        """Units in streaming mode, which hear no request."""
        self._stuck: dict[str, float] = {}

    def process(self, dt: float) -> None:
        """Advance all units."""
        for unit in (*self.device.values(), *self._streams):
            unit.process(dt)

    def restart(self) -> None:
        """A loss of power."""
        for unit in self.device.values():
            unit.restart()

    def panel(self, *change: Any) -> bool:
        """A person at the front panel of a unit, given by its letter; see `AlicatDevice.panel`."""
        letter, *change_there = change
        if letter not in self.device:
            raise ValueError(f"no unit {letter!r}; one of {', '.join(self.device)}")
        with self.lock:
            return self.device[letter].panel(*change_there)

    def idle(self) -> float | None:
        """Send what streams."""
        if not self._streams:
            return None
        self.send(f"{self._frame('@', self._streams[0])}\r".encode("ascii"))
        return STREAM_PERIOD

    def _streaming(self, text: str) -> bool:
        """Whether a line was about the streaming mode, which ends by giving the unit a letter."""
        if match := re.fullmatch(r"@@\s*=?\s*([A-Z])", text.upper()):
            for unit in self._streams:
                self.device[match[1]] = unit
            self._streams.clear()
            return True
        if (match := re.fullmatch(r"([A-Z])@\s*=?\s*@", text.upper())) and match[1] in self.device:
            self._streams.append(self.device.pop(match[1]))
            return True
        return False

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
        if self._streaming(text):
            return True
        letter, words = text[:1].upper(), text[1:].strip().upper()
        unit = self.device.get(letter)
        if unit is None or self._has("dead", letter) or self._misses(letter):
            return True
        unlockable = self.faults.extra.get("no_lock")
        if words == "L" and isinstance(unlockable, dict) and letter in unlockable:
            answer = str(unlockable[letter])
            if not answer:
                return True
        else:
            answer = "?" if self._has("refuse", letter) else self._answer(letter, unit, words)
        if answer != "?":
            shown_letter = chr(ord(letter) + 1) if self._has("swap", letter) else letter
            answer = "\r".join(f"{shown_letter} {row}" for row in answer.split("\r"))
        if not self.faults.freeze:
            unit.process(0.0)  # a set-point works on the plant before its answer is out
        timing.sleep(IDLE_BYTES * self.byte_time)
        tail = str(self.faults.extra.get("tail", ""))
        self.send("".join(f"{row}\r{tail}" for row in answer.split("\r")).encode("ascii"))
        return True

    # -- what a unit says
    def _answer(self, letter: str, unit: AlicatDevice, words: str) -> str:
        """The answer without the unit's letter; rows are parted by CR."""
        prefixed, words = words.startswith("$$"), words.removeprefix("$$")
        if unit.firmware.startswith("GP"):
            changes = words not in ("", "??M*", "??D*") and not re.fullmatch(r"R\d+", words)
            if changes != prefixed:
                return "?"
        if words == "":
            return self._frame(letter, unit)
        if match := re.fullmatch(r"S\s*([+-]?\d+(?:\.\d+)?)", words):
            return self._set(letter, unit, float(match[1]) * PA_PER_UNIT[unit.unit_code])
        if re.fullmatch(r"\d+", words) and int(words) <= 64000:
            return self._set(letter, unit, int(words) / 64000 * unit.full_scale)
        if words.startswith("LC"):
            return self._setting(letter, unit, words)
        if words.startswith("L"):
            return self._loop_words(letter, unit, words)
        if words in ("HP", "HC", "E", "C"):
            unit.hold({"E": "EXH", "C": ""}.get(words, words))
            return self._frame(letter, unit)
        if words in ("U", "P"):
            unit.locked, unit.offset = unit.locked and words != "U", unit.offset if words == "U" else unit.pressure
            return self._frame(letter, unit)
        return self._setting(letter, unit, words)

    def _setting(self, letter: str, unit: AlicatDevice, words: str) -> str:
        """Settings that a unit keeps without power."""
        keep = self._has("keep", letter)
        if match := re.fullmatch(r"R122|W122=(\d+)", words):
            unit.loop = int(match[1]) if match[1] and not keep else unit.loop
            return f"  122 = {unit.loop}"
        if unit.version >= (7, 11) and (match := re.fullmatch(r"SR(?: (\d+(?:\.\d+)?) ([3-7]))?", words)):
            if match[1] and not keep:
                unit.ramp = float(match[1]) * PA_PER_UNIT[unit.unit_code] / SECONDS[match[2]]
            name, per_second = UNIT_NAMES[unit.unit_code], unit.ramp / PA_PER_UNIT[unit.unit_code]
            return f"{per_second:.1f} {unit.unit_code} 4 {name}/s"
        if unit.version < (10, 5):
            return self._about(unit, words)
        if match := re.fullmatch(r"LCZA(?: ([01]))?", words):
            unit.zero_active = unit.zero_active if keep or not match[1] else match[1] == "1"
            return f"{unit.zero_active:d}"
        if match := re.fullmatch(r"ZCA(?: (?:(0)|1 (\d+(?:\.\d+)?)))?", words):
            if not keep and (match[1] or match[2]):
                unit.auto_tare, unit.tare_delay = not match[1], float(match[2] or unit.tare_delay)
            return f"{unit.auto_tare:d} {unit.tare_delay:.1f}"
        if match := re.fullmatch(r"ZCP(?: ([01]))?", words):
            unit.power_up_tare = unit.power_up_tare if keep or not match[1] else match[1] == "1"
            return f"{unit.power_up_tare:d}"
        return self._about(unit, words)

    def _loop_words(self, letter: str, unit: AlicatDevice, words: str) -> str:
        """LS and LSS where the firmware has them; L locks the display."""
        if words == "L" or unit.version < (8, 0):
            unit.locked = True
            return self._frame(letter, unit)
        if unit.version >= (10, 5) and (match := re.fullmatch(r"LSS(?: ([SAU]))?", words)):
            unit.source = unit.source if self._has("keep", letter) or not match[1] else match[1]
            return unit.source
        if unit.version >= (9, 0) and (match := re.fullmatch(r"LS(?: (\d+(?:\.\d+)?))?", words)):
            if match[1]:
                self._set(letter, unit, float(match[1]) * PA_PER_UNIT[unit.unit_code])
            shown = self._shown(unit, unit.setpoint)
            return f"{shown} {shown} {unit.unit_code:02d} {UNIT_NAMES[unit.unit_code]}"
        return "?"

    def _about(self, unit: AlicatDevice, words: str) -> str:
        """The manufacturer's table of a unit."""
        if words == "VE":
            return f"  {unit.firmware} Jan  9 2025,15:04:07"
        if words == "??M*":
            return self._manufacturer(unit)
        if words == "??D*":
            return unit.frame_format()
        if words == "FPF 6" and unit.version >= (6, 0):
            return f"{self._shown(unit, unit.full_scale)} {unit.unit_code:02d} {UNIT_NAMES[unit.unit_code]}"
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
        """A data frame without the unit's letter: pressure, set-point, status codes."""
        measured = unit.pressure
        codes = ["POV"] if measured > 1.1 * unit.full_scale else []
        codes += {"HP": ["HLD"], "HC": ["HLD"], "EXH": ["EXH"]}.get(unit.held, [])
        codes += ["LCK"] if unit.locked else []
        status = self.faults.extra.get("status")
        if isinstance(status, dict) and letter in status:
            codes.append(str(status[letter]))
        reading = self.random.gauss(measured - unit.offset, 100.0)  # Pa, standard deviation of a reading
        if isinstance(shown := self.faults.extra.get("reading"), float):
            reading = shown
        if self._has("stuck", letter):
            reading = self._stuck.setdefault(letter, reading)
        else:
            self._stuck.pop(letter, None)
        setpoint = self._shown(unit, unit.setpoint)
        return " ".join([self._shown(unit, reading), setpoint.lstrip("+") if unit.version < (8, 0) else setpoint, *codes])

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
