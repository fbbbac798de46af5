"""An effect of one's own, tried on a small campaign before anything is concluded from it."""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from model.arrays import Array
from model.condition import NOMINAL_VACUUM, TIP, States
from model.effects.design import QUATERNION, Columns, design_from_columns
from model.effects.forward import ForwardModel
from model.effects.history import History
from model.effects.quantities import Quantities
from model.effects.readings import Readings
from model.effects.scales import scales
from model.effects.spec import EffectSpec
from model.errors import BadEffect, nearest
from model.robot import Robot

TRIED = "each {actuator} {inflated} alone, with the next and with all, without and with a spine, once loaded, and with pushes"
SWEEP = (0.0, 0.5, 1.0, 0.5, 0.0)
"""Shares of the largest pressure, up and down."""
PACE = 10.0
"""s between two states."""
LOAD = 0.05
"""Mass, forces and moments at the tip, shares of the robot's scales."""
PUSHES = (0.005, 0.01)
"""Robot lengths."""
_NO_SUCH = re.compile(r"'(\w+)' object has no attribute '(\w+)'")
LEAST = 1e-9
"""m, rad or N; above the errors of rounding."""


def prove(robot: Robot, specs: Collection[EffectSpec]) -> None:
    """Try effects on a small campaign.

    Raises `BadEffect` when a law fails, is not of the right shape, moves a reading at zero or none at its plausible size, or
    leaves no equilibrium.
    """
    if not specs:
        return
    design = design_from_columns(robot, _campaign(robot))
    baseline = ForwardModel(robot, design, catalogue={})
    without = baseline.predict(np.zeros(len(baseline.parameters)))
    of_rod = baseline.observations.channel != "force"
    for spec in specs:
        try:
            zero, large = _tried(robot, design, spec)
        except Exception as error:  # whatever a law of a person's own raises is a fault of that law
            raise BadEffect(f"effect {spec.id}: its law fails: {type(error).__name__}: {error}{_nearest(error)}") from error
        change = float(np.nanmax(np.abs(zero - without)))
        if change > 0.0 or (np.isnan(zero) != np.isnan(without)).any():
            raise BadEffect(
                f"effect {spec.id}: moves readings by up to {change:.3g} (m or rad) at zero sizes; "
                "a law must have exactly no effect there"
            )
        if not np.isfinite(large[of_rod]).any():
            raise BadEffect(
                f"effect {spec.id}: no state of a small campaign has an equilibrium at its plausible size; "
                "make the scale of its parameters smaller"
            )
        if not np.nanmax(np.abs(large - zero), initial=0.0) > LEAST:
            raise BadEffect(
                f"effect {spec.id}: moves no reading of a small campaign at its plausible size by more than {LEAST:g} (m, rad or "
                f"N), with {robot.actuators.words.fill(TRIED)}; check what its law sets, and the scale of its parameters"
            )


def _nearest(error: Exception) -> str:
    """The quantity whose name is nearest to one that does not exist; empty for another error."""
    found = _NO_SUCH.search(str(error)) if isinstance(error, AttributeError) else None
    known = {kind.__name__: [f.name for f in fields(kind)] for kind in (Quantities, Readings, History)}
    return "" if found is None or found[1] not in known else f"; {nearest(found[2], known[found[1]])}"


def _tried(robot: Robot, design: States, spec: EffectSpec) -> tuple[Array, Array]:
    """Readings at zero and at the plausible size; derivatives are taken too, in many variants at once."""
    forward = ForwardModel(robot, design, catalogue={spec.id: spec}, every_law=True)
    theta = np.zeros(len(forward.parameters))
    zero = forward.predict(theta)
    theta[forward.index(spec.id)] = [
        float(np.clip(p.scale, p.low, p.high)) if p.role == "size" else p.starts[0] for p in spec.parameters
    ]
    forward.linearise(theta)
    return zero, forward.predict(theta)


def _campaign(robot: Robot) -> Columns:
    """States in which a law shows whichever actuators, specimen or load it acts on (`TRIED`): at each spine length one chamber up
    and down, each alone, each with the next, all at pressures of their own, and one under load; then pushes."""
    of_robot, each = scales(robot), np.eye(len(robot.actuators.azimuths_deg))
    neighbours, at_once = np.maximum(each, np.roll(each, 1, axis=1) / 2), np.linspace(0.5, 1.0, len(each))
    pressure = of_robot.pressure * np.vstack([np.outer(SWEEP, each[0]), 0 * at_once, each, neighbours, at_once, each[0]])
    lengths = (0.0, 0.5 * robot.length) if robot.spine is not None else (0.0,)
    n, push = len(pressure), np.tile(PUSHES, len(lengths))
    row = np.append(np.tile(np.arange(n), len(lengths)), np.full(len(push), n))
    loaded, pushed, length = row == n - 1, row == n, np.append(np.repeat(lengths, n), np.repeat(lengths, len(PUSHES)))
    deflection = robot.length * np.append(np.zeros(n * len(lengths)), push)
    load = {"tip_mass": robot.tip_mass + LOAD * of_robot.of("kg"), "roll_deg": 30.0, "vacuum": NOMINAL_VACUUM / 2, "repeat": 2.0}
    load |= dict.fromkeys(("force_x", "force_y", "force_z"), LOAD * of_robot.of("N"))
    load |= dict.fromkeys(("tip_moment_x", "tip_moment_y", "tip_moment_z"), LOAD * of_robot.of("N m"))
    markers = [f"m{k + 1}{axis}" for k in range(len(robot.markers)) for axis in "xyz"]
    columns: dict[str, NDArray[np.generic]] = {
        "trial": np.cumsum(np.isin(row, (0, len(SWEEP), n - 1)) | (deflection == robot.length * PUSHES[0])),
        "protocol": np.where(pushed, "stiffness", "bending"),
        "specimen": np.where(length > 0, "spine", "body"),
        "branch": np.where((row > np.argmax(SWEEP)) & (row < len(SWEEP)), "unload", "load"),
        "t": np.arange(len(row)) * PACE,
        "hold": np.where(loaded, PACE, 0.0),
        "spine_length": length,
        "deflection": deflection,
        "force": np.where(pushed, 0.0, np.nan),
    }
    columns |= {name: np.where(loaded, value, np.nan) for name, value in load.items()}  # elsewhere the defaults
    columns |= {f"p{c + 1}": np.append(pressure[:, c], 0.0)[row] for c in range(len(each))}
    return columns | {name: np.where(pushed, np.nan, float(name == "qw")) for name in (*TIP, *QUATERNION, *markers)}
