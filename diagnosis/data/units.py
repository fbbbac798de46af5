"""Units that tables of other tools are written in, and which of them a number that is too large or too small looks like."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Unit:
    """`per_si`: how many of it make one of the SI unit."""

    name: str
    per_si: float

    @property
    def remedy(self) -> str:
        """What to do with the numbers."""
        return f"divide by {self.per_si:g}" if self.per_si > 1 else f"multiply by {1 / self.per_si:g}"


LENGTH_UNITS = (Unit("mm", 1000.0), Unit("cm", 100.0), Unit("inches", 1 / 0.0254))
PRESSURE_UNITS = (
    Unit("mbar", 1e-2), Unit("kPa", 1e-3), Unit("psi", 1 / 6895.0), Unit("bar", 1e-5), Unit("MPa", 1e-6),
)  # fmt: skip
FORCE_UNITS = (Unit("mN", 1000.0), Unit("gram-force", 1000 / 9.80665))


def units_near(ratio: float, units: Sequence[Unit], within: float) -> list[Unit]:
    """All units whose `per_si` is within a factor of a ratio of numbers found to numbers expected; the nearest, even if it is
    not, comes first."""
    distance = {unit: abs(math.log(ratio / unit.per_si)) for unit in units}
    first, *others = sorted(units, key=distance.__getitem__)
    return [first, *(unit for unit in others if distance[unit] < math.log(within))]


def nearest(ratio: float, units: Sequence[Unit], within: float) -> Unit | None:
    """The unit whose `per_si` is nearest to a ratio; None beyond a factor `within`."""
    if not ratio > 0:
        return None
    best = units_near(ratio, units, within)[0]
    return best if abs(math.log(ratio / best.per_si)) < math.log(within) else None
