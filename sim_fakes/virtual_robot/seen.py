"""What the cameras see of the rod."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .blocks import rotation
from .chain import Chain
from .kernels import kernel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TipView:
    """Tip as tracked: position (3) m, rotation (3, 3), body markers (k, 3) m; robot base frame."""

    position: Array
    rotation: Array
    markers: Array


def look(chain: Chain, arc_lengths: Array) -> TipView:
    """The tip now, and markers at rising arc lengths (m)."""
    turned = np.empty((3, 3))
    rotation(chain.q[-1], turned)
    return TipView(chain.r[-1].copy(), turned, centre_line(chain, arc_lengths))


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
