"""Figures of measured data: tip curves, force over deflection, moduli; legible in grey and by the colour-blind."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib

from model.actuators import Chambers, Words
from recordings.own_files import replacing

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

if TYPE_CHECKING:
    from model.estimate import Estimate
    from recordings.trials import Table

    from ..comparison import Comparison

STYLE: dict[Any, Any] = {
    "font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "grid.alpha": 0.25,
    "figure.dpi": 110, "savefig.dpi": 150, "legend.frameon": False, "axes.titlesize": 10, "text.parse_math": False,
    "svg.hashsalt": "softlab",
}  # fmt: skip


BLUE, GREY = "#20639b", "#b9c3cb"


GIVEN, CALIBRATED, WITH_CAUSE = "uncalibrated", "calibrated", "with cause"
"""Names of the models in every figure and table."""
NEAREST = "with the closest hypothesis"
"""Name of the last where nothing is named."""


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


Panel = Callable[[Axes], None]
"""Draws one panel of a figure."""


def in_a_row(panels: Sequence[Panel], path: Path) -> Path:
    """All panels in one picture, two in a row."""
    rows = -(-len(panels) // 2)
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(rows, 2, figsize=(9, 3.8 * rows), layout="constrained", squeeze=False)
        for draw, axis in zip(panels, axes.flat, strict=False):
            draw(axis)
        for axis in axes.flat[len(panels) :]:
            axis.set_axis_off()
        return save(figure, path)


def apart(panels: Sequence[Panel], path: Path) -> list[Path]:
    """Each panel as a picture of its own, which a page can set in a row or one below the other."""
    made = []
    for k, draw in enumerate(panels):
        with plt.rc_context(STYLE):
            figure, axis = plt.subplots(figsize=(4.3, 3.6), layout="constrained")
            draw(axis)
            made.append(save(figure, path.with_stem(f"{path.stem}-{k}")))
    return made


def legend_below(axis: Axes, title: str | None = None) -> None:
    """A legend that no data can lie under."""
    axis.legend(title=title, loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=3, fontsize=8, title_fontsize=8)


def tip_curves(c: Comparison, words: Words = Chambers.words) -> list[Panel]:
    """Tip x and z over pressure, per spine length: measured marks (load up, unload down), model lines."""
    lengths = list(c.condition.by_spine_length())
    pressure = c.condition.pressure.max(axis=1) / words.pascal

    def panel(axis: Axes, k: int, name: str) -> None:
        for (length, own), colour in zip(lengths, colours(len(lengths)), strict=True):
            order = np.argsort(pressure[own])
            axis.plot(pressure[own][order], c.predicted[own][order, k] * 1e3, color=colour, lw=1.2)
            axis.plot([], [], color=colour, label=f"spine {length * 100:.0f} cm")
            for branch, mark in (("load", "^"), ("unload", "v")):
                rows = own & (c.branch == branch)
                face = "none" if branch == "unload" else colour
                axis.plot(pressure[rows], c.measured[rows, k] * 1e3, mark, ms=4, color=colour, mfc=face)
        axis.plot([], [], "k-", lw=1.2, label="model")
        axis.plot([], [], "k^", ms=4, label="measured, load")
        axis.plot([], [], "kv", ms=4, mfc="none", label="measured, unload")
        axis.set_xlabel(words.axis)
        axis.set_ylabel(name)
        legend_below(axis)

    return [
        lambda axis: panel(axis, 0, "tip x, mm (bending)"),
        lambda axis: panel(axis, 2, "tip z, mm (along the hanging rod)"),
    ]


def stiffness_curves(table: Table, measured: Mapping[float, Estimate], reference: Mapping[float, float]) -> list[Panel]:
    """Force over deflection of each trial, and the modulus it gives over the spine's length next to a reference."""

    def pushes(axis: Axes) -> None:
        read = table.take(np.isfinite(table.get("force")) & np.isfinite(table.get("deflection")))
        trials = np.unique(read.trial)
        for trial, colour in zip(trials, colours(len(trials)), strict=True):
            own = read.take(read.trial == trial)
            label = f"{own.spine_length[0] * 100:.0f} cm"
            axis.plot(1e3 * own["deflection"], own["force"], "o-", ms=3, lw=1, color=colour, label=label)
        axis.set_xlabel("deflection after contact, mm")
        axis.set_ylabel("force, N")
        legend_below(axis, "spine")

    return [pushes, _moduli(measured, reference)]


def _moduli(measured: Mapping[float, Estimate], reference: Mapping[float, float]) -> Panel:
    """Apparent modulus of the spine over its length, with 95 % intervals."""
    value = np.array([e.value for e in measured.values()]) / 1e6
    half = np.array([(e.interval[1] - e.interval[0]) / 2 for e in measured.values()]) / 1e6

    def panel(axis: Axes) -> None:
        known = [100 * k for k in reference], [v / 1e6 for v in reference.values()]
        axis.plot(*known, "k--", lw=1, label="paper, Table II")
        axis.errorbar(np.array(list(measured)) * 100, value, half, fmt="o", ms=4, capsize=3, color=BLUE, label="measured, 95 %")
        axis.set_xlabel("spine length, cm")
        axis.set_ylabel("Young's modulus, MPa")
        legend_below(axis)

    return panel


def story(
    measured: Mapping[float, Estimate], reference: Mapping[float, float], before: Comparison, after: Comparison
) -> list[Panel]:
    """A day in the lab: stiffness, the tip's way in the bending plane, and the error before and after."""
    moduli = _moduli(measured, reference)

    def stiffness(axis: Axes) -> None:
        moduli(axis)
        axis.set_title("the arm pushes: stiffness of the spine")

    def bending(axis: Axes) -> None:
        lengths = list(after.condition.by_spine_length())
        pressure = after.condition.pressure.max(axis=1) / 1e3
        for (length, own), colour in zip(lengths, colours(len(lengths)), strict=True):
            tip, name = -after.measured[own, 0] * 1e3, f"{length * 100:.0f} cm"
            axis.plot(pressure[own], tip, "o", ms=3.5, color=colour, label=name)
            order = np.argsort(pressure[own])
            for c, line in ((after, "-"), (before, ":")):
                axis.plot(pressure[own][order], -c.predicted[own][order, 0] * 1e3, line, lw=1, color=colour)
        axis.set_xlabel("pressure, kPa")
        axis.set_ylabel("tip deflection, mm")
        axis.set_title("chambers inflate: tip and model (dotted: paper's)")
        legend_below(axis, "spine")

    def errors(axis: Axes) -> None:
        at = np.arange(len(before.table.rows))
        for offset, c, shade, name in (
            (-0.2, before, GREY, "paper's parameters"),
            (0.2, after, BLUE, "area factor by length"),
        ):
            axis.bar(at + offset, [1e3 * r.rmse for r in c.table.rows], 0.38, color=shade, label=name)
        axis.set_xticks(at, [f"{r.spine_length * 100:.0f}" for r in before.table.rows])
        axis.set_xlabel("spine length, cm")
        axis.set_ylabel("tip error, mm rms")
        axis.set_title("model against measurement")
        legend_below(axis)

    return [stiffness, bending, errors]
