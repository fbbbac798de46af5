"""Tendons along the body: what they bring into each section, and how guides hold them back.

A tendon with tension T at (x, y) of a section adds (0, 0, T, y T, -x T, 0) to its stress, all along the body. With friction mu
the tension at arc s lies between T0 exp(-mu a(s)) and T0 exp(mu a(s)), a the angle by which it has been bent on the way from
the base (Euler, Eytelwein), and stays what it is as long as it does.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .chain import Chain

Array = NDArray[np.float64]


class Tendons:
    """All tendons of a robot and the tension that each has in every segment."""

    def __init__(self, segments: int, count: int, friction: float) -> None:
        self._friction = friction
        self._tension = np.zeros((segments, count))

    def stress(self, pulls: Array, azimuths: Array, path: Array, chain: Chain, strains: Array) -> Array:
        """(n, 6) for pulls (count) N at the base, azimuths (count) rad and path radii (n) m of the segments."""
        angle = np.cumsum(np.linalg.norm(strains[:, 3:5], axis=1) * chain.h)
        held = np.exp(self._friction * angle)[:, None]
        self._tension = np.clip(self._tension, pulls / held, pulls * held)
        x, y = np.cos(azimuths), np.sin(azimuths)
        out = np.zeros((len(path), 6))
        out[:, 2] = self._tension.sum(axis=1)
        out[:, 3] = path * (self._tension @ y)
        out[:, 4] = -path * (self._tension @ x)
        return out
