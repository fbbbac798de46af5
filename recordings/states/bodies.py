"""Whether the bodies that the cameras name can be where they are told to be: pure, for the live run and for replay alike.

Cameras tell bodies by the pattern of their markers, and take one for another where patterns are alike. A robot's body gives that
away: no point of it is farther from another one than the stretched body between them is long, and none moves at once.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..trials import TrialRow
from .vacuum import LONGEST_LOOK

SLACK = 0.005
"""m by which a distance may be longer than the body allows: bodies for the cameras are mounted on the robot's surface."""
FASTEST = 3.0
"""m/s between two frames: a robot of 40 cm that swings freely with its whole deflection at 2 Hz reaches less."""
APART = 0.02
"""m by which states at rest of one run may differ: hysteresis and creep of the robot of the paper leave less than 1 cm."""


@dataclass(frozen=True)
class Bodies:
    """Bounds that the robot sets to the places of the tip and its markers.

    `arcs` (m): arc length of the unloaded body from the base to the tip, then to each marker, where markers are known;
    `stretch`: largest ratio of a stretched length to the unloaded one; `since` (s): rig time since which no body may have
    jumped.
    """

    since: float
    arcs: tuple[float, ...]
    stretch: float

    def begin(self, until: float) -> float:
        """Rig time (s) of the first sample that is judged where samples are judged until `until` (s)."""
        return max(self.since, until - LONGEST_LOOK)


def _name(index: int) -> str:
    return f"marker {index}" if index else "the tip"


def places_of(samples: NDArray[np.void]) -> NDArray[np.float64]:
    """Return the places (samples, bodies, 3) m of the tip and the markers; NaN where one is not seen."""
    places: Any = np.concatenate([samples["position"][:, None, :], samples["markers"]], axis=1)
    return places


def too_far(places: NDArray[np.float64], bodies: Bodies) -> str:
    """Which body is farther from the base, or from another one, than the robot is long between them, for people; empty where none
    is. `places` (samples, bodies, 3) m; the worst distance of all is told."""
    places = places[:, : len(bodies.arcs)]
    worst, said = 0.0, ""
    for name, arc, between in _pairs(places, bodies.arcs[: places.shape[1]]):
        seen = between[np.isfinite(between)]
        limit = bodies.stretch * arc + SLACK
        if len(seen) and (over := float(np.median(seen)) - limit) > worst:
            worst, farthest = over, float(np.median(seen))
            said = f"{name} are {farthest * 1e3:.0f} mm apart, the stretched robot allows {limit * 1e3:.0f} mm"
    return said


def _pairs(places: NDArray[np.float64], arcs: tuple[float, ...]) -> Iterator[tuple[str, float, NDArray[np.float64]]]:
    """Each pair of points: their names, the arc length between them (m), and how far they are apart (samples,) m."""
    for i, arc in enumerate(arcs):
        yield f"the base and {_name(i)}", arc, np.linalg.norm(places[:, i], axis=1)
        for k in range(i):
            yield f"{_name(k)} and {_name(i)}", abs(arc - arcs[k]), np.linalg.norm(places[:, i] - places[:, k], axis=1)


def jumped(samples: NDArray[np.void]) -> str:
    """Which body has been at another place since it jumped there, for people; empty where none is.

    `samples`: tracked ones of /tip, oldest first. What jumped and came back does not count.
    """
    places = places_of(samples)
    for body in range(places.shape[1]):
        seen = np.isfinite(places[:, body]).all(axis=1)
        at, t = places[seen, body], samples["t"][seen]
        if len(at) < 2:
            continue
        steps, lasted = np.diff(at, axis=0), np.diff(t)
        sudden = np.linalg.norm(steps, axis=1) > FASTEST * lasted + SLACK
        away = float(np.linalg.norm(steps[sudden].sum(axis=0)))
        if away > SLACK:
            first = int(np.argmax(sudden))
            return (
                f"{_name(body)} jumped by {float(np.linalg.norm(steps[first])) * 1e3:.0f} mm within {lasted[first] * 1e3:.0f} ms "
                f"at {t[first + 1]:.2f} s and is still {away * 1e3:.0f} mm away"
            )
    return ""


def elsewhere(before: TrialRow, now: TrialRow) -> str:
    """Which body is at rest elsewhere than it was at rest before, for people; empty where all are where they were."""
    if before.tip is None or now.tip is None or len(before.markers) != len(now.markers):
        return ""
    pairs = enumerate(zip((before.tip, *before.markers), (now.tip, *now.markers), strict=True))
    away = [(math.dist(a, b), i) for i, (a, b) in pairs if not any(map(math.isnan, (*a, *b)))]
    worst, body = max(away, default=(0.0, 0))
    return f"{_name(body)} is at rest {worst * 1e3:.0f} mm away from its place at rest" if worst > APART else ""
