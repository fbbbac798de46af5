"""Figures of measured and predicted data, legible in grey and by the colour-blind."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib

from model.actuators import Chambers, Words
from model.errors import unit_text
from recordings.own_files import replacing
from recordings.trials import Table

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from model.arrays import Array

if TYPE_CHECKING:
    from model.prediction import Prediction
    from model.prediction.inverse import Reached

    from ..comparison import Comparison


STYLE: dict[Any, Any] = {
    "font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "grid.alpha": 0.25,
    "figure.dpi": 110, "savefig.dpi": 150, "legend.frameon": False, "axes.titlesize": 10, "text.parse_math": False,
    "svg.hashsalt": "softlab", "axes.titlelocation": "left",
}  # fmt: skip

BLUE, GREY = "#20639b", "#b9c3cb"


def colours(n: int) -> list[tuple[float, float, float, float]]:
    """n colours that also differ in lightness."""
    return [tuple(c) for c in plt.get_cmap("viridis")(np.linspace(0.0, 0.88, max(n, 2)))[:n]]


def save(figure: Figure, path: Path) -> Path:
    """Write and close; the same figure is the same file, on every day."""
    kind = path.suffix.lower().removeprefix(".")
    with replacing(path) as (file, _):
        figure.savefig(file, format=kind, bbox_inches="tight", metadata={"Date": None} if kind == "svg" else None)
    plt.close(figure)
    return path


@contextmanager
def drawing(
    path: Path, size: tuple[float, float], rows: int = 1, columns: int = 1, style: dict[Any, Any] = STYLE, **how: Any
) -> Iterator[tuple[Figure, Any]]:
    """Yield a figure (`size` in inches) and its axes, `how` as for `plt.subplots`; write it to `path` at the end of the block."""
    with plt.rc_context(STYLE | style):
        figure, axes = plt.subplots(rows, columns, figsize=size, layout="constrained", **how)
        yield figure, axes
        save(figure, path)


Panel = Callable[[Axes], None]


def in_a_row(panels: Sequence[Panel], path: Path) -> Path:
    """All panels in one picture, two in a row."""
    rows = -(-len(panels) // 2)
    with drawing(path, (9, 3.8 * rows), rows, 2, squeeze=False) as (_, axes):
        for draw, axis in zip(panels, axes.flat, strict=False):
            draw(axis)
        for axis in axes.flat[len(panels) :]:
            axis.set_axis_off()
    return path


def apart(panels: Sequence[Panel], path: Path) -> list[Path]:
    """Each panel as a picture of its own, which a page can set in a row or one below the other."""
    paths = [path.with_stem(f"{path.stem}-{k}") for k in range(len(panels))]
    for place, draw in zip(paths, panels, strict=True):
        with drawing(place, (4.3, 3.6)) as (_, axis):
            draw(axis)
    return paths


def legend_below(axis: Axes, title: str | None = None) -> None:
    """A legend that no data can lie under."""
    axis.legend(title=title, loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=3, fontsize=8, title_fontsize=8)


def tip_curves(c: Comparison, words: Words = Chambers.words) -> list[Panel]:
    """Tip x and z over pressure, per spine length: measured marks (load up, unload down), model lines."""
    lengths = list(c.condition.by_spine_length())
    pressure = c.condition.pressure.max(axis=1) / words.pascal

    def panel(axis: Axes, k: int, name: str) -> None:
        for (length, selected), colour in zip(lengths, colours(len(lengths)), strict=True):
            order = np.argsort(pressure[selected])
            label = f"spine {length * 100:.0f} cm" if len(lengths) > 1 else None
            axis.plot(pressure[selected][order], c.predicted[selected][order, k] * 1e3, color=colour, lw=1.2, label=label)
            for branch, mark in (("load", "^"), ("unload", "v")):
                rows = selected & (c.branch == branch)
                face = "none" if branch == "unload" else colour
                axis.plot(pressure[rows], c.measured[rows, k] * 1e3, mark, ms=4, color=colour, mfc=face)
        axis.plot([], [], "k-", lw=1.2, label="model")
        axis.plot([], [], "k^", ms=4, label="measured, load")
        axis.plot([], [], "kv", ms=4, mfc="none", label="measured, unload")
        axis.set(xlabel=words.axis, ylabel=name)
        legend_below(axis)

    return [lambda axis: panel(axis, 0, "tip x, mm (bending)"), lambda axis: panel(axis, 2, "tip z, mm (along the hanging rod)")]


def tips(pressure: Array, spine_length: Array, prediction: Prediction, path: Path, words: Words) -> Path:
    """Draw x, y and z of the predicted tip over the highest pressure (n,) Pa, a colour for each spine length (n,) m."""
    low, high = prediction.interval()
    lengths = np.unique(np.round(spine_length, 4))
    with drawing(path, (11, 3.6), 1, 3) as (_, axes):
        for length, colour in zip(lengths, colours(len(lengths)), strict=True):
            selected = np.flatnonzero(np.round(spine_length, 4) == length)
            pressures = pressure[selected] / words.pascal
            for k, axis in enumerate(axes):
                middle, half = 1e3 * prediction.tip[selected, k], 1e3 * (high - low)[selected, k] / 2
                axis.errorbar(pressures, middle, half, fmt="o", ms=2.5, lw=0.9, capsize=2, color=colour)
            axes[0].plot([], [], "o", ms=3, color=colour, label=f"{100 * length:.3g} cm")
        for k, axis in enumerate(axes):
            axis.set(xlabel=f"highest {words.axis}", ylabel=f"tip {'xyz'[k]}, mm")
        axes[0].set_title("bars: 95 % interval of a reading")
        if 1 < len(lengths) <= 12:
            axes[0].legend(title="spine", fontsize=8, ncols=2)
    return path


def targets(wanted: Array, reached: Reached, path: Path) -> Path:
    """Draw targets (m, 3) m and expected tips with intervals from two sides; a free coordinate (NaN) is that of the tip."""
    tip = reached.prediction.tip
    place = np.where(np.isfinite(wanted), wanted, tip)
    low, high = reached.prediction.interval(model_only=True)
    with drawing(path, (9, 4), 1, 2) as (_, axes):
        for axis, (i, j) in zip(axes, ((0, 2), (0, 1)), strict=True):
            axis.errorbar(
                1e3 * tip[:, i], 1e3 * tip[:, j], 1e3 * (high - low)[:, j] / 2, 1e3 * (high - low)[:, i] / 2,
                fmt=".", ms=3, lw=0.8, color="0.25", label="expected tip, 95 % interval",
            )  # fmt: skip
            for selected, mark, label in ((reached.reached, "o", "target"), (~reached.reached, "x", "target out of reach")):
                axis.plot(1e3 * place[selected, i], 1e3 * place[selected, j], mark, ms=7, mfc="none", color="black", label=label)
            axis.plot(1e3 * np.stack([place[:, i], tip[:, i]]), 1e3 * np.stack([place[:, j], tip[:, j]]), ":", color="0.5")
            axis.set_aspect("equal", "datalim")
            axis.set(xlabel=f"{'xyz'[i]}, mm", ylabel=f"{'xyz'[j]}, mm")
        axes[0].legend(fontsize=8)
    return path


PREFIX = "sensor_"
"""Of the columns of sensors of the lab's own."""


