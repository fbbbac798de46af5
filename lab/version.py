"""Which version of the software this is, and what a recording says about where it comes from."""

from __future__ import annotations

import platform
import subprocess
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the packages' names are checked before any of them is imported, see `neighbours`
    from drivers.interfaces import Identity

NAME = "softlab"


def installed(package: str = NAME) -> str:
    """The version of an installed package."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def source() -> dict[str, str]:
    """Commit of this software and whether its files were changed; empty where it was installed without git."""
    folder = Path(__file__).parent

    def ask(*arguments: str) -> str:
        try:
            done = subprocess.run(["git", "-C", str(folder), *arguments], capture_output=True, text=True, timeout=5, check=True)
        except (OSError, subprocess.SubprocessError):
            return ""
        return done.stdout.strip()

    return {
        "commit": ask("rev-parse", "HEAD"),
        "changed": "yes" if ask("status", "--porcelain", "--untracked-files=no") else "no",
    }


def version_text() -> str:
    """For people: version, and where it comes from a checkout the commit."""
    git = source()
    if not git["commit"]:
        return f"{NAME} {installed()}"
    return f"{NAME} {installed()} ({git['commit'][:12]}{', changed' if git['changed'] == 'yes' else ''})"


PACKAGES = ("softlab", "ur_rtde", "pyserial", "pymodbus", "dynamixel-sdk", "pytrinamic", "numpy", "scipy", "mcap")


def provenance(identities: Mapping[str, Identity]) -> dict[str, dict[str, str]]:
    """Return the metadata records of a recording by name: versions, git state, host, identities of the instruments."""
    return {
        "versions": {"python": platform.python_version(), **{p: installed(p) for p in PACKAGES}},
        "source": source(),
        "host": {"system": platform.platform(), "name": platform.node()},
        "instruments": {n: " ".join(x for x in (i.maker, i.model, i.serial, i.firmware) if x) for n, i in identities.items()},
    }
