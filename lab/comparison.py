"""Measured tips beside those that the model predicts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from diagnosis.arrays import rms
from diagnosis.data.campaign import Campaign
from diagnosis.data.case import states
from diagnosis.data.levels import PRESSURE_GAP, levels
from diagnosis.edits.misfit import as_described, sample_of
from diagnosis.inference.prepare import table_columns
from model.actuators import Words
from model.arrays import Array
from model.compare import ErrorTable, error_table
from model.condition import States
from model.prediction import Prediction
from model.prediction.campaign import predict_campaign
from model.robot import THRUST, Robot
from model.shown import Shown, by_axis

from .files.inputs import Case, marked_notes
from .files.own_effects import stated_by

MANY, SET_UP = 5.0, 0.005
"""Times what a calibration leaves from which a model misses by far, if that is more than a set-up is off: share of the length."""


@dataclass(frozen=True)
class Comparison(Shown):
    """Tips measured and predicted (n, 3) m, their errors and those of markers, and how many states the model could not solve."""

    condition: States
    measured: Array
    predicted: Array
    branch: NDArray[np.str_]
    protocol: NDArray[np.str_]
    table: ErrorTable
    markers: dict[str, float]
    """rms of the distance between each marker's measured and predicted place, m."""
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
        error = {"error [mm]": 1e3 * np.linalg.norm(self.predicted - self.measured, axis=1)}
        return self.words.columns(self.condition.pressure) | tips | error


def expected(case: Case, effects: Path | None = None, intervals: bool = False) -> tuple[Campaign, Prediction]:
    """The states of a case that have a tip, and what its robot predicts of them as fits and diagnoses do: vented chambers at
    zero gauge, trial by trial.

    `effects`: Python file of effects of one's own that robot.yaml states. Raises ConfigError, `BadCase`, `BadRobot`."""
    case.tips  # noqa: B018 - refuses a table without tips
    own, _ = states(case)
    own = own.take(~own.pushed)
    return own, predict_campaign(case.robot, table_columns(own), stated_by(case.robot, effects), intervals)


def comparison(case: Case, effects: Path | None = None) -> Comparison:
    """Every measured tip beside the expected one, and the error table. Arguments and errors as of `expected`."""
    own, prediction = expected(case, effects)
    condition, measured, _ = Case(case.robot, own.trials).tips
    tip, ok = prediction.tip, prediction.converged
    table = error_table(condition[ok], measured[ok], tip[ok], case.robot.length)
    places = zip(own.trials.markers[ok].swapaxes(0, 1), prediction.shape[ok].swapaxes(0, 1), strict=False)
    off = ((k, np.linalg.norm(seen - modelled, axis=1)) for k, (seen, modelled) in enumerate(places, 1))
    markers = {f"m{k}": float(np.sqrt(np.nanmean(away**2))) for k, away in off if np.isfinite(away).any()}
    far_off = [*_other_thrust(case.robot, own, effects, table.rmse)] or _far_off(case.robot, own, table.rmse)
    notes = (*case.table.warnings, *marked_notes(case.table), *far_off)
    return Comparison(
        condition[ok], measured[ok], tip[ok], own.trials["branch"][ok], own.trials["protocol"][ok], table,
        markers, int((~ok).sum()), case.robot.actuators.words, notes,
    )  # fmt: skip


def _other_thrust(robot: Robot, own: Campaign, effects: Path | None, missed: float) -> Iterator[str]:
    """A line if the other kind of thrust, with nothing else changed, leaves far less than `missed` (m)."""
    other = "cap" if robot.thrust == "walls" else "walls"
    if robot.chambers is None or THRUST in robot.effects or missed < SET_UP * robot.length:
        return
    prediction = predict_campaign(robot.replace(thrust=other), table_columns(own), stated_by(robot, effects))
    left = rms(np.where(prediction.converged[:, None], prediction.tip - own.tip, robot.length))
    if MANY * left < missed:
        by = f"{1e3 * missed:.3g} mm rms, with `thrust: {other}` and nothing else changed by {1e3 * left:.3g} mm"
        yield f"the model misses the tip by {by}: write `thrust: {other}` in robot.yaml"


def _far_off(robot: Robot, own: Campaign, missed: float) -> Iterator[str]:
    """A line if a rough calibration of a robot without effects of its own leaves far less than `missed` (m), or does not help."""
    if robot.effects or robot.tolerances or (sample := sample_of(robot, own)) is None:
        return
    fits = sample.fitted([(f.edits, f.x) for f in as_described(sample)], 10)
    left, near = min((float(sample.rms(f.missed)), sample.near(f)) for f in fits)
    if not near or missed > MANY * max(left, SET_UP * robot.length):
        wrong = "" if near else "; perhaps a unit, an axis, gravity or another number is wrong"
        by = f"{1e3 * missed:.3g} mm rms, after a rough calibration by {1e3 * left:.2g} mm{wrong}"
        yield f"the model misses the tip by {by}; find the cause with lab diagnose"
