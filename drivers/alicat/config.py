"""What rig.yaml says of Alicat units."""

from __future__ import annotations

import re
from typing import Literal

from pydantic import Field, model_validator

from ..chambers import PAPER_WIRING, ChamberMap
from ..configs import RegulatorsConfig


class Config(RegulatorsConfig):
    """How to reach the units, their range, and what may be asked of them."""

    port: str
    """Serial port of the RS-485 adapter."""
    baud: Literal[19200, 38400, 57600, 115200] = Field(115200, json_schema_extra={"unit": "Bd"})
    units: tuple[str, ...] = ("A", "B", "C")
    """Unit letters, in channel order."""
    chambers: tuple[tuple[int, ...], ...] = PAPER_WIRING
    """Chambers (1..9) on each channel."""
    full_scale: float = Field(400e3, gt=0, le=2e6, json_schema_extra={"unit": "Pa"})
    """Range of the units, compared at `open`."""
    unit: Literal["Pa", "hPa", "kPa", "MPa", "mbar", "bar", "psi"] | None = None
    """Unit of the displays, by default kPa; required with firmware before 6v00."""
    timeout: float = Field(0.25, ge=0.05, le=2, json_schema_extra={"unit": "s"})
    """Of an answer, host time; a failed request is repeated once."""
    max_age: float = Field(1.0, gt=0, le=10, json_schema_extra={"unit": "s"})
    """Of the first unit's reading when the last one's arrives, host time."""

    @model_validator(mode="after")
    def _fits_together(self) -> Config:
        ChamberMap(self.chambers)
        if len(self.units) != len(self.chambers):
            raise ValueError(f"{len(self.units)} units but {len(self.chambers)} lists of chambers; give one unit for each list")
        for unit in self.units:
            if not re.fullmatch("[A-Z]", unit) or self.units.count(unit) > 1:
                raise ValueError(f"units {', '.join(self.units)}: {unit!r} must be one letter A to Z, used once")
        if self.max_pressure > self.full_scale:
            raise ValueError(
                f"max_pressure {self.max_pressure:g} Pa is above the units' full_scale {self.full_scale:g} Pa; lower it"
            )
        return self
