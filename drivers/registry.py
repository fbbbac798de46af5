"""The project's own drivers by name, and what every driver is announced by.

A driver is announced by a `Driver`: under which key of rig.yaml its instrument stands, its table there, and how it is
made. A package announces one as an entry point of the group `softlab.drivers`; the entry point's name is what
`driver:` in rig.yaml says. `docs/howto/driver.md` shows a whole package.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from . import configs

QUANTITY = re.compile(r"[a-z][a-z0-9_]{0,29}")
ROLES: Mapping[str, type[configs.InstrumentConfig]] = MappingProxyType(
    {
        "arm": configs.ArmConfig,
        "force": configs.ForceConfig,
        "pressure": configs.RegulatorsConfig,
        "spine": configs.LengthUnitConfig,
        "valve": configs.ValveConfig,
        "gauge": configs.GaugeConfig,
        "mocap": configs.MocapConfig,
        "sensor": configs.SensorConfig,
    }
)
"""Keys of `instruments` in rig.yaml, and what the table of every driver under it must have. Of sensors of the lab's own there
may be several, each under a name of its own in `instruments.sensors`."""


@dataclass(frozen=True)
class Driver:
    """One kind of instrument.

    `make(name, config, clock)` gives an actuator or a gauge; of a stream, `make(name, config, clock, sink, notice)`, where
    `sink` takes each sample and `notice` a sentence worth a warning. Both not yet opened. An arm also has
    `make_state`, its stream of `ArmSample`.
    """

    role: str
    """Key in rig.yaml, one of `ROLES`; also which protocol of `interfaces` it serves."""
    config: type[configs.InstrumentConfig]
    make: Callable[..., Any]
    make_state: Callable[..., Any] | None = None
    quantities: Mapping[str, str] = field(default_factory=dict)
    """Of a sensor: what it measures, name -> unit. Its samples are objects with `t` (s) and these numbers as attributes."""
    own_process: bool = False
    """Its library may crash or hang: the guard runs it in a process of its own."""


def faults(driver: object) -> str:
    """All that is wrong with what an entry point gives; empty when it is a driver."""
    if not isinstance(driver, Driver):
        return f"is of type {type(driver).__name__}, not drivers.registry.Driver"
    if driver.role not in ROLES:
        return f"role {driver.role!r} must be one of {', '.join(ROLES)}"
    base = ROLES[driver.role]
    faults = []
    if not (isinstance(driver.config, type) and issubclass(driver.config, base)):
        faults.append(f"config must be a subclass of drivers.configs.{base.__name__}")
    elif all(f.annotation is int for k, f in driver.config.model_fields.items() if k in (*configs.PORTS, *configs.HOSTS)):
        faults.append(f"config must have one of {', '.join((*configs.PORTS, *configs.HOSTS))} as text, the instrument's address")
    if not callable(driver.make):
        faults.append("make must be callable")
    if driver.role == "arm" and not callable(driver.make_state):
        faults.append("an arm must have make_state")
    if driver.role == "sensor":
        faults += _not_quantities(driver.quantities)
    return "; ".join(faults)


def _not_quantities(quantities: object) -> list[str]:
    """What is wrong with what a sensor says it measures."""
    if not isinstance(quantities, Mapping) or not quantities:
        return ["a sensor must have quantities, name -> unit"]
    return [
        f"quantity {name!r}: {unit!r} must be lower-case letters, digits and _, at most 30, and its unit must be text"
        for name, unit in quantities.items()
        if not (isinstance(name, str) and QUANTITY.fullmatch(name) and name != "t" and isinstance(unit, str))
    ]


__all__ = ["GROUP", "OWN", "ROLES", "Driver", "faults", "own"]

GROUP = "softlab.drivers"
INSTALL = "install them: pip install 'softlab[rig]'"
OWN: Mapping[str, str] = MappingProxyType(
    {
        "ur5": "drivers.ur5.driver",
        "ft300s": "drivers.ft300s.driver",
        "alicat": "drivers.alicat.driver",
        "smc_itv": "drivers.smc_itv.driver",
        "dynamixel": "drivers.dynamixel.driver",
        "tmcl": "drivers.tmcl.driver",
        "numato": "drivers.numato.driver",
        "pfeiffer": "drivers.pfeiffer.driver",
        "natnet": "drivers.natnet.driver",
    }
)
"""The module that has each one's `DRIVER`, imported when the drivers are looked up, since the instruments' libraries need not
be installed where nothing is measured."""


def own() -> tuple[dict[str, Driver], dict[str, str]]:
    """The project's drivers by name; and of those that cannot be used here, what to install."""
    good: dict[str, Driver] = {}
    missing: dict[str, str] = {}
    for name, module in OWN.items():
        try:
            good[name] = importlib.import_module(module).DRIVER
        except ImportError as error:
            missing[name] = f"the instruments' libraries are not installed ({error}); {INSTALL}"
    return good, missing
