"""What rig.yaml says of SMC ITV regulators."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field, model_validator

from ..chambers import ChamberMap
from ..configs import RegulatorsConfig


class Config(RegulatorsConfig):
    """How to reach the units, their range, and what may be asked of them."""

    ports: tuple[str, ...] = Field(min_length=1)
    """Serial ports, in channel order."""
    chambers: tuple[tuple[int, ...], ...] = ((1,), (2,), (3,), (4,), (5,), (6,), (7,), (8,), (9,))
    """Chambers (1..9) on each channel."""
    full_scale: float = Field(
        gt=0,
        le=1e6,
        json_schema_extra={
            "unit": "Pa",
            "write": "the units cannot report it; see their label: ITV_01_ 100 kPa, ITV_03_ 500 kPa, ITV_05_ 900 kPa",
        },
    )
    """Pressure at 1023 counts; readings do not show a wrong one."""
    timeout: float = Field(0.25, ge=0.05, le=2, json_schema_extra={"unit": "s"})
    """Of an answer, host time; a failed request is repeated once."""
    poll_interval: float = Field(0.1, ge=0.0, le=5, json_schema_extra={"unit": "s"})
    """Shortest time between two polls of one unit, host time."""

    widest: ClassVar[float | None] = 900e3

    @model_validator(mode="after")
    def _fits_together(self) -> Config:
        ChamberMap(self.chambers)
        if len(self.ports) != len(self.chambers):
            raise ValueError(f"{len(self.ports)} ports but {len(self.chambers)} lists of chambers; give one port for each list")
        if len(set(self.ports)) != len(self.ports):
            raise ValueError(f"ports {', '.join(self.ports)}: a port is listed twice")
        if self.max_pressure > self.full_scale:
            raise ValueError(
                f"max_pressure {self.max_pressure:g} Pa is above the units' full_scale {self.full_scale:g} Pa; lower it"
            )
        return self
