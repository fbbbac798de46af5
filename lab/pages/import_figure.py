"""What was cut from a file: pressures and tip over time with the states that were taken, and the states in the robot's frame."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from recordings.own_files import replacing

from ..imports.table import Imported

MM, KPA = 1e3, 1e-3
MOST_POINTS = 4000
"""Of a line; more are not seen."""
GREYS = ("black", "0.45", "0.7")
STYLES = ("-", "--", ":", "-.")


def draw(made: Imported, length: float, path: Path) -> None:
    """Write the picture of an import (.svg, .png or .pdf)."""
    figure = plt.figure(figsize=(10, 6.5), layout="constrained")
    grid = figure.add_gridspec(2, 3, width_ratios=(1.3, 1.3, 1))
    pressure = figure.add_subplot(grid[0, :2])
    tip = figure.add_subplot(grid[1, :2], sharex=pressure)
    _over_time(made, pressure, tip)
    for k, axis in enumerate((0, 1)):
        _plane(made, axis, length, figure.add_subplot(grid[k, 2]))
    with replacing(path) as (file, _):
        figure.savefig(file, format=path.suffix.removeprefix("."), dpi=130)
    plt.close(figure)


def _over_time(made: Imported, pressure: Axes, tip: Axes) -> None:
    rows = iter(made.table.rows)
    for number, (_, q, cuts) in enumerate(made.files):
        every = max(1, len(q.t) // MOST_POINTS)
        for k in range(q.pressures.shape[1]):
            pressure.plot(
                q.t[::every], q.pressures[::every, k] * KPA, STYLES[k // 3 % 4], color=GREYS[k % 3], lw=1,
                label=f"p{k + 1}" if not number else None,
            )  # fmt: skip
        moved = (q.tip - np.nanmedian(q.tip, axis=0)) * MM
        for k, axis in enumerate("xyz"):
            tip.plot(
                q.t[::every], moved[::every, k], STYLES[k], color=GREYS[k], lw=1, label=axis if not number else None
            )
        for cut in cuts:
            t = q.t[cut.rows]
            for ax in (pressure, tip):
                ax.axvspan(t[0], max(t[-1], t[0] + 1e-6), color="tab:orange", alpha=0.35, lw=0)
            row = next(rows, None)
            if row is not None:
                pressure.plot([row.t], [max(row.pressures) * KPA], "o", ms=3, mfc="none", color="tab:orange")
    pressure.set(ylabel="pressure, kPa", title=f"{len(made.table)} states (orange)")
    tip.set(ylabel="tip beside its median, mm", xlabel="time, s")
    pressure.legend(fontsize="small", ncols=5, loc="upper left")
    tip.legend(fontsize="small", ncols=3, loc="upper left")


def _plane(made: Imported, axis: int, length: float, ax: Axes) -> None:
    tips = np.array([r.tip for r in made.table if r.tip is not None]) * MM
    highest = np.array([max(r.pressures) for r in made.table if r.tip is not None]) * KPA
    ax.plot([0, 0], [0, length * MM], color="0.6", lw=3, solid_capstyle="butt")
    ax.annotate("straight robot", (0, 0), (4, 4), textcoords="offset points", fontsize="small", color="0.4")
    dots = ax.scatter(tips[:, axis], tips[:, 2], c=highest, s=14, cmap="viridis")
    ax.figure.colorbar(dots, ax=ax, label="highest pressure, kPa")
    ax.set(xlabel=f"{'xy'[axis]}, mm", ylabel="z, mm")
    ax.set_aspect("equal", adjustable="datalim")
