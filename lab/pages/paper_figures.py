"""The figures of `lab paper`: model curves, backbones, the integrator's share of the error, area factors."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from .figures import STYLE, colours, save

Array = NDArray[np.float64]
PAPER, OURS = "#8a8a8a", "#b5382a"
"""Published values in grey, computed ones in a red that differs from it in lightness too."""


def curves(lengths: Array, pressures: Array, converged: Array, euler: Array, steps: int, path: Path) -> Path:
    """Tips (l, p, 3) m over pressure (Pa) for each spine length (m): sideways and down, as in the paper's Fig. 5."""
    with plt.rc_context({**STYLE, "figure.constrained_layout.wspace": 0.06}):
        figure, axes = plt.subplots(1, 2, figsize=(9.6, 4.2), layout="constrained")
        kpa = pressures / 1e3
        for axis, k, sign, name in ((axes[0], 0, -1, "x, sideways (mm)"), (axes[1], 2, 1, "y, down (mm)")):
            for i, colour in enumerate(colours(len(lengths))):
                axis.plot(kpa, sign * converged[i, :, k] * 1e3, color=colour, lw=1.6)
                axis.plot(kpa, sign * euler[i, :, k] * 1e3, "o", ms=4.5, mfc="none", mew=0.9, color=colour)
            ends = sign * converged[:, -1, k] * 1e3
            _label_ends(axis, kpa[-1], ends, lengths)
            axis.set_xlabel("pressure in three chambers (kPa)")
            axis.set_ylabel(f"tip {name}")
            axis.set_xticks(kpa)
        axes[0].plot([], [], color="0.25", lw=1.6, label="converged rod")
        axes[0].plot([], [], "o", ms=4.5, mfc="none", color="0.25", label=f"Euler, {steps} steps")
        axes[0].legend(loc="upper left")
        return save(figure, path)


def backbones(lengths: Array, shapes: Array, arcs: Array, pressure: float, path: Path) -> Path:
    """Hanging backbones (l, k, 3) m at one pressure (Pa); thick where arc length `arcs` (k,) m is within the spine."""
    with plt.rc_context(STYLE):
        figure, axis = plt.subplots(figsize=(4.8, 5.2), layout="constrained")
        for i, (length, shape, colour) in enumerate(zip(lengths, shapes, colours(len(lengths)), strict=True)):
            x, z = -shape[:, 0] * 1e3, shape[:, 2] * 1e3
            inside = arcs <= length + 1e-9
            # Short spines on top of long ones, or the longest would hide them all.
            axis.plot(x[inside], z[inside], color=colour, lw=5, solid_capstyle="butt", zorder=3 - 0.1 * i)
            axis.plot(x, z, color=colour, lw=1.5, zorder=3 - 0.1 * i, label=f"{length * 100:g} cm")
            axis.plot(x[-1], z[-1], "o", ms=5, color=colour)
        axis.set_aspect("equal")
        axis.invert_yaxis()
        axis.margins(0.06)
        axis.set_xlabel("x, sideways (mm)")
        axis.set_ylabel("y, down (mm)")
        axis.set_title(f"{pressure / 1e3:g} kPa; thick: holds the spine")
        axis.legend(title="spine", loc="upper right")
        return save(figure, path)


def errors(lengths: Array, published: Array, integrator: Array, steps: int, path: Path) -> Path:
    """Mean errors (l, 2) m in the paper's X and Y: model against measurement, and the integrator's part."""
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.4), layout="constrained")
        at = np.arange(len(lengths))
        for k, (axis, name) in enumerate(zip(axes, ("X, sideways", "Y, down"), strict=True)):
            for values, shift, colour, label in (
                (published, -0.2, PAPER, "Table III: paper's model against measurement"),
                (integrator, 0.2, OURS, f"integrator alone: Euler, {steps} steps, against converged"),
            ):
                bars = axis.bar(at + shift, values[:, k] * 1e3, 0.38, color=colour, label=label)
                axis.bar_label(bars, fmt="%.1f", fontsize=7, padding=1, color="0.25")
            axis.set_xticks(at, [f"{length * 100:g}" for length in lengths])
            axis.grid(False, axis="x")
            axis.set_xlabel("spine length (cm)")
            axis.set_ylabel("mean absolute error (mm)")
            axis.set_title(name, loc="left")
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=2)
        return save(figure, path)


def area_factors(lengths: Array, published: Array, converged: Array, steps: int, path: Path) -> Path:
    """A_effect / A_norm over spine length (m): as published, and what the converged rod needs for the same curves."""
    with plt.rc_context(STYLE):
        figure, axis = plt.subplots(figsize=(4.8, 3.6), layout="constrained")
        cm = lengths * 100
        axis.plot(cm, published, "-s", ms=5, lw=1.2, color=PAPER, label="as published")
        label = f"converged rod, fitted to the\ncurves of Euler with {steps} steps"
        axis.plot(cm, converged, "-o", ms=5, lw=1.2, mfc="none", color=OURS, label=label)
        axis.axhline(1.0, color="0.4", lw=0.8, ls=":")
        axis.annotate("geometric area", (cm[-1], 1.0), (0, 3), textcoords="offset points", ha="right", fontsize=8)
        axis.set_ylim(0.9, None)
        axis.set_xticks(cm)
        axis.set_xlabel("spine length (cm)")
        axis.set_ylabel("effective / geometric chamber area")
        axis.legend(loc="upper left")
        return save(figure, path)


def _label_ends(axis: Axes, x: float, ends: Array, lengths: Array) -> None:
    """Write the spine lengths (m) right of the curves' ends, pushed apart where they would overlap."""
    low, high = axis.get_ylim()
    gap = 0.045 * (high - low)
    order = np.argsort(ends)
    places = ends[order].copy()
    for _ in range(100):
        overlap = np.maximum(0.0, gap - np.diff(places))
        places[1:] += 0.5 * overlap
        places[:-1] -= 0.5 * overlap
    shades = colours(len(lengths))
    for place, index in zip(places, order, strict=True):
        text = f"{lengths[index] * 100:g} cm"
        axis.annotate(text, (x, place), (x + 7, place), va="center", fontsize=8, annotation_clip=False, color=shades[index])
    above = max(float(places[-1]), high) + gap
    axis.annotate("spine", (x, above), (x + 7, above), va="center", fontsize=8, annotation_clip=False, color="0.3")
