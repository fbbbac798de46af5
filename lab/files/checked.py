"""Files next to rig.yaml: when the rig last passed `lab check --move`, with which USB adapters, and which recording its run
writes.

Port names go to adapters in the order in which they are plugged in, so two of them may come back swapped. The check,
which shows that each instrument follows its commands, keeps the adapters of instruments that have no serial number of their
own; the guard refuses others.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from drivers.configs import PORTS
from drivers.errors import WrongDevice
from drivers.interfaces import Identity
from drivers.line_quality import adapter
from recordings.bounded import read_bounded
from recordings.own_files import replaced

from .config import ConfigError
from .rig_file import RigFile, addresses

KEY = "adapters"
"""In the file of the last check."""


def place(rig_path: Path) -> Path:
    """Return where the last check of a rig is kept."""
    return rig_path.with_suffix(".checked")


def adapters_now(rig: RigFile, identities: Mapping[str, Identity]) -> dict[str, str]:
    """Return the adapter at each port, by the port, of the instruments that were opened and have no serial number."""
    nameless = {name for name, identity in identities.items() if not identity.serial}
    ports = [text for name, key, text in addresses(rig.instruments) if name in nameless and key in PORTS]
    return {port: text for port in ports if (text := adapter(port))}


class Adapters:
    """The adapters that one rig's ports must have: those of its last check, and those of this session."""

    def __init__(self, rig: RigFile) -> None:
        self._rig = rig
        self._known: dict[str, str] = {}
        try:
            kept = json.loads(place(rig.path).read_text(encoding="utf-8"))[KEY] if rig.path is not None else {}
            self._known = {port: text for port, text in kept.items() if isinstance(text, str)}
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            pass  # never checked, or by an earlier version

    def check(self, name: str) -> None:
        """Raise WrongDevice when another adapter than before is at a port of this instrument; nothing is sent."""
        for port in (text for of, key, text in addresses(self._rig.instruments) if of == name and key in PORTS):
            if (before := self._known.get(port)) and (now := adapter(port)) and now != before:
                raise WrongDevice(
                    name,
                    f"at {port} is the USB adapter {now}, not {before} as before: the adapters have swapped names, and "
                    "this instrument cannot be told apart by its answers. Replug them in the old order, or write their "
                    "/dev/serial/by-id names in rig.yaml; after a change of adapters run lab check --move",
                )

    def learn(self, name: str, identity: Identity) -> None:
        """Note the adapters of an instrument that was opened."""
        self._known = adapters_now(self._rig, {name: identity}) | self._known


@dataclass(frozen=True)
class Moved:
    """One moved actuator: whether it followed its command, and the observation."""

    what: str
    ok: bool
    text: str


def digest(rig: RigFile) -> str:
    """SHA-256 of what the check depends on: instruments' tables but limits and time-outs, and where the stand is."""
    tables = rig.model_dump(mode="json", include={"instruments", "stand"})
    tables["instruments"].pop("sensors")  # they move nothing
    for table in tables["instruments"].values():
        for key in [k for k in table or {} if k.startswith("max_") or k == "timeout"]:
            del table[key]
    return hashlib.sha256(json.dumps(tables, sort_keys=True).encode()).hexdigest()


def keep(rig_path: Path, rig: RigFile, seen: Sequence[Moved], adapters: Mapping[str, str] | None = None) -> None:
    """Keep a check of today, with the adapters found (see `adapters_now`); one that was not passed removes an older one."""
    path = place(rig_path)
    if not all(moved.ok for moved in seen):
        path.unlink(missing_ok=True)
        return
    when = time.strftime("%Y-%m-%d %H:%M:%S")
    result = {"when": when, "digest": digest(rig), "seen": [asdict(m) for m in seen], KEY: dict(adapters or {})}
    replaced(path, json.dumps(result, indent=1) + "\n")


def last(rig_path: Path, rig: RigFile) -> dict[str, str] | str:
    """The last check that is valid for the present rig.yaml, or why there is none: local date and time under `moved`, and the
    observation of each actuator."""
    try:
        data: Any = json.loads(place(rig_path).read_text(encoding="utf-8"))
        if data["digest"] != digest(rig):
            return f"instruments or stand of {rig_path} were changed after the check of {data['when']}"
        return {"moved": str(data["when"]), **{str(m["what"]): str(m["text"]) for m in data["seen"]}}
    except FileNotFoundError:
        return f"{rig_path} has not passed `lab check --move`"
    except (OSError, ValueError, KeyError, TypeError):
        return f"{place(rig_path)} cannot be read"


def announce(rig: Path, recording: Path) -> None:
    """From now on the rig's run writes this recording; where the line cannot be written, nothing is announced."""
    with contextlib.suppress(OSError):
        replaced(rig.with_suffix(".recording"), os.fsencode(recording.resolve()) + b"\n")


def recording_of(rig: Path) -> Path:
    """The newest recording of a rig's runs; raises ConfigError when none is known."""
    if not rig.exists():
        raise ConfigError(f"{rig}: no such file; give a recording, or the rig.yaml of a run")
    line = rig.with_suffix(".recording")
    if not line.exists():
        raise ConfigError(f"{rig}: has no known run ({line.name} is not there); give its recording instead")
    found = Path(os.fsdecode(read_bounded(line, 5000, ConfigError).strip()))  # bytes
    if not found.is_file():
        raise ConfigError(f"{line}: names {found}, which does not exist; give the recording instead")
    return found
