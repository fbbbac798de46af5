"""How much of the gap each effect carries, in m, and which effects are named.

With d_e the change of the readings by effect e, and N their response to what every lab calibrates (area factors),
the effect carries

    c_e = rms over states of  d_e - N (N^T N)^-1 N^T d_e        (m)

so an effect gets no credit for what a calibration absorbs. All effects count, those within their tolerance as well:
a tolerance that carries more than any named effect is the cause. c_e is drawn from the posterior over hypotheses and sizes,
d_e linear about each hypothesis' fit; at the fit it is that of the model itself where the effect carries a noise floor. In
each draw the largest carrier is named, if it carries at least one noise floor where the hypothesis names it, else two; with
it each that carries as many and 0.4 as much, if the hypothesis names it or it has the least size of a named effect. (With two
effects of one size a hypothesis of one of them takes the other for a tolerance, as the prior of a pair is small.) Else none is
named. The answer is the effect that is named in most draws, with those that are named together with it in two thirds of all;
each draw that names all of the answer counts for it, whatever else it names.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtri

from ..arrays import Array, Ints, Mask
from ..judgement import COMPARABLE, LEAST_DRAWN, LEAST_NAMED_FLOORS, LEAST_NAMED_SIZE, LEAST_SECOND, OUTSTANDING_FLOORS, TOGETHER
from .candidate import Candidate
from .evidence import KNOWN, NONE, Hypothesis
from .executor import Executor
from .fit import Fit
from .jacobian import Columns
from .posterior import EffectPosterior, posterior, shares
from .problem import FitParameters, Problem
from .search import Search

DEVIATES = ndtri((np.arange(15) + 0.5) / 15)
"""Equally probable standard normal deviates of the logarithm of the gap that another form of a law carries."""
DRAWS, SEED = 256, 11
"""Of each hypothesis."""
JITTER, TINY = 1e-8, 1e-300
"""Added to the diagonal of correlations, which may be singular; least variance."""
Products = dict[str, Array]
"""See `_squares`."""


class Naming(NamedTuple):
    """When draws name an effect."""

    comparable: float = COMPARABLE
    """Share of what the largest effect carries that another of no small size must carry to be named with it."""
    outstanding: float = OUTSTANDING_FLOORS
    """Noise floors that an effect must carry to be named although no hypothesis names it."""


USUAL = Naming()


@dataclass(frozen=True)
class Budget:
    """Draws of what effects carry, from the posterior over hypotheses and their sizes."""

    effects: tuple[str, ...]
    metres: Array
    """(d, e) rms of the tip; of stiffness trials alone, of the deflection."""
    floors: Array
    """(d, e) the same in noise floors, of tip or deflection, whichever is larger."""
    weight: Array
    """(d,) probability of each draw; they sum to one."""
    form_error: Array
    """(d,) possible relative error of the laws: from the data where no other effect is free to absorb it, else the largest
    (decision 070)."""
    tolerant: Mask
    """(d,) whether other effects are free within their tolerances, and may hide errors of a law."""
    law_error: dict[str, float]
    """By effect, its law's part of that error where nothing hides it."""
    names: Mask
    """(d, e) which effects each draw names."""

    @property
    def nothing_stands_out(self) -> float:
        """Probability that no effect carries `OUTSTANDING_FLOORS`."""
        return float(self.weight[(self.floors < OUTSTANDING_FLOORS).all(axis=1)].sum())

    def second(self, answer: Hypothesis) -> dict[str, float]:
        """Effects named together with an answer, and their conditional probabilities, largest first: where one of them
        probably acts but none by itself is probable."""
        answered = np.isin(self.effects, answer)
        held = self.weight * self.names[:, answered].all(axis=1)
        named = self.names & ~answered
        any_other, each = float(held @ named.any(axis=1)), held @ named
        if any_other <= TOGETHER * held.sum():
            return {}
        listed = [i for i in np.argsort(-each).tolist() if each[i] > LEAST_SECOND * held.sum()]
        return {self.effects[i]: float(each[i] / held.sum()) for i in listed}

    def interval(self, effect: str, *quantiles: float) -> tuple[float, ...]:
        """Quantiles (m) of the gap an effect carries, the possible error of its law included."""
        share = np.where(self.tolerant, 1.0, self.law_error[effect])
        laws = np.exp(np.outer(share * self.form_error, DEVIATES))
        carried = (self.metres[:, self.effects.index(effect), None] * laws).ravel()
        weight = np.repeat(self.weight, DEVIATES.size)
        return tuple(np.quantile(carried, quantiles, weights=weight, method="inverted_cdf").tolist())


