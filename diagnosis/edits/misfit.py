"""How far the rod is from the tips under edits of robot and table: one robust misfit, fitted and weighed for all of them.

    min sum_i rho(|tip_i - rod(theta)_i|^2 / s^2) + sum_k (theta_k / w_k)^2,    rho(z) = 2 (sqrt(1 + z) - 1),

theta: the calibration, within what the diagnosis fits itself, and the parameters of the edits; s is 1 % of the robot's length.
The evidence of edits with k free parameters on C conditions, of residual rms b of their means and w of repeats about these,

    log p = log prior - B log max(b, b0) - W log max(w, w0) - k / 2 log(B + W),     B = min(C, 7), W = min(repeats, 14):

errors of the model are the same whenever a condition is repeated, and smooth over conditions, so that few of these count.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import lsq_linear

from model.errors import ModelError
from model.robot import Robot
from model.rods import FINE, solve
from model.section import rods_of
from recordings.trials import ORIENTATION, TIP, Table

from .. import judgement
from ..arrays import Array, Ints, Mask
from ..data.campaign import Campaign, settings, spread_over
from .edit import AREA, CALIBRATION, Edit, Edited, calibrated

STEP = 1.5e-8
"""Of differences by parameters, relative."""
CONVERGED, TINY = 1e-3, 1e-9
"""Relative decrease of the cost at which a fit has converged; slack of bounds."""
DIRECT = replace(FINE, follow=False)
"""A rod so soft that it has to be loaded in steps, at a thousand times the cost, counts as one that does not stand."""
AREAS = np.log([1.0, 3.0, 1 / 3, 9.0, 1 / 9])
"""Logarithms of area factors with which a fit may begin."""
PLACES = (*TIP, *ORIENTATION)
MOST = 60
"""States that are compared."""


@dataclass(frozen=True)
class Fit:
    """The parameters with which edits come nearest."""

    edits: tuple[Edit, ...]
    theta: Array
    """(8,) calibration."""
    own: tuple[Array, ...]
    """Parameters of each edit."""
    missed: Array
    """(n, 3) m, tip predicted minus measured."""
    log_posterior: float

    @property
    def x(self) -> Array:
        """All parameters."""
        return np.concatenate([self.theta, *self.own])


@dataclass(frozen=True)
class Sample:
    """The states that are compared, and the robot as described, with one area factor unless its table is near."""

    robot: Robot
    table: Table
    condition: Ints
    """(n,) 0 .."""

    @classmethod
    def of(cls, robot: Robot, states: Campaign) -> Sample:
        """Of states with a tip: three of each of 20 conditions, or more of fewer."""
        condition = np.unique(states.condition, return_inverse=True)[1]
        count = int(condition.max()) + 1
        used = spread_over(count, MOST // 3)
        each = MOST // len(used)
        rows = [own[spread_over(len(own), each)] for c in used for own in [np.flatnonzero(condition == c)]]
        kept = np.sort(np.concatenate(rows))
        sample = cls(robot, states.trials.take(kept), np.unique(condition[kept], return_inverse=True)[1])
        if not isinstance(robot.area_factor, dict):
            return sample
        area = float(np.mean(robot.area_factor_at(states.spine_length[kept])))
        near = sample.rms(sample.fitted((), [np.zeros(len(CALIBRATION))], 2).missed) < judgement.EDIT_LOSS_SCALE * robot.length
        return sample if near else replace(sample, robot=robot.with_area_factor(area))

    def edited(self, edits: Sequence[Edit], theta: Array, own: Sequence[Array]) -> Edited:
        """Robot and table with calibration and edits."""
        made = calibrated(self.robot, self.table, theta)
        for edit, values in zip(edits, own, strict=True):
            made = edit.apply(*made, values)
        return made

    def predicted(self, robot: Robot, table: Table) -> Array:
        """(n, 3) m, the tip; NaN where the rod has no equilibrium."""
        try:
            rod = solve(rods_of(robot, settings(robot, table)), DIRECT)
        except ModelError:
            return np.full((len(table), 3), np.nan)
        return np.where(rod.converged[:, None], rod.tip, np.nan)

    def rms(self, missed: Array) -> float:
        """m, s sqrt(mean rho(d^2 / s^2)): the rms of distances d that are small, while large ones count less."""
        scale = judgement.EDIT_LOSS_SCALE * self.robot.length
        squared = (missed**2).sum(axis=1) / scale**2
        return scale * float(np.sqrt(np.mean(2 * (np.sqrt(1 + squared) - 1)))) if len(missed) else 0.0

    @cached_property
    def _repeated(self) -> Array:
        """(n,) factor from a deviation from the mean of its condition to a reading's error; 0 of those not repeated."""
        count = np.bincount(self.condition)[self.condition]
        return np.where(count > 1, np.sqrt(count / np.maximum(count - 1, 1)), 0.0)

    def between_and_within(self, missed: Array) -> tuple[float, float]:
        """m, rms of the means of conditions, and of repeats about these."""
        count = np.bincount(self.condition)[:, None]
        mean = np.stack([np.bincount(self.condition, axis) for axis in missed.T], axis=1) / count
        repeated = self._repeated > 0
        deviation = ((missed - mean[self.condition]) * self._repeated[:, None])[repeated]
        return self.rms(mean), self.rms(deviation)

    def log_evidence(self, missed: Array, parameters: int) -> float:
        """As stated above, without the prior."""
        between, within = self.between_and_within(missed)
        conditions = min(len(np.unique(self.condition)), judgement.EDIT_CONDITIONS)
        repeats = min(len(self.condition) - len(np.unique(self.condition)), judgement.EDIT_REPEATS)
        model, noise = judgement.EDIT_MODEL_ERROR * self.robot.length, judgement.EDIT_NOISE * self.robot.length
        cost = conditions * np.log(np.hypot(between, model)) + repeats * np.log(np.hypot(within, noise))
        return float(-cost - parameters / 2 * np.log(conditions + repeats))

    def fitted(self, edits: tuple[Edit, ...], starts: Iterable[Array], steps: int, alone: bool = False) -> Fit:
        """The best of edits, from the best of the starts (8 + own,) after this many steps; `alone`: of their own numbers, area
        factor and modulus."""
        problem = _Problem(self, edits)
        start = min((problem.inside(x) for x in starts), key=lambda x: self.rms(problem.missed(x)))
        x = problem.descended(start, steps, alone)
        theta, own = problem.split(x)
        missed = problem.missed(x)
        count = sum(len(edit.bounds) + len(edit.widens) - (AREA in edit.widens) for edit in edits)
        prior = sum(float(np.log(edit.prior)) for edit in edits)
        return Fit(edits, theta, own, missed, prior + self.log_evidence(missed, count))

    def starts(self, edits: tuple[Edit, ...], near: Fit) -> Iterator[list[Array]]:
        """Where fits of edits may begin: beside the calibration of `near`, a fit of all but the last, and as described."""
        last = edits[-1]
        for theta in (near.theta, np.zeros(len(CALIBRATION))):
            out = []
            for values in last.starts:
                made = theta.copy()
                made[[*last.widens]] = values[: len(last.widens)]
                out.append(np.concatenate([made, *near.own, values[len(last.widens) :]]))
            yield out


