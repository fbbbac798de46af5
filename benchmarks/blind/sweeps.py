"""What is measured on a blind case (the base sweep, the menu of further experiments) and which of it a design shows."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

from lab.files.config import ConfigError
from recordings.trials import Table, TrialRow

Reading = Literal["fly", "settled", "hold"]
BEND = (9, 1, 2)
"""Chambers inflated in the base sweep."""
ALL = tuple(range(1, 10))


@dataclass(frozen=True)
class PlannedState:
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
class MenuSweep:
    """Spine lengths by pressures of one chamber group, up and perhaps down again. SI units."""

    name: str
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

    def states(self) -> Iterator[PlannedState]:
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
                        yield PlannedState(trial, step, repeat, branch, spine, vacuum, self._at(pressure, branch), rate, hold)

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
        # s from the ramp's end to the middle of a settled reading
        return (0.0,) if self.reading == "fly" and pressure > 0 else (5.0,)


PAPER_LENGTHS = (0.0, 0.05, 0.10, 0.15, 0.20, 0.25, 0.30)
PAPER_PRESSURES = (50e3, 100e3, 150e3, 200e3, 250e3)
BASE = MenuSweep("base", PAPER_LENGTHS, PAPER_PRESSURES, repeats=3, unload=True, reading="fly", rate=5e3)
"""The paper's 35 states, loading and unloading, three times, with the state at zero pressure."""

_FEW = (0.0, 0.15, 0.30)
MENU: tuple[MenuSweep, ...] = (
    MenuSweep("tip_mass", _FEW, (50e3, 150e3, 250e3), repeats=2, tip_mass=0.153),
    MenuSweep("all_chambers", _FEW, (50e3, 100e3, 150e3), chambers=ALL, repeats=2),
    MenuSweep("other_group", _FEW, (100e3, 200e3), chambers=(3, 4, 5), repeats=2),
    MenuSweep("roll", _FEW, (100e3, 200e3), repeats=2, roll_deg=90.0),
    MenuSweep("hold", _FEW, (150e3,), repeats=2, zero_state=False, reading="hold",
          holds=(2.0, 5.0, 10.0, 30.0)),
    MenuSweep("fast", _FEW, PAPER_PRESSURES, repeats=2, unload=True, reading="fly", rate=20e3),
    MenuSweep("vacuum", (0.10, 0.20, 0.30), (100e3, 200e3), repeats=2, vacuums=(30e3, 50e3)),
)  # fmt: skip
"""Experiments a diagnosis may ask for, each measured on the same robot."""


@dataclass(frozen=True)
class Design:
    """The share of the measurements that a diagnosis is given."""

    name: str
    both_branches: bool
    """Unload branch and zero state; without, the paper's own data: loading only, from 50 kPa on."""
    orientation: bool
    markers: bool
    extras: bool
    """All experiments of the menu at once."""

    def show(self, table: Table) -> Table:
        """The rows and columns that are shown: of one branch the paper's states."""
        return Table.of(self._row(r) for r in table if self.both_branches or (r.branch == "load" and max(r.pressures) > 20e3))

    def _row(self, r: TrialRow) -> TrialRow:
        return replace(r, orientation=r.orientation if self.orientation else None, markers=r.markers if self.markers else ())


DESIGNS = {
    d.name: d
    for d in (
        Design("tip", False, False, False, False),
        Design("full", True, True, False, False),
        Design("full+markers", True, True, True, False),
        Design("full+extras", True, True, False, True),
    )
}
CHANNELS = ("unload", "orientation", "markers")
"""Further channels of the base sweep that can be asked for like an experiment."""


def design(name: str) -> Design:
    """By name; raises ConfigError."""
    if name not in DESIGNS:
        raise ConfigError(f"--design {name}: must be one of {', '.join(DESIGNS)}")
    return DESIGNS[name]
