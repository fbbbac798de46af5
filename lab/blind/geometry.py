"""The robots that the virtual robot of the bench can be: the paper's, and slimmer ones with three chambers or tendons."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any


@dataclass(frozen=True)
class Geometry:
    """What makes one robot another than the paper's."""

    channels: tuple[tuple[int, ...], ...]
    """Chambers, numbered from 1, that share a regulator."""
    bend: tuple[int, ...]
    """Those inflated in the base sweep."""
    truth: Mapping[str, Any]
    """Fields of `RobotTruth`; m, degrees."""

    @property
    def chambers(self) -> int:
        """How many there are."""
        return sum(len(c) for c in self.channels)


_THREE = {
    "outer_radius": 0.045, "inner_radius": 0.025, "spine_radius": 0.025, "chamber_radius": 0.0075, "chamber_path_radius": 0.036,
    "chamber_azimuths_deg": (0.0, 120.0, 240.0),
}  # fmt: skip
_OF_THREE = (((1,), (2,), (3,)), (1,))
GEOMETRIES: Mapping[str, Geometry] = MappingProxyType(
    {
        "paper": Geometry(((9, 1, 2), (3, 4, 5), (6, 7, 8)), (9, 1, 2), {}),
        "three_chambers": Geometry(*_OF_THREE, _THREE),
        "tapered": Geometry(*_OF_THREE, {**_THREE, "spine_radius": 0.017, "chamber_radius": 0.006, "taper": 0.7}),
        "tendons": Geometry(*_OF_THREE, {**_THREE, "tendons": True}),
    }
)
