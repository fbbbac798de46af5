"""Tells from the robot's shape that a jammed spine has gone soft, where the vacuum gauge does not."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from recordings.trials import TrialRow, Vector3

FARTHER = 1.5
"""Times the deflection of the load branch that a tip may have at the same pressure when unloading: hysteresis and creep make
up to a fifth more, a spine of 20 cm that goes soft nearly twice as much, a longer one more."""


@dataclass
class Shapes:
    """The tips of one sweep: where the chambers were vented, and at each pressure (Pa) of the load branch; m, base frame."""

    straight: Vector3 | None = None
    loaded: dict[float, Vector3] = field(default_factory=dict)
    seen: str = ""
    """What showed last that the spine had gone soft; empty while nothing did."""
    asked: bool = False
    """A person was asked about it in this trial: seen again with the spine jammed anew, it only marks the trial."""

    def begin(self) -> None:
        """The sweep begins, perhaps again."""
        self.straight, self.seen = None, ""
        self.loaded.clear()

    def take(self, branch: Literal["load", "unload"], pressure: float, row: TrialRow) -> bool:
        """Compare a state that was read with the others; returns whether the spine must have gone soft in between."""
        if row.tip is None:
            return False
        if branch == "load":
            if not pressure:
                self.straight = row.tip
            self.loaded[pressure] = row.tip
        if branch == "load" or not pressure or self.straight is None or pressure not in self.loaded:
            return False
        before, now = math.dist(self.loaded[pressure], self.straight), math.dist(row.tip, self.straight)
        # m
        if now - before < 0.01 or now < FARTHER * before:
            return False
        self.seen = (
            f"at {pressure / 1e3:g} kPa the tip is deflected by {now * 1e3:.0f} mm when unloading and was by "
            f"{before * 1e3:.0f} mm when loading, limit {FARTHER:g} times as much"
        )
        return True
