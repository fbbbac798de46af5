"""From a table of trials to arrays, and what such a table can and cannot be asked.

Nothing is guessed: rows that cannot be used are left out and counted, a table that cannot be used at all is refused,
and what a sound but small table does not hold is said as a concern that travels with the result.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from model.robot import Robot
from recordings.trials import Table, TrialRow

from .errors import BadCase

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

FARTHEST = 1.5
"""Robot lengths: no tip of a rod that stretches by less than half is further from its base."""
SPINE_GAP, PRESSURE_GAP, VACUUM_GAP, RATE_GAP = 3e-3, 3e3, 10e3, 1e3
"""m, Pa, Pa, Pa/s: readings that differ by less were meant to be the same setting."""
HOLD_GAP = 0.4
"""Of log(1 + hold / s): settled readings wait as long as it takes, holds of 2, 5 and 10 s were meant to differ."""
FEWEST_REPEATS = 3


class CaseLike(Protocol):
    """A robot and its table of trials."""

    @property
    def robot(self) -> Robot: ...

    @property
    def table(self) -> Table: ...


@dataclass(frozen=True)
class States:
    """n states with a tip, in the order in which they happened; SI, angles in rad."""

    rows: tuple[TrialRow, ...]
    trial: Ints
    spine_length: Array
    pressure: Array
    """(n, chambers) Pa gauge."""
    branch: Array
    """1 load, -1 unload."""
    time: Array
    """s; NaN where not recorded."""
    tip: Array
    """(n, 3) m, base frame."""
    condition: Ints
    """States of equal number were meant to be the same."""
    kind: Ints
    """States of equal number belong to the same kind of experiment; 0 is the sweep that most states belong to."""

    def __len__(self) -> int:
        return len(self.rows)

    def take(self, rows: NDArray[np.bool_]) -> States:
        """The states picked by a mask."""
        kept = tuple(r for r, k in zip(self.rows, rows, strict=True) if k)
        return States(
            kept, self.trial[rows], self.spine_length[rows], self.pressure[rows], self.branch[rows], self.time[rows],
            self.tip[rows], self.condition[rows], self.kind[rows],
        )  # fmt: skip

    @property
    def highest(self) -> Array:
        """(n,) Pa, pressure of the most inflated chamber."""
        out: Array = self.pressure.max(axis=1)
        return out

    @property
    def repeats(self) -> int:
        """Trials in which a state was read, in the middle over all states."""
        return int(np.median(np.bincount(self.condition)[np.unique(self.condition)]))


def states(case: CaseLike) -> tuple[States, tuple[str, ...]]:
    """The states with a tip, and what is to be said about the table; raises `BadCase`."""
    robot = case.robot
    of_robot = [r for r in case.table if r.protocol != "stiffness" and r.tip is not None]
    if not of_robot:
        raise BadCase(
            f"{len(case.table)} rows, none with a tip position: a bending or elongation run is needed to see a gap of the robot"
        )
    sound = [r for r in of_robot if np.isfinite((*r.tip, r.spine_length, *r.pressures)).all()]  # type: ignore[misc]
    concerns = []
    if len(sound) < len(of_robot):
        bad = len(of_robot) - len(sound)
        concerns.append(f"{bad} of {len(of_robot)} states hold values that are not finite and are left out")
    if not sound:
        raise BadCase(f"all {len(of_robot)} states hold values that are not finite: nothing can be compared")
    _refuse_strange(robot, sound)
    made = _arrays(sound)
    return made, tuple(concerns + _concerns(made))


def _refuse_strange(robot: Robot, rows: list[TrialRow]) -> None:
    tips = np.array([r.tip for r in rows])
    distance = np.linalg.norm(tips, axis=1)
    worst = int(np.argmax(distance))
    if distance[worst] > FARTHEST * robot.length:
        raise BadCase(
            f"trial {rows[worst].trial} step {rows[worst].step}: the tip lies {distance[worst]:.3g} m from the base of a robot "
            f"that is {robot.length:g} m long ({int((distance > FARTHEST * robot.length).sum())} of {len(rows)} states): check "
            "the unit (m) and the frame (base of the robot)"
        )
    chambers = {len(r.pressures) for r in rows}
    if chambers != {len(robot.chambers.azimuths_deg)}:
        raise BadCase(
            f"rows with {sorted(chambers)} pressures for a robot with {len(robot.chambers.azimuths_deg)} chambers: "
            "tables of different robots cannot be diagnosed together"
        )
    longest = max(r.spine_length for r in rows)
    if longest > robot.length * 1.001:
        raise BadCase(
            f"spine length {longest:g} m is beyond the robot's {robot.length:g} m: check the unit (m) or the robot"
        )


def _arrays(rows: list[TrialRow]) -> States:
    trial = np.array([r.trial for r in rows], np.int64)
    spine = np.clip([r.spine_length for r in rows], 0.0, None)
    pressure = np.array([r.pressures for r in rows])
    branch = np.array([-1.0 if r.branch == "unload" else 1.0 for r in rows])
    kind = _kinds(rows, pressure)
    level = levels(pressure.max(axis=1), PRESSURE_GAP)
    held = levels(np.log1p([r.hold or 0.0 for r in rows]), HOLD_GAP)
    keys = np.column_stack([levels(spine, SPINE_GAP), level, branch.astype(np.int64), kind, held])
    condition = np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)
    time = np.array([np.nan if r.t is None else r.t for r in rows])
    tip = np.array([r.tip for r in rows])
    return States(tuple(rows), trial, spine, pressure, branch, time, tip, condition, kind)


def _kinds(rows: list[TrialRow], pressure: Array) -> Ints:
    """Number of each row's kind of experiment: protocol, chambers inflated, tip mass, roll, vacuum, rate and hold."""
    inflated = (pressure > 0.5 * pressure.max(axis=1, keepdims=True)) & (pressure > PRESSURE_GAP)
    on_the_fly = np.array([r.hold is not None and r.hold <= 0 for r in rows])
    rate = np.array([abs(r.rate or 0.0) for r in rows])
    speed = np.zeros(len(rows))
    trials = np.array([r.trial for r in rows])
    for t in np.unique(trials):
        # A trial is of one kind: near zero pressure no chamber stands out, and at its ends a sweep stands still.
        own = trials == t
        inflated[own] = inflated[own][np.argmax(pressure[own].max(axis=1))]
        speed[own] = rate[own].max() if on_the_fly[own].any() else 0.0
    columns = [
        np.unique([r.protocol for r in rows], return_inverse=True)[1],
        np.unique(inflated, axis=0, return_inverse=True)[1].reshape(-1),
        levels(np.array([r.tip_mass or 0.0 for r in rows]), 2e-3),
        levels(np.array([r.roll_deg or 0.0 for r in rows]), 1.0),
        levels(np.array([r.vacuum or 0.0 for r in rows]), VACUUM_GAP),
        levels(speed, RATE_GAP),
    ]
    _, index, count = np.unique(np.column_stack(columns), axis=0, return_inverse=True, return_counts=True)
    rank = np.argsort(np.argsort(-count, kind="stable"), kind="stable")
    return rank[index.reshape(-1)].astype(np.int64)


