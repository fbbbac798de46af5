"""The states of a campaign as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from model.condition import States, conditions
from model.robot import Robot
from recordings.trials import TIP, Table

from ..arrays import Array, Ints, Mask, rows_by, scattered
from .levels import vented_at_zero


@dataclass(frozen=True)
class Campaign:
    """n states as measured, in the order in which they happened, those of the robot before those of stiffness trials; SI, rad.

    The model's counterpart is `States`, where missing values have defaults (here NaN), vented chambers are at 0 Pa (here as
    read), and a trial in which the spine changes is split into several, numbered from 0.
    """

    trials: Table
    row: Ints
    """Index of each state among the rows of the case's table."""
    condition: Ints
    """States of equal number were meant to be the same."""
    kind: Ints
    """States of equal number belong to the same kind of experiment; 0 is the sweep that most states belong to."""
    pressure_gap: float
    """Pa within which pressures count as one setting."""
    history: Campaign | None = None
    """States of the same table whose tip was not read, with their `row`: laws with memory know them, nothing compares them."""

    def __len__(self) -> int:
        return len(self.trials)

    def take(self, rows: Mask) -> Campaign:
        """The states picked by a mask."""
        row, condition, kind = (of_states[rows] for of_states in (self.row, self.condition, self.kind))
        return Campaign(self.trials.take(rows), row, condition, kind, self.pressure_gap, self.history)

    pushed = cached_property[Mask](lambda s: s.trials.pushed)
    """(n,) states of stiffness trials: force and deflection of a cantilever, no tip."""
    trial = cached_property[Ints](lambda s: s.trials.trial)
    """(n,) number of the trial."""
    spine_length = cached_property[Array](lambda s: np.clip(s.trials.spine_length, 0.0, None))
    """(n,) m."""
    pressure = cached_property[Array](lambda s: np.where(s.pushed[:, None], 0.0, s.trials.pressures))
    """(n, chambers) Pa gauge; 0 for pushes."""
    vented_at_zero = cached_property[Array](lambda s: vented_at_zero(s.pressure, s.trial, s.pressure_gap))
    """(n, chambers) Pa gauge, those of vented chambers 0."""
    highest = cached_property[Array](lambda s: s.pressure.max(axis=1))
    """(n,) Pa, pressure of the most inflated chamber."""
    branch = cached_property[Array](lambda s: np.where(s.trials.get("branch") == "unload", -1.0, 1.0))
    """(n,) 1 load, -1 unload."""
    time = cached_property[Array](lambda s: s.trials.get("t"))
    """(n,) s; NaN where not recorded."""
    tip = cached_property[Array](lambda s: np.where(s.pushed[:, None], np.nan, s.trials.tip))
    """(n, 3) m, base frame; NaN for pushes."""
    roll = cached_property[Array](lambda s: np.radians(s.trials.get("roll_deg", 0.0)))
    """(n,) rad, by which the body was turned in its mount."""
    main = cached_property[Mask](lambda s: ~s.pushed if (~s.pushed).any() else s.pushed)
    """(n,) states in which the gap is looked for: all with a tip; the pushes where there are no others."""
    deflection = cached_property[Array](lambda s: np.where(s.pushed, s.trials.get("deflection", 0.0), 0.0))
    """(n,) m; 0 for states of the robot."""
    repeat = cached_property[Ints](lambda s: s.trials.get("repeat").astype(np.int64))
    """(n,) number of the repeat of the sweep."""
    inflated = cached_property[Mask](lambda s: (s.pressure > 0.5 * s.highest[:, None]) & (s.pressure > s.pressure_gap))
    """(n, chambers) chambers above half the state's highest pressure, and above `pressure_gap`."""

    @cached_property
    def chambers(self) -> tuple[tuple[int, ...], ...]:
        """Numbers, from 1, of the chambers inflated in each state; at rest those of the next state of its trial, else of the
        last."""
        out = self.inflated.copy()
        for own in rows_by(self.trial):
            used = own[self.inflated[own].any(axis=1)]
            if used.size:
                out[own] = self.inflated[used[np.minimum(np.searchsorted(used, own), used.size - 1)]]
        return tuple(tuple(int(c) + 1 for c in np.flatnonzero(row)) for row in out)

    points = cached_property[Array](lambda s: np.concatenate([s.tip[None], np.swapaxes(s.trials.markers, 0, 1)]))
    """(1 + k, n, 3) m, the tip and k markers."""

    def repeated(self, predicted: Array) -> Array:
        """(1 + k, n, 3) m, each point by the states of other trials in its condition: `predicted` (1 + k, n, 3) and the median of
        what it misses there; NaN where there are none."""
        out, points = np.full(self.points.shape, np.nan), np.ma.masked_invalid(self.points - predicted)
        for rows in rows_by(self.condition):
            for trial in np.unique(self.trial[rows]) if np.ptp(self.trial[rows]) else ():
                own = self.trial[rows] == trial
                out[:, rows[own]] = np.ma.median(points[:, rows[~own]], axis=1).filled(np.nan)[:, None]
        return out + predicted

    def farthest(self, expected: Array, trial: int | None = None) -> str:
        """The state, of one trial or of all, with a point that is farthest from where it is expected (1 + k, n, 3) m, and how
        far; empty where none is expected."""
        among = np.isin(self.trial, self.trial if trial is None else trial)
        off = np.where(among & np.isfinite(away := np.linalg.norm(self.points - expected, axis=2)), away, -1.0)
        point, i = np.unravel_index(off.argmax(), off.shape)
        time = f" (t = {self.time[i]:.1f} s)" if np.isfinite(self.time[i]) else ""
        what = f"marker {point} is" if point else "the tip is"
        return f"{self.trials.place(int(i))}{time}, where {what} {1e3 * off[point, i]:.3g} mm" if off[point, i] > 0 else ""

    @property
    def repeats(self) -> int:
        """Number of trials in which a state's condition was read, median over the states in which the gap is looked for."""
        # A state read twice in one trial is no repeat: it lacks the differences between trials.
        pairs = np.unique(np.column_stack([self.condition, self.trial])[self.main], axis=0)
        trials = np.unique(pairs[:, 0], return_counts=True)[1]
        return int(np.median(np.repeat(trials, trials)))

    @property
    def within_trials(self) -> bool:
        """Whether most conditions were read again, but in one trial only, as if it were several."""
        return self.repeats < 2 and float(np.median(np.unique(self.condition[self.main], return_counts=True)[1])) >= 2


