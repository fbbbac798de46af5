"""States of one robot as the laws of effects see them: each is a trial of its own, reached from rest by one ramp."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from model.condition import Condition
from model.effects.design import HOLD, NOMINAL_VACUUM, RATE, TIP, USED, Design
from model.robot import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True)
class States:
    """n states in v variants (v = 1 where nothing is varied)."""

    design: Design
    """What was asked for."""
    pressure: Array
    """(v, n, chambers) Pa gauge."""
    spine_length: Array
    """(v, n) m."""
    area_factor: Array
    """(v, n) A_effect / A_norm."""

    def __len__(self) -> int:
        return len(self.design)


def design_of(condition: Condition, vacuum: float = NOMINAL_VACUUM, rate: float = RATE, hold: float = HOLD) -> Design:
    """The design of states read `hold` s after a ramp of `rate` Pa/s from rest, at the vacuum (Pa) of the spine's moduli."""
    n = len(condition)
    number, no, zero = np.arange(n), np.zeros(n, bool), np.zeros(n)
    return Design(
        trial=number,
        trial_id=number,
        stiffness=no,
        body=no,
        unload=no,
        repeat=np.ones(n, np.int64),
        t=np.full(n, np.nan),
        rate=np.full(n, rate),
        hold=np.full(n, hold),
        sitting=np.zeros(n, np.int64),
        progress=np.full(n, 0.5),
        spine_length=condition.spine_length,
        vacuum=np.full(n, vacuum),
        nominal_vacuum=vacuum,
        tip_mass=condition.tip_mass,
        tip_load=condition.force,
        roll=condition.roll,
        pressure=condition.pressure,
        used=condition.pressure > USED,
        deflection=zero,
        channels=TIP,
    )


def states_of(robot: Robot, design: Design) -> States:
    """The states as asked for."""
    factor = robot.area_factor_at(design.spine_length)
    return States(design, design.pressure[None], design.spine_length[None], factor[None])


def with_rest(s: States) -> States:
    """The states of a single variant and, behind them, the rest of each: its chambers vented, all else the same."""
    design = s.design
    arrays = {f.name: getattr(design, f.name) for f in fields(design)}
    twice: Any = {
        name: np.concatenate([value, 0 * value if name == "pressure" else value])
        for name, value in arrays.items()
        if isinstance(value, np.ndarray)
    }
    twice["hold"][len(design) :] = HOLD
    return States(
        replace(design, **twice),
        np.concatenate([s.pressure, 0 * s.pressure], axis=1),
        np.tile(s.spine_length, 2),
        np.tile(s.area_factor, 2),
    )
