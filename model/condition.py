"""Conditions: what is asked of the robot in each of n states, as arrays with one row a state."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from model.errors import BadCondition
from model.robot import Robot

Array = NDArray[np.float64]

LOWEST_PRESSURE = -101_325.0
"""Pa gauge: a perfect vacuum."""
HIGHEST_PRESSURE = 2e6
"""Pa gauge: beyond this a value is taken for a wrong unit."""


@dataclass(frozen=True)
class Condition:
    """n states of one robot; make it with `conditions`, which broadcasts and fills in the robot's own values."""

    spine_length: Array
    """(n,) m."""
    pressure: Array
    """(n, chambers) Pa gauge, in the order of robot.yaml's azimuths."""
    tip_mass: Array
    """(n,) kg hung at the tip."""
    roll: Array
    """(n,) rad, the chamber pattern turned about the rod's axis."""
    force: Array
    """(n, 3) N, known forces on the tip, base frame, besides the weight of `tip_mass`."""

    def __post_init__(self) -> None:
        n = len(self.spine_length)
        for field in fields(self):
            value: Array = getattr(self, field.name)
            want = {"pressure": "(n, chambers)", "force": "(n, 3)"}.get(field.name, "(n,)")
            fits = value.shape[:1] == (n,) and value.ndim == (1 if want == "(n,)" else 2)
            if not fits or (field.name == "force" and value.shape[1] != 3):
                raise BadCondition(f"{field.name}: shape {value.shape}, must be {want} with n = {n} as in spine_length")
            _refuse(field.name, "", value, ~np.isfinite(value), "must be finite: drop the rows that were not measured")
        _refuse("spine_length", "m", self.spine_length, self.spine_length < 0, "must not be negative")
        _refuse("tip_mass", "kg", self.tip_mass, self.tip_mass < 0, "must not be negative")
        wrong = (self.pressure < LOWEST_PRESSURE) | (self.pressure > HIGHEST_PRESSURE)
        limits = f"must be within {LOWEST_PRESSURE:g} and {HIGHEST_PRESSURE:g} Pa gauge: check the unit"
        _refuse("pressure", "Pa", self.pressure, wrong, limits)

    def __len__(self) -> int:
        return len(self.spine_length)

    def __getitem__(self, rows: slice | NDArray[np.bool_] | NDArray[np.intp]) -> Condition:
        """The states picked by a slice, mask or index array."""
        return Condition(
            self.spine_length[rows], self.pressure[rows], self.tip_mass[rows], self.roll[rows], self.force[rows]
        )

    def by_spine_length(self) -> Iterator[tuple[float, NDArray[np.bool_]]]:
        """Each spine length (m, to 0.1 mm) with the mask of its states, shortest first."""
        rounded = np.round(self.spine_length, 4)
        for length in np.unique(rounded):
            yield float(length), rounded == length

    def check(self, robot: Robot) -> None:
        """Raise `BadCondition` where the states do not fit the robot."""
        chambers = len(robot.actuators.azimuths_deg)
        if self.pressure.shape[1] != chambers:
            raise BadCondition(
                f"pressure: {self.pressure.shape[1]} columns, robot {robot.name!r} has {chambers} chambers: "
                "give one column per chamber"
            )
        limit = robot.length if robot.spine is not None else 0.0
        reason = "the robot's length" if robot.spine is not None else "this robot has no spine"
        too_long = self.spine_length > limit * (1 + 1e-9)
        _refuse("spine_length", "m", self.spine_length, too_long, f"must not exceed {limit:g} m ({reason})")


def conditions(
    robot: Robot,
    spine_length: ArrayLike,
    pressure: ArrayLike,
    tip_mass: ArrayLike | None = None,
    roll: ArrayLike = 0.0,
    force: ArrayLike = (0.0, 0.0, 0.0),
) -> Condition:
    """States of `robot` from numbers or arrays that broadcast over n; raises `BadCondition`.

    spine_length in m, pressure (..., chambers) in Pa gauge, tip_mass in kg (the robot's own when None), roll in rad,
    force (..., 3) in N on the tip, base frame.

    >>> from pathlib import Path
    >>> from model.robot import load_robot
    >>> states = conditions(load_robot(Path("robot.yaml")), [0.0, 0.1, 0.2], [60e3] * 3 + [0.0] * 6)
    >>> len(states), states.pressure.shape
    (3, (3, 9))
    """
    p, pull = np.atleast_2d(_floats("pressure", pressure)), np.atleast_2d(_floats("force", force))
    rows = {
        "spine_length": _floats("spine_length", spine_length),
        "tip_mass": _floats("tip_mass", robot.tip_mass if tip_mass is None else tip_mass),
        "roll": _floats("roll", roll),
    }
    n = max(len(p), len(pull), *(value.size for value in rows.values()))
    full = {}
    for name, value in rows.items():
        if value.ndim > 1 or value.size not in (1, n):
            raise BadCondition(f"{name}: shape {value.shape}, must be one number or ({n},)")
        full[name] = np.broadcast_to(value.reshape(-1), (n,)).copy()
    if p.ndim != 2 or len(p) not in (1, n):
        raise BadCondition(f"pressure: shape {p.shape}, must be (chambers,) or ({n}, chambers)")
    if pull.ndim != 2 or pull.shape[1] != 3 or len(pull) not in (1, n):
        raise BadCondition(f"force: shape {pull.shape}, must be (3,) or ({n}, 3)")
    made = Condition(
        pressure=np.broadcast_to(p, (n, p.shape[1])).copy(), force=np.broadcast_to(pull, (n, 3)).copy(), **full
    )
    made.check(robot)
    return made


def _floats(field: str, value: ArrayLike) -> Array:
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise BadCondition(f"{field}: {value!r} is not an array of numbers") from error


def _refuse(field: str, unit: str, values: Array, wrong: NDArray[np.bool_], limit: str) -> None:
    if wrong.any():
        where = tuple(int(i) for i in np.argwhere(wrong)[0])
        value = f"{values[where]:g} {unit}".strip()
        raise BadCondition(f"{field}: {value} in state {where[0]}, {limit} ({int(wrong.sum())} such values)")
