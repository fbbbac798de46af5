"""What a recording says about where it comes from: versions, git state, host, identities of the instruments."""

from __future__ import annotations

import platform
from collections.abc import Mapping

from drivers.interfaces import Identity

from ..version import installed, source

PACKAGES = (
    "softlab",
    "ur_rtde",
    "pyserial",
    "pymodbus",
    "dynamixel-sdk",
    "pytrinamic",
    "numpy",
    "scipy",
    "mcap",
)


def provenance(identities: Mapping[str, Identity]) -> dict[str, dict[str, str]]:
    """Metadata records by name."""
    return {
        "versions": {"python": platform.python_version(), **{p: installed(p) for p in PACKAGES}},
        "source": source(),
        "host": {"system": platform.platform(), "name": platform.node()},
        "instruments": {n: " ".join(x for x in (i.maker, i.model, i.serial, i.firmware) if x) for n, i in identities.items()},
    }
