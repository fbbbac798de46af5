"""The hypotheses still in play, and what each predicts of an experiment.

A prediction is a normal distribution about the hypothesis' own fit,

    cov = S C S^T + S' V S'^T + S_m V_m S_m^T + f^2 F F^T + g^2 D D^T + R,

C the posterior covariance of the robot's parameters with every effect that is not named free within its tolerance. V is that of
parameters that the fit did not have, drawn anew with each trial, V_m that of the mounting, done anew: the scatter of trials where
it was estimated, else the prior. F is the error of the laws (f), D the smooth discrepancy (g), R the readings' noise with what
lasts of it from state to state.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import fdtrc

from model.effects.design import design_from_columns
from model.errors import ModelError

from ..arrays import Array
from ..criticism.gaussian import Gaussian
from ..data.campaign import Labels, places
from ..inference.discrepancy import settings, smooth_errors
from ..inference.evidence import Hypothesis
from ..inference.posterior import UNKNOWN, EffectPosterior
from ..inference.prepare import Prepared
from ..inference.reading_noise import OFFSET, robot_noise
from ..judgement import COMPARED_DISCREPANCY, RIVAL_LEAST_WEIGHT, TOLERATED_SIZES
from .distinguishability import Distinguishability

MOST = 5
"""Rivals that are compared."""
LEAST_SPIKE = float(TOLERATED_SIZES[TOLERATED_SIZES > 0].min())
MOUNTED = ("tilt", "frame_shift")
"""Tolerances that are drawn again where a robot may be mounted anew."""


@dataclass(frozen=True)
class RivalForecast:
    """Values (n,) that one hypothesis predicts, and how surely."""

    mean: Array
    factor: Array
    """(n, n) lower Cholesky factor of the covariance."""
    labels: Labels
    """State and channel of each value."""

    def log_density(self, outcomes: Array) -> Array:
        """(draws,) of outcomes (draws, n), up to a constant common to all."""
        white = solve_triangular(self.factor, (outcomes - self.mean).T, lower=True)
        return -0.5 * (white**2).sum(axis=0) - float(np.log(np.diag(self.factor)).sum())

    def p_value(self, observed: Array, contrasts: int) -> float:
        """Probability of values (n,) at least so far off: F, as the noise is known from this many contrasts alone. Values
        that are not finite are left out."""
        known = np.isfinite(observed)
        covariance = (self.factor @ self.factor.T)[np.ix_(known, known)]
        white = solve_triangular(np.linalg.cholesky(covariance), (observed - self.mean)[known], lower=True)
        n = int(known.sum())
        return float(fdtrc(n, max(contrasts, 1), float(white @ white) / n))

    @cached_property
    def tip(self) -> tuple[Array, Array]:
        """Tip (states, 3) and standard deviation of each coordinate, m; NaN where it is not measured."""
        state, channel, spread = self.labels.state, self.labels.channel, np.sqrt((self.factor**2).sum(axis=1))
        states = int(state.max(initial=-1)) + 1
        return places(states, state, channel, self.mean), places(states, state, channel, spread)


class Rivals:
    """Leading hypotheses of a diagnosis with their probabilities among each other."""

    def __init__(self, p: Prepared, weighed: EffectPosterior, separation: Distinguishability) -> None:
        """The leading hypotheses, and the rivals of the first that these data cannot tell from it; their `weight` (k,) sums to
        one."""
        ranked: list[Hypothesis] = [h for h, _ in weighed.ranking if h != UNKNOWN][:MOST]
        if len(ranked[0]) == 1:
            ranked[1:1] = [(e,) for e in separation.rivals(ranked[0][0]) if (e,) in weighed.candidates]
        self.prepared, self.candidates = p, tuple(weighed.candidates[h] for h in dict.fromkeys(ranked))[:MOST]
        weight = np.maximum([weighed.probability(c.named) for c in self.candidates], RIVAL_LEAST_WEIGHT)
        self.weight: Array = weight / weight.sum()
        self.names = tuple(" + ".join(c.named) or "none" for c in self.candidates)
        """In words."""

    def predict(self, table: Mapping[str, Any]) -> tuple[RivalForecast, ...] | None:
        """The forecast of each candidate for the states of a table's columns (as those of trials.csv); None where one of them has
        no equilibrium, or this robot cannot do what the table says."""
        p = self.prepared
        try:
            forward = p.forward.on(design_from_columns(p.robot, table))
        except ModelError:
            return None
        names = {info.name: i for i, info in enumerate(forward.parameters)}
        fitted_parameters = p.problem.parameters
        lasting = np.flatnonzero(~fitted_parameters.recurs)
        # the same parameters in this model and among those of the problem that last
        _, in_model, known = np.intersect1d([*names], np.take(fitted_parameters.names, lasting), return_indices=True)
        own_sd = np.array([p.noise_components.trial.get(info.source, info.sd) for info in forward.parameters])
        source = np.array([info.source for info in forward.parameters])
        fresh = ~np.isin(np.arange(len(own_sd)), in_model)  # those that the fit did not have
        labels = Labels(forward.observations.row, forward.observations.channel.astype(np.str_))
        design, length = forward.design, p.robot.length
        branch, no_kind = np.where(design.unload, -1.0, 1.0), np.zeros(len(design))
        where = settings(design.spine_length, design.pressure.max(axis=1), branch, no_kind, length)
        errors = smooth_errors(where, labels.state, labels.channel, p.unit, length)
        smooth, forecasts = errors.discrepancy, list[RivalForecast]()
        for c, known_covariance in zip(self.candidates, self._covariances, strict=True):
            theta = np.zeros(len(own_sd))
            theta[in_model] = c.fit.theta[lasting[known]]
            mean, slope = forward.linearise(theta)
            if not np.isfinite(mean).all() or not np.isfinite(slope).all():
                return None
            covariance = slope[:, in_model] @ known_covariance[np.ix_(known, known)] @ slope[:, in_model].T  # S C S^T
            for again in (fresh, np.isin(source, MOUNTED)):  # S' V S'^T and, besides C, S_m V_m S_m^T
                covariance += (slope[:, again] * own_sd[again] ** 2) @ slope[:, again].T
            covariance += max(c.weighed.peak.size, COMPARED_DISCREPANCY) ** 2 * smooth @ smooth.T  # g^2 D D^T
            # an error of the pressure readings moves the tip as an offset of the pressures does
            by_pressure = slope[:, [i for name, i in names.items() if name == OFFSET]]
            root = robot_noise(p.noise_components, labels, design.trial, design.t, by_pressure).colour(np.eye(len(mean)))
            covariance += root @ root.T  # R
            for effect in c.named:
                contribution = mean - forward.predict(np.where(source == effect, 0.0, theta))
                if np.isfinite(contribution).all():
                    law_error = errors.laws(c.weighed.peak.form_error * fitted_parameters.law_error[effect] * contribution)
                    covariance += law_error @ law_error.T  # f^2 F F^T
            factor = np.asarray(np.linalg.cholesky(covariance), np.float64)
            forecasts.append(RivalForecast(mean, factor, labels))
        return tuple(forecasts)

    @cached_property
    def _covariances(self) -> list[Array]:
        """Posterior covariance of the problem's parameters that do not recur, under each of the candidates."""
        p, out = self.prepared.problem.parameters, []
        chosen = np.flatnonzero(~p.recurs)
        for c in self.candidates:
            linear, at = c.fit.linear(self.prepared.problem), c.weighed.peak
            prior = p.prior(p.mask(c.named), max(at.spike, LEAST_SPIKE), at.slab, linear.effect_size)
            scale = p.scaled(prior)[0][chosen]
            known = Gaussian(linear, prior, at.size, at.form_error).covariance(p.of_effect, chosen)
            out.append(scale[:, None] * known * scale[None, :])
        return out
