"""Whether a series of force readings is that of a sensor at rest, against the noise of the FT 300-S.

Each axis is judged by itself, in three ways: by its scatter (a tool that vibrates), by its trend over the series (a load
that comes on, a sensor that warms up), and by the means of its parts (a step, a slow swing).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

from ..interfaces import Vector6

AXES = (("fx", "N"), ("fy", "N"), ("fz", "N"), ("mx", "N m"), ("my", "N m"), ("mz", "N m"))
NOISE: Vector6 = (0.1, 0.1, 0.1, 0.005, 0.005, 0.005)
"""Standard deviation of a reading at rest, N and N m."""
SCATTER_SIGMAS, TREND_SIGMAS, PART_SIGMAS = 6.0, 5.0, 6.0
"""Standard errors beyond which scatter, trend or a part's mean is no noise: together fewer than one in 100 000 series at
rest is refused."""
PARTS = 10
"""Equal parts of a series whose means are compared with its own,"""


def unrest(readings: Sequence[Vector6]) -> str:
    """Return the axis that changed most, by how much, and the limit in words; empty for a sensor at rest.

    `readings`: consecutive raw readings, N and N m. One reading alone cannot be judged.
    """
    worst, text = 1.0, ""
    for (axis, unit), noise, values in zip(AXES, NOISE, zip(*readings, strict=True), strict=True):
        for what, found, limit in _judged(values, noise):
            if found > worst * limit:
                worst, text = found / limit, f"{axis} {what} {found:.3g} {unit}, limit {limit:.2g} {unit}"
    return text


def _judged(values: Sequence[float], noise: float) -> list[tuple[str, float, float]]:
    """What of one axis is judged, as words, value and limit."""
    n = len(values)
    if n < 2:
        return []
    mean = sum(values) / n
    scatter = math.sqrt(sum((x - mean) ** 2 for x in values) / (n - 1))
    allowed = max(2.0, 1 + SCATTER_SIGMAS / math.sqrt(2 * (n - 1)))
    judged = [("scatters by", scatter, allowed * noise)]
    # From neighbour to neighbour hardly anything but noise changes, whatever the load does meanwhile.
    jitter = math.sqrt(sum((b - a) ** 2 for a, b in pairwise(values)) / (2 * (n - 1)))
    sd = min(max(noise, jitter), allowed * noise)
    if n > 2:
        trend = 12 * sum((i - (n - 1) / 2) * x for i, x in enumerate(values)) / (n * (n + 1))
        judged.append(("drifts by", abs(trend), TREND_SIGMAS * sd * math.sqrt(12 / n)))
    size = n // PARTS
    if size >= 2:
        means = [sum(values[i : i + size]) / size for i in range(0, size * PARTS, size)]
        farthest = max(abs(part - mean) for part in means)
        judged.append(("jumps by", farthest, PART_SIGMAS * sd / math.sqrt(size)))
    return judged
