"""What a recording says about where it comes from: versions, git state, host, identities of the instruments."""

from __future__ import annotations

import platform
import subprocess
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from drivers.interfaces import Identity

PACKAGES = (
    "softlab",
    "ur_rtde",
    "pyserial",
    "pymodbus",
    "natnet",
    "dynamixel-sdk",
    "pytrinamic",
    "numpy",
    "scipy",
    "mcap",
)


def provenance(identities: Mapping[str, Identity]) -> dict[str, dict[str, str]]:
    """Metadata records by name."""
    return {
        "versions": {"python": platform.python_version(), **{p: _version(p) for p in PACKAGES}},
        "source": _git(),
        "host": {"system": platform.platform(), "name": platform.node()},
        "instruments": {
            n: " ".join(x for x in (i.maker, i.model, i.serial, i.firmware) if x) for n, i in identities.items()
        },
    }


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def _git() -> dict[str, str]:
    """Commit of this software and whether its files were changed; empty where it was installed without git."""
    folder = Path(__file__).parent

    def ask(*arguments: str) -> str:
        try:
            done = subprocess.run(
                ["git", "-C", str(folder), *arguments], capture_output=True, text=True, timeout=5, check=True
            )
        except (OSError, subprocess.SubprocessError):
            return ""
        return done.stdout.strip()

    return {
        "commit": ask("rev-parse", "HEAD"),
        "changed": "yes" if ask("status", "--porcelain", "--untracked-files=no") else "no",
    }
