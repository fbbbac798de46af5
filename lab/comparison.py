"""Measured tips beside those that the model predicts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.compare import ErrorTable, error_table
from model.condition import Condition
from model.rods import FINE, solve
from model.section import rods_of

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


def comparison(case: Case) -> Comparison:
    """Predict every measured state with the case's robot."""
    condition, measured, _ = case.tips
    branch = np.array([r.branch for r in case.table if r.tip is not None and r.protocol != "stiffness"])
    result = solve(rods_of(case.robot, condition), FINE)
    ok = result.converged
    table = error_table(condition[ok], measured[ok], result.tip[ok], case.robot.length)
    return Comparison(condition[ok], measured[ok], result.tip[ok], branch[ok], table, int((~ok).sum()))
