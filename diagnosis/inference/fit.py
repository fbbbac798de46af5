"""The most probable parameters under one hypothesis: Levenberg-Marquardt within bounds, the discrepancy integrated out.

Sizes and shape parameters multiply each other, so the most probable point often lies along a narrow curved valley. Steps are
therefore damped in units of the prior, which shortens them along badly known directions, and where the model
is curved along a step it is corrected to second order (geodesic acceleration, Transtrum and Sethna 2012).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ..arrays import Array, Ints
from .jacobian import Jacobian
from .linear import Linear, SizePrior
from .problem import FormError, Problem, derivatives

LEAST_PROMISE, CHORD_PROMISE, WRITTEN_PROMISE = 0.01, 0.2, 1e-5
"""Steps that promise to lower it by less are not tried; the second where derivatives are never taken anew, the third where the
numbers are written: 0.01 is a seventh of a standard deviation, by which they would depend on the start."""
DAMPINGS = (0.0, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 1e3, 1e4, 1e5, 1e6, 1e7)
"""Added to the curvature, in units of the prior's, until a step lowers the cost."""
FIRST_DAMPINGS, CHORD_DAMPINGS = DAMPINGS[:6], DAMPINGS[:3]
"""The same in the first steps of a hypothesis, with derivatives by what it names alone taken anew, and where derivatives are
never taken anew: where those do not lead down, others do."""
LEAST_GAIN, NEAR, PROMISING, HALVINGS = 2.0, 5.0, 1.0, 6
"""A step that lowers the cost by less is the last, and a search within this many prior sd of its minimum may end, both in units
of `LEAST_PROMISE`, or of the least promise where it is smaller; a promise from which even a search near its minimum goes on; how
often a start without equilibrium is moved half way to the baseline before it is moved there."""
TRUST_RATIO, MOST_CORRECTION = 0.75, 0.75
"""Share of the predicted decrease from which a step is taken uncorrected; largest correction, as a share of the step."""


@dataclass(frozen=True)
class Fit:
    """A most probable point and the linear problem around it."""

    theta: Array
    """(k,) parameters, in their own units."""
    predicted: Array
    """(n,) there."""
    slope: Jacobian | None
    """Derivatives there; None where they were not kept."""
    cost: float
    """Half the squared misfit plus half the squared distance from the prior."""
    predicted_decrease: float
    """Decrease of the cost that the linear problem still predicts: 0 at the most probable point."""
    form_error: FormError | None = None
    """Model-form error of some effects there; None: no law is taken to be wrong."""

    def derivatives(self, problem: Problem) -> Jacobian:
        """The slope, recomputed if it was not kept."""
        return self.slope if self.slope is not None else problem.jacobian(self.theta)[1]

    def whole(self, problem: Problem, named: tuple[str, ...]) -> Fit:
        """The same fit with the derivatives by all parameters and the model-form error of the laws of `named` effects."""
        predicted, slope = problem.jacobian(self.theta)
        return replace(self, predicted=predicted, slope=slope).with_form_error(problem, named)

    def with_form_error(self, problem: Problem, named: tuple[str, ...], shared: bool = False) -> Fit:
        """The same fit with the model-form error of the laws of `named` effects; `shared` as in `FormError`."""
        done = {effect: problem.response(self.theta, self.predicted, effect) for effect in named}
        known = {e: d for e, d in done.items() if np.isfinite(d).all() and d.any()}
        return replace(self, form_error=FormError(named, known, shared))

    def without_law(self, effect: str) -> Fit:
        """The same fit where the law of one effect cannot be wrong, as it is taken away."""
        laws = self.form_error
        assert laws is not None
        kept = {e: done for e, done in laws.responses.items() if e != effect}
        return replace(self, form_error=replace(laws, responses=kept))

    def linear(self, problem: Problem) -> Linear:
        """The linear problem around it, rebuilt each time: it is as large as the derivatives."""
        slope = self.derivatives(problem)
        linear = problem.whitened(self.theta, self.predicted, slope.every)
        known = None if slope.base is None else slope.base.tolerated
        return linear if self.form_error is None else problem.with_form_error(linear, self.theta, self.form_error, known)


def refit(problem: Problem, prior: SizePrior, size: float, start: Fit) -> Fit:
    """A search that ends near its start, whose derivatives are used throughout (chord method): one prediction a step. Near
    the end their promise may be false: less than `CHORD_PROMISE` is not pursued."""
    known, none = start.derivatives(problem).flat, np.zeros(0, np.int64)
    descent = _Descent(problem, prior, size, known, none, CHORD_PROMISE, CHORD_DAMPINGS)
    return descent.search(replace(start, slope=known.shared), rounds=6, tolerance=0.0)


