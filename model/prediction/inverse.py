"""The way back: pressures, and the spine's length where it is free, that bring the tip to wanted places.

For each target minimise, within the limits of pressure and length,

    |W (p(u) - target)|^2 / (2 tau^2) + total pressure / highest pressure

with tau so small that the second term decides only between ways to the same place: it moves the tip by less than 1 um. A
sequence of box-constrained least-squares problems (Gauss-Newton with the model's gradient in a trust region), from the
best of many states that are tried first.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from model.actuators import Words
from model.arrays import Array, Mask, Order
from model.errors import BadCondition
from model.prediction.box_minima import box_minima
from model.prediction.predictor import Prediction, Predictor
from model.robot import Robot
from model.shown import Shown, by_axis

TAU = 0.05e-3
"""m."""
REACHED = 0.1e-3
"""m: a tip that is expected closer to its target counts as there."""
TRIED, SEED = 4096, 7
"""States among which starts are looked for, and their seed."""
BANDS, NEAREST = 4, 12
"""Bands of spine length in each of which a start is taken: the state of least pressure of this many nearest to the target."""
ROUNDS, STEP_TOLERANCE, COST_TOLERANCE = 40, 1e-6, 1e-5
FIRST_RADIUS, LEAST_RADIUS = 0.3, 1e-7
"""Trust region, as a share of the ranges."""
DAMPING = 1e-2
"""Keeps directions that do not move the tip determined; pressure moves along them by 1 / DAMPING ranges a step."""


@dataclass(frozen=True)
class ReachLimits:
    """What may be asked of the robot."""

    max_pressure: Array
    """(groups,) Pa."""
    groups: tuple[tuple[int, ...], ...]
    """Chambers, counted from 1, that share a regulator."""
    spine: tuple[float, float]
    """m; from and to."""


@dataclass(frozen=True)
class Reached(Shown):
    """What to ask of the robot for m targets, and where its tip will be."""

    pressures: Array
    """(m, chambers) Pa gauge."""
    spine_length: Array
    """(m,) m."""
    miss: Array
    """(m,) m from the tip that is expected to the target, along the wanted axes; for one out of reach, of the nearest point."""
    prediction: Prediction
    """With intervals."""
    words: Words

    @property
    def reached(self) -> Mask:
        """(m,) whether the target can be reached."""
        return np.asarray(self.miss <= REACHED)

    def __repr__(self) -> str:
        return f"<Reached: {int(self.reached.sum())} of {len(self.miss)} targets, error up to {1e3 * self.miss.max():.3g} mm>"

    def _columns(self) -> dict[str, Any]:
        spine = {"spine [mm]": 1e3 * self.spine_length} if self.spine_length.any() else {}
        tip = by_axis("tip {} [mm]", self.prediction.tip)
        return {**self.words.columns(self.pressures), **spine, **tip, "miss [mm]": 1e3 * self.miss}


def limits_of(
    robot: Robot, groups: Sequence[Sequence[int]] | None = None, spine: tuple[float, float] | None = None
) -> ReachLimits:
    """The robot's limits; raises `BadCondition` for groups that its chambers do not make up.

    `groups`: chambers that share a regulator, each by itself unless given; chambers in none stay vented. `spine`: lengths
    (m), all from 0 to the longest in robot.yaml's table of moduli unless given.
    """
    count = len(robot.actuators.azimuths_deg)
    chamber_groups = tuple(tuple(g) for g in groups) if groups is not None else tuple((c,) for c in range(1, count + 1))
    flat = [c for g in chamber_groups for c in g]
    if not flat or len(set(flat)) < len(flat) or not all(1 <= c <= count for c in flat):
        raise BadCondition(f"groups: {chamber_groups}, must hold each chamber at most once, counted from 1 to {count}")
    if robot.max_pressure is None:
        words = robot.actuators.words
        raise BadCondition(
            f"max_{words.pressure}: robot.yaml does not say how much its {words.kind} may hold; add it, such as 10 {words.unit}"
        )
    limit, longest = (robot.length, max(robot.spine.modulus)) if robot.spine is not None else (0.0, 0.0)
    low, high = spine if spine is not None else (0.0, longest)
    if not 0 <= low <= high <= limit:
        raise BadCondition(f"spine length: {low:g} .. {high:g} m, must lie between 0 and {limit:g} m")
    most = np.array([min(robot.pressure_limits[c - 1] for c in g) for g in chamber_groups])
    return ReachLimits(most, chamber_groups, (low, high))


def inverse(
    at: Predictor,
    targets: ArrayLike,
    limits: ReachLimits,
    weights: ArrayLike | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> Reached:
    """Pressures and spine lengths of least total pressure for targets (m, 3) m in the base frame.

    A coordinate that is NaN is free. `weights` (m, 3) tell which axes matter where not all can be met. Raises
    `BadCondition` for targets of another shape, in mm, or that want nothing.
    """
    wanted = np.atleast_2d(np.asarray(targets, float))
    if wanted.ndim != 2 or wanted.shape[1] != 3:
        raise BadCondition(f"targets: shape {wanted.shape}, must be (m, 3)")
    free = ~np.isfinite(wanted)
    if free.all(axis=1).any():
        raise BadCondition(f"targets: row {int(np.argmax(free.all(axis=1)))} wants no coordinate at all")
    far, length = float(np.nanmax(np.abs(wanted), initial=0.0)), at.robot.length
    if far > 3.0 * length:
        raise BadCondition(f"a target is {far:g} m from the base of a robot of {length:g} m, which looks like mm or cm; write m")
    weight = np.where(free, 0.0, 1.0 if weights is None else np.broadcast_to(np.asarray(weights, float), wanted.shape))
    if not (weight >= 0).all() or (weight.max(axis=1) <= 0).any():
        raise BadCondition("weights: must be numbers, not negative, and one of each row above 0")
    search = _InverseSearch(at, limits, np.where(free, 0.0, wanted), weight)
    with warnings.catch_warnings(action="ignore"):  # of states that are only tried
        u = search.run(progress)
    pressures, lengths = search.inputs(u)
    prediction = at(pressures, lengths, intervals=True)
    miss = np.linalg.norm(np.where(free, 0.0, prediction.tip - wanted), axis=1)
    return Reached(pressures, lengths, miss, prediction, at.robot.actuators.words)


class _InverseSearch:
    """Targets and the scaled inputs u within 0 .. 1: the groups' pressures, then the spine's length."""

    def __init__(self, at: Predictor, limits: ReachLimits, wanted: Array, weight: Array) -> None:
        self._at, self._limits, self._wanted, self._weight = at, limits, wanted, weight
        self._member = np.zeros((len(limits.groups), len(at.robot.actuators.azimuths_deg)))
        for g, chambers in enumerate(limits.groups):
            self._member[g, [c - 1 for c in chambers]] = 1.0
        low, high = limits.spine
        self._low, self._range = low, high - low
        # Total pressure; a length costs nothing.
        self._cost = np.append(self._member.sum(axis=1) * limits.max_pressure / limits.max_pressure.max(), 0.0)
        self._high = np.append(np.ones(len(limits.groups)), 1.0 if self._range > 0 else 0.0)

    def inputs(self, u: Array) -> tuple[Array, Array]:
        """Pressures (n, chambers) Pa and lengths (n,) m."""
        return (self._limits.max_pressure * u[:, :-1]) @ self._member, self._low + self._range * u[:, -1]

    def run(self, progress: Callable[[float], None]) -> Array:
        """(m, k) the best inputs of each target: each start is improved in a trust region until its cost stays."""
        start = self._starts()
        m, tries = start.shape[:2]
        row = np.repeat(np.arange(m), tries)
        u = start.reshape(m * tries, -1)
        missed, slope, cost = self._linear(u, row)
        radius = np.full(len(u), FIRST_RADIUS)
        active = np.flatnonzero(np.isfinite(cost))
        for k in range(ROUNDS):
            if not active.size:
                break
            progress(k / ROUNDS)
            trial = self._steps(u[active], missed[active], slope[active], radius[active])
            trial_missed, trial_slope, trial_cost = self._linear(trial, row[active])
            better = trial_cost < cost[active]
            decrease, step = cost[active] - trial_cost, np.abs(trial - u[active]).max(axis=1)
            radius[active] = np.where(better, np.minimum(2 * radius[active], 1.0), 0.3 * np.minimum(radius[active], step))
            accepted = active[better]
            u[accepted], missed[accepted] = trial[better], trial_missed[better]
            slope[accepted], cost[accepted] = trial_slope[better], trial_cost[better]
            converged = better & ((decrease < COST_TOLERANCE) | (step < STEP_TOLERANCE))
            active = active[~converged & (radius[active] > LEAST_RADIUS)]
        costs = cost.reshape(m, tries)
        # rounding must not choose among ways to a target
        best = np.argmax(costs <= costs.min(axis=1, keepdims=True) + 1e-8, axis=1)
        return np.asarray(u.reshape(m, tries, -1)[np.arange(m), best])

    def _starts(self) -> Array:
        """(m, tries, k) inputs to start from: of `TRIED` random states with one to three groups inflated, or all, for each target
        and band of spine length that of least pressure among the `NEAREST`, and last the nearest of all."""
        rng = np.random.default_rng(SEED)
        groups = len(self._limits.groups)
        u = rng.uniform(size=(TRIED, groups + 1))
        order = rng.random((TRIED, groups)).argsort(axis=1)
        inflated = rng.choice([*range(1, min(groups, 3) + 1), groups], TRIED)
        u[:, :-1] *= order < inflated[:, None]
        u[:, -1] *= self._high[-1]
        u[0] = 0.0
        tips = self._at(*self.inputs(u), arcs=()).tip
        solved = np.isfinite(tips).all(axis=1)
        u, tips = u[solved], tips[solved]
        if not len(u):
            raise BadCondition("targets: the rod has no equilibrium at any state within the limits: check robot.yaml")
        pressure_cost = u @ self._cost
        bands = np.minimum((BANDS * u[:, -1]).astype(int), BANDS - 1)
        members = [candidates for candidates in (np.flatnonzero(bands == b) for b in range(BANDS)) if candidates.size]
        out = np.empty((len(self._wanted), len(members) + 1, u.shape[1]))
        for i, (wanted, weight) in enumerate(zip(self._wanted, self._weight, strict=True)):
            distance = (((tips - wanted) * weight) ** 2).sum(axis=1)
            out[i, -1] = u[np.argmin(distance)]
            for k, candidates in enumerate(members):
                near = candidates[np.argsort(distance[candidates])[:NEAREST]]
                out[i, k] = u[near[np.argmin(pressure_cost[near])]]
        return out

    def _linear(self, u: Array, row: Order) -> tuple[Array, Array, Array]:
        """Weighted misses (n, 3) over TAU, their slopes (n, 3, k) by u, and costs (n,)."""
        prediction = self._at(*self.inputs(u), arcs=(), gradient=True)
        assert prediction.tip_by_pressure is not None and prediction.tip_by_length is not None
        weight = self._weight[row] / TAU
        missed = weight * (prediction.tip - self._wanted[row])
        by_group = prediction.tip_by_pressure @ self._member.T * self._limits.max_pressure
        slope = weight[:, :, None] * np.concatenate([by_group, self._range * prediction.tip_by_length[:, :, None]], axis=2)
        cost = 0.5 * (missed**2).sum(axis=1) + u @ self._cost
        return missed, slope, np.where(np.isfinite(cost) & np.isfinite(slope).all(axis=(1, 2)), cost, np.inf)

    def _steps(self, u: Array, missed: Array, slope: Array, radius: Array) -> Array:
        """The optima (n, k) of the linear problems within limits and trust regions."""
        curve = slope.swapaxes(1, 2) @ slope + DAMPING * np.eye(u.shape[1])
        uphill = (missed[:, None] @ slope)[:, 0] + self._cost
        low, high = np.maximum(-u, -radius[:, None]), np.minimum(self._high - u, radius[:, None])
        return np.clip(u + box_minima(curve, uphill, low, high), 0.0, self._high)
