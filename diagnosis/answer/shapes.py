"""Shapes of the robot in the states that are missed most: measured, calibrated baseline, and with the best hypothesis."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..data.levels import SPINE_GAP, levels
from ..inference.prepare import Prepared

Array = NDArray[np.float64]


def worst_states(p: Prepared, calibrated: Array, explained: Array) -> list[dict[str, Any]]:
    """The worst state of each chamber group and spine length, the four worst of these, worst first; m, base frame.

    `calibrated` and `explained` are parameters (k,); what each trial has of its own is left out of both. None where another
    simulator takes the rod's place, which tells no shape.
    """
    if p.baseline is not None:
        return []
    models = {"calibrated": p.common(calibrated), "explained": p.common(explained)}
    tips = {name: p.tip(p.problem.forward.predict(theta)) for name, theta in models.items()}
    missed = np.linalg.norm(p.states.tip - tips["calibrated"], axis=1)
    shown = _picked(p, missed)
    if not shown:
        return []
    # A fitted robot may be a little longer than its description: beyond the tip stands for the tip.
    arcs = np.append(np.linspace(0.0, p.robot.length, 25 - 1), 2 * p.robot.length)
    curves = {name: p.forward.shapes(theta, arcs) for name, theta in models.items()}
    return [
        {
            "trial": int(p.states.trial[i]),
            "step": p.states.rows[i].step,
            "spine_length": float(p.states.spine_length[i]),
            "pressure": float(p.states.highest[i]),
            "branch": p.states.rows[i].branch,
            "chambers": list(p.states.chambers[i]),
            "measured_tip": p.states.tip[i].tolist(),
            "measured_markers": [list(m) for m in p.states.rows[i].markers or ()],
        }
        | {name: {"tip": tips[name][i].tolist(), "backbone": curves[name][i].tolist()} for name in models}
        for i in shown
    ]


def _picked(p: Prepared, missed: Array) -> list[int]:
    """Indices of the states to show."""
    length = levels(p.states.spine_length, SPINE_GAP)
    worst: dict[tuple[tuple[int, ...], int], int] = {}
    for i in sorted(np.flatnonzero(np.isfinite(missed)), key=lambda i: -missed[i]):
        worst.setdefault((p.states.chambers[i], int(length[i])), int(i))
    return list(worst.values())[:4]
