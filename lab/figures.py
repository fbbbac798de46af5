"""Figures of measured data: tip curves, force over deflection, moduli. Drawn without a screen, legible in grey and by the colour-blind."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

if TYPE_CHECKING:
    from model.estimate import Estimate
    from recordings.trials import Table

    from .compare import Comparison

STYLE: dict[Any, Any] = {
    "font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "grid.alpha": 0.25,
    "figure.dpi": 110, "savefig.dpi": 150, "legend.frameon": False, "axes.titlesize": 10,
}  # fmt: skip


def colours(n: int) -> list[tuple[float, float, float, float]]:
    """n colours that also differ in lightness."""
    return [tuple(c) for c in plt.get_cmap("viridis")(np.linspace(0.0, 0.88, max(n, 2)))[:n]]


def save(figure: Figure, path: Path) -> Path:
    """Write and close."""
    figure.savefig(path, bbox_inches="tight")
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


def force_curves(table: Table, path: Path) -> Path:
    """Force over deflection of each stiffness trial."""
    with plt.rc_context(STYLE):
        figure, axis = plt.subplots(figsize=(4.6, 3.6), layout="constrained")
        trials = sorted({r.trial for r in table if r.force is not None})
        for trial, colour in zip(trials, colours(len(trials)), strict=True):
            rows = [r for r in table if r.trial == trial and r.force is not None and r.deflection is not None]
            axis.plot([1e3 * (r.deflection or 0) for r in rows], [r.force for r in rows], "o-", ms=3, lw=1, color=colour,
                      label=f"{rows[0].spine_length * 100:.0f} cm")  # fmt: skip
        axis.set_xlabel("deflection, mm")
        axis.set_ylabel("force, N")
        axis.legend(title="spine", fontsize=8)
        return save(figure, path)


def moduli(measured: Mapping[float, Estimate], reference: Mapping[float, float], path: Path) -> Path:
    """Apparent modulus of the spine over its length, with 95 % intervals, beside the paper's Table II."""
    with plt.rc_context(STYLE):
        figure, axis = plt.subplots(figsize=(4.6, 3.6), layout="constrained")
        x = np.array(list(measured)) * 100
        y = np.array([e.value for e in measured.values()]) / 1e6
        half = np.array([(e.interval[1] - e.interval[0]) / 2 for e in measured.values()]) / 1e6
        axis.errorbar(x, y, half, fmt="o", ms=4, capsize=3, color="#20639b", label="measured, 95 %")
        axis.plot([100 * k for k in reference], [v / 1e6 for v in reference.values()], "k--", lw=1, marker="s", ms=4, mfc="none",
                  label="paper, Table II")  # fmt: skip
        axis.set_xlabel("spine length, cm")
        axis.set_ylabel("Young's modulus, MPa")
        axis.legend(fontsize=8)
        return save(figure, path)
