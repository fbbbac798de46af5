"""Probability of a cause outside the catalogue, and which such causes would look like the named one.

Three kinds of such causes, with their prior odds against the catalogue:

1. A relative of an effect (`relatives`) in its place: weighed like a hypothesis of the catalogue, in the linear problem of the
   answer. Next to a named effect it would absorb the error of that effect's law.
2. A stage's error of free form in addition to the named effects (`stage_errors`).
3. A cause that looks exactly like a named one.

The last two become more probable as repeats scatter more than usual.
Log evidence is divided by the temperature, as everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from model.effects.catalogue import CATALOGUE
from model.effects.forward import ForwardModel
from model.effects.spec import EffectSpec

from .. import judgement
from ..arrays import Array
from ..inference.candidate import Candidate
from ..inference.evidence import KNOWN, Hypothesis, weigh
from ..inference.fit import Fit, fit
from ..inference.posterior import Related, log_weight
from ..inference.prepare import Prepared, least_sizes, observable_effects, parameters, possible
from ..inference.problem import FitParameters, MaskedForward, derivatives
from .relatives import relatives

LEAST_SHARE, MOST_FITTED, ROUNDS = 0.1, 3, 8
"""Share of the best hypothesis' weight that a relative must promise to be fitted; most relatives and rounds."""


def related(p: Prepared, candidates: Sequence[Candidate], reached: Mapping[Hypothesis, float]) -> tuple[Related, ...]:
    """Relatives in the place of each effect of some candidates, and alone where they name none; the most probable first.

    `candidates` have the log evidence of their hypotheses and all derivatives. `reached` is the log evidence of all hypotheses:
    a relative gets no credit for evidence that a catalogue hypothesis gains in the same problem. Relatives are
    weighed in linear problems first (`promised`); the most promising are fitted, until one that is fitted leads.
    """
    effects = len(p.problem.parameters.ids)
    further = {id: spec for id, spec in relatives(p.robot).items() if id not in p.forward.catalogue}
    forward = _with_relatives(p, observable_effects(p.robot, p.forward.design, further))
    promised: dict[tuple[str, Hypothesis], tuple[float, Candidate]] = {}

    def above(beside: Hypothesis, log_evidence: float) -> float:
        return max(log_evidence - reached.get(beside, math.inf), 0.0)

    for c in candidates:
        for beside, alone, with_relative in _promised(p, forward, c):
            for r, log_evidence in with_relative.items():
                z = log_evidence - above(beside, alone)
                if z > promised.get((r, beside), (-math.inf, c))[0]:
                    promised[r, beside] = z, c

    weight = partial(log_weight_of, effects=effects)
    unfitted = sorted((Related(*k, z) for k, (z, _) in promised.items()), key=weight, reverse=True)
    least_weight = max(log_weight(c.named, c.log_evidence, effects) for c in candidates) + math.log(LEAST_SHARE)
    fitted: list[Related] = []
    while unfitted and p.baseline is None and len(fitted) < MOST_FITTED and weight(unfitted[0]) > least_weight:
        first = unfitted.pop(0)
        with_it, without = fit_relative(p, first, promised[first.relative, first.beside][1], least_weight)
        fitted.append(replace(with_it, log_evidence=with_it.log_evidence - above(first.beside, without)))
        if unfitted and weight(max(fitted, key=weight)) > weight(unfitted[0]):
            break
    return tuple(sorted((*fitted, *unfitted), key=weight, reverse=True))


def _promised(p: Prepared, forward: ForwardModel, c: Candidate) -> Iterator[tuple[Hypothesis, float, dict[str, float]]]:
    """What stands beside a relative in a candidate, its log evidence, and that with each relative in place of one effect, in the
    linear problem of the candidate."""
    wider, white = _relatives(p, forward, c)
    added = wider.infos[len(p.problem.parameters.infos) :]
    ids = tuple(dict.fromkeys(i.source for i, column in zip(added, white.T, strict=True) if column.any()))
    offset = c.log_evidence - weigh(c.fit.linear(p.problem), KNOWN, p.problem.parameters, [c.named])[0].log_evidence
    for one in c.named or ("",):
        beside = tuple(e for e in c.named if e != one)
        there = (c.fit.without_law(one) if c.named else c.fit).linear(p.problem)
        size = None if there.effect_size is None else np.append(there.effect_size, np.zeros(len(added)))
        extended = replace(there, effects=np.hstack([there.effects, white]), effect_size=size)
        alone, *with_relative = weigh(extended, KNOWN, wider, [beside, *((*beside, r) for r in ids)])
        yield beside, alone.log_evidence + offset, {r: w.log_evidence + offset for r, w in zip(ids, with_relative, strict=True)}


