"""Measured against model: the error table of the paper (its Table III) and the residuals behind it.

The paper's figures have X along the direction the robot bends to and Y along the hanging rod. In the base frame
used here these are x (for the chamber group around azimuth 0 and no roll) and z; the third coordinate y is out of
the bending plane and is shown too, because a turned chamber pattern shows there alone.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike

from model.arrays import Array
from model.condition import States
from model.errors import BadCondition
from model.estimate import readings


@dataclass(frozen=True)
class ErrorRow:
    """Errors of the states with one spine length, m."""

    spine_length: float
    n: int
    mean_abs_x: float
    """The paper's error in X axis when the robot bends along x."""
    mean_abs_y: float
    mean_abs_z: float
    """The paper's error in Y axis."""
    rmse: float
    """Of the tip distance."""
    worst: float
    """Largest tip distance."""


@dataclass(frozen=True)
class ErrorTable:
    """Errors by spine length, and over all states."""

    rows: tuple[ErrorRow, ...]
    length: float
    """Robot length the percentages refer to, m."""
    rmse: float
    """Over all states, m."""
    residual: Array
    """(n, 3) measured minus model, m, base frame, in the order of the states."""

    def worst_percent(self, axis: str) -> float:
        """Largest mean error along an axis of any spine length, % of the robot's length; x is the paper's headline, z its Y."""
        return 100 * max(getattr(row, f"mean_abs_{axis}") for row in self.rows) / self.length

    def as_dict(self) -> dict[str, object]:
        """JSON-able; lengths in m."""
        return {
            "rows": [asdict(row) for row in self.rows],
            "length": self.length,
            "rmse": self.rmse,
            **{f"worst_percent_{axis}": self.worst_percent(axis) for axis in "xz"},
        }


def error_table(condition: States, measured: ArrayLike, predicted: ArrayLike, length: float) -> ErrorTable:
    """Compare tips (n, 3) m in the base frame; `length` of the robot in m. Raises `BadCondition` on shapes and NaN."""
    n = len(condition)
    tips = readings(n, 3, measured=measured, predicted=predicted)
    if n == 0:
        raise BadCondition("measured: no states to compare")
    residual = tips["measured"] - tips["predicted"]
    distance = np.linalg.norm(residual, axis=1)
    rows = []
    for spine_length, of_length in condition.by_spine_length():
        x, y, z = (float(value) for value in np.abs(residual[of_length]).mean(axis=0))
        rmse, worst = float(np.sqrt(np.mean(distance[of_length] ** 2))), float(distance[of_length].max())
        rows.append(ErrorRow(spine_length, int(of_length.sum()), x, y, z, rmse, worst))
    return ErrorTable(tuple(rows), length, float(np.sqrt(np.mean(distance**2))), residual)
