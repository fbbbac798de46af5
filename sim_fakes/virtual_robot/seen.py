"""What the cameras report: frames, marker positions and latency between the rod and the published tip."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .blocks import rotation
from .chain import Chain
from .directions import Directions
from .effects import Laws
from .kernels import kernel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TipView:
    """Tip as tracked: position (3) m, rotation (3, 3), body markers (k, 3) m; robot base frame."""

    position: Array
    rotation: Array
    markers: Array


def quaternion_matrix(q: Array) -> Array:
    """Rotation matrix of a unit quaternion w, x, y, z."""
    out = np.empty((3, 3))
    rotation(q, out)
    return out


def axis_quaternion(axis: tuple[float, float, float], angle: float) -> Array:
    """Unit quaternion of a turn by angle (rad) about a unit axis."""
    s = math.sin(angle / 2)
    return np.array([math.cos(angle / 2), axis[0] * s, axis[1] * s, axis[2] * s])


class Cameras:
    """Turns a shape into what motion capture reports."""

    def __init__(self, markers: tuple[float, ...], laws: Laws, directions: Directions) -> None:
        self._arc_lengths = np.array(markers, dtype=np.float64)
        self._laws = laws
        self._directions = directions
        self._frame = quaternion_matrix(axis_quaternion(directions.frame_axis, laws.frame_misalignment))

    def look(self, chain: Chain, roll: float) -> TipView:
        """The tip now; a marker offset sits on the body and so turns with its roll (rad)."""
        rotation = quaternion_matrix(chain.q[-1])
        position = chain.r[-1].copy()
        if self._laws.marker_offset:
            a = self._directions.marker + roll
            position += rotation @ (self._laws.marker_offset * np.array([math.cos(a), math.sin(a), 0.0]))
        markers = centre_line(chain, self._arc_lengths)
        if self._laws.frame_misalignment:
            return TipView(self._frame @ position, self._frame @ rotation, markers @ self._frame.T)
        return TipView(position, rotation, markers)


@kernel
def centre_line(chain: Chain, arc_lengths: Array) -> Array:
    """Points (k, 3) of the centre line at rising arc lengths (m), cubic between nodes; its end beyond the end."""
    out = np.empty((len(arc_lengths), 3))
    a = np.empty((3, 3))
    b = np.empty((3, 3))
    k = 0
    start = 0.0
    for m in range(len(arc_lengths)):
        while arc_lengths[m] > start + chain.h[k] and k < len(chain.h) - 1:
            start += chain.h[k]
            k += 1
        x = min((arc_lengths[m] - start) / chain.h[k], 1.0)
        rotation(chain.q[k], a)
        rotation(chain.q[k + 1], b)
        chord = 0.0
        for i in range(3):
            chord += (chain.r[k + 1, i] - chain.r[k, i]) ** 2
        chord = np.sqrt(chord)
        for i in range(3):
            along = x * (1 - x) ** 2 * a[i, 2] + x * x * (x - 1) * b[i, 2]
            ends = (1 + 2 * x) * (1 - x) ** 2 * chain.r[k, i] + x * x * (3 - 2 * x) * chain.r[k + 1, i]
            out[m, i] = ends + chord * along
    return out


class Delay:
    """Keeps vectors and gives them back `latency` seconds later, straight lines in between."""

    def __init__(self, latency: float) -> None:
        self._latency = latency
        self._kept: deque[tuple[float, Array]] = deque()

    def clear(self) -> None:
        """Forget everything."""
        self._kept.clear()

    def pass_through(self, t: float, value: Array) -> Array:
        """Put in the value of time t (s, rising) and take out what is to be published now."""
        if self._latency <= 0.0:
            return value
        self._kept.append((t, value.copy()))
        due = t - self._latency
        while len(self._kept) > 1 and self._kept[1][0] <= due:
            self._kept.popleft()
        (t0, a), (t1, b) = self._kept[0], self._kept[min(1, len(self._kept) - 1)]
        share = (due - t0) / (t1 - t0) if t1 > t0 else 0.0
        return np.asarray(a + min(max(share, 0.0), 1.0) * (b - a))


def pack(view: TipView) -> Array:
    """A view as one vector, for `Delay`."""
    return np.concatenate([view.position, view.rotation.ravel(), view.markers.ravel()])


def unpack(vector: Array) -> TipView:
    """The view of a vector; a rotation between two others is made orthonormal again."""
    u, _, vt = np.linalg.svd(vector[3:12].reshape(3, 3))
    return TipView(vector[:3], u @ vt, vector[12:].reshape(-1, 3))
