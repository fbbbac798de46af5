"""What is measured on a blind case: the base sweep, and the menu of further experiments, as the bending protocol does them."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

Reading = Literal["fly", "settled", "hold"]
BEND = (9, 1, 2)
"""Chambers inflated in the base sweep."""
ALL = tuple(range(1, 10))
SETTLED_HOLD = 5.0
"""s from the ramp's end to the middle of a settled reading."""


@dataclass(frozen=True)
class State:
    """One reading of a sweep. SI units; `rate` signed, `hold` since the ramp's end, 0 when read while ramping."""

    trial: int
    step: int
    repeat: int
    branch: str
    spine_length: float
    vacuum: float
    pressure: float
    rate: float
    hold: float


@dataclass(frozen=True)
class Sweep:
    """Spine lengths by pressures of one chamber group, up and perhaps down again. SI units."""

    name: str
    title: str
    spine_lengths: tuple[float, ...]
    pressures: tuple[float, ...]
    chambers: tuple[int, ...] = BEND
    repeats: int = 1
    unload: bool = False
    zero_state: bool = True
    reading: Reading = "settled"
    rate: float = 25e3
    average: float = 3.0
    """s that a reading averages, at least."""
    band: float = 7.5e3
    """Pa before the ramp's end at which its last level is read on the fly: half the average must fit in between."""
    holds: tuple[float, ...] = ()
    """Readings after the ramp's end, s, for `reading` hold."""
    tip_mass: float = 0.053
    roll_deg: float = 0.0
    vacuums: tuple[float, ...] = (80e3,)

    @property
    def protocol(self) -> str:
        """The protocol that does it."""
        return "elongation" if self.chambers == ALL else "bending"

    def states(self) -> Iterator[State]:
        """Every reading, in order."""
        up = [(0.0, "load")] * self.zero_state + [(p, "load") for p in self.pressures]
        down = [(p, "unload") for p in self.pressures[-2::-1]] + [(0.0, "unload")] * self.zero_state
        levels = up + down * self.unload
        trial = 0
        for vacuum in self.vacuums:
            for repeat, spine in itertools.product(range(1, self.repeats + 1), self.spine_lengths):
                trial += 1
                step, before = 0, 0.0
                for pressure, branch in levels:
                    moved = pressure - before
                    rate = 0.0 if abs(moved) < 1e3 else self.rate * (1 if moved > 0 else -1)
                    before = pressure
                    for hold in self._holds(pressure):
                        step += 1
                        yield State(trial, step, repeat, branch, spine, vacuum, self._at(pressure, branch), rate, hold)

    def _at(self, pressure: float, branch: str) -> float:
        """Where a level is read: on the fly the last of a ramp just before its end."""
        if self.reading != "fly" or pressure == 0:
            return pressure
        if branch == "load":
            return pressure - self.band * (pressure == self.pressures[-1])
        return pressure + self.band * (pressure == self.pressures[0])

    def _holds(self, pressure: float) -> tuple[float, ...]:
        if self.reading == "hold":
            return self.holds
        return (0.0,) if self.reading == "fly" and pressure > 0 else (SETTLED_HOLD,)

    def settings(self) -> list[str]:
        """The same sweep as KEY=VALUE settings of the protocol."""
        words = {"fly": "sweep", "settled": "settled", "hold": "hold"}
        settings = [
            f"spine_lengths={list(self.spine_lengths)}",
            f"pressures={list(self.pressures)}",
            f"chambers={list(self.chambers)}",
            f"repeats={self.repeats}",
            f"unload={str(self.unload).lower()}",
            f"zero_state={str(self.zero_state).lower()}",
            f"reading={words[self.reading]}",
            f"rate={self.rate}",
            f"tip_mass={self.tip_mass}",
            f"roll_deg={self.roll_deg}",
            f"vacuums={list(self.vacuums)}",
            f"settle.average={self.average}",
            f"settle.band={self.band if self.reading == 'fly' else 1.5e3}",
        ]
        return settings + ([f"hold_times={list(self.holds)}"] if self.holds else [])


PAPER_LENGTHS = (0.0, 0.05, 0.10, 0.15, 0.20, 0.25, 0.30)
PAPER_PRESSURES = (50e3, 100e3, 150e3, 200e3, 250e3)
BASE = Sweep("base", "bending sweep", PAPER_LENGTHS, PAPER_PRESSURES, repeats=3, unload=True, reading="fly", rate=5e3)
"""The paper's 35 states, loading and unloading, three times, with the state at zero pressure."""
AGAIN = "again"
"""The base sweep measured once more, as others do instead of choosing."""
BASE_SETTLED = replace(BASE, reading="settled", rate=25e3)

_FEW = (0.0, 0.15, 0.30)
MENU: tuple[Sweep, ...] = (
    Sweep("tip_mass", "100 g more at the tip", _FEW, (50e3, 150e3, 250e3), repeats=2, tip_mass=0.153),
    Sweep("all_chambers", "all nine chambers at once", _FEW, (50e3, 100e3, 150e3), chambers=ALL, repeats=2),
    Sweep("other_group", "chambers 3, 4, 5", _FEW, (100e3, 200e3), chambers=(3, 4, 5), repeats=2),
    Sweep("roll", "robot re-mounted, rolled by 90 deg", _FEW, (100e3, 200e3), repeats=2, roll_deg=90.0),
    Sweep("hold", "held at pressure", _FEW, (150e3,), repeats=2, zero_state=False, reading="hold",
          holds=(2.0, 5.0, 10.0, 30.0)),
    Sweep("fast", "faster ramp, read on the fly", _FEW, PAPER_PRESSURES, repeats=2, unload=True, reading="fly", rate=20e3),
    Sweep("vacuum", "less vacuum", (0.10, 0.20, 0.30), (100e3, 200e3), repeats=2, vacuums=(30e3, 50e3)),
)  # fmt: skip
"""Experiments a diagnosis may ask for, each measured on the same robot."""
