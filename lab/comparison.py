"""Measured tips beside those that the model predicts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.data.case import states
from diagnosis.data.levels import PRESSURE_GAP, levels
from diagnosis.edits.misfit import as_described, sample_of
from diagnosis.inference.prepare import table_columns
from model.actuators import Words
from model.arrays import Array, Ints
from model.compare import ErrorTable, error_table
from model.condition import States
from model.effects import CATALOGUE, EffectSpec
from model.prediction import Prediction
from model.prediction.campaign import predict_campaign
from model.shown import Shown, by_axis
from recordings.trials import Table

from .files.inputs import Case, marked_notes

MANY = 5.0
"""Times what a calibration leaves from which a model misses by far."""


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
    notes: tuple[str, ...] = ()
    """Doubts about how the table was read and about states, and what to do about a model that misses by far."""

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


def expected(case: Case, catalogue: Mapping[str, EffectSpec] = CATALOGUE, intervals: bool = False) -> Expected:
    """Every measured state predicted with the case's robot as fits and diagnoses do: vented chambers at zero gauge, trial by
    trial.

    `catalogue` knows the effects that its robot.yaml states. Raises ConfigError, `BadCase`, `BadRobot`."""
    case.tips  # noqa: B018 - refuses a table without tips
    own, _ = states(case)
    own = own.take(~own.pushed)
    return Expected(own.row, own.trials, predict_campaign(case.robot, table_columns(own), catalogue, intervals))


def comparison(case: Case, catalogue: Mapping[str, EffectSpec] = CATALOGUE) -> Comparison:
    """Every measured tip beside the expected one, and the error table. Raises as `expected` does."""
    found = expected(case, catalogue)
    condition, measured, _ = Case(case.robot, found.table).tips
    tip = found.prediction.tip
    ok = np.asarray(np.isfinite(tip).all(axis=1))
    branch, protocol = found.table["branch"][ok], found.table["protocol"][ok]
    table = error_table(condition[ok], measured[ok], tip[ok], case.robot.length)
    words, notes = case.robot.actuators.words, (*case.table.warnings, *marked_notes(case.table), *_far_off(case, table.rmse))
    return Comparison(condition[ok], measured[ok], tip[ok], branch, protocol, table, int((~ok).sum()), words, notes)


def _far_off(case: Case, missed: float) -> Iterator[str]:
    """A line if a rough calibration of a robot without effects of its own leaves far less than `missed` (m), or does not help."""
    if case.robot.effects or case.robot.tolerances or (sample := sample_of(case.robot, states(case)[0])) is None:
        return
    fits = sample.fitted([(f.edits, f.x) for f in as_described(sample)], 10)
    left, near = min((float(sample.rms(f.missed)), sample.near(f)) for f in fits)
    if not near or missed > MANY * left:
        wrong = "" if near else "; perhaps a unit, an axis, gravity or another number is wrong"
        by = f"{1e3 * missed:.3g} mm rms, after a rough calibration by {1e3 * left:.2g} mm{wrong}"
        yield f"the model misses the tip by {by}; find the cause with lab diagnose"
