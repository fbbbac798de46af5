"""Tables as loggers, spreadsheets and motion capture write them, made up; one robot of three chambers bends in all of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

HEADINGS = ("Time [s]", "P1 [kPa]", "P2 [kPa]", "P3 [kPa]", "Tip X [mm]", "Tip Y [mm]", "Tip Z [mm]")
BARE = tuple(h.split(" [")[0] for h in HEADINGS)
UNITS = ("s", "kPa", "kPa", "kPa", "mm", "mm", "mm")
LEVELS = (0.0, 15.0, 35.0, 15.0, 0.0)
Row = Sequence[float]
Change = Callable[[int, list[str]], list[str]]


def bent(chamber: int, level: float, turn: float) -> tuple[float, float, float]:
    """mm, where the tip of 150 mm stands with one chamber at a level (kPa), for a turn of rad/kPa."""
    azimuth, angle = math.radians(120 * chamber), turn * level or 1e-9
    across, along = 150 * (1 - math.cos(angle)) / angle, 150 * math.sin(angle) / angle
    return -across * math.cos(azimuth), -across * math.sin(azimuth), along


def sweep(each: int = 1, step: float = 0.04, turn: float = 0.005) -> list[list[float]]:
    """s, kPa, mm: three chambers one after the other, twice; `each` rows of every level; it turns about as the rod does."""
    out: list[list[float]] = []
    for chamber in (0, 1, 2, 0, 1, 2):
        for level in LEVELS:
            for _ in range(each):
                jitter = 0.02 * math.sin(5.3 * len(out))
                pressures = [level * (k == chamber) + jitter for k in range(3)]
                tip = [v + jitter for v in bent(chamber, level, turn)]
                out.append([len(out) * (4.0 if each == 1 else step), *pressures, *tip])
    return out


STATES = 30
PLATEAUS = 25
"""Of `sweep`: a chamber's last rest and the next one's first are one."""


def text(
    rows: Sequence[Row],
    separator: str = ",",
    headings: Sequence[str] = HEADINGS,
    change: Change = lambda k, c: c,
    end: str = "\n",
) -> str:
    """A table with headings; `change` gets the number of a row and its cells."""
    lines = [separator.join(change(k, [f"{v:.3f}" for v in row])) for k, row in enumerate(rows)]
    return end.join([*([separator.join(headings)] if headings else []), *lines]) + end


def comma(cells: list[str], *columns: int) -> list[str]:
    """The same cells, some with a decimal comma."""
    return [c.replace(".", ",") if k in columns else c for k, c in enumerate(cells)]
