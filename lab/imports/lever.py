"""Whether the tracked point sits where the map says: a body that bends evenly ties the place of its end to the turn of it.

An arc of length L that turns by theta towards d ends at L a, a = (1 - cos theta) / theta d + sin theta / theta e_z. A tracked
point off by h along the axis from where the map has it adds h (R - 1) e_z to what is taken for that end. The lengths of all
states are free and h is one for all; both are linear: least squares say how well readings fit without h and with it. (A point
off sideways cannot be seen: (R - 1) d = -theta a, as if the body were shorter.)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from recordings.trials import TrialRow

Array = NDArray[np.float64]

LEAST_TURN = np.radians(10.0)
FEWEST = 6
"""States that turn by as much."""
WRONG, RIGHT = 0.05, 0.25
"""Share of the robot's length that is missed without h, and share of that with h, from which on it is told."""


def lever_off(rows: Sequence[TrialRow], length: float) -> tuple[float, float, float] | None:
    """h (m), and the rms (m) that are missed without and with it, where readings that start from the straight robot contradict
    the map; None otherwise."""
    kept = [
        (np.array(r.tip), Rotation.from_quat(r.orientation, scalar_first=True)) for r in rows if r.tip and r.orientation
    ]
    kept = [(tip, turn) for tip, turn in kept if np.hypot(*turn.as_rotvec()[:2]) > LEAST_TURN]
    n = len(kept)
    if n < FEWEST:
        return None
    arcs = np.zeros((n, 3, n))
    for i, (_, turn) in enumerate(kept):
        x, y = turn.as_rotvec()[:2]
        theta = float(np.hypot(x, y))
        across = (1 - np.cos(theta)) / theta**2
        arcs[i, :, i] = across * y, -across * x, np.sin(theta) / theta
    seen = np.concatenate([tip for tip, _ in kept])
    levers = np.concatenate([(turn.as_matrix() - np.eye(3))[:, 2:] for _, turn in kept])
    without, both = arcs.reshape(3 * n, n), np.hstack([arcs.reshape(3 * n, n), levers])
    found = np.linalg.lstsq(both, seen, rcond=None)[0]
    missed = [
        float(np.sqrt(np.sum((seen - a @ c) ** 2) / n))
        for a, c in ((without, np.linalg.lstsq(without, seen, rcond=None)[0]), (both, found))
    ]
    if missed[0] < WRONG * length or missed[1] > RIGHT * missed[0]:
        return None
    return float(found[-1]), missed[0], missed[1]
