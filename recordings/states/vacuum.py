"""Whether a jammed spine kept its vacuum: pure, for the live run and for replay alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

LONGEST_LOOK = 600.0
"""s before the end of a window in which its vacuum is judged at most: samples stay in memory for `buffer.KEEP`, 900 s."""


@dataclass(frozen=True)
class VacuumBand:
    """The vacuum that a jammed spine must keep: from `lowest` to `highest` (Pa below ambient) since rig time `since` (s).

    A spine that was soft in between has another shape, even if its vacuum came back, so every sample counts: from
    `since` to the first one after the window that is read.
    """

    since: float
    lowest: float
    highest: float

    def begin(self, until: float) -> float:
        """Rig time (s) of the first sample that is judged where samples are judged until `until` (s)."""
        return max(self.since, until - LONGEST_LOOK)


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
