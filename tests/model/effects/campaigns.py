"""Campaigns like the paper's, as the columns of a trials table, and what the forward model says of them."""

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from model.arrays import Array
from model.effects import ForwardModel, design_from_columns
from model.robot import Robot

Columns = dict[str, NDArray[Any]]
LEVELS = (50e3, 100e3, 150e3, 200e3, 250e3)


def campaign(
    lengths: Sequence[float] = (0.0, 0.05, 0.10, 0.15, 0.20, 0.25, 0.30),
    levels: Sequence[float] = LEVELS,
    unload: bool = True,
    zero: bool = True,
    repeats: int = 1,
    rate: float = 25e3,
    hold: float = 2.0,
    chambers: Sequence[int] = (9, 1, 2),
    **same: float,
) -> Columns:
    """One trial a spine length and repeat: levels up and down; `same` sets a whole column (roll_deg, tip_mass ..)."""
    up = [(p, "load") for p in ([0.0] if zero else []) + list(levels)]
    down = [(p, "unload") for p in list(levels)[-2::-1] + ([0.0] if zero else [])]
    fixed = {"protocol": "bending", "rate": rate, "hold": hold, "vacuum": 80e3, "qw": 1.0}
    fixed |= dict.fromkeys(("x", "y", "z", "qx", "qy", "qz"), 0.0) | same
    rows: list[dict[str, Any]] = []
    time = 0.0
    for trial, (repeat, length) in enumerate([(r, s) for r in range(1, repeats + 1) for s in lengths], 1):
        last, time = 0.0, time + 100.0
        for step, (pressure, branch) in enumerate(up + (down if unload else [])):
            time, last = time + abs(pressure - last) / rate + hold, pressure
            own = {"trial": trial, "step": step, "repeat": repeat, "branch": branch, "t": time, "spine_length": length}
            rows.append(fixed | own | {f"p{c}": pressure if c in chambers else 0.0 for c in range(1, 10)})
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def joined(*parts: Columns) -> Columns:
    """Campaigns one after another."""
    out, trials, time = [], 0, 0.0
    for part in parts:
        out.append(part | {"trial": part["trial"] + trials, "t": part["t"] + time})
        trials, time = int(out[-1]["trial"].max()), float(out[-1]["t"].max())
    return {name: np.concatenate([part[name] for part in out]) for name in out[0]}


def pushes(specimen: str, lengths: Any, deflections: Any) -> Columns:
    """Stiffness trials, one a length, of which each gives all deflections."""
    n, k = len(np.atleast_1d(lengths)), len(deflections)
    return {
        "trial": np.repeat(np.arange(1, n + 1), k), "protocol": np.full(n * k, "stiffness"), "specimen": np.full(n * k, specimen),
        "spine_length": np.repeat(lengths, k), "deflection": np.tile(deflections, n), "force": np.zeros(n * k),
    }  # fmt: skip


class Moved:
    """The forward model of a campaign by names of its parameters: tips, and how far effects move them."""

    def __init__(
        self, robot: Robot, columns: Mapping[str, Any], channels: Sequence[str] | None = ("x", "y", "z"), **options: Any
    ):
        self.forward = ForwardModel(robot, design_from_columns(robot, columns, channels), **options)

    @cached_property
    def still(self) -> Array:
        """(n, 3) m, tips without any effect."""
        return self.tips()

    def vector(self, values: Mapping[str, float] | None = None, /, **named: float) -> Array:
        """A parameter vector, zero but for parameters by name, with __ for the dot."""
        theta = np.zeros(len(self.forward.parameters))
        names = [p.name for p in self.forward.parameters]
        for name, value in {**(values or {}), **named}.items():
            theta[names.index(name.replace("__", "."))] = value
        return theta

    def tips(self, values: Mapping[str, float] | None = None, /, **named: float) -> Array:
        """(n, 3) m."""
        predicted, channel = self.forward.predict(self.vector(values, **named)), self.forward.observations.channel
        return np.column_stack([predicted[channel == axis] for axis in "xyz"])

    def by(self, values: Mapping[str, float] | None = None, /, **named: float) -> Array:
        """(n, 3) m, how far parameters move the tips."""
        return self.tips(values, **named) - self.still