def fit(
    problem: Problem,
    prior: SizePrior,
    size: float,
    start: Array | Fit,
    rounds: int = 6,
    frozen: Jacobian | None = None,
    least_promise: float = LEAST_PROMISE,
) -> Fit:
    """Search from parameters (k,), or from another fit, whose derivatives are then used for the first step.

    `prior` of the effects, `size` of the discrepancy. Effects of variance 0 are left out, wherever the start has them, and
    the slope of the result has nothing for them. With `frozen`, derivatives by named effects alone are taken anew at each step;
    all others are those of `frozen`. It ends when less than `least_promise` can be gained.
    """
    fresh = problem.parameters.scaled(prior)[0] > 0
    if frozen is not None:
        of_effect = problem.parameters.of_effect
        fresh[of_effect] &= prior.wide
        fresh[~of_effect] = False
    dampings = DAMPINGS if frozen is None else FIRST_DAMPINGS
    return _Descent(problem, prior, size, frozen, np.flatnonzero(fresh), least_promise, dampings).search(start, rounds, NEAR)


def fit_alone(problem: Problem, named: tuple[str, ...], theta: Array, rounds: int) -> Fit:
    """Fit some effects and what is fitted in every model, from parameters (k,) without the other effects."""
    p = problem.parameters
    return fit(problem, p.prior_of(named), 0.0, np.where(np.isin(p.effects, ["", *named]), theta, 0.0), rounds)


class _Descent:
    """Minimises the cost of one problem: half the squared misfit and distance from the prior, discrepancy integrated out."""

    def __init__(
        self, problem: Problem, prior: SizePrior, size: float, frozen: Jacobian | None, fresh: Ints,
        least_promise: float, dampings: Sequence[float],
    ) -> None:  # fmt: skip
        """Derivatives by `fresh` parameters are taken anew, the others are those of `frozen`."""
        self.problem, self.size, self._p, self._forward = problem, size, problem.parameters, problem.forward
        self.scale, self.mean = problem.parameters.scaled(prior)
        self._frozen, self._fresh, self._least, self._dampings = frozen, fresh, least_promise, dampings
        m = problem.whitened_discrepancy.shape[1]
        self._factor = cho_factor(np.eye(m) + size**2 * problem.gram, lower=True) if size and m else None

    def search(self, start: Array | Fit, rounds: int, tolerance: float) -> Fit:
        """Step down until the minimum of the linear problem is within `tolerance` (as `NEAR`) or it promises too little."""
        local, unit = self.begin(start), min(self._least, LEAST_PROMISE)
        if rounds:
            self._forward = self._forward.near(local.theta)
        level = 0  # index among the dampings
        for _ in range(rounds):
            away = np.abs((local.optimum - local.theta) / self._p.sd) if np.isfinite(local.cost) else np.array([np.inf])
            if away.max(initial=0.0) < tolerance * unit and self._promise(local) < PROMISING:
                break
            step = self.step_down(local, level)
            if step is None:
                break
            theta, cost, level = step
            self._forward = self._forward.near(theta)
            predicted, slope = self._linearised(theta)
            if not np.isfinite(predicted).all():  # a trial mistook a state for one in equilibrium
                break
            decrease, local = local.cost - cost, _Local(self, theta, predicted, slope, cost)
            if decrease < max(LEAST_GAIN * unit, self._least):
                break
            level = max(level - 2, 0)
        return Fit(local.theta, local.predicted, local.slope, local.cost, self._promise(local))

    def _promise(self, local: _Local) -> float:
        return max(local.cost - self.cost(local.optimum, local.missed_at(local.optimum)), 0.0)

    def missed(self, predicted: Array) -> Array:
        """Measured minus predicted values (n,), whitened."""
        return self.problem.noise.whiten(self.problem.observed - predicted)

    def cost(self, theta: Array, missed: Array) -> float:
        """Of parameters (k,) and what they miss, whitened (n,); infinite where a state has no equilibrium."""
        if not np.isfinite(missed).all():
            return np.inf
        free, taken = self.scale > 0, 0.0
        away = (theta - self.mean)[free] / self.scale[free]
        if self._factor is not None:
            along = self.size * (self.problem.whitened_discrepancy.T @ missed)
            taken = float(along @ cho_solve(self._factor, along, check_finite=False))
        return 0.5 * (float(missed @ missed) - taken) + 0.5 * float((away**2).sum())

    def begin(self, start: Array | Fit) -> _Local:
        """The linear problem at a start; one without equilibrium is moved half way to the baseline, where all have one."""
        if isinstance(start, Fit):
            theta, predicted, slope = start.theta, start.predicted, start.derivatives(self.problem)
        else:
            within = np.clip(start, self._p.lower, self._p.upper)
            for share in (*0.5 ** np.arange(HALVINGS), 0.0):
                theta = share * within
                predicted, slope = self._linearised(theta)
                if np.isfinite(predicted).all():
                    break
        # a start with more than the hypothesis has is left at any cost
        allowed = (theta == self.mean)[self.scale == 0].all()
        return _Local(self, theta, predicted, slope, self.cost(theta, self.missed(predicted)) if allowed else np.inf)

    def step_down(self, local: _Local, level: int) -> tuple[Array, float, int] | None:
        """A point of no higher cost, its cost, and the level of damping that led there, from `level` up; None if there is none.

        If the strongest leads to no equilibrium, all are tried again with predictions that stop at such a state.
        """
        for trial in (True, False):
            cost = 0.0
            for k in range(level, len(self._dampings)):
                damped = self._damped(local, self._dampings[k], trial)
                if damped is None:
                    return None
                goal, cost = damped
                if cost <= local.cost and np.isfinite(cost):
                    return goal, cost, k
            if np.isfinite(cost):
                return None
        return None

    def _damped(self, local: _Local, damping: float, trial: bool) -> tuple[Array, float] | None:
        """The point (k,) that a step with this damping, corrected for curvature, leads to, and its cost, perhaps infinite;
        None where the linear problem promises less than `least_promise`. `trial`: see `Forward.predict`."""
        goal = local.goal(damping) if damping else local.optimum
        linear = local.missed_at(goal)
        # negative where the damped step ends higher in the linear problem: that promises nothing, and is tried
        promised = local.cost - self.cost(goal, linear)
        if 0 <= promised < self._least:
            return None
        missed = self.missed(self._forward.predict(goal, trial, whole=not trial))
        goal_cost = self.cost(goal, missed)
        if local.cost - goal_cost >= TRUST_RATIO * promised or not np.isfinite(goal_cost):
            return goal, goal_cost
        corrected = local.goal(damping, linear - missed)
        sd = self._p.sd
        if np.linalg.norm((corrected - goal) / sd) > MOST_CORRECTION * np.linalg.norm((goal - local.theta) / sd):
            return goal, goal_cost
        corrected_cost = self.cost(corrected, self.missed(self._forward.predict(corrected, trial, whole=not trial)))
        return (corrected, corrected_cost) if corrected_cost < goal_cost else (goal, goal_cost)

    def _linearised(self, theta: Array) -> tuple[Array, Jacobian]:
        predicted, columns = derivatives(self._forward, theta, self._fresh.tolist())
        white = columns.whitened(self.problem.noise, self._p.sd[self._fresh])
        return predicted, Jacobian(len(theta), self._fresh, white, self._frozen)


