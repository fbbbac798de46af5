"""What was cut from a file: pressures and tip over time with the states and trials that were taken, and where each group of
chambers moves the tip."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection

from diagnosis.data.levels import pressure_gap
from model.actuators import Words
from model.arrays import Array
from model.robot import Robot
from recordings.trials import Table

from ..imports.table import Imported
from .figures import save

GREYS = ("black", "0.45", "0.7")
STYLES = ("-", "--", ":", "-.")
BESIDE: dict[str, Any] = {"fontsize": "small", "loc": "upper left", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.3}
"""A legend to the right of its panel."""
COLUMNS, MOST_GROUPS = 4, 7
"""Panels in a row at most, and groups of chambers that are drawn."""


def draw(imported: Imported, robot: Robot, path: Path) -> None:
    """Draw an import into a file (.svg, .png or .pdf): all rows over time, the tip from the side, and from the top by group."""
    states = imported.table.take(imported.table.with_tip)
    groups = _groups(states)
    most = sorted(groups, key=lambda g: -len(groups[g]))[:MOST_GROUPS]
    shown = {g: rows for g, rows in groups.items() if g in most}
    lines = -(-(len(shown) + 1) // COLUMNS)  # of panels, one of them for the side view
    columns = -(-(len(shown) + 1) // lines)
    words = robot.actuators.words
    figure = plt.figure(figsize=(10, 5.0 + 2.7 * lines), layout="constrained")
    grid = figure.add_gridspec(2, 1, height_ratios=(5.0, 2.7 * lines))
    over_time, planes = (figure.add_subfigure(grid[k]) for k in (0, 1))
    _over_time(imported, states, words, *over_time.subplots(2, 1, sharex=True))
    panels = planes.subplots(lines, columns, squeeze=False).ravel()
    dots = _side(states, robot, panels[0])
    for panel, (group, rows) in zip(panels[1:], shown.items(), strict=False):
        _top(states.take(np.array(rows)), group, states, robot, panel)
    for panel in panels[1 + len(shown) :]:
        panel.set_axis_off()
    planes.colorbar(dots, ax=panels.tolist(), label=f"highest {words.axis}")
    named = f"{len(shown)} of {len(groups)} groups" if len(shown) < len(groups) else "each group"
    planes.suptitle(
        f"Tip from the side, and along z for {named} of {words.actuators}; arrow: expected bending direction", fontsize="medium"
    )
    save(figure, path)


def _groups(states: Table) -> Mapping[tuple[int, ...], Sequence[int]]:
    """Indices of the states by the chambers inflated, from 1, in the order in which they come; without those at rest."""
    highest = states.pressures.max(axis=1, initial=-np.inf)
    rows = np.flatnonzero(highest > pressure_gap(states))
    inflated = states.pressures[rows] > 0.5 * highest[rows, None]
    groups, first, group = np.unique(inflated, axis=0, return_index=True, return_inverse=True)
    return {tuple((np.flatnonzero(groups[k]) + 1).tolist()): rows[group == k].tolist() for k in np.argsort(first)}


def _over_time(imported: Imported, states: Table, words: Words, pressure: Axes, tip: Axes) -> None:
    """Draw pressures and tip of all rows over time (s), with the rows that became states, and where trials begin."""
    for number, (_, q, cuts) in enumerate(imported.files):
        pressures, places = q.table.pressures, q.table.tip
        every = max(1, len(q.t) // 4000)  # more points cannot be seen
        for k in range(pressures.shape[1]):
            pressure.plot(
                q.t[::every], pressures[::every, k] / words.pascal, STYLES[k // 3 % 4], color=GREYS[k % 3], lw=1,
                label=f"p{k + 1}" if not number else None,
            )  # fmt: skip
        moved = (places - np.nanmedian(places, axis=0)) * 1e3
        for k, axis in enumerate("xyz"):
            tip.plot(q.t[::every], moved[::every, k], STYLES[k], color=GREYS[k], lw=1, label=axis if not number else None)
        taken = np.isin(np.arange(len(q.t)), np.r_[tuple(cut.rows for cut in cuts)] if cuts else [])
        for ax in (pressure, tip):
            ax.fill_between(q.t, 0, 1, taken, transform=ax.get_xaxis_transform(), color="tab:orange", alpha=0.35, lw=0)
    t = states.get("t")
    pressure.plot(t, states.pressures.max(axis=1) / words.pascal, "o", ms=3, mfc="none", color="tab:orange", label="state")
    begins = (t - states.get("hold", 0.0))[np.diff(states.trial, prepend=-1) != 0]
    for ax in (pressure, tip):
        ax.vlines(begins, 0, 1, transform=ax.get_xaxis_transform(), color="tab:blue", lw=0.6, label="trial begins")
        ax.legend(**BESIDE)
    pressure.set(ylabel=words.axis, title=f"{len(states)} states in {len(begins)} trials")
    tip.set(ylabel="tip minus its median, mm", xlabel="time, s")


def _dots(ax: Axes, x: Array, y: Array, colour: Array, **limits: Any) -> PathCollection:
    """Draw points (n,), each in a colour (n,); those that look the same are drawn once."""
    steps = [np.round(1000 * (v - v.min()) / max(float(np.ptp(v)), 1e-300)) for v in (x, y, colour)]
    shown = np.unique(np.column_stack(steps), axis=0, return_index=True)[1]
    return ax.scatter(x[shown], y[shown], c=colour[shown], s=14, cmap="viridis", **limits)


def _side(states: Table, robot: Robot, ax: Axes) -> PathCollection:
    """All tips, by their distance from the axis."""
    x, y, z = 1e3 * states.tip.T
    ax.plot([0, 0], [0, robot.length * 1e3], color="0.6", lw=3, solid_capstyle="butt")
    dots = _dots(ax, np.hypot(x, y), z, states.pressures.max(axis=1) / robot.actuators.words.pascal)
    ax.set_title("side; grey: straight robot", fontsize="small")
    width = 1e3 * max(0.7 * robot.length, 1.1 * float(np.hypot(*states.tip[:, :2].T).max()))
    ax.set(xlabel="from the axis, mm", ylabel="z, mm", xlim=(-0.05 * width, width))
    ax.set_aspect("equal")
    return dots


def _top(of_group: Table, group: Sequence[int], states: Table, robot: Robot, ax: Axes) -> None:
    """Tips of the states of one group, and the direction in which the chambers push them."""
    pascal = robot.actuators.words.pascal
    highest = states.pressures.max(axis=1) / pascal
    x, y, _ = 1e3 * of_group.tip.T
    size = 1.1 * 1e3 * max(float(np.abs(states.tip[:, :2]).max()), 1e-3)
    towards, roll = robot.bending_directions, of_group.get("roll_deg", 0.0)
    wired = of_group.pressures.shape[1] == len(towards)
    pushes = (of_group.pressures @ towards) * np.exp(1j * np.radians(roll)) if wired else np.zeros(0)
    pushed = dict(zip(np.round(roll).tolist(), pushes.tolist(), strict=False))
    # a push across the axis below a tenth of the pressures' sum has no direction: they balance each other
    weak = 0.1 * float(of_group.pressures.sum(axis=1).max())
    at_rest = 1e3 * states.tip[states.pressures.max(axis=1) <= pressure_gap(states), :2]
    start = complex(*at_rest.mean(axis=0)) if len(at_rest) else 0j
    for push in (p / abs(p) for p in pushed.values() if abs(p) > weak):
        end = start + 0.9 * (size - max(abs(start.real), abs(start.imag))) * push
        ax.annotate("", (end.real, end.imag), (start.real, start.imag), arrowprops={"arrowstyle": "->", "color": "0.6"})
    _dots(ax, x, y, of_group.pressures.max(axis=1) / pascal, vmin=highest.min(), vmax=highest.max())
    ax.set_title(" + ".join(f"p{c}" for c in group), fontsize="small")
    ax.set(xlabel="x, mm", ylabel="y, mm", xlim=(-size, size), ylim=(-size, size))
    ax.set_aspect("equal")
