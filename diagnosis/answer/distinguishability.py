"""Distinguishability: which effects these data cannot tell apart.

T_ij is the misfit (chi-square) that would be left if effect i were at work with size t and effect j were fitted instead,
everything else refitted too: T = t (H_ii - H_ij (H_jj + I)^-1 H_ji) t, H the information about both. Below 9 the two are tied:
the right one would lead by less than three standard deviations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import Array, Mask
from ..inference.candidate import Candidate
from ..inference.linear import Reduced
from ..inference.posterior import EffectPosterior
from ..inference.problem import FitParameters, Problem
from ..judgement import COMPARED_DISCREPANCY, RIVAL_PROBABILITY, TIED


@dataclass(frozen=True)
class Distinguishability:
    """Separations between single effects."""

    effects: tuple[str, ...]
    separation: Array
    """(e, e) T of row's effect against column's; the diagonal holds T against no effect at all."""

    def rivals(self, effect: str) -> tuple[str, ...]:
        """Effects that these data cannot tell from this one: T below `TIED`."""
        i = self.effects.index(effect)
        return tuple(e for j, e in enumerate(self.effects) if j != i and self.separation[i, j] < TIED)

    def groups(self, ranked: EffectPosterior) -> tuple[tuple[str, ...], ...]:
        """Groups of probable, detectable effects that these data cannot tell apart."""
        detectable = np.diag(self.separation) >= TIED  # against no effect at all
        seen = [e for e, shows in zip(self.effects, detectable, strict=True) if shows and ranked.of_effect(e) > RIVAL_PROBABILITY]
        groups = (tuple(e for e in seen if e == one or e in self.rivals(one)) for one in seen)
        return tuple(dict.fromkeys(g for g in groups if len(g) > 1))


def distinguishability(problem: Problem, best: Candidate, ranked: EffectPosterior) -> Distinguishability:
    """Separations of all single effects in the linear problem of the `best` hypothesis, everything else free within its
    tolerance: at the fitted size where an effect is probable, else at its plausible scale."""
    p, linear, at = problem.parameters, best.fit.linear(problem), best.weighed.peak
    size = np.ones(len(p.scale))
    for effect in p.ids:
        if ranked.of_effect(effect) > RIVAL_PROBABILITY:
            fitted = ranked.candidates.get((effect,), best).fit.theta
            size = np.where(p.mask((effect,)), fitted[p.of_effect] / p.scale, size)
    reduced = linear.reduced(max(at.size, COMPARED_DISCREPANCY), at.form_error)
    out = np.diag([_separation(reduced, p, one, None, size, at.spike, linear.effect_size)[0] for one in p.ids])
    for i, one in enumerate(p.ids):
        for j, other in enumerate(p.ids[:i]):
            out[i, j], out[j, i] = _separation(reduced, p, one, other, size, at.spike, linear.effect_size)
    return Distinguishability(p.ids, out)


def visible(reduced: Reduced, p: FitParameters, spike: float, effect_size: Array | None) -> tuple[str, ...]:
    """The effects that would be seen at their plausible size."""
    size = np.where(p.sizes, 1.0, 0.0)
    return tuple(e for e in p.ids if _separation(reduced, p, e, None, size, spike, effect_size)[0] >= TIED)


def _separation(
    reduced: Reduced, p: FitParameters, one: str, other: str | None, size: Array, spike: float, effect_size: Array | None
) -> tuple[float, float]:
    """T of one effect against the other (None: against no effect), and of the other against the one, each with its parameters at
    `size` (p,); the other effects are free within `spike`, their shape parameters as `effect_size` (p,) allows."""
    both = p.mask((one,) if other is None else (one, other))
    information = _left(reduced.information, both, np.sqrt(p.prior(both, spike, 1.0, effect_size).variance))
    own, at, prior_sd = p.mask((one,))[both], size[both], np.ones(int(both.sum()))
    of_one, of_other = (float(at[k] @ _left(information, k, prior_sd) @ at[k]) for k in (own, ~own))
    return of_one, of_other


def _left(information: Array, own: Mask, sd: Array) -> Array:
    """What is left of the information (p, p) about `own` parameters when the others are fitted within `sd` (p,) of each."""
    across, among = information[np.ix_(own, ~own)] * sd[~own], information[np.ix_(~own, ~own)] * np.outer(sd[~own], sd[~own])
    return information[np.ix_(own, own)] - across @ np.linalg.solve(among + np.eye(len(among)), across.T)
