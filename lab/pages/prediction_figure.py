"""Figure of a prediction: the tip over pressure with its 95 % intervals, or where wanted tips are and what is reached."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from model.actuators import Words
from model.prediction import Prediction
from model.prediction.inverse import Reached

from .figures import STYLE, colours, save

Array = NDArray[np.float64]


def tips(pressure: Array, spine_length: Array, found: Prediction, path: Path, words: Words) -> Path:
    """x, y and z of the tip over the highest pressure (n,) Pa, a colour for each spine length (n,) m."""
    low, high = found.interval()
    lengths = np.unique(np.round(spine_length, 4))
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(1, 3, figsize=(11, 3.6), layout="constrained")
        for length, colour in zip(lengths, colours(len(lengths)), strict=True):
            own = np.flatnonzero(np.round(spine_length, 4) == length)
            at = pressure[own] / words.pascal
            for k, axis in enumerate(axes):
                middle, half = 1e3 * found.tip[own, k], 1e3 * (high - low)[own, k] / 2
                axis.errorbar(at, middle, half, fmt="o", ms=2.5, lw=0.9, capsize=2, color=colour)
            if len(lengths) <= 12:
                axes[0].plot([], [], "o", ms=3, color=colour, label=f"{100 * length:.3g} cm")
        for k, axis in enumerate(axes):
            axis.set_xlabel(f"highest {words.axis}")
            axis.set_ylabel(f"tip {'xyz'[k]}, mm")
        axes[0].set_title("bars: 95 % interval of a reading", loc="left")
        axes[0].legend(title="spine", fontsize=8, ncols=2)
        return save(figure, path)


def targets(wanted: Array, found: Reached, path: Path) -> Path:
    """Targets (m, 3) m and the tips that are expected, seen along y and along z; free coordinates are those of the tip."""
    tip = found.prediction.tip
    place = np.where(np.isfinite(wanted), wanted, tip)
    low, high = found.prediction.interval(model_only=True)
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
        for axis, (i, j) in zip(axes, ((0, 2), (0, 1)), strict=True):
            axis.errorbar(
                1e3 * tip[:, i], 1e3 * tip[:, j], 1e3 * (high - low)[:, j] / 2, 1e3 * (high - low)[:, i] / 2,
                fmt=".", ms=3, lw=0.8, color="0.25", label="expected tip, 95 % interval",
            )  # fmt: skip
            for own, mark, label in ((found.reached, "o", "target"), (~found.reached, "x", "target out of reach")):
                axis.plot(1e3 * place[own, i], 1e3 * place[own, j], mark, ms=7, mfc="none", color="black", label=label)
            axis.plot(1e3 * np.stack([place[:, i], tip[:, i]]), 1e3 * np.stack([place[:, j], tip[:, j]]), ":", color="0.5")
            axis.set_aspect("equal", "datalim")
            axis.set_xlabel(f"{'xyz'[i]}, mm")
            axis.set_ylabel(f"{'xyz'[j]}, mm")
        axes[0].legend(fontsize=8)
        return save(figure, path)
