"""The words that one Alicat pressure controller understands, and the data frame it answers with.

Requests are ASCII lines that begin with the unit's letter and end in CR. Wire pressures are in the unit's own unit of
measure, as its display shows them, and no answer names it; results are Pa.
"""

from __future__ import annotations

import contextlib
import re
from dataclasses import dataclass
from enum import IntEnum

from ..errors import BadReply, NoReply
from ..serial_line import SerialLine, show

CR = b"\r"
UNITS = {
    "Pa": (2, 1.0), "hPa": (3, 100.0), "kPa": (4, 1e3), "MPa": (5, 1e6), "mbar": (6, 100.0), "bar": (7, 1e5),
    "psi": (10, 6894.757),
}  # fmt: skip
"""Units of measure that rig.yaml may name: Alicat's number, and Pa."""
PA = dict(UNITS.values()) | {
    8: 98.0665, 9: 98_066.5, 11: 47.8803, 12: 0.133322, 13: 133.322, 14: 133.322, 15: 3386.39, 16: 9.80665, 17: 9.7971,
    18: 98.0665, 19: 97.971, 20: 249.089, 21: 248.843, 22: 101_325.0,
}  # fmt: skip
"""Pa in every unit of pressure that a panel offers, by Alicat's number."""


class Variable(IntEnum):
    """Alicat's numbers of what a unit reads and controls."""

    GAUGE_PRESSURE = 6
    GAUGE_SETPOINT = 38


COUNTS = 64000
"""A set-point can also be sent as this many parts of the full scale, which is independent of the unit of measure."""
FRAME = re.compile(r"[A-Z]((?:\s+[+-]?\d+(?:\.\d+)?){2,})((?:\s+[A-Z0-9]{3})*)\s*")
"""Firmware before 8v00 gives the set-point without its sign."""
ROUNDING = 0.6
"""Digits by which a set-point read back may differ from the one sent: half a digit, and the arithmetic."""
LOCKED = "LCK"
"""Status code: the buttons of the front panel are locked."""
FAULT_CODES = {
    "ADC": "its electronics report a communication error; power-cycle it",
    "EXH": "its exhaust valve is held open, it does not control; cancel that at its front panel or vent",
    "HLD": "its valve is held, it does not control; cancel that at its front panel or vent",
    "MOV": "mass flow over range; look for a leak or a burst chamber",
    "OPL": "its over-pressure limit has tripped; vent and find the cause",
    "OVR": "a reading is over range; vent and look at its display",
    "POV": "pressure over range; vent and check the supply pressure against its range",
    "TOV": "temperature over range; let it cool down",
    "VOV": "volume flow over range; look for a leak or a burst chamber",
}
"""Status codes with which the pressure is not controlled. The others (display locked, ...) do no harm."""


@dataclass(frozen=True)
class Readout:
    """One data frame: pressure and set-point (Pa gauge), and the unit's status codes."""

    measured: float
    setpoint: float
    codes: tuple[str, ...]


