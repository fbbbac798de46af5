"""Measured tips beside those that the model predicts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.data.case import states
from diagnosis.inference.prepare import table_columns
from model.compare import ErrorTable, error_table
from model.condition import Condition
from model.effects import CATALOGUE, EffectSpec
from model.prediction.campaign import predict_campaign
from model.rods import FINE, solve
from model.section import rods_of
from recordings.trials import Table

from .files.inputs import Case


@dataclass(frozen=True)
class Comparison:
    """Tips measured and predicted (n, 3) m, the error table, and how many states the model could not solve."""

    condition: Condition
    measured: NDArray[np.float64]
    predicted: NDArray[np.float64]
    branch: NDArray[np.str_]
    table: ErrorTable
    unsolved: int


def comparison(case: Case, catalogue: Mapping[str, EffectSpec] = CATALOGUE) -> Comparison:
    """Predict every measured state with the case's robot, in the order in which they happened where its effects ask for it.

    `catalogue` knows the effects that its robot.yaml states. Raises ConfigError, `BadCase`, `BadRobot`.
    """
    if case.robot != case.robot.plain:
        return _with_effects(case, catalogue)
    condition, measured, _ = case.tips
    branch = np.array([r.branch for r in case.table if r.tip is not None and r.protocol != "stiffness"])
    result = solve(rods_of(case.robot, condition), FINE)
    ok = result.converged
    table = error_table(condition[ok], measured[ok], result.tip[ok], case.robot.length)
    return Comparison(condition[ok], measured[ok], result.tip[ok], branch[ok], table, int((~ok).sum()))


def _with_effects(case: Case, catalogue: Mapping[str, EffectSpec]) -> Comparison:
    """The states as fits and diagnoses see them: vented chambers at zero gauge, trial by trial."""
    case.tips  # noqa: B018 - refuses a table without tips
    own, _ = states(case)
    own = own.take(~own.pushed)
    condition, measured, _ = Case(case.robot, Table(own.rows)).tips
    tip = predict_campaign(case.robot, table_columns(own), catalogue).tip
    ok = np.asarray(np.isfinite(tip).all(axis=1))
    branch = np.array([r.branch for r in own.rows])
    table = error_table(condition[ok], measured[ok], tip[ok], case.robot.length)
    return Comparison(condition[ok], measured[ok], tip[ok], branch[ok], table, int((~ok).sum()))
