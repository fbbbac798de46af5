"""Worlds drawn under a plan, and their probabilities: which causes it can tell apart, before anything is measured.

They are linear about the robot as it is described,

    y = A theta + N u + g D w + sum_e f_e r_e o (B z_e) + e,    r_e = A_e theta_e,

with at most one cause at 0.5 to 1.5 plausible scales; every other effect in clutter, heavy-tailed; each law wrong by a smooth
share f_e of what its effect does there; the rest as the prior has it. Each world is weighed under none and every single effect
with the evidence of the diagnosis (`inference.evidence`), and named by the largest probability. Pairs and causes outside the
catalogue are not drawn. Source: simulation-based calibration (Talts et al. 2018).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp, softmax

from ..arrays import Array
from ..inference.budget import BudgetPart, after_calibration
from ..inference.candidate import Candidate
from ..inference.evidence import KNOWN, NONE, Hypothesis, log_allowed_share
from ..inference.linear import Linear
from ..inference.posterior import hypothesis_prior
from ..inference.prepare import Prepared, parts
from ..inference.problem import Problem, leading
from ..inference.search import Search
from ..judgement import SAME_ODDS, TEMPERATURE, TOLERATED_SIZES

CAUSE = (0.5, 1.5)
"""Plausible scales of a cause."""
CLUTTER = (0.0, 0.05, 0.1, 0.2)
"""Standard deviation of every other effect, plausible scales; one of them in each world."""
FREEDOM = 3
"""Degrees of freedom of Student's t, of the clutter."""
TOLERATED = float(TOLERATED_SIZES[TOLERATED_SIZES > 0].mean())


@dataclass(frozen=True)
class Planned:
    """The linear problem of a design, without any effect."""

    problem: Problem
    none: Candidate
    where: tuple[BudgetPart, ...]
    effects: tuple[str, ...]
    """That can be drawn."""

    @classmethod
    def of(cls, prepared: Prepared) -> Planned:
        """Of a campaign."""
        none = next(c for c in Search(prepared.problem).tried if not c.with_tolerances)
        p, own = prepared.problem.parameters, none.linear(prepared.problem).effects
        # a shorter whitened response cannot be drawn
        seen = [e for e in p.ids if (own[:, p.mask((e,)) & p.sizes] ** 2).sum() > 1.0]
        return cls(prepared.problem, none, parts(prepared), tuple(seen))

    @cached_property
    def linear(self) -> Linear:
        """Around the calibrated robot."""
        return self.none.linear(self.problem)

    def sizes(self, effect: str) -> NDArray[np.intp]:
        """Indices of its parameters that are sizes."""
        p = self.problem.parameters
        return np.flatnonzero(p.mask((effect,)) & p.sizes)

    def floors(self, white: Array) -> float:
        """Noise floors that a whitened response (n,) carries after calibration."""
        done = self.problem.noise.colour(white)[:, None]
        left = after_calibration(self.problem, self.where, self.none.fit.derivatives(self.problem).whole, done)
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


@dataclass(frozen=True)
class World:
    """One robot that was drawn."""

    readings: Array
    """(n,) whitened."""
    cause: str
    """Empty: none."""
    size: float
    """Plausible scales."""
    done: Mapping[str, Array]
    """Effect -> its whitened response (n,)."""


def drawn(d: Planned, rng: np.random.Generator, cause: str, clutter: Sequence[float]) -> World:
    """One world with a cause (empty: none), by the equation at the top of the file; `clutter`: standard deviations of all other
    effects in plausible scales, one of which this world has."""
    linear, p, noise = d.linear, d.problem.parameters, d.problem.noise
    y = rng.standard_normal(len(linear.observed)) + linear.nuisance.along(rng.standard_normal(linear.nuisance.shape[1]))
    discrepancy_size = rng.choice(KNOWN.sizes, p=KNOWN.size_weights)
    y += discrepancy_size * (linear.discrepancy @ rng.standard_normal(linear.discrepancy.shape[1]))
    clutter_sd, cause_size, responses = float(rng.choice(clutter)), float(rng.uniform(*CAUSE)), {}
    basis = d.problem.form_error_basis
    for effect in d.effects:
        columns = d.sizes(effect)
        direction = rng.standard_normal(len(columns))
        direction /= np.linalg.norm(direction)
        clutter_size = clutter_sd * rng.standard_t(FREEDOM) / np.sqrt(FREEDOM / (FREEDOM - 2))
        theta = direction * (cause_size if effect == cause else clutter_size)
        theta = np.where(p.low[columns] >= 0, np.abs(theta), np.where(p.high[columns] <= 0, -np.abs(theta), theta))
        response = noise.colour(linear.effects[:, columns] @ theta)
        law_error = p.law_error[effect] * rng.choice(KNOWN.form_errors) * (basis @ rng.standard_normal(basis.shape[1]))
        responses[effect] = noise.whiten(response * (1 + law_error))
        y += responses[effect]
    return World(y, cause, cause_size, responses)


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
        for g, row in enumerate(replace(with_readings, form_error=d.form_errors(h)).reductions(KNOWN.sizes, KNOWN.form_errors)):
            for f, accumulated in enumerate(row):
                gram, misfit = accumulated.information, np.diag(accumulated.information)[k:]
                of_worlds = replace(accumulated, information=gram[:k, :k], score=gram[k:, :k])
                for s, spike in enumerate(KNOWN.spikes):
                    prior = p.prior(mask, float(spike), linear.effect_size)
                    log_p, mean, covariance = of_worlds.update(prior)
                    cut = replace(prior, variance=np.where(mask, prior.variance, 0.0))
                    within_bounds = log_allowed_share(mean, np.diag(covariance)[None], cut, p)
                    within_bounds = within_bounds - log_allowed_share(prior.mean[None], prior.variance[None], cut, p)
                    terms.append(log_p - 0.5 * misfit + within_bounds + KNOWN.log_weights[s, g, f])
        evidence[i] = logsumexp(terms, axis=0)
    score = evidence.T / TEMPERATURE + np.log([hypothesis_prior(h, len(d.effects)) for h in named])
    return named, softmax(score, axis=1) / (1 + SAME_ODDS)
