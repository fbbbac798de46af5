"""Figure of a diagnosis: how large the named effect is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from diagnosis.answer.headline import for_people
from model.actuators import Words

from .figures import STYLE, save

FACTOR = "times"
"""Unit in which a person reads a logarithm."""
BLUE, RED, GREY = "#20639b", "#b5382a", "#8a8a8a"


def sizes(found: Sequence[Mapping[str, Any]], folder: Path, words: Words) -> list[Path]:
    """Density of each parameter of the named effects, cut at its physical bounds: over the possible range, and close up."""
    return [path for k, size in enumerate(found) for path in _panels(size, folder, k, words)]


def _panels(size: Mapping[str, Any], folder: Path, number: int, words: Words) -> list[Path]:
    size, unit = _for_people(size, words)
    mean, sd = size["mean"], max(size["sd"], 1e-300)
    ends = [x for x in (size["low"], size["high"], 0.0, size["median"]) if x is not None]
    pad = 0.04 * (max(ends) - min(ends))
    near = min(mean - 4 * sd, size["low90"]), max(mean + 4 * sd, size["high90"])
    shown = np.exp if unit == FACTOR else lambda x: x
    parts = [
        (f"{size['name']}{unit and ', '}{unit}", min(ends) - pad, max(ends) + pad),
        (f"90 %: {shown(size['low90']):.3g} .. {shown(size['high90']):.3g}", *near),
    ]
    made = []
    for name, (title, left, right) in zip(("wide", "close"), parts, strict=True):
        with plt.rc_context(STYLE):
            figure, axis = plt.subplots(figsize=(3.8, 1.75), layout="constrained")
            _density(axis, size, left, right)
            axis.set_title(title, loc="left", fontsize=9)
            axis.xaxis.set_major_formatter(lambda x, _: f"{shown(x):.3g}")
            made.append(save(figure, folder / f"size-{number}-{name}.svg"))
    return made


def _for_people(size: Mapping[str, Any], words: Words) -> tuple[dict[str, Any], str]:
    """The numbers in the unit in which a person reads them; logarithms stay, with the unit of the factor."""
    number, unit = for_people(1.0, size["unit"], words)
    factor = 1.0 if unit == FACTOR else number
    return {key: factor * value if isinstance(value, float) else value for key, value in size.items()}, unit


def _density(axis: Axes, size: Mapping[str, Any], left: float, right: float) -> None:
    """Between two values; the impossible part is dotted, the 90 % interval shaded, zero black, bounds red."""
    mean, sd = size["mean"], max(size["sd"], 1e-300)
    low, high = (b if b is not None else sign * np.inf for b, sign in ((size["low"], -1), (size["high"], 1)))
    x = np.unique(np.concatenate([np.linspace(left, right, 500), np.clip(mean + sd * np.linspace(-5, 5, 300), left, right)]))
    possible = (x >= low) & (x <= high)
    top = -0.5 * ((float(np.clip(mean, low, high)) - mean) / sd) ** 2
    y = np.exp(np.minimum(-0.5 * ((x - mean) / sd) ** 2 - top, 0.3))
    axis.plot(x, np.where(possible, np.nan, y), ":", color=GREY, lw=1)
    axis.plot(x, np.where(possible, y, np.nan), color=BLUE)
    shown = possible & (x >= size["low90"]) & (x <= size["high90"])
    axis.fill_between(x, 0, np.where(shown, y, 0.0), where=shown, color=BLUE, alpha=0.2, lw=0)
    axis.axvline(0.0, color="0.3", lw=0.8)
    axis.axvline(size["median"], color=BLUE, lw=0.8, ls="--")
    for bound in (low, high):
        if np.isfinite(bound):
            axis.axvline(bound, color=RED, lw=1.6)
    axis.set_xlim(left, right)
    axis.set_ylim(0, 1.25)
    axis.set_yticks([])
