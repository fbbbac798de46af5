"""Who is on the line: which units answer, with which firmware, and whether they are pressure controllers."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Sequence

from ..errors import BadReply, NoReply, Unreachable, WrongDevice
from ..serial_line import SerialLine, show
from .wire import AlicatUnit

UNASKED = 0.2
"""Host seconds in which a unit in streaming mode sends by itself; it does so every 50 ms unless told otherwise."""


def find_units(name: str, line: SerialLine, units: Sequence[AlicatUnit], twice: Callable[[Callable[[], str]], str]) -> list[str]:
    """Firmware of each unit; `twice` makes a request that may be repeated.

    Raises `Unreachable` naming the silent ones, `WrongDevice` for foreign answers and for what sends unasked.
    """
    firmwares: dict[str, str] = {}
    for unit in units:
        with contextlib.suppress(NoReply):
            try:
                firmwares[unit.letter] = twice(unit.firmware)
            except BadReply as e:
                raise _foreign(name, line, unit, e) from e
    silent = [unit.letter for unit in units if unit.letter not in firmwares]
    if silent:
        answered = ", ".join(firmwares) or "none"
        raise Unreachable(
            name,
            f"no answer from unit {', '.join(silent)} on {line.port} at {line.baud} Bd (answered: {answered}); check power, "
            "cable, and the letter and baud rate in the unit's menu",
        )
    return list(firmwares.values())


def _foreign(name: str, line: SerialLine, unit: AlicatUnit, e: BadReply) -> WrongDevice:
    line.flush()
    if heard := line.listen(UNASKED):
        return WrongDevice(
            name,
            f"something on {line.port} sends {show(heard)} without being asked: a unit in streaming mode (stop it with "
            f"`@@ {unit.letter}`) or another device; check port and baud rate in rig.yaml",
        )
    return WrongDevice(
        name,
        f"the device on {line.port} at {line.baud} Bd is not Alicat unit {unit.letter} ({e.message}); check port and baud "
        "rate in rig.yaml",
    )


def pressure_controller(name: str, unit: AlicatUnit) -> tuple[str, str]:
    """Model and serial number of a unit; raises `WrongDevice` when it controls no pressure."""
    model, serial = unit.model_and_serial()
    if not re.match(r"E?PC|IVC", model):
        raise WrongDevice(
            name,
            f"unit {unit.letter} is a {model or 'device without a model name'}; a pressure controller (PC, PCD) is needed",
        )
    return model, serial


def version_of(firmware: str) -> tuple[int, int]:
    """Firmware as numbers; the oldest has none."""
    match = re.match(r"(\d+)v(\d+)", firmware)
    return (int(match[1]), int(match[2])) if match else (0, 0)
