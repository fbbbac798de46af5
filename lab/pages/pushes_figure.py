"""Figure of stiffness trials in a diagnosis: what the model misses, as a deflection, specimen by specimen."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from .figures import CALIBRATED, STYLE, colours, save


def pushes(found: Mapping[str, Any], name: str, path: Path) -> Path:
    """`found` is the diagnosis' detail of stiffness trials: deflection read, and missed by the model, a line a trial.

    `name` of the model with the cause.
    """
    models = (("calibrated", CALIBRATED), ("explained", name))
    trial, deflection = np.array(found["trial"]), np.array(found["deflection"])
    names = [f"{one} {100 * length:.3g} cm" for one, length in zip(found["specimen"], found["spine_length"], strict=True)]
    specimens = list(dict.fromkeys(names))
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(2, 1, figsize=(4.8, 5.6), layout="constrained", sharex=True, sharey=True)
        for axis, (key, title) in zip(axes, models, strict=True):
            missed = 1e3 * (np.array(found["force"]) - np.array(found[key])) / np.array(found["stiffness"])
            axis.axhspan(-found["floor_mm"], found["floor_mm"], color="0.9")
            for name, colour in zip(specimens, colours(len(specimens)), strict=False):
                for t in np.unique(trial[[n == name for n in names]]):
                    own = trial == t
                    axis.plot(1e3 * deflection[own], missed[own], "-o", ms=2.5, lw=0.9, color=colour)
                axis.plot([], [], color=colour, label=name)
            axis.set_title(title, loc="left")
            axis.set_ylabel("measured minus model,\nmm of deflection")
        axes[1].set_xlabel("deflection, mm")
        figure.legend(*axes[1].get_legend_handles_labels(), loc="outside lower center", fontsize=8, ncols=3)
        return save(figure, path)