class _Problem:
    """The misfit of robot and table with parameters x, its derivatives by forward differences, and its minimum."""

    def __init__(self, sample: Sample, edits: tuple[Edit, ...]) -> None:
        self._sample, self._edits = sample, edits
        bound, self._sd = judgement.EDIT_USUAL.copy(), judgement.EDIT_SD.copy()
        for edit in edits:
            for number, widest in edit.widens.items():
                bound[number], self._sd[number] = widest, np.inf
        own = [b for edit in edits for b in edit.bounds]
        self.low = np.concatenate([-bound, [low for low, _ in own]])
        self.high = np.concatenate([bound, [high for _, high in own]])
        self.free = np.ones(len(self.low), bool)
        self.free[2 : len(CALIBRATION)] = [any(k in edit.widens for edit in edits) for k in range(2, len(CALIBRATION))]
        self._unit = judgement.EDIT_LOSS_SCALE * sample.robot.length
        self._last: tuple[Array, Array] = (np.full(len(self.low), np.nan), np.zeros(0))
        self._base: tuple[Robot, Table, Array] = (sample.robot, sample.table, np.zeros(0))

    def inside(self, x: Array) -> Array:
        """The nearest x from which a bounded search can begin."""
        margin = 0.005 * (self.high - self.low)
        return np.asarray(np.clip(x, self.low + margin, self.high - margin))

    def split(self, x: Array) -> tuple[Array, tuple[Array, ...]]:
        """Calibration and the parameters of each edit."""
        theta, own = x[: len(CALIBRATION)], x[len(CALIBRATION) :]
        return theta, tuple(np.split(own, np.cumsum([len(edit.bounds) for edit in self._edits])[:-1]) if self._edits else ())

    def missed(self, x: Array) -> Array:
        """(n, 3) m, tip predicted minus measured; a robot length where the rod has no equilibrium."""
        if not np.array_equal(x, self._last[0]):
            robot, table = self._sample.edited(self._edits, *self.split(x))
            self._base = robot, table, self._sample.predicted(robot, table)
            self._last = x.copy(), self._from(self._base[2], table)
        return self._last[1]

    def _from(self, predicted: Array, table: Table) -> Array:
        return np.where(np.isfinite(predicted), predicted - table.tip, self._sample.robot.length)

    def _beside(self, x: Array) -> Array:
        """The same next to the last x; the rod is solved anew only where it changes, not where places in the table do."""
        robot, table = self._sample.edited(self._edits, *self.split(x))
        known, read, predicted = self._base
        kept = robot == known and all(table.values[n] is c for n, c in read.values.items() if n not in PLACES)
        return self._from(predicted if kept else self._sample.predicted(robot, table), table)

    def cost(self, x: Array) -> float:
        """What is minimised."""
        squared = (self.missed(x) ** 2).sum(axis=1) / self._unit**2
        return float(2 * (np.sqrt(1 + squared) - 1).sum() + ((x[: len(CALIBRATION)] / self._sd) ** 2).sum())

    def descended(self, x: Array, steps: int, alone: bool) -> Array:
        """x after some Gauss-Newton steps within the bounds, readings far off weighed down, each shortened until it gains."""
        free = self.free if alone else np.ones(len(x), bool)
        for _ in range(steps):
            missed, before = self.missed(x), self.cost(x)
            weight = (1 + (missed**2).sum(axis=1) / self._unit**2) ** -0.25
            rows = np.concatenate([np.repeat(weight, 3), np.ones(len(CALIBRATION))])
            residual = np.concatenate([missed.ravel() / self._unit, x[: len(CALIBRATION)] / self._sd])
            bounds = self.low[free] - x[free] - TINY, self.high[free] - x[free] + TINY
            step = np.zeros(len(x))
            step[free] = lsq_linear(rows[:, None] * self.slope(x, free), -rows * residual, bounds, max_iter=20).x
            moved = next((y for k in range(4) if self.cost(y := x + step / 3**k) < before), None)
            if moved is None:
                return x
            x = moved
            if self.cost(x) > (1 - CONVERGED) * before:
                return x
        return x

    def slope(self, x: Array, free: Mask) -> Array:
        """(3 n + 8, k) derivatives of tip errors over s, and of the calibration over w, by those that are free."""
        missed = self.missed(x)
        out = np.zeros((missed.size + len(CALIBRATION), len(x)))
        for k in np.flatnonzero(free).tolist():
            moved = x.copy()
            moved[k] += np.copysign(STEP * max(1.0, abs(x[k])), x[k])
            change = self._beside(moved) - missed
            out[: missed.size, k] = change.ravel() / (moved[k] - x[k]) / self._unit
        np.fill_diagonal(out[missed.size :, : len(CALIBRATION)], 1 / self._sd)
        return out[:, free]
