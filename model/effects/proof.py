"""An effect of one's own, tried on a small campaign before anything is concluded from it."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from model.effects.design import Columns, Design, design_from_columns
from model.effects.forward import ForwardModel
from model.effects.spec import EffectSpec
from model.errors import BadEffect
from model.robot import Robot

Array = NDArray[np.float64]

PRESSURES = (0.0, 100e3, 200e3, 100e3, 0.0)
"""Pa, up and down."""


def prove(robot: Robot, specs: Iterable[EffectSpec]) -> None:
    """Raises `BadEffect` when a law fails, is not of the right shape, does something at zero, or leaves no equilibrium."""
    specs = tuple(specs)
    if not specs:
        return
    design = design_from_columns(robot, _campaign(robot))
    baseline = ForwardModel(robot, design, catalogue={})
    still = baseline.predict(np.zeros(len(baseline.parameters)))
    for spec in specs:
        try:
            zero, large = _tried(robot, design, spec)
        except Exception as error:  # whatever a law of a person's own raises is a fault of that law
            raise BadEffect(f"effect {spec.id}: its law fails: {type(error).__name__}: {error}") from error
        moved = float(np.nanmax(np.abs(zero - still)))
        if moved > 0.0 or (np.isnan(zero) != np.isnan(still)).any():
            raise BadEffect(
                f"effect {spec.id}: moves readings by up to {moved:.3g} (m or rad) at zero sizes; "
                "a law must have exactly no effect there"
            )
        if not np.isfinite(large).any():
            raise BadEffect(
                f"effect {spec.id}: no state of a small campaign has an equilibrium at its plausible size; "
                "make the scale of its parameters smaller"
            )


def _tried(robot: Robot, design: Design, spec: EffectSpec) -> tuple[Array, Array]:
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
    """Two spine lengths, one chamber up and down, tip and orientation read."""
    n, chambers = len(PRESSURES), len(robot.actuators.azimuths_deg)
    lengths = (0.0, 0.5 * robot.length) if robot.spine is not None else (0.0,)
    columns: dict[str, NDArray[np.generic]] = {
        "trial": np.repeat(np.arange(1, len(lengths) + 1), n),
        "branch": np.tile(["load"] * 3 + ["unload"] * 2, len(lengths)),
        "t": np.arange(n * len(lengths)) * 10.0,
        "spine_length": np.repeat(lengths, n),
    }
    columns |= {f"p{c + 1}": np.tile(PRESSURES if c == 0 else np.zeros(n), len(lengths)) for c in range(chambers)}
    return columns | {
        name: np.full(n * len(lengths), float(name == "qw")) for name in ("x", "y", "z", "qw", "qx", "qy", "qz")
    }
