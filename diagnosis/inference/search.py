"""Which hypotheses are tried, and where each is linearised: one best-first search.

Effects are not linear at full size, so the evidence of each hypothesis is taken in the linear problem around its own most
probable point: twice, with all other effects absent and with all other effects free within their tolerances, whose most
probable points can lie far apart. The two evidences are added.

A queue holds points at which hypotheses are weighed and from which they can be searched. The promise of a point is the log
evidence of its linear problem plus, in the same units, the logarithm of the prior. First the single effects are weighed around
none, or at their starts where they are not linear there. Then the searches of the most promising points continue, some in
parallel. Where a leading search has converged, its neighbours (one effect more, one less, one exchanged, tolerances on or off)
are weighed in its linear problem and join the queue. A point whose promise falls short of the best hypothesis by more than a
margin is dropped; the search ends when none remains. Without tolerances effects are also added one by one, each time
the one that makes the data most probable (forward selection), regardless of the margin: with tolerances, these replace a
second effect, and neither of two effects alone promises anything.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from scipy.special import logsumexp

from .. import judgement
from ..arrays import Array
from .candidate import Bases, Candidate, complete, light
from .evidence import KNOWN, NONE, Hypothesis, weigh
from .executor import SINGLE_THREAD, DiagnosisStep, Executor
from .fit import LEAST_PROMISE, WRITTEN_PROMISE, Fit, fit
from .jacobian import Jacobian
from .linear import Linear
from .posterior import hypothesis_prior
from .problem import FitParameters, FormError, Problem, derivatives

Key = tuple[Hypothesis, bool]
"""A hypothesis, and whether all other effects are free within their tolerances."""

FIRST_ROUNDS, ROUNDS, LAST_ROUNDS, FEW_OWN = 2, 4, 30, 8
"""Steps of a search from a new point, which recomputes the derivatives by named effects only; steps of each further search, with
all derivatives; most steps of a hypothesis that is searched by itself; derivatives of its own that one may keep to be drawn."""

UNKEPT, MOST_UNKEPT = 1e5, 4
"""Log evidence by which a search may fall short of what its linear problem promised, and searches in a row that may, until none
is followed: near a robot that snaps to other equilibria no linear problem holds, and each search takes seconds."""


class Standing(NamedTuple):
    """Progress of a search: sent with each candidate to other processes, which hold the search as it began."""

    best: float = -np.inf
    """Log evidence, with that of the prior, of the best hypothesis reached."""
    searched: frozenset[Key] = frozenset()
    alone: Mapping[int, float] = {}
    """By number of effects: log evidence of the best hypothesis reached without tolerances."""


_evidence = attrgetter("log_evidence")


class Search:
    """Searches the hypotheses of one problem, keeping what it has found."""

    def __init__(self, problem: Problem, executor: Executor = SINGLE_THREAD) -> None:
        self.problem, self._executor = problem, executor
        self._tried: dict[Key, Candidate] = {}
        self._queue: list[Candidate] = []
        self._promised: dict[Key, float] = {}
        self._none: dict[bool, Candidate] = {}
        self._standing = Standing()
        self._calibrated(False)

    def __getstate__(self) -> dict[str, Any]:
        """Pickled without earlier candidates."""
        return vars(self) | {"_tried": {}, "_queue": [], "_promised": {}}

    def _calibrated(self, with_tolerances: bool) -> Candidate:
        """None, without tolerances or with them, around which the search begins; fitted once."""
        if with_tolerances not in self._none:
            size, start = judgement.FIT_DISCREPANCY_SIZE, np.zeros_like(self.problem.parameters.sd)
            if with_tolerances:
                tolerant = self._weigh(NONE, self.fit(NONE, True, size, self._calibrated(False).fit, 3), True)
                none = self.fit(NONE, True, tolerant.weighed.peak.size, tolerant.fit, 5).with_form_error(self.problem, NONE)
            else:
                none = self.fit(NONE, False, size, start, 4).whole(self.problem, NONE)
            (found,) = self.around(self._as_reference(none), [NONE], with_tolerances)
            self._none[with_tolerances] = replace(found, turns=1, ended=True)
            self._add([self._none[with_tolerances]])
        return self._none[with_tolerances]

    @property
    def found(self) -> dict[Hypothesis, Candidate]:
        """All hypotheses weighed; each stands with its better fit and the evidence of both."""
        out: dict[Hypothesis, Candidate] = {}
        for named in dict.fromkeys(h for h, _ in self._tried):
            both = [c for w in (False, True) if (c := self._tried.get((named, w))) is not None]
            best = max(both, key=_evidence)
            total = float(logsumexp([c.log_evidence for c in both]))
            out[named] = replace(best, weighed=replace(best.weighed, log_evidence=total + best.fit.predicted_decrease))
        return out

    @property
    def tried(self) -> list[Candidate]:
        """All hypotheses weighed, without tolerances and with them each by itself."""
        return list(self._tried.values())

    def run(self, begun: Sequence[tuple[Hypothesis, Array]] = ()) -> list[Candidate]:
        """All candidates of the catalogue, most probable data first; some are `begun` at parameters (k,) of their own, too."""
        self._calibrated(True)
        first = self._first()
        first += [self._to_the_end(named, False, judgement.FIT_DISCREPANCY_SIZE, theta) for named, theta in begun]
        self._add(first)
        self._queue = first  # all of them: `_add` queues only starts that are better than the earlier ones of a hypothesis
        self._search()
        return sorted(self.found.values(), key=lambda c: -c.log_evidence)

    def _search(self) -> None:
        searched, share, taken_apart, unkept = 0, 0.0, set[Key](), 0
        while unkept < MOST_UNKEPT:
            do, chosen = self._searched_on, self._most_promising()
            if not chosen:
                best = max(self._tried.values(), key=_evidence)
                if len(best.named) < 2 or (best.named, best.with_tolerances) in taken_apart:
                    break
                taken_apart.add((best.named, best.with_tolerances))
                do, chosen = self._taken_apart, [best]
            for begun, found in zip(chosen, self._map(do, chosen), strict=True):
                self._add(found)
                unkept = unkept + 1 if begun.weighed.log_evidence - found[0].log_evidence > UNKEPT else 0
            searched += len(chosen)
            share = max(share, searched / (searched + len(self._queue) + 1))
            self._executor.progress(str(DiagnosisStep.HYPOTHESES), share)
        self._executor.progress(str(DiagnosisStep.HYPOTHESES), 1.0)

    def _first(self) -> list[Candidate]:
        """Every single effect around none, with and without tolerances; those that are not linear at each of their starts."""
        out, at_starts = [], []
        p = self.problem.parameters
        near = max(map(_evidence, self._none.values())) - judgement.SEARCH_MARGIN
        for c in (c for w, none in self._none.items() for c in self.around(none.fit, [(e,) for e in p.ids], w)):
            own_starts = needs_own(p, c.named)
            # with tolerances, none may have moved to where the effect acts, and then promises more
            if not own_starts or c.log_evidence > self._none[c.with_tolerances].log_evidence + judgement.UNCONVERGED:
                out.append(c)
            both = not p.tolerable[p.mask(c.named)].any()
            if own_starts and (both or self._none[c.with_tolerances].log_evidence > near):
                at_starts.append(c)
        return [*out, *itertools.chain(*self._map(self._at_starts, at_starts, DiagnosisStep.FIRST_LOOK))]

    def _at_starts(self, c: Candidate) -> list[Candidate]:
        """A hypothesis that was weighed around none in the linear problems of its starts: no step taken."""
        points = starts(self.problem.parameters, c.named, c.fit)
        begun = (self.fit(c.named, c.with_tolerances, c.weighed.peak.size, start, 0, c.base) for start in points)
        return [self._weigh(c.named, there, c.with_tolerances, shared=True) for there in begun]

    # ------------------------------------------------------------------ the queue

    def _log_prior(self, named: Hypothesis) -> float:
        """In units of log evidence."""
        return judgement.TEMPERATURE * float(np.log(hypothesis_prior(named, len(self.problem.parameters.ids))))

    def _margin(self, c: Candidate) -> float:
        """How far below the best hypothesis a point may lie and still win with one more effect."""
        more = (*c.named, "")
        if not c.turns or len(more) not in judgement.PRIOR_OF_NUMBER or len(c.named) == len(self.problem.parameters.ids):
            return judgement.SEARCH_MARGIN
        return judgement.SEARCH_MARGIN - self._log_prior(c.named) + self._log_prior(more)

    def _add(self, found: Iterable[Candidate]) -> None:
        """Keep the best of each hypothesis, and queue what is new or more probable by a factor e than any before."""
        for c in found:
            key = c.named, c.with_tolerances
            known, promised = self._tried.get(key), self._promised.get(key, -np.inf)
            if known is None or (c.turns > 0, c.log_evidence) > (known.turns > 0, known.log_evidence):
                self._tried[key] = c
            self._promised[key] = max(promised, c.weighed.log_evidence)
            if not c.ended and (c.turns or c.weighed.log_evidence > promised + judgement.TEMPERATURE):
                self._queue.append(c)

    def _most_promising(self) -> list[Candidate]:
        """Take the next points from the queue, one of each hypothesis; drop those that promise less than what was reached."""
        searched = {key: c for key, c in self._tried.items() if c.turns}
        best = max(c.log_evidence + self._log_prior(c.named) for c in searched.values())
        alone = {len(c.named): c.log_evidence for c in sorted(searched.values(), key=_evidence) if not c.with_tolerances}
        self._standing = Standing(best, frozenset(searched), alone)

        def promise(c: Candidate) -> float:
            return c.weighed.log_evidence + self._log_prior(c.named)

        def worth_it(c: Candidate) -> bool:
            known = searched.get((c.named, c.with_tolerances))
            gains = known is None or known is c or c.weighed.log_evidence > known.log_evidence + judgement.UNCONVERGED
            return gains and (promise(c) > best - self._margin(c) or self._first_alone(c, c.weighed.log_evidence))

        self._queue = sorted(filter(worth_it, self._queue), key=promise, reverse=True)
        best_of_each = {(c.named, c.with_tolerances): c for c in reversed(self._queue)}
        chosen = sorted(best_of_each.values(), key=promise, reverse=True)[: judgement.SEARCHED_AT_ONCE]
        self._forget_derivatives()
        self._queue = [c for c in self._queue if not any(c is x for x in chosen)]
        return chosen

    def _forget_derivatives(self) -> None:
        """Drop the derivatives of what has ended or is behind, a few only where no draw of the budget will need them: in a large
        campaign they take most memory."""
        waiting = {id(c) for c in self._queue}
        for key, c in ((key, c) for key, c in self._tried.items() if id(c) not in waiting):
            behind = self._standing.best - c.log_evidence - self._log_prior(c.named)
            drawn = behind < -judgement.TEMPERATURE * np.log(judgement.LEAST_DRAWN)
            few = c.fit.slope is not None and c.fit.slope.at.size <= FEW_OWN
            if (c.ended or behind > judgement.SEARCH_MARGIN) and not (drawn and few):
                self._tried[key] = replace(c, fit=replace(c.fit, slope=None))

    # ------------------------------------------------------------------ one point

    def _searched_on(self, c: Candidate) -> list[Candidate]:
        """Continue a search from a point; add its neighbours once it has converged and leads."""
        turned = self._turn(c)
        if not turned.ended:
            return [turned]
        if not self._leads(turned):
            more = self._with_one_more(turned.named) if self._first_alone(turned, turned.log_evidence) else []
            return [turned, *self.around(self._whole(turned), more, turned.with_tolerances)] if more else [turned]
        extended, switched, *others = self._next_to(turned)
        if (c.named, switched.with_tolerances) in self._standing.searched:
            return [extended, switched, *others]
        points = [switched]
        if len(c.named) == 1 and needs_own(self.problem.parameters, c.named):
            none = self._calibrated(switched.with_tolerances).fit
            points += self._at_starts(*self.around(none, [c.named], switched.with_tolerances))
        return [extended, *map(self._turn, points), *others]

    def _taken_apart(self, c: Candidate) -> list[Candidate]:
        """A hypothesis of several effects, and those that name one less, searched from its fit: from there one of them may
        explain alone what seemed to take several."""
        out, start = [], c.fit.theta
        for named in (c.named, *itertools.combinations(c.named, len(c.named) - 1)):
            out.append(replace(self._to_the_end(named, c.with_tolerances, c.weighed.peak.size, start), turns=1))
            start = out[0].fit.theta
        return out

    def _first_alone(self, c: Candidate, log_evidence: float) -> bool:
        """Whether this would be the best that was reached without tolerances by as many effects."""
        return not c.with_tolerances and log_evidence >= self._standing.alone.get(len(c.named), -np.inf)

    def _leads(self, c: Candidate) -> bool:
        """Whether a hypothesis lies within the margin for further search."""
        return c.log_evidence + self._log_prior(c.named) > self._standing.best - self._margin(c)

    def _turn(self, c: Candidate) -> Candidate:
        """Continue the search of a hypothesis, first keeping the derivatives by effects that are not named, later recomputing
        all; and whether it has converged: evidence rises by less than `UNCONVERGED`, or the linear problem promises no more."""
        start: Array | Fit = c.fit
        rounds, frozen = (ROUNDS, None) if c.turns else (FIRST_ROUNDS, c.base)
        if c.turns and c.base is not None:
            start = c.fit.theta  # all derivatives are recomputed
        elif not c.turns and far(self.problem, c.fit.predicted, self._calibrated(c.with_tolerances).fit):
            # Far from where it was calibrated the robot needs another calibration and other derivatives first.
            start, rounds, frozen = recalibrated(self.problem, c.fit.theta), ROUNDS, None
        fitted = self.fit(c.named, c.with_tolerances, c.weighed.peak.size, start, rounds, frozen)
        weighed = self._weigh(c.named, fitted, c.with_tolerances, shared=frozen is not None)
        # where no step leads to a prediction, both are minus infinity
        stalled = c.turns > 0 and not weighed.log_evidence - c.log_evidence >= judgement.UNCONVERGED
        weighed = replace(max(c, weighed, key=_evidence) if c.turns else weighed, turns=c.turns + 1)
        # A leading one recomputes all derivatives, with the most probable size of its discrepancy.
        settled = not self._leads(weighed) or (frozen is None and weighed.weighed.peak.size == c.weighed.peak.size)
        converged = weighed.fit.predicted_decrease <= judgement.UNCONVERGED and settled
        return replace(weighed, ended=stalled or converged)

    def _next_to(self, c: Candidate) -> list[Candidate]:
        """A candidate's neighbours by one effect more, less or exchanged, or by tolerances, weighed where it was fitted."""
        here = self._whole(c)
        linear = here.linear(self.problem)
        own, *more = self.around(here, [c.named, *self._with_one_more(c.named)], c.with_tolerances, linear)
        out = [replace(own, turns=c.turns, ended=True), *self.around(here, [c.named], not c.with_tolerances, linear), *more]
        for taken in c.named:
            kept = tuple(e for e in c.named if e != taken)
            exchanged = [h for h in self._with_one_more(kept) if h != c.named]
            out += self.around(here.without_law(taken), [kept, *exchanged], c.with_tolerances)
        return out

    def _whole(self, c: Candidate) -> Fit:
        """The fit of a candidate with all derivatives, around which others are weighed."""
        return self._as_reference(c.fit.whole(self.problem, c.named))

    def _with_one_more(self, named: Hypothesis) -> list[Hypothesis]:
        """Hypotheses that name one effect more; none where the prior knows no such number."""
        ids = self.problem.parameters.ids
        if len(named) + 1 not in judgement.PRIOR_OF_NUMBER:
            return []
        return [tuple(sorted((*named, e), key=ids.index)) for e in ids if e not in named]

    def fitted(self, named: Hypothesis, more: Sequence[Array]) -> Candidate:
        """One hypothesis by itself, all other effects absent, searched to convergence from each of its starts and from `more`
        (k,) parameters, the first those of the robot calibrated without a discrepancy. Where a discrepancy takes up what a
        hypothesis misses, it is searched without one too: the evidence decides."""
        none = begun = self._none[False]
        if named:
            (here,) = self.around(none.fit, [named], False)
            begun = max((self._searched_on(c)[0] for c in self._at_starts(here)), key=_evidence)
        sizes = begun.weighed.peak.size, 0.0
        points: list[Array | Fit] = [begun.fit, *more]
        # a calibration is nearly linear: each size has one start
        each = itertools.product({*sizes}, points) if named or len(more) > 1 else zip(sizes, points, strict=True)
        ends = (self.fit(named, False, size, at, LAST_ROUNDS, least_promise=WRITTEN_PROMISE) for size, at in each)
        return max((self._weigh(named, end, False) for end in ends), key=_evidence)

    def with_all_derivatives(self, c: Candidate) -> Candidate:
        """The same candidate with derivatives by all parameters, those of absent effects included."""
        return replace(c, fit=c.fit.whole(self.problem, c.named))

    def alone(self, c: Candidate) -> Candidate:
        """The same hypothesis with all other effects absent, searched to convergence."""
        begun = self._tried.get((c.named, False), c)
        return self._to_the_end(c.named, False, begun.weighed.peak.size, begun.fit.theta)

    def searched_beside(self, leading: Candidate, answer: Candidate) -> Candidate:
        """An answer that was only weighed, searched from there and from the leading hypothesis, where it is a tolerance."""
        if answer.turns:
            return answer
        named, with_tolerances, size = answer.named, leading.with_tolerances, leading.weighed.peak.size
        ends = [self._to_the_end(named, with_tolerances, size, start.theta) for start in (answer.fit, leading.fit)]
        return max(ends, key=_evidence)

    def _to_the_end(self, named: Hypothesis, with_tolerances: bool, size: float, start: Array | Fit) -> Candidate:
        """A hypothesis searched by itself from a start, and weighed where that ends; `size` of its discrepancy."""
        return self._weigh(named, self.fit(named, with_tolerances, size, start, LAST_ROUNDS), with_tolerances)

    # ------------------------------------------------------------------ here or elsewhere

    def _map(
        self, do: Callable[[Candidate], list[Candidate]], begun: Iterable[Candidate], step: DiagnosisStep | None = None
    ) -> list[list[Candidate]]:
        """`do`, a method of this search, for every candidate, here or elsewhere."""
        begun = list(begun)
        sent = [(do.__name__, light(c, self._bases(None)), self._standing) for c in begun]
        found = self._executor.map(self._done, sent, step)
        return [[complete(c, self._bases(b)) for c in own] for b, own in zip(begun, found, strict=True)]

    def _done(self, sent: tuple[str, Candidate, Standing]) -> list[Candidate]:
        name, given, self._standing = sent
        begun = complete(given, self._bases(None))
        return [light(c, self._bases(begun)) for c in getattr(self, name)(begun)]

    def _bases(self, begun: Candidate | None) -> Bases:
        """Derivatives that this process and another one have: those of none, and of what a candidate was begun at."""
        every = {str(w): none for w, none in self._none.items()} | ({} if begun is None else {"begun": begun})
        return {name: c.base for name, c in every.items() if c.base is not None}

    def fit(
        self, named: Hypothesis, with_tolerances: bool, size: float, start: Array | Fit, rounds: int,
        frozen: Jacobian | None = None, least_promise: float = LEAST_PROMISE,
    ) -> Fit:  # fmt: skip
        """A hypothesis fitted from a start, with a discrepancy of this size; see `fit.fit`."""
        p = self.problem.parameters
        own = p.prior_of(named, judgement.FIT_TOLERATED_SIZE * with_tolerances)
        return fit(self.problem, own, size, start, rounds, frozen, least_promise)

    def _as_reference(self, f: Fit) -> Fit:
        """A fit that lends its derivatives and the model-form error of what is not named to hypotheses around it."""
        form_error, base = f.form_error, f.derivatives(self.problem).flat
        assert form_error is not None
        # with no response of the named effects, only columns for the laws of the others are made
        of_others = replace(f, slope=base, form_error=FormError(form_error.named, {})).linear(self.problem).form_error
        return replace(f, slope=replace(base, tolerated=of_others).shared, form_error=replace(form_error, shared=True))

    def around(self, f: Fit, named: Sequence[Hypothesis], with_tolerances: bool, linear: Linear | None = None) -> list[Candidate]:
        """Hypotheses in the linear problem of a fit that may have been made for another, `linear` where it is made already."""
        grid, parameters = KNOWN.part(with_tolerances), self.problem.parameters
        found = weigh(linear or f.linear(self.problem), grid, parameters, named) if named else []
        return [Candidate(h, w, f, with_tolerances) for h, w in zip(named, found, strict=True)]

    def _weigh(self, named: Hypothesis, fitted: Fit, with_tolerances: bool, shared: bool = False) -> Candidate:
        return self.around(fitted.with_form_error(self.problem, named, shared), [named], with_tolerances)[0]


