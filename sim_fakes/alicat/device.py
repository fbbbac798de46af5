"""One Alicat pressure controller without its wire: its physics, its persistent settings, its front panel."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from ..plant import AMBIENT, Plant
from ..pty_fake import Device

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
        # loop 34 is that for absolute pressure
        return max(0.0, self._driven - AMBIENT) if self.loop == 34 else self._driven + self.offset

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
            rows = [
                " D00 NAME_______ TYPE_____ MinVal_  MaxVal_  UNITS__",
                " D01 Unit ID     char         A         Z       na",
            ]
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
        rows += [
            f"D03 038 {'Gauge Press Setpt':<26} {sign}   {unit}",
            f"D04 701 {'*Error':<26} string          3 {codes[0]}",
        ]
        rows += [f"D{i:02d} 702 {'*Status':<26} string          3 {code}" for i, code in enumerate(codes[1:], 5)]
        return "\r".join(rows)
