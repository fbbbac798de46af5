"""The states of a campaign as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from model.condition import States, conditions
from model.robot import Robot
from recordings.trials import TrialRow

from ..arrays import Array, Ints, Mask


@dataclass(frozen=True)
class Campaign:
    """n states as measured, in the order in which they happened, those of the robot before those of stiffness trials; SI, rad.

    The model has the same as `States`: there what a row does not state has its default (here it is None in `rows`), vented
    chambers are at 0 Pa (here: as read), and a trial in which the spine changes is several, numbered from 0.
    """

    rows: tuple[TrialRow, ...]
    condition: Ints
    """States of equal number were meant to be the same."""
    kind: Ints
    """States of equal number belong to the same kind of experiment; 0 is the sweep that most states belong to."""
    pressure_gap: float
    """Pa within which pressures count as one setting."""

    def __len__(self) -> int:
        return len(self.rows)

    def take(self, rows: Mask) -> Campaign:
        """The states picked by a mask."""
        kept = tuple(r for r, k in zip(self.rows, rows, strict=True) if k)
        return Campaign(kept, self.condition[rows], self.kind[rows], self.pressure_gap)

    @cached_property
    def pushed(self) -> Mask:
        """(n,) states of stiffness trials: force and deflection of a cantilever, no tip."""
        return np.array([r.protocol == "stiffness" for r in self.rows], bool)

    @cached_property
    def trial(self) -> Ints:
        """(n,) number of the trial."""
        return np.array([r.trial for r in self.rows], np.int64)

    @cached_property
    def spine_length(self) -> Array:
        """(n,) m."""
        return np.clip([r.spine_length for r in self.rows], 0.0, None)

    @cached_property
    def pressure(self) -> Array:
        """(n, chambers) Pa gauge; 0 for pushes."""
        of_robot = [r.pressures for r, pushed in zip(self.rows, self.pushed, strict=True) if not pushed]
        out = np.zeros((len(self), len((of_robot or [r.pressures for r in self.rows] or [(0.0,)])[0])))
        if of_robot:
            out[~self.pushed] = of_robot
        return out

    @cached_property
    def branch(self) -> Array:
        """(n,) 1 load, -1 unload."""
        return np.array([-1.0 if r.branch == "unload" else 1.0 for r in self.rows])

    @cached_property
    def time(self) -> Array:
        """(n,) s; NaN where not recorded."""
        return np.array([np.nan if r.t is None else r.t for r in self.rows])

    @cached_property
    def tip(self) -> Array:
        """(n, 3) m, base frame; NaN for pushes."""
        tips = [(np.nan,) * 3 if pushed else r.tip for r, pushed in zip(self.rows, self.pushed, strict=True)]
        return np.array(tips, float).reshape(len(self), 3)

    @cached_property
    def roll(self) -> Array:
        """(n,) rad, by which the body was turned in its mount."""
        return np.radians([r.roll_deg or 0.0 for r in self.rows])

    @cached_property
    def main(self) -> Mask:
        """(n,) states in which the gap is looked for: all with a tip; the pushes where there are no others."""
        return ~self.pushed if (~self.pushed).any() else self.pushed

    @cached_property
    def deflection(self) -> Array:
        """(n,) m; 0 for states of the robot."""
        return np.array([(r.deflection or 0.0) if p else 0.0 for r, p in zip(self.rows, self.pushed, strict=True)])

    @cached_property
    def repeat(self) -> Ints:
        """(n,) number of the repeat of the sweep."""
        return np.array([r.repeat for r in self.rows], np.int64)

    @cached_property
    def inflated(self) -> Mask:
        """(n, chambers) chambers above half the state's highest pressure, and above `pressure_gap`."""
        return np.asarray((self.pressure > 0.5 * self.highest[:, None]) & (self.pressure > self.pressure_gap))

    @cached_property
    def chambers(self) -> tuple[tuple[int, ...], ...]:
        """Numbers, from 1, of the chambers inflated in each state; at rest those of the next state of its trial, else of the
        last."""
        out = self.inflated.copy()
        for trial in np.unique(self.trial):
            own = np.flatnonzero(self.trial == trial)
            used = own[self.inflated[own].any(axis=1)]
            if used.size:
                out[own] = self.inflated[used[np.minimum(np.searchsorted(used, own), used.size - 1)]]
        return tuple(tuple(int(c) + 1 for c in np.flatnonzero(row)) for row in out)

    @property
    def highest(self) -> Array:
        """(n,) Pa, pressure of the most inflated chamber."""
        return np.asarray(self.pressure.max(axis=1))

    @property
    def repeats(self) -> int:
        """Number of trials in which a condition was read, median over the conditions in which the gap is looked for."""
        # A state read twice in one trial is not repeated: what differs from trial to trial is not in it.
        pairs = np.unique(np.column_stack([self.condition, self.trial])[self.main], axis=0)
        return int(np.median(np.unique(pairs[:, 0], return_counts=True)[1]))


def spread_over(count: int, most: int) -> Ints:
    """Numbers 0 .. `count` - 1, or as many of them as `most`, evenly spread."""
    return np.unique(np.linspace(0, count - 1, min(most, count)).astype(np.int64))


def tip_masses(robot: Robot, rows: Sequence[TrialRow]) -> Array:
    """(n,) kg; the robot's own where none is recorded."""
    return np.array([robot.tip_mass if r.tip_mass is None else r.tip_mass for r in rows])


def settings(robot: Robot, rows: Sequence[TrialRow], vented: bool = False) -> States:
    """What was asked of the robot in each row, a trial of its own; `vented`: without its pressures. Raises `BadCondition`."""
    pressures = np.array([r.pressures for r in rows])
    return conditions(
        robot,
        np.clip([r.spine_length for r in rows], 0.0, None),
        np.zeros((len(rows), len(robot.actuators.azimuths_deg))) if vented else pressures,
        tip_masses(robot, rows),
        np.radians([r.roll_deg or 0.0 for r in rows]),
        np.array([r.tip_force for r in rows]),
    )
