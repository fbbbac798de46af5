"""The actuators' side of a rig: which driver serves which instrument, what may be asked of it, and what is polled."""

from __future__ import annotations

from typing import Any

from drivers.interfaces import Clock

from ..files.all_drivers import drivers

COMMANDS: dict[str, tuple[str, ...]] = {
    "pressure": ("set", "read", "vent"),
    "spine": ("home", "move_to", "stop", "read"),
    "valve": ("set", "read"),
    "gauge": ("read",),
    "arm": ("move_to", "moving", "stop", "standing"),
}
"""What may be asked of each instrument."""
ENERGISING = {("pressure", "set"), ("spine", "home"), ("spine", "move_to"), ("valve", "set"), ("arm", "move_to")}
"""Commands after which the rig is no longer in its safe state."""
POLLED = ("pressure", "spine", "valve", "gauge")
ACTUATORS = ("arm", "pressure", "spine", "valve")
"""What can move, push or hold something."""


def make(name: str, driver: str, config: Any, clock: Clock) -> Any:
    """The driver of one instrument, not yet opened."""
    return drivers()[driver].make(name, config, clock)
