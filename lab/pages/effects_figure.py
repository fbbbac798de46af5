"""Small multiples of the effects' signatures: one panel an effect, its own scale, loading full and unloading dashed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from ..signatures import Signature
from .figures import STYLE, colours, plt, save

COLUMNS = 5


def draw(found: list[Signature], path: Path) -> Path:
    """Draw all signatures into one picture, but those of effects that move nothing."""
    found = [s for s in found if s.how != "none"]
    rows = -(-len(found) // COLUMNS)
    with plt.rc_context({**STYLE, "font.size": 7.5, "axes.titlesize": 8.5}):
        figure, axes = plt.subplots(rows, COLUMNS, figsize=(13, 2.1 * rows + 0.4), layout="constrained", squeeze=False)
        for axis, signature in zip(axes.flat, found, strict=False):
            _panel(axis, signature)
        for axis in axes.flat[len(found) :]:
            axis.set_axis_off()
        longest = max(found, key=lambda s: (s.how != "stiffness", len(s.spine_length)))
        figure.legend(handles=_legend(longest), loc="outside upper left", ncols=8)
        return save(figure, path)


def _panel(axis: Axes, s: Signature) -> None:
    stiffness = s.how == "stiffness"
    for x, y, colour in zip(s.x, s.shown, colours(len(s.x)), strict=True):
        top = int(np.argmax(x))
        scaled = x * 1e3 if stiffness else x / 1e3
        axis.plot(scaled[: top + 1], y[: top + 1], color=colour, lw=1.2)
        axis.plot(scaled[top:], y[top:], color=colour, lw=1.0, ls=(0, (3, 2)))
    axis.axhline(0.0, color="0.6", lw=0.6, zorder=0)
    title = s.effect.id if s.how == "settled" else f"{s.effect.id} ({s.how})"
    axis.set_title(title, loc="left")
    axis.set_xlabel("deflection, mm" if stiffness else "pressure, kPa", labelpad=1)
    axis.set_ylabel("force, N" if stiffness else f"tip {'xyz'[s.axis]}, mm", labelpad=1)


def _legend(s: Signature) -> list[Line2D]:
    lengths = zip(s.spine_length, colours(len(s.spine_length)), strict=True)
    found = [Line2D([], [], color=colour, label=f"{length * 100:g} cm spine") for length, colour in lengths]
    found.append(Line2D([], [], color="0.3", label="load"))
    return [*found, Line2D([], [], color="0.3", ls=(0, (3, 2)), label="unload")]
