"""Whether this software's packages are its own: their names are plain words (`model`, `drivers`), and others may use them too."""

from __future__ import annotations

import base64
import hashlib
import importlib.util
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from .version import NAME

PACKAGES = ("drivers", "sim_fakes", "protocols", "recordings", "model", "diagnosis")
FIRST = {name: f"{name}/__init__.py" for name in PACKAGES} | {"timing": "timing.py"}
"""The file of each that is imported first."""
REMEDY = (
    f"install {NAME} into an environment of its own (python -m venv, pipx, uvx), and keep PYTHONPATH and the folder that you "
    "start Python in free of these names"
)


def strangers() -> str:
    """What stands where a package of this software should, and what to do; empty where all are its own."""
    home = Path(__file__).resolve().parent.parent
    written = _written()
    found = []
    for name, first in FIRST.items():
        place, own = _place(name), home / first
        if place is None:
            found.append(f"the package {name} of {NAME} is missing from {home}: install {NAME} again")
        elif place != own:
            found.append(f"another package called {name}, {place}, hides the one of {NAME}, {own}: {REMEDY}")
        elif name in written and _digest(place) != written[name]:
            found.append(f"another package has written into {place}, which is {NAME}'s: {REMEDY}")
    return "\n".join(found)


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


def _digest(path: Path) -> str:
    """As installers write it."""
    return base64.urlsafe_b64encode(hashlib.sha256(path.read_bytes()).digest()).rstrip(b"=").decode()
