"""What `lab check --move` found, kept beside rig.yaml: a run says when its rig was last seen to do what it is told."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from recordings.own_files import replaced

from ..files.adapters import KEY, place
from ..files.rig_file import RigFile


@dataclass(frozen=True)
class Moved:
    """One actuator that was tried: whether it did what it was told, and what was seen."""

    what: str
    ok: bool
    text: str


@dataclass(frozen=True)
class Checked:
    """A check that was passed."""

    when: str
    """Local date and time."""
    seen: tuple[Moved, ...]


def digest(rig: RigFile) -> str:
    """SHA-256 of what the check depends on: every instrument's table but its limits and time-outs, and where the stand is.

    When it changes, the check must be repeated.
    """
    tables = rig.model_dump(mode="json", include={"instruments", "stand"})
    tables["instruments"].pop("sensors")  # they move nothing
    for table in tables["instruments"].values():
        for key in [k for k in table or {} if k.startswith("max_") or k == "timeout"]:
            del table[key]
    return hashlib.sha256(json.dumps(tables, sort_keys=True).encode()).hexdigest()


def keep(rig_path: Path, rig: RigFile, seen: Sequence[Moved], adapters: Mapping[str, str] | None = None) -> None:
    """Keep a check of today, with the adapters found (see `files.adapters`); one that was not passed removes an older one."""
    path = place(rig_path)
    if not all(moved.ok for moved in seen):
        path.unlink(missing_ok=True)
        return
    when = time.strftime("%Y-%m-%d %H:%M:%S")
    result = {"when": when, "digest": digest(rig), "seen": [asdict(m) for m in seen], KEY: dict(adapters or {})}
    replaced(path, json.dumps(result, indent=1) + "\n")


def last(rig_path: Path, rig: RigFile) -> Checked | str:
    """The last check of a rig as its file is now, or why there is none."""
    try:
        data: Any = json.loads(place(rig_path).read_text(encoding="utf-8"))
        if data["digest"] != digest(rig):
            return f"instruments or stand of {rig_path} were changed after the check of {data['when']}"
        return Checked(str(data["when"]), tuple(Moved(**m) for m in data["seen"]))
    except FileNotFoundError:
        return f"{rig_path} never passed lab check --move, which fakes can do without"
    except (OSError, ValueError, KeyError, TypeError):
        return f"{place(rig_path)} cannot be read"
