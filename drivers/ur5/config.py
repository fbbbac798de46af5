"""A UR5 by ur_rtde: its address and its limits."""

from __future__ import annotations

from pydantic import Field, model_validator

from ..configs import ArmConfig
from ..interfaces import Vector6


class Config(ArmConfig):
    """How to reach the arm and what may be asked of it. Lengths in its base frame."""

    host: str
    """Address of the controller (ports 29999, 30003, 30004)."""
    model: str = "UR5"
    """`UR5`, or `UR5e` (e-Series)."""
    serial: str = ""
    """Serial number of the controller; any when empty."""
    max_step: float = Field(0.3, gt=0, le=1.7, json_schema_extra={"unit": "m"})
    """Longest motion."""
    max_turn: float = Field(0.8, gt=0, le=3.2, json_schema_extra={"unit": "rad"})
    """Largest turn of the TCP in one motion."""
    stop_deceleration: float = Field(2.0, gt=0, le=10.0, json_schema_extra={"unit": "m/s^2"})
    position_tolerance: float = Field(0.5e-3, ge=1e-5, le=0.01, json_schema_extra={"unit": "m"})
    """Largest distance from its target at which a motion may end."""
    turn_tolerance: float = Field(5e-3, ge=1e-4, le=0.1, json_schema_extra={"unit": "rad"})
    """The same of orientation."""
    tcp: Vector6 | None = None
    """TCP in the flange frame (m, rotation vector rad), set at `open`; by default the pendant's."""
    payload: float | None = Field(None, ge=0, le=20, json_schema_extra={"unit": "kg"})
    """Mass at the flange that the pendant must state; by default any, unchanged since `open`."""
    watchdog_frequency: float = Field(5.0, ge=2.0, le=50.0, json_schema_extra={"unit": "Hz"})
    """The controller stops the arm when it hears from this driver less often."""
    timeout: float = Field(1.0, ge=0.2, le=10, json_schema_extra={"unit": "s"})
    """Of an answer, host time."""

    @model_validator(mode="after")
    def _box_has_room(self) -> Config:
        for axis, low, high in zip("xyz", self.workspace_min, self.workspace_max, strict=True):
            if not low < high:
                raise ValueError(f"workspace_min {axis} = {low:g} m must be below workspace_max {axis} = {high:g} m")
        return self
