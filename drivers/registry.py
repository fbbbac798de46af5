"""All drivers by name: the project's own and those of installed packages.

A driver is announced by a `Driver`: under which key of rig.yaml its instrument stands, its table there, and how it is
made. A package announces one as an entry point of the group `softlab.drivers`; the entry point's name is what
`driver:` in rig.yaml says. `docs/drivers.md` shows a whole package.
"""

from __future__ import annotations

import functools
import importlib.metadata
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from . import configs
from .alicat import driver as alicat
from .dynamixel import driver as dynamixel
from .ft300s import driver as ft300s
from .natnet import driver as natnet
from .numato import driver as numato
from .pfeiffer import driver as pfeiffer
from .smc_itv import driver as smc_itv
from .tmcl import driver as tmcl
from .ur5 import driver as ur5
from .ur5 import state as ur5_state

GROUP = "softlab.drivers"
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
    `sink` takes each sample and `notice` a sentence worth a warning. Both not yet opened. An arm has `make_state`
    beside it, its stream of `ArmSample`.
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


def _arm_state(name: str, config: ur5.Config, clock: Any, sink: Any) -> ur5_state.UR5State:
    return ur5_state.UR5State(name, ur5_state.Config(host=config.host, max_age=config.max_age), clock, sink)


OWN: Mapping[str, Driver] = MappingProxyType(
    {
        "ur5": Driver("arm", ur5.Config, ur5.UR5, make_state=_arm_state, own_process=True),
        "ft300s": Driver("force", ft300s.Config, ft300s.FT300S),
        "alicat": Driver("pressure", alicat.Config, alicat.Alicat),
        "smc_itv": Driver("pressure", smc_itv.Config, smc_itv.SmcItv),
        "dynamixel": Driver("spine", dynamixel.Config, dynamixel.DynamixelSpine),
        "tmcl": Driver("spine", tmcl.Config, tmcl.TmclSpine),
        "numato": Driver("valve", numato.Config, numato.NumatoValve),
        "pfeiffer": Driver("gauge", pfeiffer.Config, pfeiffer.PfeifferGauge),
        "natnet": Driver("mocap", natnet.Config, natnet.NatNetMocap),
    }
)


@functools.cache
def _found() -> tuple[Mapping[str, Driver], Mapping[str, str]]:
    """The drivers by name; and of those that an installed package announces in vain, what is wrong."""
    good, bad = dict(OWN), {}
    for entry in importlib.metadata.entry_points(group=GROUP):
        try:
            driver = entry.load()
        except Exception as error:  # noqa: BLE001 - whatever a package of others raises must not keep a rig from landing
            wrong = f"cannot be loaded: {type(error).__name__}: {error}"
        else:
            wrong = "the name is taken, choose another" if entry.name in OWN else _faults(driver)
        if wrong:
            bad[entry.name] = f"entry point {entry.name} = {entry.value} of {GROUP}: {wrong}"
        else:
            good[entry.name] = driver
    return MappingProxyType(good), MappingProxyType(bad)


def drivers() -> Mapping[str, Driver]:
    """The project's own and those of installed packages, by name."""
    return _found()[0]


def broken() -> Mapping[str, str]:
    """What is wrong with those that an installed package announces and that cannot be used, by name."""
    return _found()[1]


def of_role(role: str) -> Mapping[str, Driver]:
    """The drivers of one key in rig.yaml, by name."""
    return {name: driver for name, driver in drivers().items() if driver.role == role}


def _faults(driver: object) -> str:
    """All that is wrong with what an entry point gives; empty when it is a driver."""
    if not isinstance(driver, Driver):
        return f"is of type {type(driver).__name__}, not drivers.registry.Driver"
    if driver.role not in ROLES:
        return f"role {driver.role!r} must be one of {', '.join(ROLES)}"
    base = ROLES[driver.role]
    faults = []
    if not (isinstance(driver.config, type) and issubclass(driver.config, base)):
        faults.append(f"config must be a subclass of drivers.configs.{base.__name__}")
    elif not {*configs.PORTS, *configs.HOSTS} & set(driver.config.model_fields):
        faults.append(f"config must have one of {', '.join((*configs.PORTS, *configs.HOSTS))}, where it is reached")
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
        f"quantity {name!r}: {unit!r} must be small letters, digits and _, 30 at most, and its unit text"
        for name, unit in quantities.items()
        if not (isinstance(name, str) and QUANTITY.fullmatch(name) and name != "t" and isinstance(unit, str))
    ]
