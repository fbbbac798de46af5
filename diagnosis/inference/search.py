"""Which hypotheses are tried, and where each is linearised: none, all single effects, guided pairs and triples.

Effects are not linear at full size, so the evidence of each hypothesis is taken in the linear problem around its own most
probable point: twice, with all other effects absent and with all other effects free within their tolerances, whose most
probable points can lie far apart. The two evidences are added. Screening is cheap: the leading single effects are tried with
two steps each; only the best of them are followed to the end. Pairs extend the leading singles, triples the leading pairs,
as long as the gain in evidence pays for the prior of one more effect.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from ..judgement import (
    CONVERGED_AT_ONCE,
    CONVERGED_SINGLES,
    CONVERGENCE_ROUNDS,
    COSTLY,
    DOMINATED,
    FEWEST_REFINED,
    FIT_DISCREPANCY_SIZE,
    FIT_TOLERATED_SIZE,
    FOLLOWED_MARGINS,
    LEADING_SINGLES,
    NEARLY_BEST,
    NEGLIGIBLE,
    NONE_MARGIN,
    PARENTS,
    PROMISE_MARGIN,
    PRUNED,
    REFINED_FIRST,
    REFINED_PAIRS,
    REFINED_TRIPLES,
    TRIPLES_GAIN,
    TRUSTED_DECREASE,
    UNCONVERGED,
)
from .candidate import (
    AMONG_AT_ONCE,
    AMONG_AT_STARTS,
    Candidate,
    References,
    Task,
    complete,
    first_look,
    light,
    without_derivatives,
)
from .evidence import KNOWN, LARGE, NONE, Hypothesis, weigh
from .executor import SINGLE_THREAD, DiagnosisStep, Executor
from .fit import Fit, fit
from .problem import FormError, Problem
from .slope import Reference, Slope
from .starts import Starts

Array = NDArray[np.float64]


def _evidence(c: Candidate) -> float:
    return c.log_evidence


def _promised(f: Fit) -> float:
    """Least cost that the linear problem around a fit promises."""
    return f.cost - f.predicted_decrease


class Search:
    """Searches the hypotheses of one problem, keeping what it has found."""

    def __init__(self, problem: Problem, executor: Executor = SINGLE_THREAD) -> None:
        self.problem, self._executor = problem, executor
        self._grids = {with_tolerances: KNOWN.part(with_tolerances) for with_tolerances in (False, True)}
        self._tried: dict[tuple[Hypothesis, bool], Candidate] = {}
        self._begin, self._best = Starts(problem), -np.inf
        self._references: References = {}
        self._none: dict[bool, Candidate] = {}
        calibrated = self._fit(NONE, False, FIT_DISCREPANCY_SIZE, problem.parameters.mean, 4)
        self._begin_at(self._with_all_derivatives(calibrated), False)
        at_once = self._weigh_around(self._none[False].fit, self._single, False)
        executor.first_look(first_look(at_once.values(), AMONG_AT_ONCE))
        fitted = self._weigh(NONE, self._fit(NONE, True, FIT_DISCREPANCY_SIZE, self._none[False].fit, 3), True)
        self._begin_at(self._fit(NONE, True, fitted.grid_point.size, fitted.fit, 5), True)

    def __getstate__(self) -> dict[str, Any]:
        """What a search elsewhere needs: nothing of what was tried."""
        return vars(self) | {"_tried": {}}

    def _begin_at(self, none: Fit, with_tolerances: bool) -> None:
        """Keep a fit of none, at which other searches begin; its derivatives are their reference."""
        alone = replace(none, form_error=FormError(NONE, {}))
        p = self.problem
        reference = Reference(none.derivatives(p).every, p.noise, p.parameters.sd, alone.linear(p).form_error)
        around = replace(none, slope=Slope.at_reference(reference), form_error=FormError(NONE, {}, shared=True))
        found = self._weigh_around(around, [NONE], with_tolerances)[NONE]
        self._references[with_tolerances], self._none[with_tolerances] = reference, found
        self._keep(found)

    @property
    def _single(self) -> list[Hypothesis]:
        return [(e,) for e in self.problem.parameters.ids]

    @property
    def found(self) -> dict[Hypothesis, Candidate]:
        """All hypotheses weighed; each stands with its better fit and the evidence of both."""
        out: dict[Hypothesis, Candidate] = {}
        for named in dict.fromkeys(h for h, _ in self._tried):
            both = [
                c for with_tolerances in (False, True) if (c := self._tried.get((named, with_tolerances))) is not None
            ]
            best = max(both, key=_evidence)
            total = float(logsumexp([c.log_evidence for c in both]))
            out[named] = replace(best, weighed=replace(best.weighed, log_evidence=total + best.fit.predicted_decrease))
        return out

    @property
    def tried(self) -> list[Candidate]:
        """All hypotheses weighed, without tolerances and with them each by itself."""
        return list(self._tried.values())

    def run(self) -> list[Candidate]:
        """All candidates of the catalogue, most probable data first."""
        singles = self._singles()
        pairs = self._extend(singles[:PARENTS], REFINED_PAIRS, DiagnosisStep.PAIRS)
        if pairs and pairs[0].log_evidence > singles[0].log_evidence + TRIPLES_GAIN:
            self._extend(pairs[:PARENTS], REFINED_TRIPLES, DiagnosisStep.TRIPLES)
        self._prune()
        self._finish()
        return sorted(self.found.values(), key=lambda c: -c.log_evidence)

    def unknown(self, leading: Sequence[Candidate], shares: Sequence[float], temperature: float) -> Candidate:
        """The hypothesis that something outside the catalogue is at work, beside any of the leading hypotheses.

        `shares` are the prior probabilities of the leading hypotheses: something unknown beside an effect is as much rarer
        than something unknown alone as the effect is than none. Evidence is divided by the temperature, shares are not.
        """
        tasks = [Task(c.named, begun=c) for c in leading]
        beside = [c for (c,) in self._map(self._with_large_discrepancy, tasks)]
        terms = np.array([c.laplace_log_evidence for c in beside]) / temperature + np.log(np.array(shares))
        i = int(np.argmax(terms))
        total = replace(beside[i].weighed, log_evidence=temperature * float(logsumexp(terms)))
        return replace(beside[i], weighed=total)

    def _with_large_discrepancy(self, task: Task) -> list[Candidate]:
        c = task.begun
        assert c is not None
        grid = LARGE.part(c.with_tolerances)
        (weighed,) = weigh(c.linear(self.problem), grid, self.problem.parameters, [c.named])
        return [replace(c, weighed=weighed, grid_point=weighed.peak(grid), unknown=True)]

    def fitted(self, named: Hypothesis) -> Candidate:
        """One hypothesis by itself, all other effects absent, searched from each of its starting points to the end."""
        begun = self._best_of_starts(named, False, ()) if named else self._none[False]
        return max(begun, self._refined(begun, 30), key=_evidence)

    def with_all_derivatives(self, c: Candidate) -> Candidate:
        """The same candidate with derivatives by all parameters, those of absent effects included, and its linear problem."""
        whole = self._with_form_error(c.named, self._with_all_derivatives(c.fit))
        return replace(c, fit=whole, made=whole.linear(self.problem))

    def leading_and_answer(self, leading: Candidate, answer: Candidate) -> tuple[Candidate, Candidate]:
        """Both with all derivatives; once where they are one."""
        whole = self.with_all_derivatives(leading)
        return whole, whole if answer is leading else self.with_all_derivatives(answer)

    def _map(
        self, do: Callable[[Task], list[Candidate]], tasks: Sequence[Task], step: DiagnosisStep | None = None
    ) -> list[list[Candidate]]:
        """`do`, a method of this search, for every task, here or elsewhere."""
        sent = [
            (do.__name__, t if t.begun is None else replace(t, begun=light(t.begun, self._references))) for t in tasks
        ]
        return [[complete(c, self._references) for c in found] for found in self._executor.map(self._done, sent, step)]

    def _done(self, sent: tuple[str, Task]) -> list[Candidate]:
        name, task = sent
        begun = None if task.begun is None else complete(task.begun, self._references)
        return [light(c, self._references) for c in getattr(self, name)(replace(task, begun=begun))]

    def _singles(self) -> list[Candidate]:
        """Every single effect around the fit of none; the leading ones, and those not linear there, from starts of their own."""
        singles = self._single
        own_start = {h for h in singles if self._begin.needs_own(h)}
        here = {
            with_tolerances: self._weigh_around(self._none[with_tolerances].fit, singles, with_tolerances)
            for with_tolerances in (False, True)
        }
        leading = {
            h for c in here.values() for h in sorted(singles, key=lambda h: -c[h].log_evidence)[:LEADING_SINGLES]
        }
        alone = [h for h in singles if h in own_start]
        glances = self._map(self._glanced, [Task(h) for h in alone], DiagnosisStep.FIRST_LOOK)
        first = {(h, w): c for w in here for h, c in here[w].items()}
        first |= {(h, c.with_tolerances): c for h, both in zip(alone, glances, strict=True) for c in both}
        for c in first.values():
            self._keep(c)
        self._executor.first_look(first_look(first.values(), AMONG_AT_STARTS))
        followed = self._worth_following({k: c for k, c in first.items() if k[0] in own_start | leading})
        self._follow(followed[:REFINED_FIRST])
        self._follow(self._not_surpassed(followed[REFINED_FIRST:], first))
        best: list[Candidate] = []
        for with_tolerances in (False, True):
            own = sorted(
                (c for c in self._of(1) if c.with_tolerances == with_tolerances), key=lambda c: -c.laplace_log_evidence
            )
            best += [
                c for c in own[:CONVERGED_SINGLES] if c.laplace_log_evidence > max(map(_evidence, own)) - NEARLY_BEST
            ]
        tasks = [Task(c.named, begun=c) for c in best]
        for (c,) in self._map(self._refined_where_better, tasks, DiagnosisStep.SINGLE_EFFECTS):
            self._keep(c)
        return sorted(self._of(1), key=lambda c: -c.log_evidence)

    def _of(self, count: int) -> list[Candidate]:
        """What was tried of so many effects."""
        return [c for (named, _), c in self._tried.items() if len(named) == count]

    def _glanced(self, task: Task) -> list[Candidate]:
        """The best by evidence in the linear problem at its starting points, without and with tolerances: no step taken, and
        the errors of the laws of all that is not named as for none."""
        out = []
        for with_tolerances, none in self._none.items():
            begun = (
                self._fit(
                    task.named, with_tolerances, none.grid_point.size, start, 0, self._references[with_tolerances]
                )
                for start in self._begin.of(task.named, none.fit)
            )
            tried = [self._weigh(task.named, fitted, with_tolerances, shared=True) for fitted in begun]
            out.append(max(tried, key=lambda c: c.laplace_log_evidence))
        return out

    def _worth_following(self, first: Mapping[tuple[Hypothesis, bool], Candidate]) -> list[Task]:
        """Hypotheses that could still win, and whether without tolerances, with them or both.

        A linear problem says little of a point that is far away: the larger the decrease it predicts, the more its evidence
        may be surpassed.
        """
        top = max(c.laplace_log_evidence for c in first.values())
        kept: dict[Hypothesis, tuple[bool, ...]] = {}
        for with_tolerances in (False, True):
            own = {h: c for (h, w), c in first.items() if w == with_tolerances}
            if max(c.laplace_log_evidence for c in own.values()) < top - DOMINATED:
                continue
            ranked = sorted(own, key=lambda h: -own[h].laplace_log_evidence)
            for place, h in enumerate(ranked):
                margin = next(m for decrease, m in FOLLOWED_MARGINS if own[h].fit.predicted_decrease < decrease)
                if place < FEWEST_REFINED or own[h].laplace_log_evidence > top - margin:
                    kept[h] = (*kept.get(h, ()), with_tolerances)
        leading_first = sorted(kept, key=lambda h: -max(first[h, w].laplace_log_evidence for w in kept[h]))
        return [Task(h, kept[h]) for h in leading_first]

    def _follow(self, tasks: Sequence[Task]) -> None:
        for both in self._map(self._screened, tasks, DiagnosisStep.SINGLE_EFFECTS):
            for c in both:
                self._keep(c)

    def _not_surpassed(self, tasks: Sequence[Task], first: Mapping[tuple[Hypothesis, bool], Candidate]) -> list[Task]:
        """Those whose linear problem promises at least nearly what others have reached, or says little."""
        if max(map(_evidence, self._none.values())) > self._best - NONE_MARGIN:
            return list(tasks)

        def could_win(c: Candidate) -> bool:
            return c.laplace_log_evidence > self._best - PROMISE_MARGIN or c.fit.predicted_decrease > TRUSTED_DECREASE

        # A search with tolerances begins at what the one without them finds, too: both are done or none.
        return [t for t in tasks if any(could_win(first[t.named, w]) for w in t.with_tolerances)]

    def _screened(self, task: Task) -> list[Candidate]:
        """Two steps from each starting point; the best by evidence at the point reached, without and with tolerances."""
        out: list[Candidate] = []
        for with_tolerances in task.with_tolerances:
            out.append(self._best_of_starts(task.named, with_tolerances, [c.fit.theta for c in out]))
        return out

    def _best_of_starts(self, named: Hypothesis, with_tolerances: bool, more: Sequence[Array]) -> Candidate:
        """The best of what is reached from the usual starting points and some more.

        Those far from where the robot was calibrated cost most: where a search from one of `more` ends, they are left out.
        """
        none, reference = self._none[with_tolerances], self._references[with_tolerances]
        follow = partial(self._fit, named, with_tolerances, none.grid_point.size)
        close: list[Array | Fit] = []
        far: list[Array] = []
        for start in (*self._begin.of(named, none.fit), *more):
            if isinstance(start, Fit) or not self._begin.far(start, none.fit):
                close.append(start)
            else:
                far.append(start)
        tried = [follow(start, 2, reference) for start in close]
        if not (more and tried and min(tried, key=_promised).predicted_decrease <= UNCONVERGED):
            # Far from where it was calibrated the robot needs another calibration and other derivatives first.
            tried += [follow(self._begin.recalibrated(start), 4) for start in far]
        least = min(map(_promised, tried))
        could_be_best = [f for f in tried if _promised(f) <= least + COSTLY]
        return max((self._weigh(named, f, with_tolerances) for f in could_be_best), key=_evidence)

    def _refined(self, c: Candidate, rounds: int) -> Candidate:
        return self._weigh(
            c.named, self._fit(c.named, c.with_tolerances, c.grid_point.size, c.fit, rounds), c.with_tolerances
        )

    def _refined_where_better(self, task: Task) -> list[Candidate]:
        assert task.begun is not None
        return [max(task.begun, self._refined(task.begun, 4), key=_evidence)]

    def _refined_to_the_end(self, task: Task) -> list[Candidate]:
        assert task.begun is not None
        return [max(task.begun, self._refined(task.begun, 6), key=_evidence)]

    def _refined_in_two_rounds(self, task: Task) -> list[Candidate]:
        assert task.begun is not None
        return [self._refined(task.begun, 2)]

    def _extend(self, parents: Sequence[Candidate], follow: int, step: DiagnosisStep) -> list[Candidate]:
        """Each parent with one effect more: weighed where the parent was fitted, the leading ones followed."""
        extended: dict[tuple[Hypothesis, bool], Candidate] = {}
        around = self._map(self._with_one_more, [Task(c.named, begun=c) for c in parents])
        for c in itertools.chain.from_iterable(around):
            key = (c.named, c.with_tolerances)
            if key not in extended or extended[key].log_evidence < c.log_evidence:
                extended[key] = c
        if not extended:
            return []
        leading = sorted(extended.values(), key=lambda c: -c.laplace_log_evidence)
        tasks = [Task(c.named, begun=c) for c in leading[:follow]]
        refined = self._map(self._refined_in_two_rounds, tasks, step)
        followed = {(c.named, c.with_tolerances): c for (c,) in refined}
        # Those not followed are taken to lose as much as the median of those that were.
        typical = max(
            float(
                np.median(
                    [
                        c.laplace_log_evidence - followed[c.named, c.with_tolerances].laplace_log_evidence
                        for c in leading[:follow]
                    ]
                )
            ),
            0.0,
        )
        for c in leading:
            penalised = replace(c.weighed, log_evidence=c.laplace_log_evidence - typical)
            self._keep(followed.get((c.named, c.with_tolerances)) or replace(c, weighed=penalised))
        return sorted((self._tried[key] for key in extended), key=lambda c: -c.log_evidence)

    def _with_one_more(self, task: Task) -> list[Candidate]:
        """A candidate's effects and any other one, weighed where the candidate was fitted."""
        c = task.begun
        assert c is not None
        children = self._children(c)
        if not children:
            return []
        known = c.with_tolerances and c.fit.slope is not None
        around = self._with_form_error(c.named, c.fit if known else self._with_all_derivatives(c.fit))
        return list(self._weigh_around(around, children, c.with_tolerances).values())

    def _prune(self) -> None:
        """The leading hypothesis with one effect less, and the best of these with one less again, searched from where they were
        found: a search for fewer effects that began at none may have ended elsewhere."""
        tried: set[tuple[Hypothesis, bool]] = set()
        pruned: set[tuple[Hypothesis, bool]] = set()
        shorter: list[Candidate] = []
        for _ in range(PRUNED):
            leading = max(self._tried.values(), key=_evidence)
            left = [c for c in (leading, *shorter) if len(c.named) > 1 and (c.named, c.with_tolerances) not in pruned]
            if not left:
                return
            c = max(left, key=_evidence)
            pruned.add((c.named, c.with_tolerances))
            fewer = [(tuple(x for x in c.named if x != e), c.with_tolerances) for e in c.named]
            fresh = [Task(key[0], begun=c) for key in fewer if key not in tried]
            tried |= set(fewer)
            for (found,) in self._map(self._searched_from, fresh, DiagnosisStep.FEWER_EFFECTS):
                known = self._tried.get((found.named, found.with_tolerances))
                if known is None or found.log_evidence > known.log_evidence:
                    self._keep(found)
            shorter = [self._tried[key] for key in fewer]

    def _searched_from(self, task: Task) -> list[Candidate]:
        """Some of a candidate's effects, searched from where all of them were found."""
        named, c = task.named, task.begun
        assert c is not None
        found = self._fit(named, c.with_tolerances, c.grid_point.size, c.fit.theta, 6)
        return [self._weigh(named, found, c.with_tolerances)]

    def _finish(self) -> None:
        """Leading hypotheses whose search was cut short are searched to convergence, some of them in parallel."""
        for _ in range(CONVERGENCE_ROUNDS):
            best = max(map(_evidence, self._tried.values()))
            cut = [
                c
                for c in self._tried.values()
                if c.laplace_log_evidence > best - NEARLY_BEST and c.fit.predicted_decrease > UNCONVERGED
            ]
            if not cut:
                return
            leading = sorted(cut, key=lambda c: -c.laplace_log_evidence)[:CONVERGED_AT_ONCE]
            tasks = [Task(c.named, begun=c) for c in leading]
            for (reached,) in self._map(self._refined_to_the_end, tasks, DiagnosisStep.CONVERGENCE):
                # The decrease still predicted at the end is not counted again.
                weighed = replace(reached.weighed, log_evidence=reached.log_evidence)
                self._keep(replace(reached, weighed=weighed, fit=replace(reached.fit, predicted_decrease=0.0)))

    def _children(self, parent: Candidate) -> list[Hypothesis]:
        ids = self.problem.parameters.ids
        more: Iterable[str] = (e for e in ids if e not in parent.named)
        return [tuple(sorted((*parent.named, e), key=ids.index)) for e in more]

    def _fit(
        self,
        named: Hypothesis,
        with_tolerances: bool,
        size: float,
        start: Array | Fit,
        rounds: int,
        frozen: Reference | None = None,
    ) -> Fit:
        p = self.problem.parameters
        return fit(
            self.problem, p.prior(p.mask(named), FIT_TOLERATED_SIZE * with_tolerances), size, start, rounds, frozen
        )

    def _with_all_derivatives(self, f: Fit) -> Fit:
        """The same fit with the derivatives by all parameters."""
        predicted, slope = self.problem.linearise(f.theta)
        return replace(f, predicted=predicted, slope=Slope.of(slope))

    def _with_form_error(self, named: Hypothesis, f: Fit, shared: bool = False) -> Fit:
        return replace(f, form_error=self.problem.form_error(f.theta, f.predicted, named, shared))

    def _weigh_around(self, f: Fit, named: Sequence[Hypothesis], with_tolerances: bool) -> dict[Hypothesis, Candidate]:
        """Hypotheses in the linear problem of a fit that was made for another."""
        grid = self._grids[with_tolerances]
        found = weigh(f.linear(self.problem), grid, self.problem.parameters, named)
        return {h: Candidate(h, w, f, w.peak(grid), with_tolerances) for h, w in zip(named, found, strict=True)}

    def _weigh(self, named: Hypothesis, fitted: Fit, with_tolerances: bool, shared: bool = False) -> Candidate:
        return self._weigh_around(self._with_form_error(named, fitted, shared), [named], with_tolerances)[named]

    def _keep(self, c: Candidate) -> None:
        """What is far behind is kept without derivatives: of a large campaign they take most memory."""
        self._best = max(self._best, c.log_evidence)
        kept = c if c.log_evidence > self._best - NEGLIGIBLE else without_derivatives(c)
        self._tried[c.named, c.with_tolerances] = kept
