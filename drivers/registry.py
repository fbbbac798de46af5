"""The project's own drivers by name, and what every driver is announced by.

A driver is announced by a `Driver`: under which key of rig.yaml its instrument stands, its table there, and how it is
made. A package announces one as an entry point of the group `softlab.drivers`; the entry point's name is what
`driver:` in rig.yaml says. `docs/howto/driver.md` shows a whole package.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from types import MappingProxyType

from .spec import ROLES, Driver, faults

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
