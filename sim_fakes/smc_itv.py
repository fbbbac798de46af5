"""Fake SMC ITV electro-pneumatic regulator with RS-232C: one unit on one pty.

Stricter than the instrument: lines must end in CR LF, words must be exact (one space, upper case), and a poll (`MON`,
`REQ`) that comes too soon after the last one is not answered.

Faults of its own, in `faults.extra`:
    refuse    a text answered to every command, such as "UNKNOWN COMMAND" or "OUT OF RANGE"
    ignore    set-points are acknowledged with the old one
    reading   counts that `MON` gives instead of the measured ones
    stuck     `MON` repeats the pressure that it gave when the fault began
The back door `device` gives the unit's state: set-point in counts, range, highest count that it takes;
`panel("setpoint", 41)` is a person at its keys.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

import timing
from timing import RigClock

from .plant import Plant
from .pty_fake import Device, PtyFake

STEPS = 1023


@dataclass
class ItvDevice(Device):
    """One regulator without its wire; pressures are Pa."""

    plant: Plant
    chambers: tuple[int, ...]
    full_scale: float
    setpoint: int = 0
    """Counts of 0..1023 over the full scale."""
    highest: int = STEPS
    """Largest set-point that it takes."""
    locked: bool = False
    """Its keys are locked: by a person, its line has no word for that."""

    def panel(self, setting: str, value: int) -> bool:
        """A person changes the "setpoint" or the "highest" one (counts) by its keys; False when they are locked."""
        if setting not in ("setpoint", "highest"):
            raise ValueError(f"a panel has no {setting!r}")
        if not self.locked:
            setattr(self, setting, value)
        return not self.locked

    def process(self, dt: float) -> None:
        """Drive the chambers' regulators."""
        with self.plant.lock:
            for chamber in self.chambers:
                self.plant.regulator[chamber - 1] = self.setpoint / STEPS * self.full_scale

    @property
    def pressure(self) -> float:
        """Mean pressure of its chambers, without noise."""
        with self.plant.lock:
            return float(np.mean([self.plant.chamber_pressure[c - 1] for c in self.chambers]))


class SmcItvFake(PtyFake):
    """The unit on one pty; `chambers` are the plant's chambers (1..9) that it feeds."""

    own_faults: ClassVar[Mapping[str, tuple[str, Any]]] = {
        "wrong_id": ("refuse", "ITV?"),
        "nak": ("refuse", "UNKNOWN COMMAND"),
        "stuck": ("stuck", True),
        "over_range": ("reading", 1023),
    }

    def __init__(
        self,
        plant: Plant,
        clock: RigClock,
        chambers: Sequence[int],
        seed: int = 0,
        full_scale: float = 500e3,
        poll_interval: float = 0.095,
    ) -> None:
        """`full_scale` in Pa; `poll_interval`: polls that come sooner are not answered, s of host time."""
        super().__init__("smc_itv", clock, 9600, seed)
        self.device = ItvDevice(plant, tuple(chambers), full_scale)
        self._poll_interval = poll_interval
        self._polled_at = -1.0
        self._stuck: int | None = None

    def process(self, dt: float) -> None:
        """Advance the unit."""
        self.device.process(dt)

    def panel(self, *change: Any) -> bool:
        """A person at the unit's keys; see `ItvDevice.panel`."""
        with self.lock:
            return self.device.panel(*change)

    def restart(self) -> None:
        """The set-point is forgotten."""
        self.device.setpoint = 0

    def feed(self) -> bool:
        """Answer one line."""
        line, end, rest = self.buffer.partition(b"\r\n")
        if not end:
            return False
        self.buffer = rest
        self.requests.append(line + end)
        text = line.decode("ascii", "replace")
        if text in ("MON", "REQ") and self._too_soon():
            return True
        refuse = self.faults.extra.get("refuse")
        answer = str(refuse) if refuse else self._answer(text)
        if not self.faults.freeze:
            self.device.process(0.0)  # a set-point works on the plant before its answer is out
        self.send(answer.encode("ascii") + b"\r\n")
        return True

    def _too_soon(self) -> bool:
        last, self._polled_at = self._polled_at, timing.now()
        return self._polled_at - last < self._poll_interval

    def _answer(self, text: str) -> str:
        if match := re.fullmatch(r"SET (\d+)", text):
            return self._set(int(match[1]))
        if text in ("INC", "DEC"):
            return self._set(self.device.setpoint + (2 if text == "INC" else -2))
        if text == "REQ":
            return str(self.device.setpoint)
        if text == "MON":
            return str(self._measured())
        return "UNKNOWN COMMAND"

    def _set(self, counts: int) -> str:
        if not 0 <= counts <= self.device.highest:
            return "OUT OF RANGE"
        if not self.faults.extra.get("ignore"):
            self.device.setpoint = counts
        return str(self.device.setpoint)

    def _measured(self) -> int:
        pressure = self.random.gauss(self.device.pressure, 200.0)  # Pa, standard deviation of a reading
        counts = max(0, min(STEPS, round(pressure / self.device.full_scale * STEPS)))
        if isinstance(shown := self.faults.extra.get("reading"), int):
            counts = shown
        if self.faults.extra.get("stuck"):
            counts = self._stuck = counts if self._stuck is None else self._stuck
        else:
            self._stuck = None
        return counts
