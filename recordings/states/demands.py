"""What must hold while a state is read, besides its rule: the vacuum of a jammed spine, and places that bodies can have.

Pure, for the live run and for replay alike.

Cameras tell bodies by the pattern of their markers, and take one for another where patterns are alike. A robot's body gives that
away: no two points of it are farther apart than the stretched body between them is long, and none moves at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..trials import TrialRow

SLACK = 0.005
"""m by which a distance may be longer than the body allows: bodies for the cameras are mounted on the robot's surface."""
AWAY = 0.02
"""m that a body at rest may be from where it rested before: hysteresis and creep of the paper's robot leave less than half."""
FASTEST = 3.0
"""m/s; a robot of 40 cm that swings freely with its whole deflection at 2 Hz stays below."""


@dataclass(frozen=True)
class Demand:
    """What must hold since rig time `since` (s)."""

    since: float

    def begin(self, until: float) -> float:
        """Rig time (s) of the first sample that is judged where samples are judged until `until` (s)."""
        return max(self.since, until - 600.0)  # samples stay in memory for 900 s, `buffer.KEEP`


@dataclass(frozen=True)
class VacuumBand(Demand):
    """The vacuum that a jammed spine must keep: from `lowest` to `highest` (Pa below ambient).

    A spine that was soft in between has another shape, even if its vacuum came back, so every sample counts: from
    `since` to the first one after the window that is read.
    """

    lowest: float
    highest: float


@dataclass(frozen=True)
class Bodies(Demand):
    """Bounds that the robot sets to the places of the tip and its markers. Since `since` no body may have jumped.

    `arcs` (m): arc length of the unloaded body from the base to the tip, then to each marker, where markers are known;
    `stretch`: largest ratio of a stretched length to the unloaded one; `off` (m): distance of each from the axis, where not 0.
    """

    arcs: tuple[float, ...]
    stretch: float
    off: tuple[float, ...] = ()


def left_band(samples: NDArray[np.void], ambient: float, band: VacuumBand) -> str:
    """When and how far the vacuum was first outside its band, for people; empty where it never was.

    `samples`: of /vacuum, oldest first; `ambient`: Pa absolute.
    """
    below: NDArray[np.float64] = ambient - samples["absolute"]
    outside = ~((below >= band.lowest) & (below <= band.highest))
    if not outside.any():
        return ""
    first: Any = int(np.argmax(outside))
    return (
        f"the vacuum was {below[first] / 1e3:.1f} kPa below ambient at {samples['t'][first]:.2f} s, and must stay from "
        f"{band.lowest / 1e3:.1f} to {band.highest / 1e3:.1f} kPa while the spine is jammed"
    )


def _name(index: int) -> str:
    return f"marker {index}" if index else "the tip"


def places_of(samples: NDArray[np.void]) -> NDArray[np.float64]:
    """Return the places (samples, bodies, 3) m of the tip and the markers; NaN where one is not seen."""
    return np.asarray(np.concatenate([samples["position"][:, None, :], samples["markers"]], axis=1))


def too_far(places: NDArray[np.float64], bodies: Bodies) -> str:
    """Which body is farther from the base, or from another one, than the robot is long between them, for people; empty where none
    is. `places` (samples, bodies, 3) m; the message names the worst distance."""
    worst, text, aside = 0.0, "", dict(enumerate(bodies.off))
    points = [(_name(i), arc, aside.get(i, 0.0), places[:, i]) for i, arc in enumerate(bodies.arcs[: places.shape[1]])]
    for i, (name, arc, off, place) in enumerate(points):
        for other_name, other_arc, other_off, other_place in [("the base", 0.0, 0.0, np.zeros(3)), *points[:i]]:
            distances = np.linalg.norm(place - other_place, axis=1)
            seen, limit = distances[np.isfinite(distances)], bodies.stretch * abs(arc - other_arc) + off + other_off + SLACK
            if len(seen) and (apart := float(np.median(seen))) - limit > worst:
                worst = apart - limit
                text = f"{other_name} and {name} are {apart * 1e3:.0f} mm apart, the stretched robot allows {limit * 1e3:.0f} mm"
    return text


LATEST = 0.5
"""s; a frame that comes later than this after it was taken is no reason for a jump: the cameras' clock may have been set."""


def jumped(samples: NDArray[np.void]) -> str:
    """Which body has been at another place since it jumped there, for people; empty where none is.

    `samples`: tracked ones of /tip, oldest first. What jumped and came back does not count. Between two frames as much time
    passed as their arrivals or the cameras' stamps say, whichever is more: a busy computer or network hands over several at once.
    """
    places = places_of(samples)
    for body in range(places.shape[1]):
        seen = np.isfinite(places[:, body]).all(axis=1)
        position, t, stamp = places[seen, body], samples["t"][seen], samples["device_time"][seen]
        if len(position) < 2:
            continue
        steps, dt = np.diff(position, axis=0), np.diff(t)
        dt = np.clip(np.nan_to_num(np.diff(stamp)), dt, dt + LATEST)
        sudden = np.linalg.norm(steps, axis=1) > FASTEST * dt + SLACK
        away = float(np.linalg.norm(steps[sudden].sum(axis=0)))
        if away > SLACK:
            first = int(np.argmax(sudden))
            return (
                f"{_name(body)} jumped by {float(np.linalg.norm(steps[first])) * 1e3:.0f} mm within {dt[first] * 1e3:.0f} ms "
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
    return f"{_name(body)} is at rest {worst * 1e3:.0f} mm away from its place at rest" if worst > AWAY else ""