# ------------------------------------------------------------------ where searches begin
def needs_own(p: FitParameters, named: Hypothesis) -> bool:
    """Whether an effect is one-sided, or has several starting points."""
    return any(p.lower[i] == 0 or len(p.infos[i].starts) > 1 for i, e in enumerate(p.effects) if e in named)


def starts(p: FitParameters, named: Hypothesis, none: Fit) -> list[Array | Fit]:
    """Where searches begin: the fit of none, or all combinations of the starts of what is named where it has several or is
    one-sided: at zero, where such an effect ends, the tolerances of the others could take its place."""
    if not needs_own(p, named):
        return [none]
    columns = [i for i, e in enumerate(p.effects) if e in named]
    values = np.array([*itertools.product(*(_start_values(p, i) for i in columns))])
    points = np.tile(none.theta, (len(values), 1))
    points[:, columns] = values
    return [*points]


def recalibrated(problem: Problem, start: Array) -> Array:
    """Parameters (k,) with those that are fitted in every model fitted to the data anew, all others as they are."""
    p, whiten = problem.parameters, problem.noise.whiten
    free = np.flatnonzero(p.calibration)
    if not free.size:
        return start
    theta, least_chi_square = start.copy(), np.inf
    for _ in range(8):
        predicted, slope = derivatives(problem.forward, theta, free.tolist())
        if not np.isfinite(predicted).all():
            theta[free] *= 0.5
            continue
        columns, residual = whiten(slope.whole * p.sd[free]), whiten(problem.observed - predicted)
        if least_chi_square - float(residual @ residual) < 0.01 * least_chi_square:
            break
        least_chi_square = float(residual @ residual)
        step = np.linalg.lstsq(columns, residual, rcond=None)[0]
        theta[free] = np.clip(theta[free] + p.sd[free] * step, p.lower[free], p.upper[free])
    return theta


def far(problem: Problem, predicted: Array, none: Fit) -> bool:
    """Whether a prediction (n,) is much further from the data than that of no effect, or has no equilibrium somewhere."""
    if not np.isfinite(predicted).all():
        return True
    there, here = (problem.noise.whiten(problem.observed - y) for y in (predicted, none.predicted))
    return float(there @ there) > judgement.FAR_START * float(here @ here)


def _start_values(p: FitParameters, i: int) -> tuple[float, ...]:
    """Values of a named effect's parameter to begin at."""
    given = p.infos[i].starts
    if p.infos[i].role == "shape":
        return given or (0.0,)
    return tuple(v for v in given if v) or (judgement.ONE_SIDED_START * float(p.sd[i]) if p.lower[i] == 0 else 0.0,)
