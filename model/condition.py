"""States: what is asked of the robot in each of n states, as arrays with one row a state."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from model.arrays import Array, Ints, Mask
from model.errors import BadCondition
from model.robot import Robot

LOWEST_PRESSURE = -101_325.0
"""Pa gauge: a perfect vacuum."""
HIGHEST_PRESSURE = 2e6
"""Pa gauge: beyond this a value is taken for a wrong unit."""
RATE, HOLD = 25e3, 2.0
"""Pa/s and s, where a table does not say how a state was reached."""
NOMINAL_VACUUM = 80e3
"""Pa below ambient at which the robot's spine moduli hold, when the table has no vacuum."""
USED = 0.02
"""Share of the largest pressure; a chamber that never reads more within a trial is taken as vented."""
TIP = ("x", "y", "z")


@dataclass(frozen=True)
class States:
    """n states of one robot in the order in which they happened, and which channels were read of them; SI.

    Made by `conditions` of settings, by `model.effects.design.design_from_columns` of a table.
    """

    trial: Ints
    """(n,) 0..trials-1; states of one trial follow each other and share one history."""
    trial_id: Ints
    """(trials,) the numbers the table gives them."""
    stiffness: Mask
    """(n,) rows of force over deflection; the others are states of the robot."""
    body: Mask
    """(n,) stiffness rows whose specimen is the body, not the bare spine."""
    unload: Mask
    repeat: Ints
    t: Array
    """(n,) s."""
    rate: Array
    """(n,) Pa/s, magnitude."""
    hold: Array
    """(n,) s; 0 = read while ramping."""
    sitting: Ints
    """(n,) number 0.. of the sitting: a new one, with the robot perhaps mounted anew, begins with a trial before which t starts
    again or nothing was read for longer than `model.effects.design.PAUSE`."""
    progress: Array
    """(n,) part of the campaign that has passed, 0 to 1: by time where it is known throughout, else by trials."""
    spine_length: Array
    """(n,) m."""
    vacuum: Array
    """(n,) Pa below ambient."""
    nominal_vacuum: float
    """Pa, the vacuum of most states with spine, at which the robot's spine moduli are taken to hold."""
    tip_mass: Array
    """(n,) kg."""
    force: Array
    """(n, 3) N, known forces on the tip, base frame, besides the weight of `tip_mass`."""
    moment: Array
    """(n, 3) N m, known moments on the tip, base frame."""
    roll: Array
    """(n,) rad."""
    pressure: Array
    """(n, chambers) Pa gauge, as read."""
    used: Mask
    """(n, chambers) chambers that are pressurised at some state of the trial."""
    deflection: Array
    """(n,) m; 0 where the row is no stiffness row."""
    unread: Mask
    """(n,) states without a reading, which laws with memory alone know."""
    channels: tuple[str, ...]
    """Observed channels, of x y z, rx ry rz, m1x .. mKz, force."""

    def __len__(self) -> int:
        return len(self.trial)

    def __getitem__(self, rows: slice | Mask | NDArray[np.integer[Any]]) -> States:
        """The states picked by a slice, mask or index array; trials keep their numbers."""
        return replace(self, **{name: getattr(self, name)[rows] for name in _BY_STATE})

    @cached_property
    def highest_of_trial(self) -> Array:
        """(n, chambers) Pa gauge, the highest reading of each chamber in the state's trial."""
        return highest_of_trial(self.trial, self.pressure)

    @cached_property
    def pace(self) -> float | None:
        """s, geometric mean of the median time between readings and the median duration of a trial; None where no time passes."""
        moving = self[~self.stiffness]
        first = np.diff(moving.trial, prepend=-1) != 0
        step = np.abs(np.where(first[:, None], moving.pressure, np.diff(moving.pressure, axis=0, prepend=0.0))).max(axis=1)
        reached = step / np.where(moving.rate > 0, moving.rate, np.inf) + np.maximum(moving.hold, 0.0)
        gap = np.diff(moving.t, prepend=np.nan)
        passed = np.where(~first & (gap > 0), gap, reached)
        if not (passed > 0).any():
            return None
        trials = np.add.reduceat(passed, np.flatnonzero(first))
        return float(np.sqrt(np.median(passed[passed > 0]) * np.median(trials[trials > 0])))

    @property
    def markers(self) -> int:
        """How many markers are observed."""
        return sum(1 for name in self.channels if re.fullmatch(r"m\d+x", name))

    def by_spine_length(self) -> Iterator[tuple[float, Mask]]:
        """Each spine length (m, to 0.1 mm) with the mask of its states, shortest first."""
        rounded = np.round(self.spine_length, 4)
        for length in np.unique(rounded):
            yield float(length), rounded == length

    def check(self, robot: Robot) -> None:
        """Raise `BadCondition` where the states do not fit the robot."""
        count, words = len(robot.actuators.azimuths_deg), robot.actuators.words
        if self.pressure.shape[1] != count:
            raise BadCondition(
                f"pressure: {self.pressure.shape[1]} columns, robot {robot.name!r} has {count} {words.actuators}: "
                f"give one column per {words.actuator}"
            )
        limit = robot.length if robot.spine is not None else 0.0
        reason = "the robot's length" if robot.spine is not None else "this robot has no spine"
        too_long = self.spine_length > limit * (1 + 1e-9)
        _refuse("spine_length", "m", self.spine_length, too_long, f"must not exceed {limit:g} m ({reason})")


