"""How far the gap shrinks, on data that no fit saw.

Before: the baseline, calibrated with one area factor. After: the named effects fitted too, every other effect free within the
tolerance that the data ask for. The share closed counts from the noise floor, its interval comes from drawing trials anew.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..arrays import Array, Ints
from ..data.campaign import Campaign
from ..data.levels import SPINE_GAP, levels
from ..inference.candidate import Candidate
from ..inference.cross_validation import CrossValidation, Model
from ..inference.executor import SINGLE_THREAD, DiagnosisStep, Executor
from ..inference.fit import Fit
from ..inference.prepare import Prepared
from ..judgement import REDUCIBLE_RATIO
from .result import LengthShrink, Shrink


class Missed(NamedTuple):
    """Errors (m) of the states as one model predicts them, NaN where nothing was measured or predicted."""

    distance: Array
    """(states,) length of `vector`."""
    vector: Array
    """(states, 3) measured minus predicted where the gap is looked for, see `Prepared.gap`."""
    deflection: Array
    """(states,) magnitude, of stiffness trials; NaN elsewhere."""


@dataclass(frozen=True)
class HeldOutErrors:
    """Errors of states, each predicted by a fit without its fold."""

    before: Missed
    """Of the calibrated baseline."""
    after: Missed
    """Of the best hypothesis."""


def baseline_model(p: Prepared, calibrated: Fit) -> Model:
    """The calibrated baseline without any effect."""
    return Model(p.problem.parameters.no_effects(), 0.0, calibrated.theta)


def candidate_model(p: Prepared, c: Candidate) -> Model:
    """The model of a hypothesis: named effects wide, the others within their tolerance."""
    return Model(c.prior(p.problem.parameters), c.grid_point.size, c.fit.theta)


class HeldOut:
    """States in parts, each of which is predicted by fits to the others."""

    def __init__(self, p: Prepared, part: Ints, how: str, executor: Executor = SINGLE_THREAD) -> None:
        """`part` (states,) is left out together; `how` names it."""
        self.how, self.executor, self._p = how, executor, p
        self._parts = CrossValidation(p.problem, part[p.labels.state], executor)

    @classmethod
    def of(cls, p: Prepared, executor: Executor) -> HeldOut | None:
        """By spine length, where there are three, else by pressure, else by trial; None where there is but one part."""
        length = levels(p.states.spine_length, SPINE_GAP)
        if len(np.unique(length)) >= 3:
            return cls(p, length, "leave one spine length out", executor)
        pressure = levels(p.states.highest, p.states.pressure_gap)
        if len(np.unique(pressure[~p.states.pushed])) >= 3:
            return cls(p, pressure, f"leave one {p.robot.actuators.words.pressure} out", executor)
        trial = np.unique(p.states.trial, return_inverse=True)[1].astype(np.int64)
        return cls(p, trial, "leave one trial out", executor) if trial.any() else None

    def errors(self, models: Sequence[Model], step: DiagnosisStep | None = None) -> Callable[[], list[Missed]]:
        """Start all refits; the function that is returned waits for them and returns the errors of each model."""
        p, residuals = self._p, self._parts.residuals(models, step)

        def missed(residual: Array) -> Missed:
            vector = p.gap(residual)
            return Missed(np.asarray(np.linalg.norm(vector, axis=1)), vector, np.abs(p.deflection(residual)))

        return lambda: [missed(residual) for residual in residuals()]


def closed(how: str, before: Array, after: Array, floor: float, states: Campaign, kind: Ints | None = None) -> Shrink:
    """The section `shrink`, from errors (n,) m of states that the fits did not see; `how` they were left out. Its interval draws
    trials anew, see `closed_with_interval`."""
    share, interval = closed_with_interval(before, after, floor, states.trial, kind)
    level = levels(states.spine_length, SPINE_GAP)
    by_length = tuple(
        LengthShrink(float(np.round(states.spine_length[i].mean(), 6)), 1e3 * rms(before[i]), 1e3 * rms(after[i]), int(i.sum()))
        for i in (level == k for k in np.unique(level))
    )
    return Shrink(how, 1e3 * rms(before), 1e3 * rms(after), 1e3 * floor, share, interval, by_length)


def share_closed(before: float, after: float, floor: float) -> float | None:
    """Share of the reducible gap that is closed, from root mean squares; None where before is at the floor."""
    if before <= REDUCIBLE_RATIO * floor:
        return None
    return 1 - (after**2 - floor**2) / (before**2 - floor**2)


def closed_with_interval(
    before: Array, after: Array, floor: float, trial: Ints, kind: Ints | None = None
) -> tuple[float | None, tuple[float, float] | None]:
    """Share closed and its 95 % interval, from tip errors (n,) m of states; no interval from fewer than two trials.

    Trials are drawn anew among those of the same `kind` (n,), where given; kinds of one trial are drawn together.
    """
    share = share_closed(rms(before), rms(after), floor)
    if share is None:
        return None, None
    names, first_state, index = np.unique(trial, return_index=True, return_inverse=True)
    if len(names) < 2:
        return share, None
    drawn = _drawn_anew(np.zeros(len(names), np.int64) if kind is None else kind[first_state])
    n = np.bincount(index)[drawn].sum(axis=1)
    # m^2 above the floor in each draw, before and after, as in `share_closed`
    reducible, remaining = (np.bincount(index, e**2)[drawn].sum(axis=1) / n - floor**2 for e in (before, after))
    shares = 1 - remaining[reducible > 0] / reducible[reducible > 0]
    if not shares.size:
        return share, None
    low, high = np.quantile(shares, [0.025, 0.975])
    return share, (float(low), float(high))


def resampled(trial: Ints) -> Array:
    """(draws, n) how often each state counts when its trials (n,) are drawn anew."""
    _, index = np.unique(trial, return_inverse=True)
    drawn = _drawn_anew(np.zeros(int(index.max(initial=-1)) + 1, np.int64))
    counts = np.array([np.bincount(row, minlength=drawn.shape[1]) for row in drawn], float)
    return np.asarray(counts[:, index])


def _drawn_anew(kind: Ints, draws: int = 500, seed: int = 31337) -> Ints:
    """(draws, trials) numbers of the trials drawn, each among those of its kind (trials,)."""
    _, kind, count = np.unique(kind, return_inverse=True, return_counts=True)
    alone = count[kind] < 2
    rng = np.random.default_rng(seed)
    out = np.empty((draws, len(kind)), np.int64)
    for group in (np.flatnonzero(np.where(alone, -1, kind) == k) for k in (-1, *range(len(count)))):
        if group.size:
            out[:, group] = group[rng.integers(0, group.size, (draws, group.size))]
    return out


def rms(values: Array) -> float:
    """Root mean square of the finite values, of rows (n, k) that of their lengths; NaN of nothing."""
    distance = values if values.ndim == 1 else np.linalg.norm(values, axis=1)
    known = distance[np.isfinite(distance)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")
