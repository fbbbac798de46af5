"""Which USB adapter was at each serial port of an instrument that has no serial number of its own.

Port names go to adapters in the order in which they are plugged in, so that two of them may come back exchanged. `lab check
--move`, which shows that each instrument does what it is told, keeps the adapters; the guard refuses others.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from drivers.configs import PORTS, InstrumentConfig
from drivers.errors import WrongDevice
from drivers.interfaces import Identity
from drivers.line_quality import adapter

from .rig_file import RigFile, present, table_of

KEY = "adapters"
"""In the file of the last check."""


def place(rig_path: Path) -> Path:
    """Return where the last check of a rig is kept."""
    return rig_path.with_suffix(".checked")


def _ports(config: InstrumentConfig) -> tuple[str, ...]:
    """The serial ports in an instrument's table."""
    values = [getattr(config, key, ()) for key in PORTS]
    return tuple(port for value in values for port in (value if isinstance(value, tuple) else (value,)))


def adapters_now(rig: RigFile, identities: Mapping[str, Identity]) -> dict[str, str]:
    """Return the adapter at each port, by the port, of the instruments that were opened and have no serial number."""
    nameless = [name for name in present(rig.instruments) if name in identities and not identities[name].serial]
    found = {port: adapter(port) for name in nameless for port in _ports(table_of(rig.instruments, name))}
    return {port: text for port, text in found.items() if text}


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
        for port in _ports(table_of(self._rig.instruments, name)):
            if (before := self._known.get(port)) and (now := adapter(port)) and now != before:
                raise WrongDevice(
                    name,
                    f"at {port} is the USB adapter {now}, needed {before} as before: adapters have exchanged their names, and "
                    "this instrument cannot tell; unplug them and put them back, or write their /dev/serial/by-id names in "
                    "rig.yaml; after a change of adapters run lab check --move",
                )

    def learn(self, name: str, identity: Identity) -> None:
        """Note the adapters of an instrument that was opened."""
        self._known = adapters_now(self._rig, {name: identity}) | self._known
