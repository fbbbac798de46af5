"""The actuators' side of a rig: which driver serves which instrument, what may be asked of it, and what is polled."""

from __future__ import annotations

from typing import Any

from drivers.alicat import driver as alicat
from drivers.dynamixel import driver as dynamixel
from drivers.interfaces import Clock
from drivers.numato import driver as numato
from drivers.pfeiffer import driver as pfeiffer
from drivers.smc_itv import driver as smc_itv
from drivers.tmcl import driver as tmcl
from drivers.ur5 import driver as ur5

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
DRIVERS: dict[str, Any] = {
    "alicat": alicat.Alicat, "smc_itv": smc_itv.SmcItv, "dynamixel": dynamixel.DynamixelSpine, "tmcl": tmcl.TmclSpine,
    "numato": numato.NumatoValve, "pfeiffer": pfeiffer.PfeifferGauge, "ur5": ur5.UR5,
}  # fmt: skip
CONFIGS: dict[str, Any] = {"ur5": ur5.Config}
"""Drivers that run in a process of their own, and how their configuration is read there."""


def make(name: str, driver: str, config: Any, clock: Clock) -> Any:
    """The driver of one instrument, not yet opened."""
    return DRIVERS[driver](name, config, clock)
