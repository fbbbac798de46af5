"""The states of a campaign from the columns of a trials table (see recordings), as plain numpy arrays by name."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from model.arrays import Array, Ints, Mask
from model.condition import (
    HIGHEST_PRESSURE,
    HOLD,
    LOWEST_PRESSURE,
    NOMINAL_VACUUM,
    RATE,
    TIP,
    USED,
    States,
    highest_of_trial,
    within,
)
from model.errors import BadCondition
from model.robot import Robot

Columns = Mapping[str, NDArray[np.generic]]

TURN = ("rx", "ry", "rz")
"""Orientation channels: rotation vector (rad, base frame) from the baseline's orientation to the tip's."""
QUATERNION = ("qw", "qx", "qy", "qz")
REST = 0.004
"""Share of the largest pressure up to which a robot is at rest."""
RAMPS_OFF, FEWEST_RAMPS = 0.1, 5
"""Relative, in the median, so that single pauses do not count; and ramps from which their rate is taken."""
PAUSE = 3600.0
"""s without a reading after which a robot may have been mounted anew."""


def design_from_columns(robot: Robot, columns: Columns, channels: tuple[str, ...] | None = None) -> States:
    """The states of a trials table of n rows; `channels` limits what counts as observed (default: what the table holds).

    Needs trial and spine_length, and p1..pN unless all rows are stiffness rows; other columns have defaults, which stand where a
    cell is empty. Raises `BadCondition` naming the column that is missing, not finite or does not fit the robot.
    """
    if "trial" not in columns or len(columns["trial"]) == 0:
        raise BadCondition("trial: the table has no such column, or no rows")
    n = len(columns["trial"])
    for name, column in columns.items():
        if np.shape(column) != (n,):
            raise BadCondition(f"{name}: shape {np.shape(column)}, must be ({n},) as trial")
    stiffness = _text(columns, "protocol", "bending", n) == "stiffness"
    spine_length = _numbers(columns, "spine_length", None, n)
    within("spine_length", spine_length, 0.0, robot.length * (1 + 1e-9), "m", "row")
    pressure = _pressures(robot, columns, stiffness)
    vacuum = _numbers(columns, "vacuum", NOMINAL_VACUUM, n)
    within("vacuum", vacuum, 0.0, 101_325.0, "Pa below ambient", "row")
    ids, trial = _trials(columns["trial"], spine_length)
    with_spine = spine_length > 0
    observed = _channels(robot, columns, stiffness)
    if channels is not None:
        unknown = sorted(set(channels) - set(observed))
        if unknown:
            raise BadCondition(f"channels: {', '.join(unknown)} not in the table, which has {', '.join(observed)}")
        observed = tuple(name for name in observed if name in channels)
    return States(
        trial=trial,
        trial_id=ids,
        stiffness=stiffness,
        body=stiffness & (_text(columns, "specimen", "spine", n) == "body"),
        unload=_text(columns, "branch", "load", n) == "unload",
        repeat=_numbers(columns, "repeat", 1.0, n).astype(np.int64),
        t=_numbers(columns, "t", np.nan, n),
        rate=np.abs(_numbers(columns, "rate", rate_of_ramps(columns, trial, pressure) or RATE, n)),
        hold=_numbers(columns, "hold", HOLD, n),
        sitting=_sittings(_numbers(columns, "t", np.nan, n), trial),
        progress=_progress(_numbers(columns, "t", np.nan, n), trial, ~stiffness),
        spine_length=spine_length,
        vacuum=vacuum,
        nominal_vacuum=_usual(vacuum[with_spine]) if with_spine.any() else NOMINAL_VACUUM,
        tip_mass=_numbers(columns, "tip_mass", robot.tip_mass, n),
        force=np.where(stiffness, 0.0, [_numbers(columns, f"force_{a}", 0.0, n) for a in "xyz"]).T,
        moment=np.where(
            stiffness, 0.0, [_numbers(columns, f"tip_moment_{a}", m, n) for a, m in zip("xyz", robot.tip_moment, strict=True)]
        ).T,
        roll=np.deg2rad(_numbers(columns, "roll_deg", 0.0, n)),
        pressure=pressure,
        used=highest_of_trial(trial, pressure) > USED * pressure.max(initial=0.0),
        deflection=np.where(stiffness, _numbers(columns, "deflection", 0.0, n), 0.0),
        unread=_numbers(columns, "unread", 0.0, n) > 0,
        channels=observed,
    )


def rate_of_ramps(columns: Columns, trial: Ints, pressure: Array) -> float:
    """Pa/s that follow from times t, `hold` and the largest change of pressures (n, actuators) between the states of a trial,

    rate = median(|dP| / (dt - hold));    0 where they are not known or half of the ramps are off by over `RAMPS_OFF`.
    """
    t, hold = (_numbers(columns, name, np.nan, len(trial)) for name in ("t", "hold"))
    change, passed = np.abs(np.diff(pressure, axis=0)).max(axis=1), np.diff(t) - hold[1:]
    moved = (np.diff(trial) == 0) & (change > REST * pressure.max(initial=0.0)) & np.isfinite(passed)
    slowness = passed[moved] / change[moved]
    usual = float(np.median(slowness)) if len(slowness) >= FEWEST_RAMPS else 0.0
    return 1 / usual if usual > 0 and np.median(np.abs(slowness / usual - 1)) < RAMPS_OFF else 0.0


def _sittings(t: Array, trial: Ints) -> Ints:
    """Number (n,) of each state's sitting (`States.sitting`); 0 where times are not known or start again with each trial."""
    one_sitting = np.zeros(len(t), np.int64)
    numbers = np.unique(trial)
    begins, ends = np.array([(t[trial == k][0], t[trial == k][-1]) for k in numbers]).T
    if len(numbers) < 2 or not np.isfinite([begins, ends]).all():
        return one_sitting
    pause = begins[1:] - ends[:-1]
    starts_with_each_trial = np.mean(pause < 0) > 0.5
    if starts_with_each_trial:
        return one_sitting
    of_trial = np.concatenate([[0], np.cumsum((pause < 0) | (pause > PAUSE))])
    return np.asarray(of_trial[np.searchsorted(numbers, trial)], np.int64)