def spread_over(count: int, most: int) -> Ints:
    """Numbers 0 .. `count` - 1, or as many of them as `most`, evenly spread."""
    return np.unique(np.linspace(0, count - 1, min(most, count)).astype(np.int64))


def tip_masses(robot: Robot, trials: Table) -> Array:
    """(n,) kg; the robot's own where none is recorded."""
    return trials.get("tip_mass", robot.tip_mass)


def tip_moments(robot: Robot, trials: Table) -> Array:
    """(n, 3) N m; the robot's own where none is recorded."""
    return np.column_stack([trials.get(f"tip_moment_{a}", m) for a, m in zip("xyz", robot.tip_moment, strict=True)])


def settings(robot: Robot, trials: Table, vented: bool = False) -> States:
    """The settings of each state, each a trial of its own; `vented`: without its pressures. Raises `BadCondition`."""
    return conditions(
        robot,
        np.clip(trials.spine_length, 0.0, None),
        np.zeros((len(trials), len(robot.actuators.azimuths_deg))) if vented else trials.pressures,
        tip_masses(robot, trials),
        np.radians(trials.get("roll_deg", 0.0)),
        trials.tip_force,
        tip_moments(robot, trials),
    )


def places(states: int, row: Ints, channel: NDArray[np.str_], values: Array, axes: Sequence[str] = TIP) -> Array:
    """(states, 3) the tip, or the point of `axes`, among values (n,), each of a state `row` and a channel; NaN where none is."""
    return np.column_stack([scattered((states,), row[channel == axis], values[channel == axis]) for axis in axes])


@dataclass(frozen=True)
class Labels:
    """What each of n measured values is."""

    state: Ints
    """(n,) index into the states."""
    channel: NDArray[np.str_]
    """(n,) x, y, z; rx, ry, rz are turns of the tip, m1x, m1y .. places of markers; force."""
    axis = cached_property[Ints](lambda s: np.array([max("xyz".find(name[-1]), 0) for name in s.channel], np.int64))
    """(n,) which of its kind's three axes; 0 for forces."""

    @cached_property
    def kind(self) -> Ints:
        """(n,) 0 tip, 1 orientation, 2 marker, 3 force."""
        turn, marker = np.char.startswith(self.channel, "r"), np.char.startswith(self.channel, "m")
        return np.select([turn, marker, self.channel == "force"], [1, 2, 3], 0).astype(np.int64)
