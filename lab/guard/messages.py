"""What the program and its guard say to each other, beside commands and their answers."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.errors import InstrumentError

from .report import SafeReport


class RigLanded(RuntimeError):
    """The guard has landed the rig by itself; it takes no command until a person has confirmed."""


@dataclass(frozen=True)
class Event:
    """What the guard tells by itself: kind "landed", "confirmed" (an instrument is safe after the landing was reported),
    "pause", "clipped", "notice" (of a driver), "waiting" (the arm, for force samples) or "beat"."""

    kind: str
    text: str = ""
    error: InstrumentError | None = None
    report: SafeReport | None = None


@dataclass(frozen=True)
class Start:
    """The guard's first message."""

    rig: str
    """RigFile as JSON."""
    path: str
    """rig.yaml, beside which latch and journal are kept; empty: none are kept."""
    clock_start: float
    despite_latch: bool
    about: str
    """The command that the program serves, for others who want the rig."""
