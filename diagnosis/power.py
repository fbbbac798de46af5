"""What a plan can tell before it is measured: worlds drawn under it, how often each cause would be named, and what a further
experiment would bring.

A case is foreseen as the plan would give it. Worlds are drawn under its design, and weighed.

Worlds are linear about the robot as it is described,

    y = A theta + N u + g D w + sum_e f_e r_e o (B z_e) + e,    r_e = A_e theta_e,

with at most one cause at 0.5 to 1.5 plausible scales; every other effect in clutter, heavy-tailed; each law wrong by a smooth
share f_e of what its effect does there; the rest as the prior has it. Each world is weighed under none and every single effect
with the evidence of the diagnosis (`inference.evidence`), and named by the largest probability. Pairs and causes outside the
catalogue are not drawn. Source: simulation-based calibration (Talts et al. 2018).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp, softmax

from model.effects.catalogue import CATALOGUE
from model.effects.design import design_from_columns
from model.effects.forward import ForwardModel
from model.effects.spec import EffectSpec
from model.robot import Robot
from recordings.trials import Table

from .answer.experiments import candidate_experiments, columns
from .answer.result import Proposal
from .arrays import Array
from .data.campaign import places
from .data.case import Case, states
from .errors import BadCase
from .inference.budget import after_calibration
from .inference.evidence import KNOWN, NONE, Hypothesis, log_allowed_share
from .inference.linear import Reduced
from .inference.posterior import hypothesis_prior
from .inference.prepare import parts, prepare
from .inference.problem import leading
from .inference.reading_noise import USUAL
from .inference.search import Search
from .judgement import CAUSE_PROBABILITY, PRIOR_OF_NUMBER, SAME_ODDS, TEMPERATURE, TOLERATED_SIZES

CAUSE = (0.5, 1.5)
"""Plausible scales of a cause."""
CLUTTER = (0.0, 0.05, 0.1, 0.2)
"""Standard deviation of every other effect, plausible scales; one of them in each world."""
FREEDOM = 3
"""Degrees of freedom of Student's t, of the clutter."""
TOLERATED = float(TOLERATED_SIZES[TOLERATED_SIZES > 0].mean())
SIZES = ("small", "medium", "large")
"""Thirds of the range of sizes."""
OTHER_LAWS = {"clean": 0.82, "cluttered": 0.71}
"""Of what such worlds promise, the share that sealed robots of other laws kept: 61 of 80 told exactly where 74.5 were promised,
46 of 106 where 65.1 were (in-sample: ten worlds without thrust on the walls, whole sweep, read while ramping)."""


class Planned:
    """The linear problem of a design, without any effect."""

    def __init__(self, case: Case, catalogue: Mapping[str, EffectSpec]) -> None:
        """Of a campaign, measured or foreseen; `effects` are those that can be drawn. Raises `BadCase`."""
        prepared = prepare(case.robot, states(case)[0], catalogue=catalogue)
        self.problem, self.where = prepared.problem, parts(prepared)
        calibrated = next(c for c in Search(self.problem).tried if not c.with_tolerances).fit
        slope = calibrated.derivatives(self.problem).every.coloured(self.problem.noise, self.problem.parameters.sd)
        self.linear, self._slope = calibrated.linear(self.problem), slope
        """Around the calibrated robot."""
        self.factors = self.problem.smooth.laws(np.ones(len(self.problem.observed)))
        """(n, b) columns of a relative error of size 1 of a law."""
        p, own = self.problem.parameters, self.linear.effects
        # a shorter whitened response cannot be drawn
        self.effects = tuple(e for e in p.ids if (own[:, p.mask((e,)) & p.sizes] ** 2).sum() > 1.0)

    def sizes(self, effect: str) -> NDArray[np.intp]:
        """Indices of its parameters that are sizes."""
        p = self.problem.parameters
        return np.flatnonzero(p.mask((effect,)) & p.sizes)

    def floors(self, white: Array) -> float:
        """Noise floors that a whitened response (n,) carries after calibration."""
        left = after_calibration(self.problem, self.where, self._slope, self.problem.noise.colour(white)[:, None])
        return max(float(np.sqrt((x**2).sum() / part.states)) / part.floor for x, part in zip(left, self.where, strict=True))

    def form_errors(self, named: Hypothesis) -> Array:
        """Columns of what may be wrong with the laws: of what is named at its plausible scale, of all else at its tolerance."""
        found = []
        for effect in self.effects:
            own = self.sizes(effect)
            size = 1 / np.sqrt(len(own)) if effect in named else TOLERATED
            size *= self.problem.parameters.law_error[effect]
            found += [size * self.linear.effects[:, j] for j in own]
        return leading(np.hstack([self.problem.form_error_of(self.problem.noise.colour(c)) for c in found]))