class AlicatUnit:
    """One unit on the line. Methods raise `NoReply` on silence, `BadReply` on `?` or anything out of protocol."""

    def __init__(self, name: str, line: SerialLine, letter: str, pa: float = 1e3) -> None:
        """`pa`: Pa in the unit's own unit of measure."""
        self.name = name
        self.letter = letter
        self.pa = pa
        self._decimals = 0
        """Of its display, as its last frame showed them."""
        self._widths: tuple[list[int], ...] = ()
        """Characters of each number of its last frame, and of one before that was not believed: they change with its unit of
        measure only, or where a character was lost."""
        self._line = line

    @property
    def digit(self) -> float:
        """Last digit of its display, Pa."""
        return self.pa * 10.0**-self._decimals

    def poll(self) -> Readout:
        """The data frame as it is now."""
        return self._frame("")

    def set(self, pressure: float, timeout: float | None = None) -> Readout:
        """Send a set-point (Pa), rounded to the unit's decimals; the answer shows the set-point that holds now.

        `timeout` (s, host time) where the line's own is too long.
        """
        return self._frame(f"S {pressure / self.pa:.{self._decimals}f}", timeout)

    def set_share(self, counts: int) -> Readout:
        """Send a set-point as `counts` of the 64000 parts of the full scale; all firmware knows this form."""
        return self._frame(f"{counts}")

    def cancel_hold(self) -> Readout:
        """Let the unit control again after its valves were held or its exhaust was opened."""
        return self._frame("C")

    def firmware(self) -> str:
        """Such as "10v20.0-R24"."""
        return self._ask("VE").split()[0]

    def model_and_serial(self) -> tuple[str, str]:
        """From the manufacturer's table, lines such as `A M04 Model Number PC-60PSIG-D`; empty when not reported."""
        with self._line.lock:
            lines = [self._ask("??M*")]
            while len(lines) < 10:  # M00 to M09
                try:
                    lines.append(self._line.read_until(CR).decode("ascii", "replace"))
                except NoReply:
                    break
        table = {m[1]: m[2] for text in lines if (m := re.search(r"\b(M\d\d)\s+(.*)", text))}
        model = table.get("M04", "").removeprefix("Model Number").strip()
        return model, table.get("M05", "").removeprefix("Serial Number").strip()

    def full_scale(self, reading: int) -> tuple[float, int, str]:
        """Range of a reading: value, code and name of its unit of measure. Firmware 6v00 and later."""
        match = re.match(r"([+-]?[\d.]+)\s+(\d+)\s*(\S*)", answer := self._ask(f"FPF {reading}"))
        if match is None:
            raise self._unexpected("its full scale", answer)
        return float(match[1]), int(match[2]), match[3]

    def lock(self) -> bool:
        """Lock the buttons of the front panel; True when the unit says that they are, False also where it rejects that.

        Power-cycling unlocks them.
        """
        for _ in range(2):  # a damaged answer must not pass for a refusal
            with contextlib.suppress(BadReply):
                return LOCKED in self._frame("L").codes
        return False

    def unlock(self, timeout: float | None = None) -> None:
        """Unlock the buttons of the front panel."""
        self._frame("U", timeout)

    def setting(self, words: str) -> str | None:
        """The answer to a query for a setting, or to a command that writes one; None where the unit does not know it."""
        for last in (False, True):  # a damaged answer must not pass for a refusal
            try:
                return self._ask(words)
            except BadReply:
                if last:
                    return None
        return None

    def loop_variable(self) -> int:
        """Alicat's number for what the control loop controls."""
        match = re.match(r"0*122\s*=\s*(\d+)", answer := self._ask("R122"))
        if match is None:
            raise self._unexpected("register 122", answer)
        return int(match[1])

    def _frame(self, words: str, timeout: float | None = None) -> Readout:
        text = f"{self.letter} {self._ask(words, timeout)}"
        match = FRAME.fullmatch(text)
        if match is None:
            raise self._unexpected("a data frame", text)
        # pressure comes first; a unit that shows more than two numbers has its set-point last
        numbers = match[1].split()
        widths = [len(number) for number in numbers]
        if self._widths and widths not in self._widths:
            self._widths = (self._widths[0], widths)
            raise self._unexpected("numbers as wide as in the last data frame", text)
        self._widths = (widths,)
        self._decimals = len(numbers[-1].partition(".")[2])
        return Readout(float(numbers[0]) * self.pa, float(numbers[-1]) * self.pa, tuple(match[2].split()))

    def _ask(self, words: str, timeout: float | None = None) -> str:
        """What follows the unit's letter in the answer."""
        request = f"{self.letter}{words}".encode("ascii") + CR
        try:
            raw = self._line.ask(request, CR, timeout)
        except NoReply as e:
            raise NoReply(self.name, f"unit {self.letter}: {e.message}") from e
        text = raw.decode("ascii", "replace").strip()
        if text.lstrip(f"{self.letter} ") == "?":
            raise BadReply(self.name, f"unit {self.letter} rejects {show(request)}; check whether its firmware supports that")
        head, _, rest = text.partition(" ")
        if head != self.letter or not rest.strip():
            raise self._unexpected(f"an answer to {show(request)}", text)
        return rest.strip()

    def _unexpected(self, wanted: str, got: str) -> BadReply:
        return BadReply(
            self.name,
            f"unit {self.letter}: expected {wanted}, got {got!r}; check the cable, the baud rate, and that no two "
            "units share a letter",
        )
