"""Figure and numbers of what sensors of the lab's own measured, state by state, under the name and unit of their driver."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from recordings.trials import Table, TrialRow

from ..files.units import unit_text
from .figures import STYLE, colours, plt, save

PREFIX = "sensor_"
MOST = 20
"""Quantities that are drawn; the table of numbers has all."""
HEIGHT = 2.3
"""Inches a quantity."""


def quantities(table: Table) -> tuple[str, ...]:
    """The columns of sensors of the lab's own."""
    return tuple(name for name in table.columns if name.startswith(PREFIX))


def label(table: Table, column: str) -> str:
    """Sensor, quantity and unit."""
    return column.removeprefix(PREFIX) + unit_text(table.sensor_units.get(column, ""), ", ")


def sensors(table: Table, path: Path) -> Path:
    """Each quantity over the states in their order and over their pressure, a colour a spine length; bars: one standard
    deviation of the samples averaged."""
    columns = quantities(table)[:MOST]
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(
            len(columns), 2, figsize=(9, 0.6 + HEIGHT * len(columns)), layout="constrained", squeeze=False, sharey="row"
        )
        lengths = sorted({row.spine_length for row in table})
        for column, (left, right) in zip(columns, axes, strict=True):
            for length, colour in zip(lengths, colours(len(lengths)), strict=True):
                _drawn(left, right, table, column, length, colour)
            left.set_ylabel(label(table, column))
            left.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes[-1][0].set_xlabel("state")
        axes[-1][1].set_xlabel("highest pressure, kPa")
        if len(lengths) > 1:
            _legend(figure, lengths)
        return save(figure, path)


def _legend(figure: Figure, lengths: list[float]) -> None:
    marks = [Line2D([], [], marker="o", ls="", ms=3.5, color=c) for c in colours(len(lengths))]
    figure.legend(marks, [f"{100 * k:.0f} cm" for k in lengths], title="spine", loc="outside right upper", fontsize=8)


def _drawn(left: Axes, right: Axes, table: Table, column: str, length: float, colour: object) -> None:
    rows: list[tuple[int, TrialRow]] = [
        (number, row) for number, row in enumerate(table, 1) if row.spine_length == length and column in row.sensors
    ]
    value = np.array([row.sensors[column] for _, row in rows])
    spread = np.array([row.sd.get(column, 0.0) for _, row in rows])
    for axis, places in (
        (left, [number for number, _ in rows]),
        (right, [max(row.pressures) / 1e3 for _, row in rows]),
    ):
        axis.errorbar(places, value, spread, fmt="o", ms=3.5, lw=0.8, capsize=2, color=colour)  # type: ignore[arg-type]


def numbers(table: Table) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Head and rows of a table: each quantity's range over the states."""
    rows = []
    for column in quantities(table):
        value = np.array([row.sensors[column] for row in table if column in row.sensors])
        spread = np.array([row.sd[column] for row in table if column in row.sd])
        noise = f"{np.sqrt(np.mean(spread**2)):.3g}" if len(spread) else ""
        rows.append((label(table, column), str(len(value)), *(f"{v:.6g}" for v in (value.min(), value.mean(), value.max())),
                     noise))  # fmt: skip
    return ("sensor and quantity", "states", "least", "mean", "greatest", "sd in a state"), rows
