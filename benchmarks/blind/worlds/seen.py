"""Forms of the effects of measuring: camera frame, marker, time; and the path of the tip that they act on.

x (n,) is the size in the unit of the form.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from .frames import apply, transposed, turn
from .robot import LENGTH, Lanes

Array = NDArray[np.float64]

ORDER = ("time_offset", "marker_offset", "frame_misalignment")


@dataclass(frozen=True)
class SeenPath:
    """Where the tips were at times (S,): positions (S, n, 3), rotations (S, n, 3, 3), markers (S, n, 3, 3)."""

    times: Array
    reads: NDArray[np.intp]
    """Which of them were read."""
    tip: Array
    turns: Array
    markers: Array
    pressures: Array
    """(S, 9) Pa as the regulators say."""

    def read(self) -> SeenPath:
        """Only what was read."""
        k = self.reads
        return SeenPath(self.times[k], np.arange(len(k)), self.tip[k], self.turns[k], self.markers[k], self.pressures[k])


@dataclass
class Seeing:
    """What lies between the tip and the table, for n lanes; effects write into it."""

    lanes: Lanes
    delays: list[Callable[[SeenPath], SeenPath]] = field(default_factory=list)
    views: list[Callable[[SeenPath], SeenPath]] = field(default_factory=list)

    def look(self, path: SeenPath) -> SeenPath:
        """The readings."""
        for delay in self.delays:
            path = delay(path)
        path = path.read()
        for view in self.views:
            path = view(path)
        return path

    @property
    def needs_time(self) -> bool:
        """Whether the path between readings matters."""
        return bool(self.delays)


Change = Callable[[Seeing, Array], None]


def seeing(lanes: Lanes, changes: Mapping[str, Change]) -> Seeing:
    """The measurement with the effects of `changes`, by effect."""
    made = Seeing(lanes)
    for effect in [*(e for e in ORDER if e in changes), *(e for e in changes if e not in ORDER)]:
        size = lanes.sizes.get(effect)
        if size is not None and np.any(size):
            changes[effect](made, size)
    return made


# ------------------------------------------------------------------ time_offset
def _at(path: SeenPath, when: Array) -> SeenPath:
    """The path's readings at times (R, n); ramps and holds are interpolated apart, as the path has corners between them."""
    tip, turns, markers = path.tip.copy(), path.turns.copy(), path.markers.copy()
    flat = np.concatenate([a.reshape(len(path.times), -1) for a in (tip, turns, markers)], axis=1)
    edges = _corners(path)
    splines = [CubicSpline(path.times[a : b + 1], flat[a : b + 1], axis=0) for a, b in itertools.pairwise(edges) if b > a]
    n = tip.shape[1]
    for k, read in enumerate(path.reads):
        wanted = np.clip(when[k], path.times[0], path.times[-1])
        for t in np.unique(wanted[wanted != path.times[read]]):
            piece = int(np.searchsorted(path.times[edges[1:-1]], t))
            row = splines[piece](t)
            chosen = wanted == t
            cut = np.split(row, [3 * n, 12 * n])
            tip[read, chosen] = cut[0].reshape(n, 3)[chosen]
            u, _, vt = np.linalg.svd(cut[1].reshape(n, 3, 3)[chosen])
            turns[read, chosen] = u @ vt
            markers[read, chosen] = cut[2].reshape(n, -1, 3)[chosen]
    return replace(path, tip=tip, turns=turns, markers=markers)


def _corners(path: SeenPath) -> list[int]:
    """The first point, those at which the pressures begin to change at another rate, and the last."""
    rate = np.diff(path.pressures, axis=0) / np.maximum(np.diff(path.times), 1e-9)[:, None]
    turns = np.flatnonzero((np.abs(np.diff(rate, axis=0)) > 1.0).any(axis=1)) + 1  # Pa/s
    return [0, *turns.tolist(), len(path.times) - 1]


def late(s: Seeing, x: Array) -> None:
    """The tip of x seconds earlier, 20 % less of it in the pressures' upper half: the gauge's own filter is faster there."""

    def law(path: SeenPath) -> SeenPath:
        high = path.pressures[path.reads].max(axis=1) / 250e3
        return _at(path, path.times[path.reads][:, None] - x[None, :] * (1.1 - 0.2 * high)[:, None])

    s.delays.append(law)


