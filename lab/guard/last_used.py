"""The rig as its last guard used it, kept where nobody edits it: `lab safe` uses it when rig.yaml cannot be read.

A guard writes it before it opens anything, to the folder of temporary files that outlive a restart of the computer, and
removes it when the rig was left safe. A copy counts only when it belongs to the reader, to root or to the owner of the
folder of rig.yaml.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import stat
from collections.abc import Iterator
from pathlib import Path

from pydantic import ValidationError

from recordings.json_text import read_json
from recordings.own_files import opened, replaced

from ..files.rig_file import RigFile
from .door import believed_accounts

FOLDER = Path("/var/tmp")
PREFIX = "softlab-rig-"


def remember(rig: RigFile) -> None:
    """Keep a rig. A full disk must not stop the guard."""
    if rig.path is not None:
        with contextlib.suppress(OSError):
            replaced(_place(rig.path), json.dumps({"path": str(rig.path), "rig": rig.model_dump_json()}))


def forget(rig: RigFile) -> None:
    """A rig was left safe."""
    if rig.path is not None:
        with contextlib.suppress(OSError):
            _place(rig.path).unlink()


def recall(path: Path) -> RigFile | None:
    """The rig as it was last used with the rig.yaml of this path; None when that is not known."""
    return next((found for found in remembered(_digest(path.resolve())) if found.path == path.resolve()), None)


def _place(path: Path) -> Path:
    return FOLDER / f"{PREFIX}{os.getuid()}-{_digest(path)}.json"


def _digest(path: Path) -> str:
    return hashlib.sha256(os.fsencode(path)).hexdigest()[:24]


def remembered(digest: str = "*") -> Iterator[RigFile]:
    """All rigs of this computer that were not left safe, or those with this digest of their path, as far as this user may know.

    Newest first; damaged files and those of other users are ignored."""
    places = [(p.lstat().st_mtime, p) for p in FOLDER.glob(f"{PREFIX}*-{digest}.json")]
    for _, place in sorted(places, reverse=True):
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError, ValidationError):
            with open(opened(place, os.O_RDONLY), "rb") as file:
                about, text = os.fstat(file.fileno()), file.read(1_000_000)
            data = read_json(text)
            path = Path(data["path"])
            if stat.S_IMODE(about.st_mode) & 0o022 or about.st_uid not in believed_accounts(path):
                continue
            yield RigFile.model_validate_json(data["rig"]).read_from(path)