def levels(values: Array, gap: float) -> Ints:
    """Number of each value's level: sorted values further than `gap` apart belong to different levels."""
    order = np.argsort(values, kind="stable")
    out = np.empty(len(values), np.int64)
    out[order] = np.concatenate([[0], np.cumsum(np.diff(values[order]) > gap)])
    return out


def _concerns(s: States) -> list[str]:
    said = []
    lengths = len(np.unique(levels(s.spine_length, SPINE_GAP)))
    pressures = len(np.unique(levels(s.highest, PRESSURE_GAP)))
    if lengths < 2:
        said.append(
            "one spine length only: what the spine does cannot be told from what the body does; record at least two lengths"
        )
    if pressures < 2:
        said.append("one pressure only: no cause can be told from the chambers' area; record at least two pressures")
    if s.highest.max() < PRESSURE_GAP:
        said.append("no state is bent: nothing can be said about chambers, spine or material; record a bending sweep")
    if s.repeats < FEWEST_REPEATS:
        word = "no state was repeated" if s.repeats < 2 else "states were read twice only"
        said.append(
            f"{word}: the noise floor is taken from the spread of settled readings and misses what differs from trial to "
            "trial, so no cause can be named with confidence; repeat the sweep three times"
        )
    if not (s.branch < 0).any():
        said.append("no unload branch: friction, creep and a shift in time look alike; read the way down too")
    return said
