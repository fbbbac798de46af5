"""Simulations of one case: what its instruments would read if a hypothesis were true, drawn from the priors of the diagnosis.

A simulation draws sizes of the named effects, small sizes of all others, nuisances, the errors of laws, the smooth discrepancy
and the noise. It is predicted by the same forward model, in the same states. The wide prior of what is fitted in every model (the
area factor) is conditioned on the case: each simulation is given the value with which it calibrates as the case does.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from diagnosis.inference.fit import Fit
from diagnosis.inference.problem import Problem
from diagnosis.judgement import DISCREPANCY_SIZES, DISCREPANCY_WEIGHTS, LAW_ERRORS, TOLERATED_SIZES

Array = NDArray[np.float64]
Hypothesis = tuple[str, ...]

ATTEMPTS = 30
"""Draws until one has an equilibrium at all states, or sizes within their bounds."""


@dataclass(frozen=True)
class Simulator:
    """Of one case."""

    problem: Problem
    calibrated: Fit
    """Nothing but nuisances fitted."""

    def readings(self, named: Hypothesis, rng: np.random.Generator) -> Array | None:
        """(n,) of one simulation; None where no draw has an equilibrium at all states."""
        problem = self.problem
        for _ in range(ATTEMPTS):
            theta, predicted = self._calibrated_alike(self.parameters(named, rng))
            if np.isfinite(predicted).all():
                break
        else:
            return None
        out = predicted.copy()
        for effect in named:
            without = np.where(np.array(problem.parameters.effects) == effect, 0.0, theta)
            done = np.nan_to_num(predicted - problem.forward.predict(without, trial=True))
            law_error = rng.choice(LAW_ERRORS) * problem.parameters.law_error[effect]
            basis = problem.form_error_basis
            out += law_error * done * (basis @ rng.normal(size=basis.shape[1]))
        size = rng.choice(DISCREPANCY_SIZES, p=DISCREPANCY_WEIGHTS)
        out += size * problem.discrepancy @ rng.normal(size=problem.discrepancy.shape[1])
        return np.asarray(out + problem.noise.colour(rng.normal(size=len(out))))

    def parameters(self, named: Hypothesis, rng: np.random.Generator) -> Array:
        """(k,) drawn; a named effect is at least as large as one that the diagnosis names."""
        p = self.problem.parameters
        prior = p.prior(p.mask(named), float(rng.choice(TOLERATED_SIZES)))
        sizes = self._within(prior.mean, np.sqrt(prior.variance), p.low, p.high, rng)
        for effect in named:
            own = p.mask((effect,))
            for _ in range(ATTEMPTS):
                if (np.abs(sizes) >= p.least_named)[own & p.sizes].any():
                    break
                again = self._within(prior.mean, np.sqrt(prior.variance), p.low, p.high, rng)
                sizes = np.where(own, again, sizes)
        theta = np.clip(p.mean + p.sd * rng.normal(size=len(p.sd)), p.lower, p.upper)
        theta[p.calibration] = self.calibrated.theta[p.calibration]
        theta[p.of_effect] = sizes * p.scale
        return theta

    def _within(self, mean: Array, sd: Array, low: Array, high: Array, rng: np.random.Generator) -> Array:
        """A normal draw cut at bounds."""
        out = mean + sd * rng.normal(size=len(mean))
        for _ in range(ATTEMPTS):
            away = (out < low) | (out > high)
            if not away.any():
                break
            out = np.where(away, mean + sd * rng.normal(size=len(mean)), out)
        return np.clip(out, low, high)

    def _calibrated_alike(self, theta: Array) -> tuple[Array, Array]:
        """The same parameters (k,) with those of the calibration moved by one step, so that least squares over them would leave
        them about where they are in the case; and what is predicted there (n,), NaN where there is no equilibrium."""
        problem, free = self.problem, np.flatnonzero(self.problem.parameters.calibration)
        predicted = problem.forward.predict(theta, trial=True)
        if not free.size or not np.isfinite(predicted).all():
            return theta, predicted
        away = problem.noise.whiten(predicted - self.calibrated.predicted)
        out = theta.copy()
        out[free] -= np.linalg.lstsq(self._free, away, rcond=None)[0]
        out = np.clip(out, problem.parameters.lower, problem.parameters.upper)
        return out, problem.forward.predict(out, trial=True)

    @cached_property
    def _free(self) -> Array:
        """(n, c) whitened derivatives by the parameters of the calibration, at the calibrated model."""
        problem = self.problem
        free = np.flatnonzero(problem.parameters.calibration)
        return problem.noise.whiten(problem.linearise(self.calibrated.theta, free.tolist())[1])