def drawn(d: Planned, rng: np.random.Generator, cause: str, clutter: Sequence[float]) -> tuple[Array, float, Array]:
    """Readings (n,) of one world with a cause (empty: none), by the equation at the top of the file, the plausible scales of it,
    and the response to it (n,), whitened; `clutter`: standard deviations of all other effects in plausible scales, one of which
    this world has."""
    linear, p, noise = d.linear, d.problem.parameters, d.problem.noise
    y = rng.standard_normal(len(linear.observed)) + linear.nuisance.along(rng.standard_normal(linear.nuisance.shape[1]))
    discrepancy_size = rng.choice(KNOWN.sizes, p=KNOWN.size_weights)
    y += discrepancy_size * (linear.discrepancy @ rng.standard_normal(linear.discrepancy.shape[1]))
    clutter_sd, cause_size, of_cause = float(rng.choice(clutter)), float(rng.uniform(*CAUSE)), np.zeros(len(y))
    for effect in d.effects:
        columns = d.sizes(effect)
        direction = rng.standard_normal(len(columns))
        direction /= np.linalg.norm(direction)
        clutter_size = clutter_sd * rng.standard_t(FREEDOM) / np.sqrt(FREEDOM / (FREEDOM - 2))
        theta = direction * (cause_size if effect == cause else clutter_size)
        theta = np.where(p.low[columns] >= 0, np.abs(theta), np.where(p.high[columns] <= 0, -np.abs(theta), theta))
        response = noise.colour(linear.effects[:, columns] @ theta)
        law_error = p.law_error[effect] * rng.choice(KNOWN.form_errors) * (d.factors @ rng.standard_normal(d.factors.shape[1]))
        own = noise.whiten(response * (1 + law_error))
        y += own
        of_cause += own * (effect == cause)
    return y, cause_size, of_cause


def probabilities(d: Planned, readings: Array) -> tuple[tuple[Hypothesis, ...], Array]:
    """None and every single effect, and their probabilities (worlds, hypotheses) for whitened readings (worlds, n).

    As `inference.evidence.weigh`, for many worlds at once: what is common to all is factorised once. Bounds cut what is named.
    """
    linear, p = d.linear, d.problem.parameters
    named: tuple[Hypothesis, ...] = (NONE, *((e,) for e in d.effects))
    k = linear.effects.shape[1]
    # Readings as further columns: X^T C^-1 X holds the information, and the score and misfit of each world.
    with_readings = replace(linear, effects=np.hstack([linear.effects, readings.T]), observed=np.zeros(len(linear.observed)))
    evidence = np.empty((len(named), len(readings)))
    for i, h in enumerate(named):
        mask, terms = p.mask(h), []
        of_grid = replace(with_readings, form_error=d.form_errors(h)).reductions(KNOWN.sizes, KNOWN.form_errors)
        gram, misfit = of_grid.information, np.diagonal(of_grid.information, axis1=2, axis2=3)[..., k:]
        of_worlds = Reduced(gram[:, :, None, :k, :k], gram[:, :, k:, :k], of_grid.base[..., None] - 0.5 * misfit)
        for s, (spike, slab) in enumerate(zip(KNOWN.spikes, KNOWN.slabs, strict=True)):
            prior = p.prior(mask, float(spike), float(slab), linear.effect_size)
            log_p, mean, root = of_worlds.update(prior)
            cut = replace(prior, variance=np.where(mask, prior.variance, 0.0))
            within_bounds = log_allowed_share(mean, (root**2).sum(axis=-2), cut, p)
            within_bounds -= log_allowed_share(prior.mean, prior.variance, cut, p)
            terms.append(log_p + within_bounds + KNOWN.log_weights[s, ..., None])
        evidence[i] = logsumexp(terms, axis=(0, 1, 2))
    score = evidence.T / TEMPERATURE + np.log([hypothesis_prior(h, len(d.effects)) for h in named])
    return named, softmax(score, axis=1) / (1 + SAME_ODDS)


@dataclass(frozen=True)
class EffectPower:
    """What becomes of worlds with one cause; its floor of scatter is the repeats'."""

    effect: str
    carries: float
    """Noise floors that it carries after calibration at its plausible size, median."""
    right: Mapping[str, float | None]
    """By size (thirds of 0.5 to 1.5 plausible scales): share in which it, and nothing else, is most probable."""
    sure: float
    """Share in which it is named with p > 0.9."""
    taken_for: tuple[tuple[str, float], ...]
    """Others that are named instead, with their share."""


@dataclass(frozen=True)
class Power:
    """What a plan can tell."""

    worlds: int
    right: float
    """Share of all worlds whose cause, or that there is none, is most probable."""
    right95: tuple[float, float]
    stated: float
    """Mean probability of what is most probable: as honest as it comes near `right`."""
    effects: tuple[EffectPower, ...]
    unseen: tuple[str, ...]
    """Effects that change nothing here that could be seen."""

    @property
    def pairs(self) -> tuple[tuple[str, str, float], ...]:
        """Effect, what it is taken for, and in which share; most first."""
        found = [(e.effect, other, share) for e in self.effects for other, share in e.taken_for if share >= 0.1]
        return tuple(sorted(found, key=lambda x: -x[2]))

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {"schema": "power/1", **asdict(self), "pairs": [list(p) for p in self.pairs]}