@dataclass(frozen=True)
class BudgetPart:
    """Values in which effects carry the gap: tips, or the forces of stiffness trials."""

    rows: Ints
    unit: Array
    """(r,) m for one unit of each value: 1 for tips, 1 / stiffness for forces."""
    floor: float
    """m, their noise floor."""
    states: int


def after_calibration(problem: Problem, where: Sequence[BudgetPart], slope: Columns, columns: Array) -> list[Array]:
    """d - N (N^T N)^-1 N^T d (r, c) in m, for tips and for forces: d columns (n, c), N those of calibration in `slope` (n, k)."""
    return [
        problem.parameters.beyond_calibration(columns[part.rows], slope.rows(part.rows), part.unit[:, None]) for part in where
    ]


def budget(problem: Problem, where: Sequence[BudgetPart], candidates: Sequence[Candidate], naming: Naming) -> Budget:
    """Draw the gap that effects carry, `DRAWS` times from each candidate of some weight; `where`: values in which they carry
    it; `naming`: when they are named."""
    p = problem.parameters
    half = np.random.default_rng(SEED).standard_normal((DRAWS // 2, len(p.scale)))
    standard = np.vstack([half, -half])  # in pairs, so that their mean is exact
    squares: dict[int, list[Products]] = {}  # by fit, which many candidates share
    least_size = np.where(p.members > 0, p.least_named[:, None], np.inf).min(axis=0) if p.narrow else LEAST_NAMED_SIZE
    draws: list[tuple[Any, ...]] = []
    for c, w in zip(candidates, shares(candidates, len(p.ids)).tolist(), strict=True):
        if w < LEAST_DRAWN:
            continue
        sd = np.sqrt(np.maximum(np.diag(c.weighed.covariance), TINY))
        # by the triangular factor, which is less sensitive to rounding than eigenvectors
        factor = np.linalg.cholesky(c.weighed.covariance / np.outer(sd, sd) + JITTER * np.eye(len(sd)))
        drawn = np.clip(c.weighed.mean + standard @ factor.T * sd, p.low, p.high)
        if id(c.fit) not in squares:
            squares[id(c.fit)] = _squares(problem, where, c.fit)
        in_metres, in_floors = _carried(p, where, squares[id(c.fit)], drawn - c.fit.theta[p.of_effect] / p.scale)
        size = np.sqrt(np.where(p.sizes, drawn, 0.0) ** 2 @ p.members)
        tolerant = c.weighed.peak.spike > 0.0
        form_error = float(KNOWN.form_errors.max()) if tolerant else c.weighed.peak.form_error
        names = _names(in_floors, size >= least_size, np.isin(p.ids, c.named), naming)
        draws.append((in_metres, in_floors, names, *(np.full(DRAWS, x) for x in (w / DRAWS, form_error, tolerant))))
    metres, floors, named, weight, law_errors, tolerances = map(np.concatenate, zip(*draws, strict=True))
    return Budget(p.ids, metres, floors, weight / weight.sum(), law_errors, tolerances, p.law_error, named)


def by_what_is_carried(b: Budget, known: EffectPosterior) -> EffectPosterior:
    """Probabilities of the answers; `known` over the hypotheses, whose candidates also stand for the answers."""
    answer = _answer(b)
    probability: dict[Hypothesis, float] = {NONE: 0.0}
    sets, member = np.unique(b.names, axis=0, return_inverse=True)
    for in_draw, w in zip(sets.tolist(), np.bincount(member.ravel(), b.weight).tolist(), strict=True):
        named = tuple(e for e, chosen in zip(b.effects, in_draw, strict=True) if chosen)
        counted = answer if answer and set(answer) <= set(named) else named
        probability[counted] = probability.get(counted, 0.0) + w
    candidates = dict(known.candidates)
    for h in probability:
        if h not in candidates:  # never weighed alone: the most probable candidate that holds all of it, or any
            fitting = [k for k, _ in known.ranking if set(h) <= set(k)] or [known.ranking[0][0]]
            candidates[h] = known.candidates[fitting[0]]
    return EffectPosterior(tuple(sorted(probability.items(), key=lambda entry: -entry[1])), candidates)


def _answer(b: Budget) -> Hypothesis:
    """The effect named in most draws, and those named together with it; none where that is more probable."""
    chosen, share, least = list[int](), b.weight @ b.names, float(b.weight @ ~b.names.any(axis=1))
    while share.max() > least:
        chosen.append(int(share.argmax()))
        share, least = (b.weight * b.names[:, chosen].all(axis=1)) @ b.names, TOGETHER
        share[chosen] = 0.0
    return tuple(b.effects[i] for i in sorted(chosen))


def _names(floors: Array, large: Mask, own: Mask, naming: Naming) -> Mask:
    """(d, e) which effects draws name, of floors they carry (d, e), whether they are of no small size (d, e) and their
    hypothesis' own (e,)."""
    least, draws, largest = np.where(own, LEAST_NAMED_FLOORS, naming.outstanding), np.arange(len(floors)), floors.argmax(axis=1)
    most = floors[draws, largest]
    share = np.where(large, naming.comparable, COMPARABLE)
    named = (floors >= np.maximum(least, share * most[:, None])) & (own | large)
    named[draws, largest] = True
    named[most < least[largest]] = False
    return np.asarray(named)


@dataclass(frozen=True)
class WeighedCauses:
    """Hypotheses of the catalogue, ranked twice: `whole` by their evidence, `known` by what their effects carry of the gap (see
    the top of the file), which is the answer once something outside the catalogue is weighed too."""

    search: Search
    whole: EffectPosterior
    known: EffectPosterior
    budget: Budget
    leading: Candidate
    """The first of `whole`, with all derivatives."""
    best: Candidate
    """The first of `known`, with all derivatives."""


def weighed(
    problem: Problem, where: Sequence[BudgetPart], executor: Executor, begun: Sequence[tuple[Hypothesis, Array]] = (),
    naming: Naming = USUAL, beyond: Callable[[Search], Sequence[Candidate]] = lambda _: (),
) -> WeighedCauses:  # fmt: skip
    """Search the hypotheses of a problem and rank them; `where` effects carry the gap, `begun`: see `Search.run`; `beyond`
    returns hypotheses that the search does not follow."""
    search = Search(problem, executor=executor)
    within = search.run(begun)
    more = beyond(search)
    whole = posterior([*within, *more], len(problem.parameters.ids))
    carried = budget(problem, where, [*search.tried, *more], naming)
    known = by_what_is_carried(carried, whole)
    first, answer = (k.candidates[k.ranking[0][0]] for k in (whole, known))
    leading = best = search.with_all_derivatives(first)
    if answer is not first:
        best = search.with_all_derivatives(search.searched_beside(first, answer))
    return WeighedCauses(search, whole, known, carried, leading, best)


def _carried(p: FitParameters, where: Sequence[BudgetPart], squares: Sequence[Products], change: Array) -> tuple[Array, Array]:
    """c_e (d, e) in m and in noise floors, with d_e linear in the effect's parameters about a fit (`_squares`), from which they
    have moved by `change` (d, p) in units of the effects' scales."""
    moved = {e: np.column_stack([change[:, p.mask((e,))], np.ones(len(change))]) for e in p.ids}
    squared = ([((x @ products[e]) * x).sum(axis=1) for e, x in moved.items()] for products in squares)
    by_part = [np.sqrt(np.maximum(np.column_stack(of_effects), 0.0)) for of_effects in squared]
    return by_part[0], np.max([m / part.floor for m, part in zip(by_part, where, strict=True)], axis=0)


def _squares(problem: Problem, where: Sequence[BudgetPart], fit: Fit) -> list[Products]:
    """For tips and for forces: effect -> M (m + 1, m + 1) in m^2, with which c_e^2 = x^T M x for x = (change of its m parameters
    since the fit, 1): mean products of its columns, and of d_e at the fit, after calibration. d_e is the effect's slope times its
    size; where that exceeds `LEAST_NAMED_FLOORS` noise floors, the difference of the model with and without the effect."""
    p = problem.parameters
    responses = {} if fit.form_error is None else dict(fit.form_error.responses)
    slope, theta = fit.derivatives(problem).every.coloured(problem.noise, p.sd), fit.theta[p.of_effect]
    of_effects, slots = slope.take(p.of_effect).whole, {e: np.flatnonzero(p.mask((e,))) for e in p.ids}
    changes = {e: responses.get(e, of_effects[:, i] @ theta[i]) for e, i in slots.items()}

    def changed() -> list[Array]:
        return after_calibration(problem, where, slope, np.column_stack(list(changes.values())))

    least = [part.states * (LEAST_NAMED_FLOORS * part.floor) ** 2 for part in where]
    large = np.any([(x**2).sum(axis=0) > squares for x, squares in zip(changed(), least, strict=True)], axis=0)
    for effect in (e for e, one in zip(p.ids, large, strict=True) if one and e not in responses):
        # Even a soft stop holds the tip: its effect is not its slope times its size.
        response = problem.response(fit.theta, fit.predicted, effect)
        if np.isfinite(response).all():
            changes[effect] = response
    products: list[Products] = []
    sized = after_calibration(problem, where, slope, of_effects * p.scale)
    for part, by_size, by_effect in zip(where, sized, changed(), strict=True):
        of = {e: np.column_stack([by_size[:, slots[e]], change]) for e, change in zip(changes, by_effect.T, strict=True)}
        products.append({e: x.T @ x / part.states for e, x in of.items()})
    return products
