"""The unit of measure and the persistent settings of an Alicat unit on which promises of safety rest, and how they are put right.

A unit keeps them without power; panel, other programs and the maker's software change them. Each is known from a firmware on;
a unit that does not answer a query in its form does not have that setting.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from ..errors import WrongDevice
from .wire import COUNTS, PA, ROUNDING, UNITS, AlicatUnit, Variable

KNOWS_FULL_SCALE = (6, 0)
"""First firmware that answers FPF, and so reports its unit of measure."""
UNKNOWN = 1e6
"""Pa taken for a unit of measure that is not known: the largest, so that no pressure passes for vented."""
TRIAL_COUNTS = 160
"""Of `COUNTS`: 5 kPa on a unit of 2 MPa, the widest that rig.yaml takes, and less on any other."""
TRIAL_SHARE = 0.25
"""By which what it shows may differ from what rig.yaml makes of that: nominal ranges are rounded, units lie further apart."""


class Measure:
    """Keep `unit.pa` true: readings are Pa in any unit of the display, which no data frame names and a panel may change."""

    def __init__(self, name: str, unit: AlicatUnit, stated: str | None, full_scale: float) -> None:
        """`stated`: the unit of measure in rig.yaml; `full_scale` there, Pa."""
        self._name, self._unit, self._stated, self._full_scale = name, unit, stated, full_scale
        self._needed = stated or "kPa"
        self._pa = unit.pa = UNITS[self._needed][1]
        self._range = full_scale
        self.tells = True
        self.untried = False
        """It does not tell, and must be tried before its next pressure."""
        self.wrong = ""
        """What is wrong, with its remedy; nothing may be inflated while there is something."""

    def begin(self, firmware: str, version: tuple[int, int]) -> None:
        """At opening. Raises WrongDevice when the unit does not tell and rig.yaml does not say."""
        self.tells = version >= KNOWS_FULL_SCALE
        if not self.tells and self._stated is None:
            raise WrongDevice(
                self._name,
                f"unit {self._unit.letter} has firmware {firmware}, which does not report its unit of measure; write what its "
                f"display shows in rig.yaml: instruments.{self._name}.unit: one of {', '.join(UNITS)}",
            )

    def ask(self) -> None:
        """Ask for unit of measure and range; of a unit that does not tell, have them tried before the next pressure."""
        if not self.tells:
            self.untried = True
            return
        value, code, label = self._unit.full_scale(Variable.GAUGE_PRESSURE)
        self._unit.pa = PA.get(code, UNKNOWN)
        self._range = value * self._unit.pa
        self.wrong = ""
        if self._unit.pa != self._pa:
            self.wrong = (
                f"unit {self._unit.letter} shows {label or 'an unknown unit of measure'} (code {code}; register FPF "
                f"{Variable.GAUGE_PRESSURE}), {self._needed} is needed (code {UNITS[self._needed][0]}); set its pressure unit to "
                f"{self._needed}, or write in rig.yaml which `unit` it shows"
            )

    def check_range(self) -> None:
        """Compare the range reported last with rig.yaml. Raises WrongDevice."""
        if not math.isclose(self._range, self._full_scale, rel_tol=1e-3):
            raise WrongDevice(
                self._name,
                f"unit {self._unit.letter} has a full scale of {self._range / 1e3:g} kPa, rig.yaml says "
                f"{self._full_scale / 1e3:g} kPa; correct full_scale in rig.yaml, or fit the right unit",
            )

    def try_out(self, pressure: float = 0.0) -> None:
        """Where the firmware does not report its unit of measure: send `pressure` (Pa; 0: a small one) as counts of the full
        scale, the same in any, and compare what the device shows. Sets `_unit.pa`, or `wrong`."""
        counts = round(pressure / self._full_scale * COUNTS) or TRIAL_COUNTS
        wanted = counts / COUNTS * self._full_scale
        shown = self._unit.set_share(counts).setpoint / self._unit.pa
        if abs(shown * self._pa - wanted) <= max(TRIAL_SHARE * wanted, ROUNDING * self._unit.digit):
            self._unit.pa, self.untried, self.wrong = self._pa, False, ""
            return
        fits = [name for name, (_, pa) in UNITS.items() if abs(shown * pa - wanted) <= TRIAL_SHARE * wanted]
        self._unit.pa = UNITS[fits[0]][1] if fits else UNKNOWN
        self.wrong = (
            f"unit {self._unit.letter} shows {shown:g} for {wanted / self._pa:.4g} {self._needed}, sent as a share of its range: "
            f"it does not show {self._needed}{f' but {fits[0]}' if fits else ''}, or its range is not "
            f"{self._full_scale / 1e3:g} kPa; correct unit or full_scale in rig.yaml"
        )


ANALOG, SAVED, UNSAVED = "A", "S", "U"


@dataclass(frozen=True)
class UnitSetting:
    """One setting with one right value."""

    name: str
    query: str
    """Also its register: what a person may send to read it."""
    since: tuple[int, int]
    """First firmware that knows it."""
    form: str
    """Pattern of an answer; its first group is the value."""
    needed: str
    write: str
    """Sets it right."""
    why: str
    """What a wrong value does."""

    def value(self, answer: str | None) -> str | None:
        """The value in an answer; None when this unit does not have the setting. Numbers without sign and padding."""
        match = re.fullmatch(self.form, answer or "")
        if match is None:
            return None
        return f"{float(match[1]):g}" if re.fullmatch(r"[+-]?[\d.]+", match[1]) else match[1]


SOURCE = UnitSetting(
    "set-point source", "LSS", (10, 5), "([SAU])", UNSAVED, "LSS U",
    "after a loss of power it drives its last set-point again",
)  # fmt: skip
WRITTEN = (
    UnitSetting(
        "set-point ramp", "SR", (7, 11), r"([+-]?\d+(?:\.\d+)?)\s+\d+\s+\d+\s+\S+", "0", "SR 0 4",
        "its own ramp slows a vent down",
    ),
    UnitSetting(
        "active control at zero", "LCZA", (10, 5), r"([01])", "1", "LCZA 1",
        "at a set-point of 0 it shuts its valves and keeps the pressure",
    ),
    UnitSetting(
        "automatic tare", "ZCA", (10, 5), r"([01])(?:\s+\S+)?", "0", "ZCA 0",
        "it takes the pressure that a vent has left for zero",
    ),
    UnitSetting(
        "tare at power-up", "ZCP", (10, 5), r"([01])", "0", "ZCP 0",
        "after a loss of power it takes the pressure in the chambers for zero",
    ),
)  # fmt: skip
"""Those that are written when they are wrong; refused when the unit does not take that."""


def put_right(name: str, unit: AlicatUnit, version: tuple[int, int], settings: tuple[UnitSetting, ...]) -> None:
    """Read each setting that this firmware has, write it when it is wrong, read it back. Raises WrongDevice."""
    for setting in settings:
        if version < setting.since or (value := setting.value(unit.setting(setting.query))) in (None, setting.needed):
            continue
        unit.setting(setting.write)
        if (now := setting.value(unit.setting(setting.query))) != setting.needed:
            raise WrongDevice(
                name,
                f"unit {unit.letter}: {setting.name} (register {setting.query}) was {value}, is {now or 'not reported'} and must "
                f"be {setting.needed}, because {setting.why}; set it at its panel",
            )


def check_loop(name: str, unit: AlicatUnit) -> None:
    """Raises WrongDevice when the unit controls something other than gauge pressure."""
    loop = unit.loop_variable()
    if loop != Variable.GAUGE_SETPOINT:
        raise WrongDevice(
            name,
            f"unit {unit.letter} controls variable {loop}, not gauge pressure ({Variable.GAUGE_SETPOINT}; register 122); "
            "choose gauge pressure as its control variable",
        )


def check_source(name: str, unit: AlicatUnit, version: tuple[int, int]) -> str:
    """See that set-points come from the serial line and are forgotten without power; returns what falls short of that.

    Raises WrongDevice when they come from the analog input.
    """
    if version < SOURCE.since:
        return ""
    source = SOURCE.value(unit.setting(SOURCE.query))
    if source == ANALOG:
        raise WrongDevice(
            name,
            f"unit {unit.letter} takes its set-point from its analog input; set its set-point source to serial "
            f"(register {SOURCE.query} is {source}, {SOURCE.needed} is needed)",
        )
    if source == SAVED:
        unit.setting(SOURCE.write)
        source = SOURCE.value(unit.setting(SOURCE.query))
    if source != UNSAVED:
        return (
            f"unit {unit.letter}: set-point source (register {SOURCE.query}) is {source or 'not reported'} and cannot be set to "
            f"{UNSAVED}: {SOURCE.why}; choose the unsaved serial source at its panel"
        )
    return ""
