"""Which version of the software this is, whether its packages are its own, and where a recording comes from.

The names of the packages are plain words (`model`, `drivers`), and others may use them too.
"""

from __future__ import annotations

import importlib.util
import platform
import subprocess
from base64 import urlsafe_b64encode
from collections.abc import Mapping
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, distribution, version
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the packages' names are checked before any of them is imported, see `strangers`
    from drivers.interfaces import Identity

NAME = "softlab"


def installed(package: str = NAME) -> str:
    """The version of an installed package."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def source() -> dict[str, str]:
    """Commit of this software, empty where it was installed without git, and whether its files were changed (yes, no)."""
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


RECORDED = ("softlab", "ur_rtde", "pyserial", "pymodbus", "dynamixel-sdk", "pytrinamic", "numpy", "scipy", "mcap")


def provenance(identities: Mapping[str, Identity]) -> dict[str, dict[str, str]]:
    """Return the metadata records of a recording by name: versions, git state, host, identities of the instruments."""
    return {
        "versions": {"python": platform.python_version(), **{p: installed(p) for p in RECORDED}},
        "source": source(),
        "host": {"system": platform.platform(), "name": platform.node()},
        "instruments": {n: " ".join(x for x in (i.maker, i.model, i.serial, i.firmware) if x) for n, i in identities.items()},
    }


PACKAGES = ("drivers", "sim_fakes", "protocols", "recordings", "model", "diagnosis")
FIRST = {name: f"{name}/__init__.py" for name in PACKAGES} | {"timing": "timing.py"}
"""The file of each that is imported first."""
REMEDY = (
    f"install {NAME} into an environment of its own (python -m venv, pipx, uvx), and keep PYTHONPATH and the folder that you "
    "start Python in free of these names"
)


def strangers() -> str:
    """Complaints about packages of this software that are missing, hidden or overwritten; empty where all are its own."""
    home = Path(__file__).resolve().parent.parent
    written = _written()
    problems = []
    for name, first in FIRST.items():
        place, ours = _place(name), home / first
        if place is None:
            problems.append(f"the package {name} of {NAME} is missing from {home}: install {NAME} again")
        elif place != ours:
            problems.append(f"another package called {name}, {place}, hides the one of {NAME}, {ours}: {REMEDY}")
        elif name in written and urlsafe_b64encode(sha256(place.read_bytes()).digest()).rstrip(b"=").decode() != written[name]:
            problems.append(f"another package has written into {place}, which is {NAME}'s: {REMEDY}")
    return "\n".join(problems)


def _place(name: str) -> Path | None:
    """The file, or of a package without one the folder, that `import` would take."""
    spec = importlib.util.find_spec(name)
    if spec is None:
        return None
    return Path(spec.origin or next(iter(spec.submodule_search_locations or [name]))).resolve()


def _written() -> dict[str, str]:
    """SHA-256 of the first file of each package as the installer wrote it; nothing for a checkout."""
    try:
        files = distribution(NAME).files or ()
    except PackageNotFoundError:
        return {}
    names = {first: name for name, first in FIRST.items()}
    return {names[str(f)]: f.hash.value for f in files if str(f) in names and f.hash is not None}
