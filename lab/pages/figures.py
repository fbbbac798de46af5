"""Figures of measured data: tip curves, force over deflection, moduli; legible in grey and by the colour-blind."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib

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


GIVEN, CALIBRATED, WITH_CAUSE = "as given", "calibrated", "with cause"
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


def tip_curves(c: Comparison, path: Path) -> Path:
    """Tip x and z over pressure, per spine length: measured marks (load up, unload down), model lines."""
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
        lengths = list(c.condition.by_spine_length())
        pressure = c.condition.pressure.max(axis=1) / 1e3
        for (length, own), colour in zip(lengths, colours(len(lengths)), strict=True):
            for axis, k in zip(axes, (0, 2), strict=True):
                order = np.argsort(pressure[own])
                axis.plot(pressure[own][order], c.predicted[own][order, k] * 1e3, color=colour, lw=1.2)
                for branch, mark in (("load", "^"), ("unload", "v")):
                    rows = own & (c.branch == branch)
                    axis.plot(
                        pressure[rows],
                        c.measured[rows, k] * 1e3,
                        mark,
                        ms=4,
                        color=colour,
                        mfc="none" if branch == "unload" else colour,
                    )
            axes[0].plot([], [], color=colour, label=f"{length * 100:.0f} cm")
        _label(axes[0], "tip x, mm (bending)")
        _label(axes[1], "tip z, mm (along the hanging rod)")
        axes[0].legend(title="spine", ncols=2, fontsize=8)
        axes[1].plot([], [], "k-", lw=1.2, label="model")
        axes[1].plot([], [], "k^", ms=4, label="measured, load")
        axes[1].plot([], [], "kv", ms=4, mfc="none", label="measured, unload")
        axes[1].legend(fontsize=8)
        return save(figure, path)


def _label(axis: Axes, text: str) -> None:
    axis.set_xlabel("pressure, kPa")
    axis.set_ylabel(text)


def stiffness_curves(
    table: Table, measured: Mapping[float, Estimate], reference: Mapping[float, float], path: Path
) -> Path:
    """Force over deflection of each trial, and the modulus it gives over the spine's length beside a reference."""
    with plt.rc_context(STYLE):
        figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
        trials = sorted({r.trial for r in table if r.force is not None})
        for trial, colour in zip(trials, colours(len(trials)), strict=True):
            rows = [r for r in table if r.trial == trial and r.force is not None and r.deflection is not None]
            way, force = [1e3 * (r.deflection or 0.0) for r in rows], [r.force for r in rows]
            left.plot(way, force, "o-", ms=3, lw=1, color=colour, label=f"{rows[0].spine_length * 100:.0f} cm")
        left.set_xlabel("deflection after contact, mm")
        left.set_ylabel("force, N")
        left.legend(title="spine", fontsize=8)
        _moduli(right, measured, reference)
        return save(figure, path)


def _moduli(axis: Axes, measured: Mapping[float, Estimate], reference: Mapping[float, float]) -> None:
    """Apparent modulus of the spine over its length, with 95 % intervals."""
    value = np.array([e.value for e in measured.values()]) / 1e6
    half = np.array([(e.interval[1] - e.interval[0]) / 2 for e in measured.values()]) / 1e6
    axis.plot([100 * k for k in reference], [v / 1e6 for v in reference.values()], "k--", lw=1, label="paper, Table II")
    axis.errorbar(
        np.array(list(measured)) * 100, value, half, fmt="o", ms=4, capsize=3, color=BLUE, label="measured, 95 %"
    )
    axis.set_xlabel("spine length, cm")
    axis.set_ylabel("Young's modulus, MPa")
    axis.legend(fontsize=8)


def story(
    measured: Mapping[float, Estimate],
    reference: Mapping[float, float],
    before: Comparison,
    after: Comparison,
    path: Path,
) -> Path:
    """One picture of a day in the lab: stiffness, the tip's way in the bending plane, and the error before and after."""
    with plt.rc_context(STYLE):
        figure, (left, middle, right) = plt.subplots(1, 3, figsize=(11, 3.7), layout="constrained")
        _moduli(left, measured, reference)
        left.set_title("the arm pushes: stiffness of the spine")
        lengths = list(after.condition.by_spine_length())
        pressure = after.condition.pressure.max(axis=1) / 1e3
        for (length, own), colour in zip(lengths, colours(len(lengths)), strict=True):
            middle.plot(
                pressure[own], -after.measured[own, 0] * 1e3, "o", ms=3.5, color=colour, label=f"{length * 100:.0f} cm"
            )
            order = np.argsort(pressure[own])
            for c, line in ((after, "-"), (before, ":")):
                middle.plot(pressure[own][order], -c.predicted[own][order, 0] * 1e3, line, lw=1, color=colour)
        middle.set_xlabel("pressure, kPa")
        middle.set_ylabel("tip deflection, mm")
        middle.set_title("three chambers inflate: tip and model (dotted: paper's)")
        middle.legend(title="spine", fontsize=7, loc="upper left")
        at = np.arange(len(before.table.rows))
        for offset, c, shade, name in (
            (-0.2, before, GREY, "paper's parameters"),
            (0.2, after, BLUE, "area factor by length"),
        ):
            right.bar(at + offset, [1e3 * r.rmse for r in c.table.rows], 0.38, color=shade, label=name)
        right.set_xticks(at, [f"{r.spine_length * 100:.0f}" for r in before.table.rows])
        right.set_xlabel("spine length, cm")
        right.set_ylabel("tip error, mm rms")
        right.set_title("model against measurement")
        right.legend(fontsize=8)
        return save(figure, path)