class _Local:
    """The linear problem around parameters (k,), in which optima are found quickly. It is solved for the k parameters and the m
    coefficients of the discrepancy together, in units of their priors about their means."""

    def __init__(self, descent: _Descent, theta: Array, predicted: Array, slope: Jacobian, cost: float) -> None:
        """Parameters whose prior has the scale 0 are held at their mean."""
        self.theta, self.predicted, self.slope, self.cost, self._columns = theta, predicted, slope, cost, slope.every
        self._size, problem, scale, mean = descent.size, descent.problem, descent.scale, descent.mean
        p = self._p = problem.parameters
        free = self._free = scale > 0
        self._scale, self._mean, self._rest = scale, mean, np.where(free, theta, mean)
        self._ratio = scale / p.sd
        discrepancy = self._discrepancy = problem.whitened_discrepancy
        count = len(theta) + discrepancy.shape[1]
        self._of_parameter = np.where(np.arange(count) < len(theta), 1.0, 0.0)
        self._here, self._low, self._high = np.zeros(count), np.full(count, -np.inf), np.full(count, np.inf)
        self._missed = descent.missed(predicted)
        if descent.size and not np.isfinite(self._missed).all():
            raise np.linalg.LinAlgError("the rod has no equilibrium there")
        where = np.flatnonzero(free)
        self._here[where] = (theta - mean)[free] / scale[free]
        self._low[where], self._high[where] = ((bound - mean)[free] / scale[free] for bound in (p.lower, p.upper))
        sizes = np.full(discrepancy.shape[1], descent.size)
        self._curve = self._columns.normal(discrepancy, problem.gram).scaled(np.concatenate([self._ratio, sizes]))
        self._score = self._pulled(self.missed_at(self._rest)) + self._curve.times(self._here)

    def _pulled(self, white: Array) -> Array:
        """(k + m,) projection of whitened values (n,) on the columns."""
        return np.concatenate([self._ratio * self._columns.against(white), self._size * (self._discrepancy.T @ white)])

    def missed_at(self, theta: Array) -> Array:
        """What the linear problem misses at parameters (k,), whitened (n,)."""
        return np.asarray(self._missed - self._columns.along((theta - self.theta) / self._p.sd))

    @cached_property
    def optimum(self) -> Array:
        """Optimum (k,) within the bounds; parameters without scale are at their mean."""
        return self.goal(0.0)

    def goal(self, damping: float, bend: Array | None = None) -> Array:
        """Optimum (k,) within the bounds, kept near theta by a damping; what has no scale is at its mean.

        `bend` (n,), whitened, is by how much the model is known to leave the linear problem there.
        """
        score = self._score + damping * self._here
        if bend is not None:
            score -= self._pulled(bend)
        x = self._curve.plus(1.0 + damping * self._of_parameter).within(-score, self._low, self._high)[: len(self._free)]
        return np.clip(np.where(self._free, self._mean + self._scale * x, self._rest), self._p.lower, self._p.upper)
