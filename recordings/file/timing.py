"""How evenly a stream came: rate, jitter and gaps from its stamps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

GAP = 2.5
"""An interval longer than this many median intervals is a gap."""


@dataclass(frozen=True)
class Timing:
    """`rate` Hz over the whole time; `interval` s, median; `jitter_p50`, `_p99`, `_max` s: quantiles of how far the
    intervals that are no gaps lie from the median; `gaps` the number of those that are; `longest` s, the longest
    interval; `missing` messages that would have filled the gaps."""

    count: int
    start: float
    end: float
    rate: float
    interval: float
    jitter_p50: float
    jitter_p99: float
    jitter_max: float
    gaps: int
    longest: float
    missing: int


def timing(stamps: NDArray[np.float64]) -> Timing:
    """Summary of ascending stamps (s); zeros where there are too few to tell."""
    n = len(stamps)
    if n < 2:
        at = float(stamps[0]) if n else 0.0
        return Timing(n, at, at, 0.0, 0.0, 0.0, 0.0, 0.0, 0, 0.0, 0)
    start, end = float(stamps[0]), float(stamps[-1])
    intervals = np.diff(stamps)
    median = float(np.median(intervals))
    gap = intervals > GAP * median if median > 0 else np.zeros(n - 1, dtype=bool)
    missing = int(np.sum(np.round(intervals[gap] / median) - 1)) if gap.any() else 0
    p50, p99, most = np.quantile(np.abs(intervals[~gap] - median), (0.5, 0.99, 1.0)).tolist()
    return Timing(
        count=n,
        start=start,
        end=end,
        rate=(n - 1) / (end - start) if end > start else 0.0,
        interval=median,
        jitter_p50=p50,
        jitter_p99=p99,
        jitter_max=most,
        gaps=int(gap.sum()),
        longest=float(intervals.max()),
        missing=missing,
    )
