"""Measured tips beside those that the model predicts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from diagnosis.data.case import states
from diagnosis.data.levels import PRESSURE_GAP, levels
from diagnosis.inference.prepare import table_columns
from model.actuators import Words
from model.arrays import Array, Ints
from model.compare import ErrorTable, error_table
from model.condition import States
from model.prediction import Prediction
from model.prediction.campaign import predict_campaign
from model.shown import Shown, by_axis
from recordings.trials import Table

from .files.inputs import Case
from .files.own_effects import stated_by


@dataclass(frozen=True)
class Comparison(Shown):
    """Tips measured and predicted (n, 3) m, the error table, and how many states the model could not solve."""

    condition: States
    measured: Array
    predicted: Array
    branch: NDArray[np.str_]
    protocol: NDArray[np.str_]
    table: ErrorTable
    unsolved: int
    words: Words

    def __repr__(self) -> str:
        missed = f", {self.unsolved} without an equilibrium" if self.unsolved else ""
        return f"<Comparison: {len(self.measured)} tips missed by {self.table.rmse * 1e3:.3g} mm rms (in-sample){missed}>"

    @property
    def elongation(self) -> list[tuple[float, ...]]:
        """Of elongation runs: spine length (m), pressure (Pa), and the elongation from the lowest pressure, measured and
        predicted (m)."""
        rows = list[tuple[float, ...]]()
        for length, of_length in self.condition.by_spine_length():
            at = of_length & (self.protocol == "elongation")
            values = np.column_stack([self.condition.pressure.max(axis=1), self.measured[:, 2], self.predicted[:, 2]])[at]
            level = levels(values[:, 0], PRESSURE_GAP)
            means = [values[level == k].mean(axis=0) for k in np.unique(level)]
            rows += [(length, mean[0], *(mean[1:] - means[0][1:])) for mean in means[1:]]
        return rows

    def _columns(self) -> dict[str, Array]:
        tips = by_axis("measured {} [mm]", self.measured) | by_axis("predicted {} [mm]", self.predicted)
        return {
            **self.words.columns(self.condition.pressure),
            **tips,
            "error [mm]": 1e3 * np.linalg.norm(self.predicted - self.measured, axis=1),
        }


@dataclass(frozen=True)
class Expected:
    """What the model expects of the states of a case that have a tip."""

    row: Ints
    """(n,) index of each state among the rows of the case's table."""
    table: Table
    prediction: Prediction


def expected(case: Case, effects: Path | None = None, intervals: bool = False) -> Expected:
    """Every measured state predicted with the case's robot as fits and diagnoses do: vented chambers at zero gauge, trial by
    trial.

    `effects`: Python file of effects of one's own that robot.yaml states. Raises ConfigError, `BadCase`, `BadRobot`."""
    case.tips  # noqa: B018 - refuses a table without tips
    own, _ = states(case)
    own = own.take(~own.pushed)
    prediction = predict_campaign(case.robot, table_columns(own), stated_by(case.robot, effects), intervals)
    return Expected(own.row, own.trials, prediction)


def comparison(case: Case, effects: Path | None = None) -> Comparison:
    """Every measured tip beside the expected one, and the error table. Arguments and errors as of `expected`."""
    found = expected(case, effects)
    condition, measured, _ = Case(case.robot, found.table).tips
    tip = found.prediction.tip
    ok = np.asarray(np.isfinite(tip).all(axis=1))
    branch, protocol = found.table["branch"][ok], found.table["protocol"][ok]
    table = error_table(condition[ok], measured[ok], tip[ok], case.robot.length)
    return Comparison(condition[ok], measured[ok], tip[ok], branch, protocol, table, int((~ok).sum()), case.robot.actuators.words)
