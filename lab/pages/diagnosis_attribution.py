"""Figures of a diagnosis: which effects the data tell apart, and how large the named one is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.patches import Rectangle

from .figures import STYLE, save

BLUE, RED, GREY = "#20639b", "#b5382a", "#8a8a8a"
SMALLEST, LARGEST = 1.0, 1000.0
"""Ends of the colour scale of separations."""
PROBABLE = 0.01
"""Effects more probable than this are in bold."""


def distinguishability(found: Mapping[str, Any], path: Path) -> Path:
    """T of each effect (row) against each other fitted in its place (column); ties framed, probable effects first."""
    effects, tied = found["effects"], found["tied_below"]
    n, values = len(effects), np.array(found["separation"], float)
    with plt.rc_context(STYLE):
        figure, axis = plt.subplots(figsize=(2.6 + 0.33 * n, 2.0 + 0.3 * n), layout="constrained")
        image = axis.imshow(
            np.clip(values, SMALLEST, LARGEST), norm=LogNorm(SMALLEST, LARGEST), cmap="viridis", aspect="auto"
        )
        for i in range(n):
            for j in range(n):
                dark = values[i, j] < 60
                axis.text(
                    j, i, _short(values[i, j]), ha="center", va="center", fontsize=5.5, color="w" if dark else "k"
                )
                if values[i, j] < tied:
                    axis.add_patch(Rectangle((j - 0.46, i - 0.46), 0.92, 0.92, fill=False, ec=RED, lw=1.3))
        axis.set_xticks(range(n), effects, rotation=90, fontsize=7.5)
        axis.set_yticks(range(n), effects, fontsize=7.5)
        for label, weight in zip((*axis.get_xticklabels(), *axis.get_yticklabels()), 2 * found["weight"], strict=True):
            label.set_fontweight("bold" if weight > PROBABLE else "normal")
        axis.grid(False)
        axis.set_xlabel("fitted instead (diagonal: nothing fitted)")
        axis.set_ylabel("at work")
        bar = figure.colorbar(image, ax=axis, label="T, expected loss of chi-square", extend="both", aspect=40)
        bar.ax.axhline(tied, color=RED, lw=1.5)
        bar.ax.text(-0.3, tied, f"{tied:g} ", color=RED, ha="right", va="center", fontsize=8)
        return save(figure, path)


def sizes(found: Sequence[Mapping[str, Any]], path: Path) -> Path:
    """Density of each parameter of the named effects, cut at its physical bounds: over the possible range, and close up."""
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(
            len(found), 2, figsize=(7.6, 1.45 * len(found) + 0.3), layout="constrained", squeeze=False
        )
        for (wide, close), size in zip(axes, found, strict=True):
            mean, sd = size["mean"], max(size["sd"], 1e-300)
            near = min(mean - 4 * sd, size["fitted"]), max(mean + 4 * sd, size["fitted"])
            ends = [x for x in (size["low"], size["high"], 0.0, size["fitted"]) if x is not None]
            pad = 0.04 * (max(ends) - min(ends))
            _density(wide, size, min(ends) - pad, max(ends) + pad)
            _density(close, size, *near)
            unit = "" if size["unit"] == "1" else f", {size['unit']}"
            wide.set_title(f"{size['name']}{unit}", loc="left", fontsize=9)
            close.set_title(f"90 %: {size['low90']:.3g} .. {size['high90']:.3g}", loc="left", fontsize=9)
        return save(figure, path)


def _density(axis: Axes, size: Mapping[str, Any], left: float, right: float) -> None:
    """Between two values; the impossible part is dotted, the 90 % interval shaded, zero black, bounds red."""
    mean, sd = size["mean"], max(size["sd"], 1e-300)
    low, high = (b if b is not None else sign * np.inf for b, sign in ((size["low"], -1), (size["high"], 1)))
    x = np.unique(
        np.concatenate([np.linspace(left, right, 500), np.clip(mean + sd * np.linspace(-5, 5, 300), left, right)])
    )
    possible = (x >= low) & (x <= high)
    top = -0.5 * ((float(np.clip(mean, low, high)) - mean) / sd) ** 2
    y = np.exp(np.minimum(-0.5 * ((x - mean) / sd) ** 2 - top, 0.3))
    axis.plot(x, np.where(possible, np.nan, y), ":", color=GREY, lw=1)
    axis.plot(x, np.where(possible, y, np.nan), color=BLUE)
    shown = possible & (x >= size["low90"]) & (x <= size["high90"])
    axis.fill_between(x, 0, np.where(shown, y, 0.0), where=shown, color=BLUE, alpha=0.2, lw=0)
    axis.axvline(0.0, color="0.3", lw=0.8)
    axis.axvline(size["fitted"], color=BLUE, lw=0.8, ls="--")
    for bound in (low, high):
        if np.isfinite(bound):
            axis.axvline(bound, color=RED, lw=1.6)
    axis.set_xlim(left, right)
    axis.set_ylim(0, 1.25)
    axis.set_yticks([])


def _short(value: float) -> str:
    """As few characters as a cell holds."""
    return f"{value:.0f}" if value < 999.5 else f"{value / 1e3:.0f}k" if value < 999.5e3 else "1M+"
