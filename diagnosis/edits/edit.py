"""What an edit is: one way in which robot.yaml or a table is wrong, with its prior and its few parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from model.robot import Robot
from recordings.trials import ORIENTATION, TIP, Table, marker_columns, pressure_columns

from ..arrays import Array
from ..findings import Finding

Edited = tuple[Robot, Table]
CALIBRATION = ("area_factor", "youngs_modulus", "azimuth", "gravity_x", "gravity_y", "origin_x", "origin_y", "origin_z")
"""What every hypothesis calibrates within `EDIT_USUAL`: logarithms of factors, rad, robot lengths."""
AREA, MODULUS, AZIMUTH, GRAVITY, ORIGIN = 0, 1, 2, slice(3, 5), slice(5, 8)
FORCE = ("force_x", "force_y", "force_z")


def _as_it_is(robot: Robot, table: Table, values: Array) -> Edited:
    return robot, table


@dataclass(frozen=True)
class Edit:
    """One way in which a description is wrong. Edits of one `kind` are about the same thing and exclude each other."""

    kind: str
    prior: float
    says: Callable[[Robot, Array, Array, float, str], Sequence[Finding]] = field(default=lambda *_: (), repr=False)
    """Robot as described, calibration (8,), own parameters, probability and what else it may be (text) -> findings; none where
    nothing is changed."""
    apply: Callable[[Robot, Table, Array], Edited] = field(default=_as_it_is, repr=False)
    """Robot and table as they would be without the mistake."""
    starts: tuple[tuple[float, ...], ...] = ((),)
    """Of the numbers that it widens, then of its own."""
    bounds: tuple[tuple[float, float], ...] = ()
    """Of its own parameters."""
    widens: Mapping[int, float] = field(default_factory=dict)
    """Number of the calibration -> its bound."""
    left: bool = False
    """Whether the diagnosis names it, so that nothing is changed."""
    of_this_campaign: bool = False
    """Whether another campaign on the robot is without it."""


def calibrated(robot: Robot, table: Table, theta: Array) -> Edited:
    """Robot and table with calibration theta (8,), unchecked."""
    area, modulus = np.exp(theta[:2]).tolist()
    factor = robot.area_factor
    areas = {k: v * area for k, v in factor.items()} if isinstance(factor, dict) else factor * area
    azimuths = tuple(a + float(np.degrees(theta[AZIMUTH])) for a in robot.actuators.azimuths_deg)
    made = with_gravity(robot.with_azimuths(azimuths).with_modulus(modulus), Rotation.from_rotvec([*theta[GRAVITY], 0.0]))
    made = made.model_copy(update={"area_factor": areas})
    return made, table.moved((-theta[ORIGIN] * robot.length).tolist()) if theta[ORIGIN].any() else table


def with_gravity(robot: Robot, turn: Rotation) -> Robot:
    """The robot with gravity turned in its base frame."""
    x, y, z = turn.apply(np.array(robot.gravity)).tolist()
    return robot.model_copy(update={"gravity": (x, y, z)})


def with_length(robot: Robot, length: float) -> Robot:
    """The robot with everything along its axis stretched to another length (m), unchecked."""
    ratio, own = length / robot.length, robot.actuators
    name = "chambers" if robot.chambers is not None else "tendons"
    ends = {name: own.model_copy(update={"ends": tuple(ratio * s for s in own.ends)})}
    sections = tuple(part.model_copy(update={"length": ratio * part.length}) for part in robot.sections)
    return robot.model_copy(update={"length": length, "sections": sections, **ends})


def turned(table: Table, turn: Rotation, sign: Sequence[float] = (1.0, 1.0, 1.0)) -> Table:
    """The table with places, orientations and forces turned, then mirrored by the signs of three axes."""
    places = [names for names in (TIP, FORCE, *marker_columns(table.markers.shape[1])) if names[0] in table.values]
    columns: dict[str, Array] = {}
    for names in places:
        seen = np.column_stack([table.get(name) for name in names])
        columns |= zip(names, (turn.apply(seen) * sign).T, strict=True)
    if ORIENTATION[0] in table.values:
        q, known = table.orientation, np.isfinite(table.orientation).all(axis=1)
        q[known] = (turn * Rotation.from_quat(q[known], scalar_first=True)).as_quat(scalar_first=True)
        mirror = np.array([1.0, *np.array(sign) * np.prod(sign)])
        columns |= zip(ORIENTATION, (q * mirror).T, strict=True)
    return table.replaced(columns)


def with_pressures(table: Table, pressures: Array) -> Table:
    """The table with other pressures (n, chambers) Pa."""
    return table.replaced(dict(zip(pressure_columns(pressures.shape[1]), pressures.T, strict=True)))


def heavier(robot: Robot, table: Table, mass: float) -> Edited:
    """Robot and table with `mass` (kg) more at the tip, or less where some hangs there."""
    kept = np.maximum(table.get("tip_mass", robot.tip_mass) + mass, 0.0)
    return robot, table.replaced({"tip_mass": kept})