def _progress(t: Array, trial: Ints, of_robot: Mask) -> Array:
    """Part 0..1 (n,) of the campaign past at the states `of_robot`, by time where trials follow each other, else by trial."""
    out = np.zeros(len(t))
    if of_robot.any():
        begins = t[of_robot][np.unique(trial[of_robot], return_index=True)[1]]
        usable = np.isfinite(t[of_robot]).all() and bool((np.diff(begins) > 0).all())
        passed = t[of_robot] if usable else trial[of_robot].astype(float)
        out[of_robot] = (passed - passed.min()) / max(float(np.ptp(passed)), 1e-9)
    return out


def with_rest(design: States) -> tuple[States, Ints]:
    """The design and, behind its rows, the rest state of each trial that does not begin with one.

    Returns also (trials,) the row at which each trial is at rest: its own first state when that is without pressure.
    """
    first_states: list[int] = []
    rest_row = np.zeros(len(design.trial_id), np.int64)
    for k in range(len(rest_row)):
        of_trial = np.flatnonzero((design.trial == k) & ~design.stiffness)
        if not of_trial.size:
            continue
        rest_row[k] = of_trial[0]
        if np.abs(design.pressure[of_trial[0]]).max() > REST * design.pressure.max():
            rest_row[k] = len(design) + len(first_states)
            first_states.append(int(of_trial[0]))
    return with_rest_of(design, np.array(first_states, int)), rest_row


def with_rest_of(states: States, rows: Ints) -> States:
    """The states and, behind them, the rest of some of them: chambers vented, all else the same."""
    extended = states[np.concatenate([np.arange(len(states)), rows])]
    extended.pressure[len(states) :] = 0.0
    extended.hold[len(states) :] = HOLD
    return extended


def _numbers(columns: Columns, name: str, default: float | None, n: int) -> Array:
    """A column of numbers; cells that were not measured take the default, which None forbids."""
    if name not in columns:
        if default is None:
            raise BadCondition(f"{name}: the table has no such column")
        return np.full(n, default)
    try:
        values = np.asarray(columns[name]).astype(float)
    except ValueError as error:
        raise BadCondition(f"{name}: holds values that are not numbers ({error})") from error
    missing = np.isnan(values)
    if missing.any() and default is None:
        raise BadCondition(f"{name}: empty in row {int(np.flatnonzero(missing)[0])}, drop the rows not measured")
    return np.where(missing, default, values) if default is not None else values


def _text(columns: Columns, name: str, default: str, n: int) -> NDArray[np.str_]:
    if name not in columns:
        return np.full(n, default)
    return np.array([str(x) if x not in (None, "") else default for x in columns[name]])


def _usual(vacuum: Array) -> float:
    """The level (Pa) that occurs most often, the stronger one of equals; readings within 2 kPa are one level."""
    levels, count = np.unique(np.round(vacuum / 2e3), return_counts=True)
    level = levels[len(count) - 1 - int(np.argmax(count[::-1]))]
    return max(float(vacuum[np.round(vacuum / 2e3) == level].mean()), 1.0)


def _pressures(robot: Robot, columns: Columns, stiffness: Mask) -> Array:
    n, chambers = len(stiffness), len(robot.actuators.azimuths_deg)
    names = [f"p{i}" for i in range(1, chambers + 1)]
    extra = [name for name in columns if re.fullmatch(r"p\d+", name) and name not in names]
    if extra:
        raise BadCondition(f"{', '.join(extra)}: robot {robot.name!r} has {chambers} chambers")
    if stiffness.all():
        return np.zeros((n, chambers))
    pressure = np.stack([_numbers(columns, name, None if name in columns else 0.0, n) for name in names], axis=1)
    if not any(name in columns for name in names):
        raise BadCondition(f"p1..p{chambers}: the table has no pressures")
    pressure[stiffness] = 0.0
    within("pressure", pressure, LOWEST_PRESSURE, HIGHEST_PRESSURE, "Pa", "row")
    return pressure


def _trials(numbers: NDArray[np.generic], spine_length: Array) -> tuple[Ints, Ints]:
    """Trial numbers and the trial of each row; a spine that changes within a trial begins another, with its own rest."""
    keys = list(zip(np.asarray(numbers).astype(int).tolist(), np.round(spine_length, 4).tolist(), strict=True))
    place = {key: k for k, key in enumerate(dict.fromkeys(keys))}
    return np.array([number for number, _ in place], np.int64), np.array([place[key] for key in keys], np.int64)


def _channels(robot: Robot, columns: Columns, stiffness: Mask) -> tuple[str, ...]:
    names: list[str] = []
    if not stiffness.all():
        names += [name for name in TIP if name in columns]
        if all(name in columns for name in QUATERNION):
            names += TURN
        for k in range(1, len(robot.markers) + 1):
            names += [name for name in (f"m{k}x", f"m{k}y", f"m{k}z") if name in columns]
    if stiffness.any() and "force" in columns:
        names.append("force")
    return tuple(names)
