"""What each effect of a robot moves the tip by, and what is left of that once the chamber area is calibrated anew.

All over the readings of a sweep, noise-free, with everything else kept: d (rows) is what the tip loses without the effect, a its
response to the area factor; left is what remains of d after least squares over a.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .campaign import Response, WalkedSweep, WorldRobot, courses
from .forms import EFFECTS

Array = NDArray[np.float64]
TRIED = 0.3
"""Plausible scales at which an effect that is not there is tried as the nearest of a cause outside the catalogue."""


@dataclass(frozen=True)
class Carried:
    """Root mean squares in mm, by effect."""

    moves: Mapping[str, float]
    calibrated: Mapping[str, float]


def carried(robot: WorldRobot, sweep: WalkedSweep, response: Response) -> Carried:
    """Of everything that is present and whose share `response` holds."""
    area = rows(robot, sweep, response, "area")
    moves, left = {}, {}
    for effect in robot.present:
        if effect in response.by:
            d = rows(robot, sweep, response, effect)
            moves[effect] = rms(d)
            left[effect] = rms(_rest(d, [area])[0])
    return Carried(_sorted(moves), _sorted(left))


def nearest(robot: WorldRobot, sweep: WalkedSweep, response: Response, cause: str, effects: Sequence[str]) -> tuple[str, float]:
    """The effect that comes closest to an outside cause after least squares over its size and the area, and the mm it leaves.

    ("none", mm) where no effect takes a tenth of it away.
    """
    area, d = rows(robot, sweep, response, "area"), rows(robot, sweep, response, cause)
    best, least = "none", 0.9 * rms(_rest(d, [area])[0])
    for effect in effects:
        if effect not in response.by:
            continue
        rest, sizes = _rest(d, [area, rows(robot, sweep, response, effect)])
        if sizes[1] < 0 and EFFECTS[effect].sign != "both":
            continue
        if (mm := rms(rest)) < least:
            best, least = effect, mm
    return best, least if best != "none" else rms(_rest(d, [area])[0])


def rows(robot: WorldRobot, sweep: WalkedSweep, response: Response, name: str) -> Array:
    """(T, R, 3) m that one change makes in all trials."""
    found = np.swapaxes(response.by[name][0][:, response.of(sweep)], 0, 1)
    course = courses(robot, sweep).get(name)
    return found if course is None else course[:, None, None] * found


def _rest(d: Array, by: Sequence[Array]) -> tuple[Array, Array]:
    a = np.stack([b.reshape(-1) for b in by], axis=1)
    scale = np.linalg.norm(a, axis=0)
    sizes = np.linalg.lstsq(a / np.maximum(scale, 1e-12), d.reshape(-1), rcond=None)[0] / np.maximum(scale, 1e-12)
    return d.reshape(-1) - a @ sizes, sizes


def rms(d: Array) -> float:
    """Root mean square length of the vectors in d, mm."""
    return float(np.sqrt(np.mean(np.sum(d.reshape(-1, 3) ** 2, axis=1))) * 1e3)


def _sorted(values: Mapping[str, float]) -> dict[str, float]:
    return {k: round(v, 3) for k, v in sorted(values.items(), key=lambda item: -item[1])}
