"""Messages between the program and its guard, other than commands and their results; what a landing reached, instrument by
instrument. Imports nothing, so that `lab safe` can ask for it at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.errors import InstrumentError

SAFE_WORDS = {"pressure": "vented", "arm": "stopped", "spine": "stopped", "valve": "vacuum off"}
"""What each actuator is in its safe state."""


@dataclass(frozen=True)
class SafeStep:
    """One instrument brought into the safe state: confirmed by reading back, or what went wrong."""

    instrument: str
    confirmed: bool
    text: str


@dataclass(frozen=True)
class SafeReport:
    """What was reached; `confirmed` only when every instrument was read back safe."""

    steps: tuple[SafeStep, ...] = field(default_factory=tuple)
    seconds: float = 0.0
    """Host time from the first stop to the last reading."""

    @property
    def confirmed(self) -> bool:
        """True when every instrument is confirmed safe."""
        return all(s.confirmed for s in self.steps)

    @property
    def said(self) -> str:
        """One line for people: what was confirmed, or what has to be done by hand."""
        if self.confirmed:
            done = dict.fromkeys(SAFE_WORDS.get(s.instrument, "safe") for s in self.steps)
            return f"{', '.join(done)}: confirmed {self.seconds:.1f} s later" if done else "nothing was open"
        left = "; ".join(f"{s.instrument}: {s.text}" for s in self.steps if not s.confirmed)
        return f"safe state NOT confirmed: {left}. Use the vent valve and the emergency stop"

    def __str__(self) -> str:
        return "; ".join(f"{s.instrument} {'safe' if s.confirmed else 'NOT CONFIRMED'}: {s.text}" for s in self.steps) or (
            "nothing was open"
        )

    @classmethod
    def parsed(cls, steps: Any) -> SafeReport:
        """A report from the JSON of its steps; raises ValueError when it is none."""
        if not isinstance(steps, list) or not all(isinstance(s, Mapping) for s in steps):
            raise ValueError("no list of steps")
        try:
            return cls(tuple(SafeStep(str(s["instrument"]), s["confirmed"] is True, str(s["text"])) for s in steps))
        except KeyError as e:
            raise ValueError(f"a step without {e}") from e


class RigLanded(RuntimeError):
    """The guard has landed the rig on its own; it accepts no command until a person has confirmed."""


@dataclass(frozen=True)
class Event:
    """Unprompted message of the guard: kind "landed", "confirmed" (an instrument is safe after the landing was reported),
    "pause", "clipped", "notice" (of a driver), "waiting" (the arm, for force samples) or "beat"."""

    kind: str
    text: str = ""
    error: InstrumentError | None = None
    report: SafeReport | None = None


@dataclass(frozen=True)
class Start:
    """The guard's first message."""

    path: str
    """rig.yaml, next to which latch and journal are kept; the guard reads it itself."""
    sha256: str
    """Of the content that the program read."""
    max_pressure: float | tuple[float, ...] | None
    """Pa, of robot.yaml, which the guard does not read."""
    clock_start: float
    despite_latch: bool
    about: str
    """The command that the program serves, for others who want the rig."""
