"""Which numbers of a campaign are compared: order, labels and measured values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.arrays import Array, Ints
from model.condition import TIP, States
from model.effects.design import QUATERNION, TURN, Columns
from model.effects.readings import Readings
from model.errors import BadCondition
from model.rotation import CONJUGATE, multiply, rotation_vector, unit


@dataclass(frozen=True)
class Observations:
    """The order in which numbers are stacked: row by row, within a row by channel."""

    row: Ints
    channel: NDArray[np.str_]
    picked: Ints
    """Where each sits in the flattened (n, all channels) array of `stacked`."""
    reference: Array
    """(n or more, 4) orientations that rx, ry, rz are counted from."""
    states: int
    """n, rows of the design."""

    def __len__(self) -> int:
        return len(self.row)

    def of(self, r: Readings) -> Array:
        """(v, observations) from readings."""
        return self.pick(channels(r, self.reference))

    def pick(self, every: Array) -> Array:
        """(v, observations) of (v, n, all channels)."""
        return every.reshape(len(every), every.shape[1] * every.shape[2])[:, self.picked]


def observations(design: States, reference: Array) -> Observations:
    """Stack what the design observes: positions and orientations of the robot's rows, forces of the stiffness rows."""
    every = np.array([*TIP, *TURN, "force", *(f"m{k}{axis}" for k in range(1, design.markers + 1) for axis in "xyz")])
    row, column = np.nonzero(np.isin(every, design.channels) & ((every == "force") == design.stiffness[:, None]))
    if not row.size:
        raise BadCondition("channels: the table has neither tip positions, orientations, markers nor forces")
    return Observations(row, every[column], row * len(every) + column, reference, len(design))


def channels(r: Readings, reference: Array) -> Array:
    """(v, n, 7 + 3 markers) of readings: tip, rotation vector from orientations (n, 4), force, markers."""
    turn = rotation_vector(multiply(r.orientation, reference[None] * CONJUGATE))
    parts = (r.tip, turn, r.force[..., None], r.markers.reshape(*r.markers.shape[:2], -1))
    v = max(len(part) for part in parts)
    return np.concatenate([np.broadcast_to(part, (v, *part.shape[1:])) for part in parts], axis=-1)


def measured(o: Observations, columns: Columns) -> Array:
    """Measured values in the order of `o`; NaN where a cell was not measured."""
    n = o.states
    by_channel = {name: np.asarray(columns[name]).astype(float) for name in columns if name in set(o.channel)}
    if set(TURN) & set(o.channel):
        q = unit(np.stack([np.asarray(columns[name]).astype(float) for name in QUATERNION], axis=1))
        turn = rotation_vector(multiply(q, o.reference[:n] * CONJUGATE))
        by_channel |= {name: turn[:, k] for k, name in enumerate(TURN)}
    value = np.empty(len(o))
    for name in np.unique(o.channel):
        of_channel = o.channel == name
        if name not in by_channel or len(by_channel[name]) != n:
            raise BadCondition(f"{name}: the table has no such column of {n} rows, the design observes it")
        value[of_channel] = by_channel[name][o.row[of_channel]]
    return np.where(np.isfinite(value), value, np.nan)
