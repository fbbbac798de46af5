"""States in the order in which they happen, trial by trial: for effects that remember the way."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from model.effects.catalogue import CATALOGUE
from model.effects.design import QUATERNION, TIP, Columns, design_from_columns
from model.effects.forward import ForwardModel
from model.effects.nominal import stated_effects
from model.effects.rotations import CONJUGATE, rotation_vector
from model.effects.spec import EffectSpec
from model.errors import BadCondition
from model.prediction.chain import Read, Slopes
from model.prediction.predictor import PRESSURE_STEP, Prediction
from model.prediction.residual import residual_of
from model.prediction.spread import PRESSURE, standard_deviations, uncertain
from model.robot import Robot
from model.rotation import from_vector, multiply
from model.stated import AREA_FACTOR

Array = NDArray[np.float64]

NUDGE = 1e-6
"""rad."""
ASKED = (
    "trial", "protocol", "repeat", "branch", "t", "rate", "hold", "spine_length", "vacuum", "tip_mass", "roll_deg",
    "force_x", "force_y", "force_z",
)  # fmt: skip
"""Columns, besides the pressures, that say what was done to the robot."""


def predict_campaign(
    robot: Robot, columns: Columns, catalogue: Mapping[str, EffectSpec] = CATALOGUE, intervals: bool = False
) -> Prediction:
    """Readings of the rows of a table as trials.csv has them (its tips and markers are not read), stiffness rows left out.

    Each trial begins at rest; `branch`, `t`, `rate` and `hold` tell how its states follow each other. Raises `BadCondition`
    for a table that does not fit the robot, `BadRobot` for an effect that robot.yaml states wrongly.
    """
    effects = stated_effects(robot, catalogue)
    design = design_from_columns(robot, _observed(robot, columns))
    forward = ForwardModel(robot, design, area="per_length", catalogue=effects)
    zero = np.zeros(len(forward.parameters))
    residual = residual_of(robot)
    learnt = None if residual is None else residual(design.pressure, design.spine_length, intervals=intervals)
    missed, unexplained = (0.0, None) if learnt is None else (learnt.mean, learnt.variance)
    if not intervals:
        return _prediction(_read(forward, forward.predict(zero)), missed)
    predicted, slope = forward.linearise(zero)
    here = _read(forward, predicted)
    names, covariance = uncertain(robot)
    by = np.array([_column(forward, slope, name) for name in names]).reshape(len(names), len(forward))
    absent = [_read(forward, forward.predict(_without(forward, id))) for id in effects]
    tip, turn, shape = _parts(forward, by)
    slopes = Slopes(tip, _turns(_parts(forward, predicted[None])[1][0], turn), shape)
    spread = standard_deviations(robot, covariance, here, slopes, absent, unexplained)
    return _prediction(here, missed, spread)


def _observed(robot: Robot, columns: Columns) -> Columns:
    """What was done to the robot, and channels of all that a reading may hold."""
    if not len(columns.get("spine_length", ())):
        raise BadCondition("the table has no rows with a spine_length")
    n = len(columns["spine_length"])
    bent = np.asarray(columns.get("protocol", np.full(n, ""))).astype(str) != "stiffness"
    if not bent.any():
        raise BadCondition("protocol: all rows are of stiffness trials, which have no tip to predict")
    asked = {k: np.asarray(v)[bent] for k, v in columns.items() if k in ASKED or re.fullmatch(r"p\d+", k)}
    asked.setdefault("trial", np.ones(n, int))
    names = (*TIP, *QUATERNION, *(f"m{k}{axis}" for k in range(1, len(robot.markers) + 1) for axis in "xyz"))
    return asked | {name: np.full(int(bent.sum()), float(name == "qw")) for name in names}


def _parts(forward: ForwardModel, values: Array) -> tuple[Array, Array, Array]:
    """Tips (v, n, 3), turns (v, n, 3) and markers (v, n, k, 3) of values (v, observations)."""
    v, n = len(values), len(forward.design)
    every = values.reshape(v, n, values.shape[1] // n)
    return every[..., :3], every[..., 3:6], every[..., 6:].reshape(v, n, every.shape[2] // 3 - 2, 3)


def _turns(vector: Array, slope: Array) -> Array:
    """(v, n, 3) rad by which the tip turns when its rotation vector (n, 3) changes with `slope` (v, n, 3)."""
    step = NUDGE / np.maximum(np.abs(slope).max(axis=(1, 2), initial=0.0), 1e-300)[:, None, None]
    there = from_vector(vector + step * slope)
    still = np.broadcast_to(from_vector(vector) * CONJUGATE, there.shape)
    return np.asarray(rotation_vector(multiply(there, still)) / step)


def _read(forward: ForwardModel, predicted: Array) -> Read:
    tip, turn, shape = (part[0] for part in _parts(forward, predicted[None]))
    return Read(tip, multiply(from_vector(turn), forward.observations.reference[: len(tip)]), shape)


def _prediction(r: Read, missed: Array | float, spread: Mapping[str, Any] | None = None) -> Prediction:
    return Prediction(r.tip + missed, r.orientation, r.shape, **(spread or {}))


def _column(forward: ForwardModel, slope: Array, name: str) -> Array:
    """(observations,) by a parameter of the posterior, in its unit; 0 for one that this campaign does not have."""
    if name == AREA_FACTOR:
        return np.asarray(slope[:, forward.index("area")].sum(axis=1) / forward.area_factor[0])
    if name == PRESSURE:
        return forward.respond(np.where(forward.design.used, PRESSURE_STEP, 0.0)) / PRESSURE_STEP
    return slope[:, [i for i, p in enumerate(forward.parameters) if p.quantity == name]].sum(axis=1)


def _without(forward: ForwardModel, id: str) -> Array:
    """(p,) parameters with which an effect of the robot is absent."""
    theta, stated = np.zeros(len(forward.parameters)), forward.robot.stated
    for k in forward.index(id):
        own = stated.get(forward.parameters[k].name)
        theta[k] = 0.0 if own is None else -own.value
    return theta
