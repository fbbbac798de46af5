"""All drivers by name: the project's own and those of installed packages.

A driver is announced by a `Driver`: under which key of rig.yaml its instrument stands, its table there, and how it is
made. A package announces one as an entry point of the group `softlab.drivers`; the entry point's name is what
`driver:` in rig.yaml says. `docs/howto/driver.md` shows a whole package.
"""

from __future__ import annotations

import functools
import importlib
import importlib.metadata
from collections.abc import Mapping
from types import MappingProxyType

from .spec import ROLES, Driver, faults

__all__ = ["GROUP", "OWN", "ROLES", "Driver", "broken", "drivers", "of_role"]

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
"""The project's own: the module that has each one's `DRIVER`, imported when the drivers are looked up, since the instruments'
libraries need not be installed where nothing is measured."""


@functools.cache
def _found() -> tuple[Mapping[str, Driver], Mapping[str, str]]:
    """The drivers by name; and of those that an installed package announces in vain, what is wrong."""
    good: dict[str, Driver] = {}
    bad: dict[str, str] = {}
    for name, module in OWN.items():
        try:
            good[name] = importlib.import_module(module).DRIVER
        except ImportError as error:
            bad[name] = f"the instruments' libraries are not installed ({error}); {INSTALL}"
    for entry in importlib.metadata.entry_points(group=GROUP):
        try:
            driver = entry.load()
        except Exception as error:  # noqa: BLE001 - whatever a package of others raises must not keep a rig from landing
            wrong = f"cannot be loaded: {type(error).__name__}: {error}"
        else:
            wrong = "the name is taken, choose another" if entry.name in OWN else faults(driver)
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
