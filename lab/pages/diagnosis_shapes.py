"""Figure of a diagnosis: the robot's shape where it is missed most, measured and by both models, and the tips close up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from mpl_toolkits.mplot3d.axes3d import Axes3D
from numpy.typing import NDArray

from .figures import STYLE, save

Array = NDArray[np.float64]

MM = 1e3
MODELS = {"calibrated": ("#8a8a8a", "--", "baseline model"), "explained": ("#20639b", "-", "with the best hypothesis")}
MEASURED = "#b5382a"
LEAST_WINDOW = 2.0
"""mm, half the edge of the smallest close-up."""
State = Mapping[str, Any]


def shapes(states: Sequence[State], path: Path) -> Path:
    """Equal axes in mm, the tip hanging down as on the rig: the whole robot, and its tip close up below.

    A single state has its tip beside.
    """
    n = len(states)
    rows, columns = (1, 2) if n == 1 else (2, n)
    with plt.rc_context(STYLE | {"font.size": 8}):
        figure = plt.figure(figsize=(2.5 * columns, 3.2 * rows))
        for k, state in enumerate(states):
            whole, close = (_axes(figure, rows, columns, row * n + k + 1) for row in (0, 1))
            points = np.vstack([_mm(state[name]["backbone"]) for name in MODELS])
            _draw(whole, state)
            _box(whole, points.min(axis=0), points.max(axis=0))
            where = f"spine {100 * state['spine_length']:.0f} cm, {state['pressure'] / 1e3:.0f} kPa, {state['branch']}"
            whole.set_title(f"{where}\ntrial {state['trial']}, step {state['step']}", fontsize=8, y=1.04)
            tips = np.vstack([_mm(state["measured_tip"]), *(_mm(state[name]["tip"]) for name in MODELS)])
            middle = tips.mean(axis=0)
            half = max(LEAST_WINDOW, 1.25 * float(np.nanmax(np.abs(tips - middle))))
            _draw(close, state, middle, half)
            _box(close, middle - half, middle + half)
            close.set_title(f"its tip, {2 * half:.0f} mm wide", fontsize=8, pad=0)
        handles, labels = figure.axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="upper center", ncols=len(labels), fontsize=8)
        figure.subplots_adjust(left=0.02, right=0.94, bottom=0.02, top=0.97 - 0.16 / rows, wspace=0.16, hspace=0.2)
        return save(figure, path)


def _axes(figure: Any, rows: int, columns: int, place: int) -> Axes3D:
    axes: Axes3D = figure.add_subplot(rows, columns, place, projection="3d")
    axes.view_init(elev=14, azim=-62)
    axes.set_proj_type("ortho")
    return axes


def _draw(axes: Axes3D, state: State, middle: Array | None = None, half: float = np.inf) -> None:
    """Backbones, their tips and what was measured; within a window around `middle` (3,) mm only, where given."""
    for name, (colour, line, label) in MODELS.items():
        curve = _fine(_mm(state[name]["backbone"]))
        if middle is not None:
            outside = np.abs(curve - middle).max(axis=1) > half
            curve[outside] = np.nan
        axes.plot(*curve.T, line, color=colour, lw=1.4, label=label)
        axes.plot(*_mm(state[name]["tip"])[:, None], "s", color=colour, ms=4 if middle is not None else 2.5)
    axes.plot(
        *_mm(state["measured_tip"])[:, None], "o", color=MEASURED, ms=5, mfc="none", mew=1.4, label="measured tip"
    )
    markers = _mm(state["measured_markers"]) if state["measured_markers"] else np.zeros((0, 3))
    if markers.size and middle is None:
        axes.plot(*markers.T, "^", color=MEASURED, ms=4, mfc="none", label="measured markers")


def _fine(curve: Array) -> Array:
    """A backbone (k, 3) with points close enough for a close-up."""
    at = np.linspace(0, len(curve) - 1, 40 * (len(curve) - 1) + 1)
    return np.stack([np.interp(at, np.arange(len(curve)), c) for c in curve.T], axis=1)


def _box(axes: Axes3D, low: Array, high: Array) -> None:
    """Equal scales on all axes, z downwards."""
    middle, edge = (low + high) / 2, np.maximum(high - low, 0.35 * float((high - low).max()))
    for k, (name, set_limits) in enumerate((("x", axes.set_xlim), ("y", axes.set_ylim), ("z", axes.set_zlim))):
        a, b = middle[k] - 0.54 * edge[k], middle[k] + 0.54 * edge[k]
        set_limits(*((b, a) if name == "z" else (a, b)))
    axes.set_box_aspect(tuple(edge), zoom=0.98)
    for axis, label in ((axes.xaxis, "x, mm"), (axes.yaxis, "y, mm"), (axes.zaxis, "z, mm")):
        axis.set_major_locator(plt.MaxNLocator(3 if label[0] == "z" else 2))
        axis.set_tick_params(labelsize=6, pad=-2)
        axis.set_label_text(label, fontsize=7)
        axis.labelpad = -6


def _mm(metres: object) -> Array:
    return MM * np.array(metres, float)
