"""Figure and numbers of what sensors of the lab's own measured, state by state, under the name and unit of their driver."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from model.actuators import Words
from recordings.trials import Table

from ..files.units import unit_text
from .figures import Panel, colours, legend_below

PREFIX = "sensor_"


def quantities(table: Table) -> tuple[str, ...]:
    """The columns of sensors of the lab's own."""
    return tuple(name for name in table.columns if name.startswith(PREFIX))


def label(table: Table, column: str) -> str:
    """Sensor, quantity and unit."""
    return column.removeprefix(PREFIX) + unit_text(table.sensor_units.get(column, ""), ", ")


def sensors(table: Table, words: Words) -> list[Panel]:
    """Each quantity over the states in their order and over their pressure, a colour a spine length; bars: one standard
    deviation of the samples averaged."""
    return [
        partial(_panel, table=table, column=column, over=over, pascal=words.pascal)
        # the table of numbers has all
        for column in quantities(table)[:20]
        for over in ("state", f"highest {words.axis}")
    ]


def _panel(axis: Axes, table: Table, column: str, over: str, pascal: float) -> None:
    lengths = np.unique(table.spine_length).tolist()
    value, spread = table[column], table.get(f"sd_{column}", 0.0)
    places = np.arange(1, len(table) + 1) if over == "state" else table.pressures.max(axis=1) / pascal
    for length, colour in zip(lengths, colours(len(lengths)), strict=True):
        own = (table.spine_length == length) & np.isfinite(value)
        shown: dict[str, Any] = {
            "fmt": "o",
            "ms": 3.5,
            "lw": 0.8,
            "capsize": 2,
            "color": colour,
            "label": f"{100 * length:.0f} cm",
        }
        axis.errorbar(places[own], value[own], spread[own], **shown)
    axis.set_ylabel(label(table, column))
    axis.set_xlabel(over)
    if over == "state":
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
    if len(lengths) > 1:
        legend_below(axis, "spine")


def numbers(table: Table) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Head and rows of a table: each quantity's range over the states."""
    rows = []
    for column in quantities(table):
        value, spread = (c[np.isfinite(c)] for c in (table[column], table.get(f"sd_{column}")))
        noise = f"{np.sqrt(np.mean(spread**2)):.3g}" if len(spread) else ""
        rows.append((label(table, column), str(len(value)), *(f"{v:.6g}" for v in (value.min(), value.mean(), value.max())),
                     noise))  # fmt: skip
    return ("sensor and quantity", "states", "least", "mean", "greatest", "sd in a state"), rows
