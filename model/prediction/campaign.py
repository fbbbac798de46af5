"""States in the order in which they happen, trial by trial: for effects that remember the way."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from model.condition import TIP
from model.effects.catalogue import CATALOGUE
from model.effects.design import QUATERNION, Columns, design_from_columns
from model.effects.forward import ForwardModel
from model.effects.nominal import stated_effects
from model.effects.spec import EffectSpec
from model.errors import BadCondition
from model.prediction.predictor import Prediction, predicted
from model.prediction.residual import residual_of
from model.robot import Robot

ASKED = (
    "trial", "protocol", "repeat", "branch", "t", "rate", "hold", "spine_length", "vacuum", "tip_mass", "roll_deg",
    "force_x", "force_y", "force_z", "tip_moment_x", "tip_moment_y", "tip_moment_z", "unread",
)  # fmt: skip
"""Columns, besides the pressures, that say what was done to the robot."""


def predict_campaign(
    robot: Robot, columns: Columns, catalogue: Mapping[str, EffectSpec] = CATALOGUE, intervals: bool = False
) -> Prediction:
    """Readings of the rows of a table as trials.csv has them (its tips and markers are not read), stiffness rows left out.

    Each trial begins at rest; `branch`, `t`, `rate` and `hold` tell how its states follow each other. Raises `BadCondition`
    for a table that does not fit the robot, `BadRobot` for an effect that robot.yaml states wrongly.
    """
    design = design_from_columns(robot, _observed(robot, columns))
    forward = ForwardModel(robot, design, area="per_length", catalogue=stated_effects(robot, catalogue))
    return predicted(forward, residual_of(robot), intervals)


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
