"""The robust misfit between rod and tips under edits of robot and table.

    min sum_i rho(|y_i - rod(theta)_i|^2 / s^2) + sum_k (theta_k / w_k)^2,    rho(z) = 2 (sqrt(1 + z) - 1),

y: tips and markers, s 1 % of the robot's length, and attitudes, s 0.2 rad; theta: the calibration, within what the diagnosis fits
itself, and the parameters of the edits. The evidence of edits with k free parameters on C conditions, of residual rms b of the
places' means, w of repeats about these and a of attitudes,

    log p = log prior - B log max(b, b0) - W log max(w, w0) - A log max(a, a0) - k / 2 log(B + W),
    B = min(C, 7), W = min(repeats, 7), A = min(C, 3):

errors of the model are the same whenever a condition is repeated, and smooth over conditions, so that few of these count. All
hypotheses descend at once: the rods of all states of all of them, at all points next to theirs, are one batch.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import groupby

import numpy as np

from model.condition import States
from model.robot import Robot
from model.rods import Fast, Rods, Solution, Stations, solve, stations
from model.rods.fast.walk import WIDTH
from model.rotation import CONJUGATE, multiply, rotation_vector, to_base
from model.section import rods_of
from recordings.trials import Table

from .. import judgement
from ..arrays import Array, Ints, Mask, equal_rows, rows_by
from ..data.campaign import Campaign, settings, spread_over
from ..data.case import finite
from .edit import AREA, AZIMUTH, CALIBRATION, MODULUS, ROD, WIDEST, Edit, Variants

STEP = 1e-4
"""Of differences by parameters, relative."""
SHARES = 3.0 ** -np.arange(3)
"""Of a step of Gauss and Newton that are tried."""
CONVERGED = 1e-3
"""Relative decrease of the cost at which a fit has converged."""
DIRECT = Fast(close=1e-9, follow=False)
"""Rods that it does not solve are loaded in `LOADS`, all at once; a rod that needs finer steps counts as unsolved."""
LOADS, FOLLOWED = (0.2, 0.4, 0.6, 0.8, 1.0), 1e-3
"""Shares of all loads, from each to the next; least margin to buckling of a rod that has the usual one at the first."""
OF_LOAD = {"tip_force", "tip_moment", "dead_force", "dead_moment", "spring_stiffness", "load"}
DIVISIONS = 6
"""Integration steps of a rod: the same everywhere, so that tips are smooth in all parameters."""
BATCH = 20_000
"""Rods that are solved in one call, as memory allows."""
AREAS = np.log([1.0, 3.0, 1 / 3, 9.0, 1 / 9])
"""Logarithms of area factors with which a fit may begin."""
COSTLY = (AZIMUTH, 3, 4)
"""Calibration numbers that a first comparison of edits keeps fixed: they need new rods and change little."""
MOST = 60
"""States that are compared."""
AMBIENT = (75e3, 107e3)
"""Pa absolute, from high places to a high on the coast."""
ONE_AREA = 0.8
"""Share of the rms of one sort of area factor, for all or by spine length, below which the other takes its place."""


@dataclass(frozen=True)
class Fit:
    """The parameters with which edits come nearest."""

    edits: tuple[Edit, ...]
    x: Array
    """All parameters: (8,) calibration, then those of each edit."""
    missed: Array
    """(readings, 3) m, predicted minus measured, see `Sample.missed`."""
    log_posterior: float

    @property
    def theta(self) -> Array:
        """(8,) calibration."""
        return self.x[: len(CALIBRATION)]

    @property
    def own(self) -> tuple[Array, ...]:
        """Parameters of each edit."""
        return tuple(np.split(self.x, np.cumsum([len(CALIBRATION), *(len(edit.bounds) for edit in self.edits)]))[1:-1])


@dataclass(frozen=True, eq=False)
class Sample:
    """The n states that are compared, and the robot as described, with one area factor where that is nearer."""

    robot: Robot
    table: Table
    condition: Ints
    """(n,) 0 .."""

    @cached_property
    def _content(self) -> tuple[str, ...]:
        columns = [("", self.condition), *sorted(self.table.values.items())]
        described = self.robot.model_dump_json(), repr(self.table.mapped)
        return (*described, *(f"{name} {column.tobytes()!r}" for name, column in columns))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sample) and self._content == other._content

    def __hash__(self) -> int:
        return hash(self._content)

    @property
    def ambient(self) -> float:
        """Pa, the lowest pressure where no chamber is ever below ambient pressure, as if they were absolute; else 0."""
        lowest = float(self.table.pressures.min())
        return lowest if self.robot.chambers is not None and AMBIENT[0] < lowest < AMBIENT[1] else 0.0

    def near(self, fit: Fit) -> bool:
        """Whether a fit comes near."""
        between, within = map(float, self.between_and_within(fit.missed))
        return between < judgement.EDIT_LOSS_SCALE * self.robot.length and within < judgement.EDIT_REPEATED * self.robot.length

    def reached(self, fit: Fit) -> bool:
        """Whether a fit leaves no more than models and repeats are off by."""
        between, within = map(float, self.between_and_within(fit.missed))
        return between < max(judgement.EDIT_MODEL_ERROR * self.robot.length, within) and self.near(fit)

    def aligned(self, fit: Fit) -> bool:
        """Whether attitudes are where a fit has them."""
        return float(self.turn(fit.missed)) < judgement.EDIT_LOSS_TURN

    @cached_property
    def described(self) -> Variants:
        """The reported values."""
        made = Variants.of(self.robot, self.table)
        known = made.markers if made.markers.shape[2] == len(self.robot.markers) else made.markers[:, :, :0]
        norm = np.linalg.norm(made.orientation, axis=-1, keepdims=True)
        return replace(made, markers=known, orientation=made.orientation / np.where(norm > 0, norm, np.nan))

    @cached_property
    def _measured(self) -> Mask:
        """(readings,) those that were measured, of all tips, markers and attitudes."""
        v = self.described
        return np.concatenate([np.isfinite(a.reshape(-1, a.shape[-1])).all(axis=1) for a in (v.tip, v.markers, v.orientation)])

    @cached_property
    def places(self) -> Mask:
        """(readings,) those of tips and markers."""
        return (np.arange(len(self._measured)) < len(self._measured) - len(self.table))[self._measured]

    @cached_property
    def _place_condition(self) -> Ints:
        """(places,) condition of each, those of each marker apart."""
        markers = self.described.markers.shape[2]
        condition = np.concatenate([self.condition, (self.condition[:, None] * markers + np.arange(markers)).ravel()
                                    + self.condition.max() + 1])  # fmt: skip
        return np.unique(condition[self._measured[: len(condition)]], return_inverse=True)[1]

    @cached_property
    def _states(self) -> States:
        return settings(self.robot, self.table, vented=True)

    def edited(self, hypotheses: Sequence[tuple[tuple[Edit, ...], Array]]) -> Variants:
        """With calibrations and edits of parameters (v, 8 + own), one hypothesis after the other."""
        theta = np.concatenate([x[:, : len(CALIBRATION)] for _, x in hypotheses])
        made, at, out = self.described.take(np.zeros(len(theta), np.int64)).calibrated(theta), 0, []
        for _, alike in groupby(hypotheses, key=lambda hypothesis: id(hypothesis[0])):  # the same edits from several starts
            every, parameters = zip(*alike, strict=True)
            x = np.concatenate(parameters)
            one, at, own = made.take(slice(at, at + len(x))).levered(1.0), at + len(x), len(CALIBRATION)
            for edit in every[0]:
                one, own = edit.apply(one, x[:, own : own + len(edit.bounds)]), own + len(edit.bounds)
            out.append(one.levered(-1.0))
        return Variants.stacked(out)

    def axes(self, v: Variants, arcs: Array) -> tuple[Solution, Stations]:
        """Equilibria of the v n rods, and these at `arcs` (v, 1, k) m from the base."""
        robot, states = self.robot, self._states
        tip_force = v.force - states.force + (v.mass - states.tip_mass)[:, :, None] * v.gravity
        changed = {
            "pressure": v.pressure, "tip_force": tip_force, "tip_moment": v.moment - states.moment, "gravity": v.gravity,
            "length": v.stretch * robot.length, "body_modulus": v.modulus * robot.youngs_modulus, "bending": v.bending,
            "area_factor": (v.area * robot.area_factor_at(states.spine_length))[:, :, None],
            "azimuth": np.radians(v.azimuth + v.roll[:, :, None]),
        }  # fmt: skip
        rods = rods_of(robot, states, changed)
        shares = rods.field("length") / rods.whole_length[:, None]
        steps = np.maximum(np.ceil(DIVISIONS * shares - 1e-6), 1).astype(np.int64)
        return standing(rods, steps, np.clip(np.repeat(arcs[:, 0], len(states), axis=0), 0.0, rods.whole_length[:, None]))

    def rods(self, v: Variants) -> Variants:
        """The same with tips, orientations and markers of the rods; NaN where one has no equilibrium."""
        solution, axis = self.axes(v, v.arcs if v.markers.size else v.arcs[..., :0])
        solved = np.where(solution.converged, 1.0, np.nan)[:, None]
        shape = (len(v.area), len(self.table), -1)
        tip, orientation = ((a * solved).reshape(shape) for a in (solution.tip, solution.orientation))
        markers = axis.position.reshape(*shape[:2], axis.values.shape[1], 3)
        if v.markers.size and (beside := self.robot.marker_places(np.radians(v.roll)) * [1.0, 1.0, 0.0]).any():
            markers = markers + to_base(axis.orientation.reshape(*markers.shape[:3], 4), beside)
        return replace(v, tip=tip, orientation=orientation, markers=markers)

    def missed(self, hypotheses: Sequence[tuple[tuple[Edit, ...], Array]]) -> list[Array]:
        """(v, readings, 3) m for each hypothesis, edits and parameters (v, ..): tips and markers predicted minus measured, then
        the turn between attitudes in units of s; a robot length where the rod has no equilibrium. Variants with the same rods
        are solved once."""
        made = self.edited(hypotheses)
        once, which = equal_rows(np.concatenate([a.reshape(len(a), -1) for a in made.arrays(ROD).values()], axis=1))
        each = max(1, BATCH // len(self.table))
        solved = [self.rods(made.take(once[k : k + each])) for k in range(0, len(once), each)]
        rods = Variants.stacked(solved).take(which)
        turn = rotation_vector(multiply(rods.orientation, made.orientation * CONJUGATE))
        turn *= judgement.EDIT_LOSS_SCALE / judgement.EDIT_LOSS_TURN * self.robot.length
        parts = [rods.tip - made.tip, (rods.markers - made.markers).reshape(len(made.tip), -1, 3), turn]
        missed = np.concatenate(parts, axis=1)[:, self._measured]
        missed = np.where(np.isfinite(missed), missed, self.robot.length)
        return np.split(missed, np.cumsum([len(x) for _, x in hypotheses])[:-1])

    def rms(self, missed: Array) -> Array:
        """(..) m, s sqrt(mean rho(d^2 / s^2)): the rms of distances d (.., n, 3) that are small, while large ones count less."""
        scale = judgement.EDIT_LOSS_SCALE * self.robot.length
        rho = 2 * (np.sqrt(1 + (missed**2).sum(axis=-1) / scale**2) - 1)
        return np.asarray(scale * np.sqrt(rho.mean(axis=-1) if rho.shape[-1] else rho.sum(axis=-1)))

    @cached_property
    def _repeated(self) -> Array:
        """(places,) factor from a deviation from the mean of its condition to a reading's error; 0 of those not repeated."""
        count = np.bincount(self._place_condition)[self._place_condition]
        return np.where(count > 1, np.sqrt(count / np.maximum(count - 1, 1)), 0.0)

    def between_and_within(self, missed: Array) -> tuple[Array, Array]:
        """(..) m, rms of the means of places' conditions, and of repeats about these, of misses (.., readings, 3)."""
        condition, places = self._place_condition, missed.compress(self.places, axis=-2)
        count = np.bincount(condition)
        mean = (np.eye(len(count))[:, condition] / count[:, None]) @ places
        lost = (places == self.robot.length).all(axis=-1, keepdims=True)  # no equilibrium is none that repeats
        deviation = np.where(lost, places, (places - mean[..., condition, :]) * self._repeated[:, None])
        return self.rms(mean), self.rms(deviation.compress(self._repeated > 0, axis=-2))

    def turn(self, missed: Array) -> Array:
        """(..) rad, robust rms of attitudes."""
        per_metre = judgement.EDIT_LOSS_TURN / judgement.EDIT_LOSS_SCALE / self.robot.length
        return self.rms(missed.compress(~self.places, axis=-2)) * per_metre

    def log_evidence(self, missed: Array, parameters: Ints) -> Array:
        """(v,) as stated above, without the prior, of misses (v, readings, 3) with numbers of parameters (v,)."""
        between, within = self.between_and_within(missed)
        count = len(np.unique(self.condition))
        conditions, repeats = min(count, judgement.EDIT_CONDITIONS), min(len(self.condition) - count, judgement.EDIT_REPEATS)
        model, noise = judgement.EDIT_MODEL_ERROR * self.robot.length, judgement.EDIT_NOISE * self.robot.length
        cost = conditions * np.log(np.hypot(between, model)) + repeats * np.log(np.hypot(within, noise))
        cost += min(count, judgement.EDIT_ATTITUDES) * np.log(np.hypot(self.turn(missed), judgement.EDIT_TURN_ERROR))
        return np.asarray(-cost - parameters / 2 * np.log(conditions + repeats))

    def fitted(self, starts: Sequence[tuple[tuple[Edit, ...], Array]], steps: int, alone: bool = False) -> list[Fit]:
        """Fits of edits from starts (8 + own,), after this many steps of Gauss and Newton within the bounds, readings far off
        weighed down, each shortened until it gains; `alone`: without those of `COSTLY` that they do not widen."""
        problems = [_Problem(self, edits, x, alone) for edits, x in starts]
        for problem, missed in zip(problems, self.missed([(p.edits, p.x[None]) for p in problems]), strict=True):
            problem.missed = missed[0]
        active = problems
        for _ in range(steps):
            beside = self.missed([(p.edits, p.beside) for p in active])
            tried = [p.steps(missed) for p, missed in zip(active, beside, strict=True)]
            there = self.missed([(p.edits, x) for p, x in zip(active, tried, strict=True)])
            active = [p for p, x, missed in zip(active, tried, there, strict=True) if p.gains(x, missed)]
            if not active:
                break
        larger = np.array([np.prod([edit.enlarges for edit in p.edits]) for p in problems])
        as_read = np.stack([p.missed for p in problems]) / np.where(self.places, larger[:, None], 1.0)[:, :, None]
        evidence = self.log_evidence(as_read, np.array([p.parameters for p in problems]))
        priors = [float(np.log([edit.prior for edit in p.edits]).sum()) for p in problems]
        return [Fit(p.edits, p.x, p.missed, e) for p, e in zip(problems, (priors + evidence).tolist(), strict=True)]

    def starts(self, edits: tuple[Edit, ...], near: Fit) -> Iterator[tuple[Array, ...]]:
        """Where fits of edits may begin: with the calibration of `near`, a fit of all but the last, or as described."""
        last = edits[-1]
        for values in last.starts:
            both = np.stack([near.theta, np.zeros(len(CALIBRATION))])
            both[:, [*last.widens]] = values[: len(last.widens)]
            yield tuple(np.concatenate([theta, *near.own, values[len(last.widens) :]]) for theta in both)