def power(plan: Planned, catalogue: Sequence[str], each: int = 40, seed: int = 1, clutter: Sequence[float] = CLUTTER) -> Power:
    """What the plan can tell, from worlds drawn under its design and weighed: `each` of none and of every effect it can draw.

    Shares of all worlds count each world with the prior probability of its cause, as the diagnosis has it.
    """
    rng = np.random.default_rng(seed)
    cause = np.repeat(["", *plan.effects], each)
    readings, size, of_cause = map(np.array, zip(*(drawn(plan, rng, one, clutter) for one in cause.tolist()), strict=True))
    hypotheses, p = probabilities(plan, readings)
    named, probability = np.array(["".join(h) for h in hypotheses])[p.argmax(axis=1)], p.max(axis=1)
    right = cause == named
    weight = np.where(cause == "", PRIOR_OF_NUMBER[0], (1 - PRIOR_OF_NUMBER[0]) / len(plan.effects))
    weight /= weight.sum()
    size_class = np.clip(np.digitize(size, np.linspace(*CAUSE, len(SIZES) + 1)) - 1, 0, len(SIZES) - 1)

    def rates_of(effect: str) -> EffectPower:
        with_cause = cause == effect
        floors = [plan.floors(done) / own for done, own in zip(of_cause[with_cause], size[with_cause], strict=True)]
        right_by_size = {name: right[with_cause & (size_class == k)] for k, name in enumerate(SIZES)}
        taken_for = Counter(str(n) or "none" for n in named[with_cause & ~right])
        return EffectPower(
            effect,
            carries=float(np.median(floors)),
            right={name: float(part.mean()) if part.size else None for name, part in right_by_size.items()},
            sure=float(np.mean((right & (probability > CAUSE_PROBABILITY))[with_cause])),
            taken_for=tuple((n, count / int(with_cause.sum())) for n, count in taken_for.most_common()),
        )

    share, sd = float(weight @ right), float(np.sqrt(weight**2 @ (right - weight @ right) ** 2))
    interval = (max(share - 1.96 * sd, 0.0), min(share + 1.96 * sd, 1.0))
    unseen = tuple(e for e in catalogue if e not in plan.effects)
    return Power(len(cause), share, interval, float(weight @ probability), tuple(map(rates_of, plan.effects)), unseen)


@dataclass(frozen=True)
class Addition:
    """An experiment more, and what it would bring."""

    experiment: Proposal
    right: float
    """Share of the same causes told right with it."""
    gained: float
    """Over what the plan tells in as many worlds."""

    @property
    def per_hour(self) -> float:
        """Gain an hour."""
        return self.gained / max(self.experiment.cost_min / 60, 1e-3)


def foreseen(robot: Robot, table: Mapping[str, NDArray[np.generic]], seed: int = 1) -> Case:
    """A case as the planned columns would give it, of a robot as it is described, read with the usual noise and scatter of
    trials. Raises `BadCase` where the rod has no equilibrium."""
    design = design_from_columns(robot, table)
    forward = ForwardModel(robot, design, area="one", catalogue={})
    rng = np.random.default_rng(seed)
    # what recurs (with trials, repeats, mountings) is drawn, all else is as described
    theta = np.array([np.clip(p.sd * rng.standard_normal(), p.low, p.high) if p.recurs else 0.0 for p in forward.parameters])
    values = forward.predict(theta)
    if not np.isfinite(values).all():
        raise BadCase("the rod model has no equilibrium at a planned state: check pressures, and robot.yaml's stiffness")
    n, read = len(design), forward.observations
    tip = places(n, read.row, read.channel, values).T + USUAL.channel["tip"] * rng.standard_normal((3, n))
    others = {"step": np.arange(1, n + 1), "protocol": np.full(n, "bending"), **table}
    return Case(robot, Table({**others, **dict(zip("xyz", tip, strict=True))}))


def additions(
    case: Case,
    catalogue: Mapping[str, EffectSpec] = CATALOGUE,
    each: int = 12,
    seed: int = 2,
    progress: Callable[[float], None] = lambda _: None,
) -> tuple[Addition, ...]:
    """What each experiment of the menu would bring beside a plan, most for its time first, by `each` worlds of every cause."""
    right_before = power(Planned(case, catalogue), tuple(catalogue), each, seed).right
    menu, chambers = candidate_experiments(case.robot, states(case)[0]), len(case.robot.actuators.azimuths_deg)
    brought = []
    for k, e in enumerate(menu):
        progress((k + 1) / (len(menu) + 1))
        try:
            more = foreseen(case.robot, columns(e.protocol, chambers, ("x", "y", "z", *e.channels)), seed).table
        except BadCase:
            continue
        later = more.replaced({"t": more["t"] + case.table["t"].max() + 60.0})
        extended = Case(case.robot, Table.joined([case.table, later]))
        right_after = power(Planned(extended, catalogue), tuple(catalogue), each, seed).right
        brought.append(Addition(e, right_after, right_after - right_before))
    progress(1.0)
    return tuple(sorted(brought, key=lambda a: -a.per_hour))