def log_weight_of(r: Related, effects: int) -> float:
    """As `log_weight`: a catalogue of few effects makes no relative more probable, and one that has no fit explains nothing."""
    named, of = (*r.beside, r.relative), max(effects, len(CATALOGUE))
    weighs = len(named) in judgement.PRIOR_OF_NUMBER and math.isfinite(r.log_evidence)
    return log_weight(named, r.log_evidence, of) if weighs else -math.inf


def fit_relative(p: Prepared, r: Related, start: Candidate, least_weight: float) -> tuple[Related, float]:
    """A relative and the effects beside it, fitted from a candidate's fit, and log evidence of the effects alone there. It is
    searched with derivatives by these alone first, and to its end where it then still promises `least_weight`."""
    of_problem = p.problem.parameters
    forward = _with_relatives(p, {r.relative: relatives(p.robot)[r.relative]})
    made = parameters(possible(forward, p.robot))
    # in the problem; -1: of the relative
    place = np.array([of_problem.names.index(name) if name in of_problem.names else -1 for name in made.names])
    least = np.where(place < 0, made.least, np.take(of_problem.least, place))
    wider = replace(made, sd=np.where(place < 0, made.sd, of_problem.sd[place]), least=tuple(least.tolist()))
    problem = replace(p.problem, forward=MaskedForward(forward, p.kept), parameters=wider)
    named = (*r.beside, r.relative)
    theta = np.where(place < 0, 0.0, start.fit.theta[place])
    theta[[i for i, e in enumerate(wider.effects) if e in start.named and e not in named]] = 0.0
    prior = wider.prior_of(named, judgement.FIT_TOLERATED_SIZE)
    begun: Array | Fit = theta
    for frozen in (problem.jacobian(theta)[1], None):
        best = fit(problem, prior, judgement.FIT_DISCREPANCY_SIZE, begun, ROUNDS, frozen)
        begun = best.whole(problem, named)
        with_it, without = weigh(begun.linear(problem), KNOWN, wider, [named, r.beside])
        if log_weight_of(replace(r, log_evidence=with_it.log_evidence), len(of_problem.ids)) <= least_weight:
            break
    mean, sd = with_it.averaged_mean * wider.scale, judgement.SIZE_SD_FACTOR * with_it.averaged_sd * wider.scale
    own = wider.mask((r.relative,))
    sizes = tuple(zip(mean[own].tolist(), sd[own].tolist(), strict=True))
    tense = {int(place[i]): value for i, value in wider.tense(best.theta).items() if place[i] >= 0}
    found = replace(r, log_evidence=with_it.log_evidence - best.predicted_decrease, sizes=sizes, tense=tense)
    return found, without.log_evidence


def _with_relatives(p: Prepared, relatives: Mapping[str, EffectSpec]) -> ForwardModel:
    """The rod's model of the states with further effects."""
    catalogue = {**p.forward.catalogue, **relatives}
    return ForwardModel(p.robot, p.forward.design, p.forward.area, catalogue, plane_direction=p.forward.plane_direction)


def _relatives(p: Prepared, forward: ForwardModel, c: Candidate) -> tuple[FitParameters, Array]:
    """The problem's parameters with those of the relatives that `forward` has beside the catalogue, as further effects, and the
    derivatives of the values by these at a candidate's fit, whitened, by one prior standard deviation of each."""
    problem, shown = p.problem, forward.catalogue.keys() - p.forward.catalogue.keys()
    fitted = dict(zip(problem.parameters.names, c.fit.theta.tolist(), strict=True))
    theta = np.array([fitted.get(info.name, 0.0) for info in forward.parameters])
    own = [i for i, info in enumerate(forward.parameters) if info.source in shown]
    slope = derivatives(forward, theta, own)[1].whole[p.kept]
    known, made = problem.parameters, parameters(tuple(forward.parameters[i] for i in own))
    of_fit = c.fit.derivatives(problem).every.coloured(problem.noise, known.sd)
    least = least_sizes(made, slope, known, of_fit, p.labels, p.noise_floor)
    wider = replace(known, infos=known.infos + made.infos, sd=np.append(known.sd, made.sd), least=known.least + least)
    return wider, problem.noise.whiten(slope * made.sd)