def quantities(table: Table) -> tuple[str, ...]:
    """The columns of sensors of the lab's own."""
    return tuple(name for name in table.columns if name.startswith(PREFIX))


def label(table: Table, column: str) -> str:
    """Sensor, quantity and unit."""
    return column.removeprefix(PREFIX) + unit_text(table.sensor_units.get(column, ""), ", ")


def sensors(table: Table, words: Words) -> list[Panel]:
    """Each quantity over the states in order and over their pressure, coloured by spine length; bars: one standard deviation."""
    return [
        partial(_panel, table=table, column=column, over=over, pascal=words.pascal)
        # the table of numbers has all
        for column in quantities(table)[:20]
        for over in ("state", f"highest {words.axis}")
    ]


def _panel(axis: Axes, table: Table, column: str, over: str, pascal: float) -> None:
    """Draw a sensor's quantity over the number of the state, or over its highest pressure in units of `pascal` Pa."""
    lengths = np.unique(table.spine_length).tolist()
    value, spread = table[column], table.get(f"sd_{column}", 0.0)
    places = np.arange(1, len(table) + 1) if over == "state" else table.pressures.max(axis=1) / pascal
    for length, colour in zip(lengths, colours(len(lengths)), strict=True):
        selected = (table.spine_length == length) & np.isfinite(value)
        axis.errorbar(
            places[selected], value[selected], spread[selected], fmt="o", ms=3.5, lw=0.8, capsize=2, color=colour,
            label=f"{100 * length:.0f} cm",
        )  # fmt: skip
    axis.set(xlabel=over, ylabel=label(table, column))
    if over == "state":
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
    if len(lengths) > 1:
        legend_below(axis, "spine")


def numbers(table: Table) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Head and rows of a table: each quantity's range over the states."""
    rows = []
    for column in quantities(table):
        value, spread = (c[np.isfinite(c)] for c in (table[column], table.get(f"sd_{column}")))
        rows.append((label(table, column), str(len(value)), *(f"{v:.6g}" for v in (value.min(), value.mean(), value.max())),
                     f"{np.sqrt(np.mean(spread**2)):.3g}" if len(spread) else ""))  # fmt: skip
    return ("sensor and quantity", "states", "least", "mean", "greatest", "sd in a state"), rows
