"""Figure of a diagnosis: the robot seen from two sides where it is missed most, measured and by both models, and its tip."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from model.actuators import Words

from .figures import CALIBRATED, STYLE, save

Array = NDArray[np.float64]

MODELS = {"calibrated": ("#8a8a8a", "--", "s"), "explained": ("#20639b", "-", "D")}
MEASURED = "#b5382a"
State = Mapping[str, Any]


def shapes(states: Sequence[State], name: str, folder: Path, words: Words) -> list[Path]:
    """A panel for each state: x and y over z in mm with equal scales, the tip hanging down, and the tip close up below.

    `name` of the model with the cause.
    """
    return [_panel(state, name, folder / f"shape-{k}.svg", words) for k, state in enumerate(states)]


def _panel(state: State, name: str, path: Path, words: Words) -> Path:
    names = dict(zip(MODELS, (CALIBRATED, name), strict=True))
    tips = np.vstack([_mm(state["measured_tip"]), *(_mm(state[model]["tip"]) for model in MODELS)])
    middle = tips.mean(axis=0)
    # no close-up is smaller than 4 mm
    half = max(2.0, 1.25 * float(np.nanmax(np.abs(tips - middle))))
    with plt.rc_context(STYLE | {"font.size": 8}):
        figure, axes = plt.subplots(2, 2, figsize=(4.0, 5.4), layout="constrained", height_ratios=(3, 2))
        for k, (whole, close) in enumerate(axes.T):
            for axis in (whole, close):
                _draw(axis, state, k, names)
                axis.set_xlabel(f"{'xy'[k]}, mm")
                axis.set_ylabel("z, mm")
            whole.set_aspect("equal", adjustable="datalim")
            whole.invert_yaxis()
            close.set(xlim=(middle[k] - half, middle[k] + half), ylim=(middle[2] + half, middle[2] - half), aspect="equal")
            close.set_title(f"tip, {2 * half:.0f} mm wide", fontsize=8)
        figure.suptitle(state_name(state, words), fontsize=9)
        handles, labels = axes[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=2, fontsize=8)
        return save(figure, path)


def state_name(state: State, words: Words) -> str:
    """Which state it is, for people."""
    parts = [f"spine {100 * state['spine_length']:.0f} cm"] if state["spine_length"] else []
    if state.get("chambers"):
        parts.append(words.group(state["chambers"]))
    parts += [f"{words.number(state['pressure'])} {words.unit}", state["branch"]]
    return f"{', '.join(parts)}\ntrial {state['trial']}, step {state['step']}"


def _draw(axis: Axes, state: State, k: int, names: Mapping[str, str]) -> None:
    """Coordinate k over z: backbones, their tips, and what was measured."""
    for model, (colour, line, mark) in MODELS.items():
        curve, tip = _mm(state[model]["backbone"]), _mm(state[model]["tip"])
        axis.plot(curve[:, k], curve[:, 2], line, color=colour, lw=1.4, label=names[model])
        axis.plot(tip[k], tip[2], mark, color=colour, ms=4)
    tip = _mm(state["measured_tip"])
    axis.plot(tip[k], tip[2], "o", color=MEASURED, ms=6, mfc="none", mew=1.4, label="measured tip")
    if state["measured_markers"]:
        markers = _mm(state["measured_markers"])
        axis.plot(markers[:, k], markers[:, 2], "^", color=MEASURED, ms=4, mfc="none", label="measured markers")


def _mm(metres: object) -> Array:
    return 1e3 * np.array(metres, float)