def sample_of(robot: Robot, states: Campaign) -> Sample | None:
    """Of the states that can be compared, three of each of 20 conditions, or more of fewer; None where there are too few."""
    tips = states.take(~states.pushed & finite(states.trials))
    if len(tips) < judgement.EDIT_FEWEST:
        return None
    rows = rows_by(tips.condition)
    used = spread_over(len(rows), MOST // 3)
    kept = np.sort(np.concatenate([rows[c][spread_over(len(rows[c]), MOST // len(used))] for c in used]))
    sample = Sample(robot, tips.trials.take(kept), np.unique(tips.condition[kept], return_inverse=True)[1])
    if not isinstance(robot.area_factor, dict):
        return sample
    return _with_areas(sample, float(np.mean(robot.area_factor_at(tips.spine_length[kept]))))


def standing(rods: Rods, steps: Ints, arcs: Array) -> tuple[Solution, Stations]:
    """Equilibria of n rods, and these at arcs (n, k) m, of equal ones once: found directly, else from each share of the loads to
    the next, with steps (n, elements) half as long."""
    once, which = equal_rows(np.concatenate([rods.values, steps, arcs], axis=1))
    rods, steps, arcs = rods[once], steps[once], arcs[once]
    found = solve(rods, replace(DIRECT, steps=steps))
    here: Solution | None = None
    left = np.flatnonzero(~found.converged)
    for share in LOADS if left.size else ():
        carried = {name: share * rods.field(name)[left] for name in rods.form.fields().keys() & OF_LOAD}
        method = replace(DIRECT, steps=2 * steps[left], remember=True)
        method = method if here is None else replace(method, least_margin=FOLLOWED)
        here = solve(rods[left].changed(**carried), method, start=here)
        left, here = left[here.converged], here.take(here.converged)
    if here is not None:
        found.values[left], found.status[left], steps[left] = here.values, here.status, 2 * steps[left]
    along = stations(rods, found, arcs, replace(DIRECT, steps=steps)).values if arcs.size else np.empty((*arcs.shape, WIDTH))
    return found.take(which), Stations(along[which])


@lru_cache(maxsize=judgement.EDIT_SAMPLES)
def as_described(sample: Sample) -> list[Fit]:
    """Fits without an edit from each of `AREAS`, almost to the end, for a first comparison."""
    return sample.fitted([((), np.eye(len(CALIBRATION))[AREA] * area) for area in AREAS], 3, alone=True)


@lru_cache(maxsize=judgement.EDIT_SAMPLES)
def _with_areas(sample: Sample, area: float) -> Sample:
    """The sample with the area factors of its spine lengths, or with this one for all where that is nearer."""
    robot = sample.robot
    other = replace(sample, robot=robot.replace(area_factor=area))
    softer = Edit("modulus", 1.0, widens={AREA: WIDEST, MODULUS: WIDEST})
    axes = np.eye(len(CALIBRATION))
    starts = [((softer,), x) for x in (*(axes[AREA] * a for a in AREAS), *(axes[MODULUS] * a for a in AREAS[1:]))]
    for some in (starts[:1], starts):
        left, of_one = (min(s.rms(f.missed) for f in s.fitted(some, 3)) for s in (sample, other))
        if min(left, of_one) < judgement.EDIT_LOSS_SCALE * robot.length:
            return other if of_one < ONE_AREA * left else sample
    return sample if left < ONE_AREA * of_one else other


class _Problem:
    """A hypothesis on its way to its minimum."""

    def __init__(self, sample: Sample, edits: tuple[Edit, ...], x: Array, alone: bool) -> None:
        """With bounds and priors as the edits have them: `sd` (8,) of the calibration's, `free` the numbers of the parameters
        that are fitted, `unit` s in m."""
        self.edits, self.missed, self.unit = edits, np.zeros((0, 3)), judgement.EDIT_LOSS_SCALE * sample.robot.length
        bound, self.sd = judgement.EDIT_USUAL.copy(), judgement.EDIT_SD.copy()
        for edit in edits:
            for number, widest in edit.widens.items():
                bound[number], self.sd[number] = widest, np.inf
        self.low, self.high = np.array([*zip(-bound, bound, strict=True), *(b for edit in edits for b in edit.bounds)]).T
        free = np.ones(len(x), bool)
        free[[*COSTLY]] = not alone
        free[[number for edit in edits for number in edit.widens]] = True
        self.free, margin = np.flatnonzero(free), 0.005 * (self.high - self.low)
        self.x = np.clip(x, self.low + margin, self.high - margin)

    @property
    def change(self) -> Array:
        """(k,) of each free parameter, for its differences."""
        at = self.x[self.free]
        return np.copysign(STEP * np.maximum(1.0, np.abs(at)), at)

    @property
    def beside(self) -> Array:
        """(k, ..) points next to x, one for each free parameter."""
        x = np.tile(self.x, (len(self.free), 1))
        x[np.arange(len(self.free)), self.free] += self.change
        return x

    def slope(self, beside: Array) -> Array:
        """(3 n, k) derivatives of tip errors over s by the free parameters, from the errors (k, n, 3) next to x."""
        return ((beside - self.missed).reshape(len(beside), -1) / self.change[:, None]).T / self.unit

    def cost(self, x: Array, missed: Array) -> Array:
        """(v,) what is minimised, at x (v, ..) with errors (v, n, 3)."""
        squared = (missed**2).sum(axis=2) / self.unit**2
        return np.asarray(2 * (np.sqrt(1 + squared) - 1).sum(axis=1) + ((x[:, : len(CALIBRATION)] / self.sd) ** 2).sum(axis=1))

    def steps(self, beside: Array) -> Array:
        """(3, ..) points to try."""
        weight = np.repeat((1 + (self.missed**2).sum(axis=1) / self.unit**2) ** -0.5, 3)
        slope, prior = self.slope(beside), np.zeros(len(self.x))
        prior[: len(CALIBRATION)] = self.sd**-2.0
        curvature = slope.T @ (weight[:, None] * slope) + np.diag(prior[self.free])
        gradient = slope.T @ (weight * self.missed.ravel() / self.unit) + (prior * self.x)[self.free]
        step = np.zeros(len(self.x))
        step[self.free] = bounded(curvature, -gradient, (self.low - self.x)[self.free], (self.high - self.x)[self.free])
        return self.x + SHARES[:, None] * step

    def gains(self, tried: Array, missed: Array) -> bool:
        """Move to the best of some points (v, ..) with errors (v, n, 3); whether it is worth another step."""
        before, costs = self.cost(self.x[None], self.missed[None])[0], self.cost(tried, missed)
        best = int(np.argmin(costs))
        if costs[best] < before:
            self.x, self.missed = tried[best], missed[best]
        return bool(costs[best] < (1 - CONVERGED) * before)

    @property
    def parameters(self) -> int:
        """How many count in the evidence."""
        return sum(len(edit.bounds) + len(edit.widens) - (AREA in edit.widens) for edit in self.edits)


def bounded(curvature: Array, slope: Array, low: Array, high: Array) -> Array:
    """(k,) x of the least x' A x / 2 - b' x within bounds around 0: what leaves them is set to them, one after the other."""
    x, inside = np.zeros(len(slope)), np.ones(len(slope), bool)
    regular = curvature + (1e-9 * np.diag(np.diag(curvature)) + 1e-12 * np.eye(len(slope)))
    while inside.any():
        rest = slope[inside] - curvature.compress(inside, 0).compress(~inside, 1) @ x[~inside]
        x[inside] = np.linalg.solve(regular.compress(inside, 0).compress(inside, 1), rest)
        beyond: Mask = inside & ((x < low) | (x > high))
        if not beyond.any():
            break
        x, inside = np.clip(x, low, high), inside & ~beyond
    return x
