"""Fake Numato USB relay module: text commands ended by CR, each echoed, answered with lines and a `>` prompt. Lines end in LF
CR, or in CR alone as newer modules have it, whose version is no number either.

Stricter than the device: lower case and single blanks only; anything else gets the prompt and does nothing.

Faults by name in `faults.extra`:
- "stuck" (bool): the coil does not follow commands, which its read-back shows.
- "foreign" (str): this is answered to everything.
- "garbled" (str): this is read back instead of on or off.
- "welded" (bool): the contact stays as it is although the coil follows, which only the vacuum shows.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, ClassVar

from timing import RigClock

from .plant import Plant
from .pty_fake import PtyFake

NAMES = "0123456789ABCDEFGHIJKLMNOPQRSTUV"


class NumatoFake(PtyFake):
    """A relay module whose relay `valve` switches the vacuum."""

    own_faults: ClassVar[Mapping[str, tuple[str, Any]]] = {
        "wrong_id": ("foreign", "relay"),
        "nak": ("foreign", "?"),
        "stuck": ("stuck", True),
        "over_range": ("garbled", "2"),
    }

    def __init__(self, plant: Plant, clock: RigClock, relays: int = 4, valve: int = 0, baud: int = 19200, seed: int = 0) -> None:
        super().__init__("numato", clock, baud, seed)
        self.plant = plant
        self.coils = [False] * relays
        self.valve = valve
        self.identity = "SOFTLAB1"
        self.version, self.line_end = "00000008", b"\n\r"

    def process(self, dt: float) -> None:
        if not self.faults.extra.get("welded"):
            self.plant.valve_on = self.coils[self.valve]

    def restart(self) -> None:
        """Without power all coils drop."""
        self.coils = [False] * len(self.coils)

    def feed(self) -> bool:
        """Take one command; answer with its echo, a value if there is one, and the prompt."""
        line, end, rest = self.buffer.partition(b"\r")
        if not end:
            return False
        self.buffer = rest
        command = line.decode("ascii", "replace")
        self.requests.append(line)
        value = self._execute(command)
        if re.fullmatch(r"relay read .", command):
            value = str(self.faults.extra.get("garbled", value))
        if foreign := self.faults.extra.get("foreign"):
            self.send(str(foreign).encode() + self.line_end + b">")
            return True
        if not self.faults.freeze:
            self.process(0.0)
        self.send(line + self.line_end + (value.encode() + self.line_end if value else b"") + b">")
        return True

    def _execute(self, command: str) -> str:
        """Do it; returns the line to answer, empty for none."""
        if command == "ver":
            return self.version
        if command == "id get":
            return self.identity
        digits = max(2, len(self.coils) // 4)
        if command == "relay readall":
            mask = sum(on << i for i, on in enumerate(self.coils))
            return f"{mask:0{digits}x}"
        match = re.fullmatch(rf"relay writeall ([0-9a-f]{{{digits}}})", command)
        if match or command == "reset":
            mask = int(match[1], 16) if match else 0
            if not self.faults.extra.get("stuck"):
                self.coils = [bool(mask >> i & 1) for i in range(len(self.coils))]
            return ""
        match = re.fullmatch(r"relay (on|off|read) ([0-9A-V])", command)
        if match is None or NAMES.index(match[2]) >= len(self.coils):
            return ""
        relay = NAMES.index(match[2])
        if match[1] == "read":
            return "on" if self.coils[relay] else "off"
        if not self.faults.extra.get("stuck"):
            self.coils[relay] = match[1] == "on"
        return ""
