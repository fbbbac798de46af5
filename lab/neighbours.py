"""Whether this software's packages are its own: their names are plain words (`model`, `drivers`), and others may use them too."""

from __future__ import annotations

import base64
import hashlib
import importlib.util
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from .version import NAME

ROOMS = ("drivers", "sim_fakes", "protocols", "recordings", "model", "diagnosis")
REMEDY = (
    f"install {NAME} into an environment of its own (python -m venv, pipx, uvx), and keep PYTHONPATH and the folder that you "
    "start Python in free of these names"
)


def strangers() -> str:
    """What stands where a package of this software should, and what to do; empty where all are its own."""
    home = Path(__file__).resolve().parent.parent
    written = _written()
    found = []
    for room in ROOMS:
        place = _place(room)
        if place is None:
            found.append(f"the package {room} of {NAME} is missing from {home}: install {NAME} again")
        elif place != home / room:
            found.append(f"another package called {room}, {place}, hides the one of {NAME}, {home / room}: {REMEDY}")
        elif room in written and _digest(place / "__init__.py") != written[room]:
            found.append(f"another package has written into {place}, which is {NAME}'s: {REMEDY}")
    return "\n".join(found)


def _place(room: str) -> Path | None:
    """The folder that `import` would take."""
    spec = importlib.util.find_spec(room)
    if spec is None:
        return None
    if spec.submodule_search_locations:
        return Path(next(iter(spec.submodule_search_locations))).resolve()
    return Path(spec.origin or room).resolve()


def _written() -> dict[str, str]:
    """SHA-256 of the first file of each package as the installer wrote it; nothing for a checkout."""
    try:
        files = distribution(NAME).files or ()
    except PackageNotFoundError:
        return {}
    firsts = {f"{room}/__init__.py": room for room in ROOMS}
    return {firsts[str(f)]: f.hash.value for f in files if str(f) in firsts and f.hash is not None}


def _digest(path: Path) -> str:
    """As installers write it."""
    return base64.urlsafe_b64encode(hashlib.sha256(path.read_bytes()).digest()).rstrip(b"=").decode()
