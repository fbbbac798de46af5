"""The persistent settings of an Alicat unit on which promises of safety rest: what each must be, and how it is put right.

A unit keeps them without power; panel, other programs and the maker's software change them. Each is known from a firmware on;
a unit that does not answer a query in its form does not have that setting.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from ..errors import WrongDevice
from .wire import AlicatUnit, Variable

ANALOG, SAVED, UNSAVED = "A", "S", "U"


@dataclass(frozen=True)
class Setting:
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


SOURCE = Setting(
    "set-point source", "LSS", (10, 5), "([SAU])", UNSAVED, "LSS U",
    "after a loss of power it drives its last set-point again",
)  # fmt: skip
WRITTEN = (
    Setting(
        "set-point ramp", "SR", (7, 11), r"([+-]?\d+(?:\.\d+)?)\s+\d+\s+\d+\s+\S+", "0", "SR 0 4",
        "its own ramp slows a vent down",
    ),
    Setting(
        "active control at zero", "LCZA", (10, 5), r"([01])", "1", "LCZA 1",
        "at a set-point of 0 it shuts its valves and keeps the pressure",
    ),
    Setting(
        "automatic tare", "ZCA", (10, 5), r"([01])(?:\s+\S+)?", "0", "ZCA 0",
        "it takes the pressure that a vent has left for zero",
    ),
    Setting(
        "tare at power-up", "ZCP", (10, 5), r"([01])", "0", "ZCP 0",
        "after a loss of power it takes the pressure in the chambers for zero",
    ),
)  # fmt: skip
"""Those that are written when they are wrong; refused when the unit does not take that."""


def put_right(name: str, unit: AlicatUnit, version: tuple[int, int], settings: tuple[Setting, ...]) -> None:
    """Read each setting that this firmware has, write it when it is wrong, read it back. Raises WrongDevice."""
    for setting in settings:
        if version < setting.since or (found := setting.value(unit.setting(setting.query))) in (None, setting.needed):
            continue
        unit.setting(setting.write)
        if (now := setting.value(unit.setting(setting.query))) != setting.needed:
            raise WrongDevice(
                name,
                f"unit {unit.letter}: {setting.name} (register {setting.query}) was {found}, is {now or 'not told'} and must "
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
            f"unit {unit.letter}: set-point source (register {SOURCE.query}) is {source or 'not told'} and cannot be set to "
            f"{UNSAVED}: {SOURCE.why}; choose the unsaved serial source at its panel"
        )
    return ""