_BY_STATE = [f.name for f in fields(States) if f.name not in ("trial_id", "nominal_vacuum", "channels")]


def conditions(
    robot: Robot,
    spine_length: ArrayLike,
    pressure: ArrayLike,
    tip_mass: ArrayLike | None = None,
    roll: ArrayLike = 0.0,
    force: ArrayLike = (0.0, 0.0, 0.0),
    moment: ArrayLike | None = None,
    vacuum: float = NOMINAL_VACUUM,
    rate: float = RATE,
    hold: float = HOLD,
) -> States:
    """States of `robot` from numbers or arrays that broadcast over n, each a trial of its own; raises `BadCondition`.

    spine_length in m, pressure (..., chambers) in Pa gauge, tip_mass in kg, roll in rad, force (..., 3) in N and moment (..., 3)
    in N m on the tip, base frame; mass and moment are the robot's own when None. Read `hold` s after a ramp of `rate` Pa/s from
    rest, at the vacuum (Pa) at which the spine's moduli hold.

    >>> from pathlib import Path
    >>> from model.robot import load_robot
    >>> states = conditions(load_robot(Path("robot.yaml")), [0.0, 0.1, 0.2], [60e3] * 3 + [0.0] * 6)
    >>> len(states), states.pressure.shape
    (3, (3, 9))
    """
    given = {"pressure": pressure, "force": force, "moment": robot.tip_moment if moment is None else moment}
    tables = {name: np.atleast_2d(_floats(name, value)) for name, value in given.items()}
    rows = {
        "spine_length": _floats("spine_length", spine_length),
        "tip_mass": _floats("tip_mass", robot.tip_mass if tip_mass is None else tip_mass),
        "roll": _floats("roll", roll),
    }
    n = max(*map(len, tables.values()), *(value.size for value in rows.values()))
    full = {}
    for name, value in rows.items():
        if value.ndim > 1 or value.size not in (1, n):
            raise BadCondition(f"{name}: shape {value.shape}, must be one number or ({n},)")
        full[name] = np.broadcast_to(value.reshape(-1), (n,)).copy()
    for name, value in tables.items():
        width, columns = (value.shape[-1], "chambers") if name == "pressure" else (3, "3")
        if value.ndim != 2 or value.shape[1] != width or len(value) not in (1, n):
            raise BadCondition(f"{name}: shape {value.shape}, must be ({columns},) or ({n}, {columns})")
        full[name] = np.broadcast_to(value, (n, width)).copy()
    for name, value in full.items():
        _refuse(name, "", value, ~np.isfinite(value), "must be finite: drop the rows that were not measured")
    _refuse("spine_length", "m", full["spine_length"], full["spine_length"] < 0, "must not be negative")
    _refuse("tip_mass", "kg", full["tip_mass"], full["tip_mass"] < 0, "must not be negative")
    within("pressure", full["pressure"], LOWEST_PRESSURE, HIGHEST_PRESSURE, "Pa gauge", "state")
    numbers, never, zero = np.arange(n), np.zeros(n, bool), np.zeros(n)
    states = States(
        trial=numbers, trial_id=numbers, stiffness=never, body=never, unload=never, repeat=np.ones(n, np.int64),
        t=np.full(n, np.nan), rate=np.full(n, rate), hold=np.full(n, hold), sitting=np.zeros(n, np.int64),
        progress=np.full(n, 0.5), vacuum=np.full(n, vacuum), nominal_vacuum=vacuum,
        used=full["pressure"] > USED * (robot.highest_limit or 0.0), deflection=zero, unread=never, channels=TIP, **full,
    )  # fmt: skip
    states.check(robot)
    return states


def highest_of_trial(trial: Ints, pressure: Array) -> Array:
    """(n, chambers) the largest of pressures (n, chambers) in each state's trial 0..."""
    top = np.full((int(trial.max(initial=-1)) + 1, pressure.shape[1]), -np.inf)
    np.maximum.at(top, trial, pressure)
    return np.asarray(top[trial])


def _floats(field: str, value: ArrayLike) -> Array:
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise BadCondition(f"{field}: {value!r} is not an array of numbers") from error


def within(field: str, values: Array, low: float, high: float, unit: str, of: str) -> None:
    """Raise `BadCondition` where a value is not from `low` to `high`; `of`: what the first axis counts."""
    outside = ~((values >= low) & (values <= high))
    _refuse(field, unit, values, outside, f"must be within {low:g} and {high:g}: check the unit", of)


def _refuse(field: str, unit: str, values: Array, wrong: Mask, limit: str, of: str = "state") -> None:
    if wrong.any():
        where = tuple(int(i) for i in np.argwhere(wrong)[0])
        value = f"{values[where]:g} {unit}".strip()
        raise BadCondition(f"{field}: {value} in {of} {where[0]}, {limit} ({int(wrong.sum())} such values)")