def late_by_frames(s: Seeing, x: Array) -> None:
    """Half of the tips x / 2, half 3 x / 2 seconds old: every other frame waits in a buffer."""

    def law(path: SeenPath) -> SeenPath:
        now = path.times[path.reads][:, None]
        early, older = _at(path, now - 0.5 * x[None, :]), _at(path, now - 1.5 * x[None, :])
        return replace(
            early, tip=(early.tip + older.tip) / 2, markers=(early.markers + older.markers) / 2,
            turns=early.turns @ turn(_half(early.turns, older.turns)),
        )  # fmt: skip

    s.delays.append(law)


def late_filter(s: Seeing, x: Array) -> None:
    """A low-pass filter of time x on the tip (on the pressure when x is below 0)."""

    def law(path: SeenPath) -> SeenPath:
        now = path.times[path.reads][:, None]
        # three points of the exponential's quadrature (Gauss and Laguerre)
        places, weights = np.polynomial.laguerre.laggauss(3)
        seen = [_at(path, now - x[None, :] * p) for p in places]
        tip = sum(w * q.tip for w, q in zip(weights, seen, strict=True))
        markers = sum(w * q.markers for w, q in zip(weights, seen, strict=True))
        return replace(seen[0], tip=np.asarray(tip), markers=np.asarray(markers), turns=_at(path, now - x).turns)

    s.delays.append(law)


def _half(a: Array, b: Array) -> Array:
    w = transposed(a) @ b
    return 0.25 * np.stack([w[..., 2, 1] - w[..., 1, 2], w[..., 0, 2] - w[..., 2, 0], w[..., 1, 0] - w[..., 0, 1]], axis=-1)


# ------------------------------------------------------------------ marker_offset
def _aside(s: Seeing, x: Array, down: float) -> Array:
    a = s.lanes.places.marker + s.lanes.roll
    return x[:, None] * np.stack([np.cos(a), np.sin(a), np.full_like(a, down)], axis=-1) / np.hypot(1, down)


def off_centre(s: Seeing, x: Array) -> None:
    """x aside and a little above the tip's face, turning with it; the pins bend by 10 % of the turn."""
    offset = _aside(s, x, 0.4)

    def law(path: SeenPath) -> SeenPath:
        return replace(path, tip=path.tip + apply(path.turns, offset) * (1 + 0.1 * (path.turns[..., 2, 2:] - 1)))

    s.views.append(law)


def one_pin_hidden(s: Seeing, x: Array) -> None:
    """x aside, growing by half where the tip has turned by more than 40 degrees: one pin is hidden then."""
    offset = _aside(s, x, 0.0)

    def law(path: SeenPath) -> SeenPath:
        turned = np.arccos(np.clip(path.turns[..., 2, 2], -1, 1))
        more = 1 + 0.5 / (1 + np.exp(-(turned - np.radians(40)) / np.radians(6)))
        return replace(path, tip=path.tip + more[..., None] * apply(path.turns, offset))

    s.views.append(law)


def cap_off_centre(s: Seeing, x: Array) -> None:
    """0.8 x aside and 0.6 x along the tip's axis, and sagging by 0.2 x where it is tilted: a cap on foam."""
    offset = _aside(s, x, 0.75)

    def law(path: SeenPath) -> SeenPath:
        tip = path.tip + apply(path.turns, offset)
        tip[..., 2] += 0.2 * np.abs(x) * np.sqrt(np.maximum(1 - path.turns[..., 2, 2] ** 2, 0.0))
        return replace(path, tip=tip)

    s.views.append(law)


# ------------------------------------------------------------------ frame_misalignment
def _turned(s: Seeing, x: Array, centre: float, growth: float = 0.0) -> None:
    rotation = turn(x[:, None] * np.array(s.lanes.places.axis))
    pivot = np.array([0.0, 0.0, centre])

    def law(path: SeenPath) -> SeenPath:
        off = path.tip - pivot
        tip = apply(rotation, off) + pivot
        if growth:
            tip = tip + growth * x[:, None] * off * np.linalg.norm(off, axis=-1, keepdims=True) / LENGTH
        return replace(path, tip=tip, turns=rotation @ path.turns, markers=apply(rotation[:, None], path.markers - pivot) + pivot)

    s.views.append(law)


def turned_about_the_middle(s: Seeing, x: Array) -> None:
    """Turned by x about the middle of the measured space, 0.12 m below the base."""
    _turned(s, x, 0.12)


def turned_about_the_ceiling(s: Seeing, x: Array) -> None:
    """Turned by x about a camera bar 60 mm above the base."""
    _turned(s, x, -0.06)


def turned_and_stretched(s: Seeing, x: Array) -> None:
    """Turned by x about the base; lengths off by 4 % of x per 0.4 m: a wand that was bent."""
    _turned(s, x, 0.0, 0.04)
