"""The robots that the virtual robot of the bench can be: the paper's, and one with three chambers in a slimmer body."""

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
    described: Mapping[str, Any]
    """The same as robot.yaml says it."""

    @property
    def chambers(self) -> int:
        """How many there are."""
        return sum(len(c) for c in self.channels)


_BODY = {"outer_radius": 0.045, "inner_radius": 0.025}
_SPINE, _CHAMBER, _PATH, _AZIMUTHS = 0.025, 0.0075, 0.036, (0.0, 120.0, 240.0)
GEOMETRIES: Mapping[str, Geometry] = MappingProxyType(
    {
        "paper": Geometry(((9, 1, 2), (3, 4, 5), (6, 7, 8)), (9, 1, 2), {}, {}),
        "three_chambers": Geometry(
            ((1,), (2,), (3,)),
            (1,),
            {
                **_BODY, "spine_radius": _SPINE, "chamber_radius": _CHAMBER, "chamber_path_radius": _PATH,
                "chamber_azimuths_deg": _AZIMUTHS,
            },
            {
                **_BODY, "spine": {"radius": _SPINE},
                "chambers": {"radius": _CHAMBER, "path_radius": _PATH, "azimuths_deg": list(_AZIMUTHS)},
            },
        ),
    }
)  # fmt: skip
