"""How far each effect of plausible size moves the tip of a robot over pressure and spine length, up and down.

Against the model without it; effects of stiffness trials are shown as force over deflection. What calibration would hide
is told beside it: the share of the signature that one common factor on the chamber area could take over.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.effects import CATALOGUE, EffectSpec, ForwardModel, design_from_columns
from model.effects.scales import scales
from model.robot import Robot

Array = NDArray[np.float64]
Columns = dict[str, NDArray[np.generic]]

LEVELS = np.linspace(0.0, 1.0, 11)
"""Shares of the largest pressure, up and down again."""
RATE, HOLD = 25e3, 2.0
"""Pa/s and s of the ramps in between."""
DEFLECTIONS = np.linspace(0.0, 0.02, 9)
"""Of the specimen's length."""


@dataclass(frozen=True)
class Signature:
    """What one effect at its plausible size does to what is read."""

    effect: EffectSpec
    how: str
    """How the states were read: settled, while ramping, stiffness, or none: this robot shows it in no kind of experiment."""
    spine_length: Array
    """(l,) m."""
    x: Array
    """(l, k) Pa of the group, or m of deflection, in the order of time."""
    change: Array
    """(l, k, 3) m, base frame; for stiffness rows (l, k, 1) N."""
    axis: int
    """The component that moves most."""
    hidden: float
    """Share (0..1) of the squared change that one factor on the chamber area could take over."""

    @property
    def rms(self) -> float:
        """Root mean square of the change, m or N."""
        return float(np.sqrt((self.change**2).sum(axis=-1).mean())) if self.change.size else 0.0

    @property
    def unit(self) -> str:
        """mm or N."""
        return "N" if self.how == "stiffness" else "mm"

    @property
    def shown(self) -> Array:
        """(l, k) the component that moves most, in `unit`."""
        return self.change[..., self.axis] * (1.0 if self.how == "stiffness" else 1e3)


def signatures(robot: Robot, effects: Mapping[str, EffectSpec] = CATALOGUE) -> list[Signature]:
    """The signature of every effect, on the first kind of experiment that shows it."""
    spines = robot.length * np.array([0.0, 0.375, 0.75]) if robot.spine is not None else np.zeros(1)
    sized = scales(robot)
    tried = [(how, _columns(robot, spines, how)) for how in ("settled", "while ramping", "stiffness")]
    models = [
        (how, columns, ForwardModel(robot, design_from_columns(robot, columns), "per_length", effects, sized=sized))
        for how, columns in tried
        if how != "stiffness" or robot.spine is not None
    ]
    return [_signature(spec.of(sized), models) for spec in effects.values()]


def _signature(spec: EffectSpec, models: list[tuple[str, Columns, ForwardModel]]) -> Signature:
    sizes = [min(p.scale, p.high) if p.role == "size" else p.starts[0] for p in spec.parameters]
    for how, columns, forward in models:  # noqa: B007 (used after the loop)
        theta = np.zeros(len(forward.parameters))
        still = forward.predict(theta)
        theta[forward.index(spec.id)] = sizes
        change = forward.predict(theta) - still
        # m or N: less is no signature
        if np.nanmax(np.abs(change)) > 1e-5:
            break
    else:
        none = np.zeros((0, 0))
        return Signature(spec, "none", np.zeros(0), none, none[..., None], 0, 0.0)
    wide = 1 if how == "stiffness" else 3
    rows = change.reshape(-1, wide)
    x = columns["deflection"] if how == "stiffness" else columns["p1"]
    spine = np.asarray(columns["spine_length"], float)
    lengths = len(np.unique(spine))
    axis = int(np.nanargmax(np.nansum(rows**2, axis=0)))
    return Signature(
        spec,
        how,
        np.unique(spine),
        np.asarray(x, float).reshape(lengths, -1),
        rows.reshape(lengths, -1, wide),
        axis,
        _hidden(forward, change) if wide == 3 else 0.0,
    )


def _hidden(forward: ForwardModel, change: Array) -> float:
    _, slope = forward.linearise(np.zeros(len(forward.parameters)))
    # A common factor on all areas moves the tips by the sum of what those of the single lengths do.
    area = slope[:, forward.index("area")].sum(axis=1)
    ok = np.isfinite(change) & np.isfinite(area)
    total = float(change[ok] @ change[ok]) * float(area[ok] @ area[ok])
    return float(change[ok] @ area[ok]) ** 2 / total if total > 0 else 0.0


def _columns(robot: Robot, spines: Array, how: str) -> Columns:
    """A campaign with chamber 1 and its neighbours; for stiffness trials, the bare spine at three lengths."""
    if how == "stiffness":
        spines = robot.length * np.array([0.25, 0.5, 0.75])
        n = DEFLECTIONS.size
        spine = np.repeat(spines, n)
        return {
            "trial": np.repeat(np.arange(3), n),
            "protocol": np.full(3 * n, "stiffness"),
            "specimen": np.full(3 * n, "spine"),
            "spine_length": spine,
            "deflection": np.tile(DEFLECTIONS, 3) * spine,
            "force": np.zeros(3 * n),
        }
    pressure = scales(robot).pressure * np.concatenate([LEVELS, LEVELS[-2::-1]])
    branch = np.repeat(["load", "unload"], [LEVELS.size, LEVELS.size - 1])
    hold = HOLD if how == "settled" else 0.0
    time = np.cumsum(np.abs(np.diff(pressure, prepend=0.0)) / RATE + hold)
    n, count = pressure.size, len(spines)
    chambers = len(robot.actuators.azimuths_deg)
    group = {0, 1, chambers - 1} if chambers >= 6 else {0}
    pressures = {f"p{c + 1}": np.tile(pressure if c in group else 0 * pressure, count) for c in range(chambers)}
    return {
        "trial": np.repeat(np.arange(count), n),
        "branch": np.tile(branch, count),
        "t": np.tile(time, count),
        "rate": np.full(n * count, RATE),
        "hold": np.full(n * count, hold),
        "spine_length": np.repeat(spines, n),
        **pressures,
        "x": np.zeros(n * count),
        "y": np.zeros(n * count),
        "z": np.zeros(n * count),
    }
