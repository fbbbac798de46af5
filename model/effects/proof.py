"""An effect of one's own, tried on a small campaign before anything is concluded from it."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from model.arrays import Array
from model.condition import States
from model.effects.design import Columns, design_from_columns
from model.effects.forward import ForwardModel
from model.effects.history import History
from model.effects.quantities import Quantities
from model.effects.readings import Readings
from model.effects.spec import EffectSpec
from model.errors import BadEffect, nearest
from model.robot import Robot

PRESSURES = (0.0, 100e3, 200e3, 100e3, 0.0)
"""Pa, up and down."""
RATE = 20e3
"""Pa/s."""
PUSHES = (0.002, 0.004)
"""m."""
_NO_SUCH = re.compile(r"'(\w+)' object has no attribute '(\w+)'")
LEAST = 1e-9
"""m, rad or N; above the errors of rounding."""


def prove(robot: Robot, specs: Iterable[EffectSpec]) -> None:
    """Try effects on a small campaign.

    Raises `BadEffect` when a law fails, is not of the right shape, moves a reading at zero or none at its plausible size, or
    leaves no equilibrium.
    """
    specs = tuple(specs)
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
                "N); check what its law sets, and the scale of its parameters"
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
    """Two spine lengths, one chamber up and down, read while ramping; then the body pushed at its end."""
    n, chambers = len(PRESSURES), len(robot.actuators.azimuths_deg)
    lengths = (0.0, 0.5 * robot.length) if robot.spine is not None else (0.0,)
    bending_rows, push_rows = n * len(lengths), len(PUSHES)

    def joined(bending: ArrayLike, push: ArrayLike) -> NDArray[np.generic]:
        return np.concatenate([np.resize(np.asarray(bending), bending_rows), np.resize(np.asarray(push), push_rows)])

    columns: dict[str, NDArray[np.generic]] = {
        "trial": np.concatenate([np.repeat(np.arange(1, len(lengths) + 1), n), np.full(push_rows, len(lengths) + 1)]),
        "protocol": joined("bending", "stiffness"),
        "specimen": joined("", "body"),
        "branch": joined(["load"] * 3 + ["unload"] * 2, "load"),
        "t": np.arange(bending_rows + push_rows) * 10.0,
        "rate": joined([0.0, RATE, RATE, -RATE, -RATE], 0.0),
        "hold": np.zeros(bending_rows + push_rows),
        "spine_length": np.concatenate([np.repeat(lengths, n), np.full(push_rows, lengths[-1])]),
        "deflection": joined(0.0, PUSHES),
        "force": joined(np.nan, 0.0),
    }
    columns |= {f"p{c + 1}": joined(PRESSURES if c == 0 else 0.0, 0.0) for c in range(chambers)}
    return columns | {name: joined(float(name == "qw"), np.nan) for name in ("x", "y", "z", "qw", "qx", "qy", "qz")}
