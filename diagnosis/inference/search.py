"""Which hypotheses are weighed, and where each is linearised: none, all single effects, guided pairs and triples.

Effects are not linear at full size, so each hypothesis is weighed in the linear problem around its own most probable
point; twice, because a robot that is otherwise perfect and one whose every other effect is a little off have their most
probable points far apart. The two evidences add up. Screening is cheap: the leading single effects are tried with two
steps each; only the best of them are followed to the end. Pairs grow from the leading singles, triples from the leading
pairs, as long as naming one more effect pays for its prior.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from .effort import ALONE, Effort
from .evidence import KNOWN, LARGE, NONE, Cell, Grid, Hypothesis, Weighed, weigh
from .fit import Fit, fit
from .linear import Prior
from .problem import Parameters, Problem

Array = NDArray[np.float64]

HELD, START_SIZE = 0.1, 0.25
"""Spike with which loose fits are made, and the discrepancy of the first of them."""


UNFINISHED = 0.5
"""A search that promises to lower the cost by more is not at its end."""


SINGLES, POLISHING, PAIRS, TRIPLES = (0.1, 0.6), (0.6, 0.65), (0.65, 0.73), (0.73, 0.77)
PRUNING, AFTER_SEARCH = (0.77, 0.81), 0.85
"""Shares of a whole diagnosis that are done before and after these parts of the search, by the clock."""
BEGIN = 0.6
"""Share of its scale at which the search for an effect that acts one way begins."""


@dataclass(frozen=True)
class Extent:
    """How far the search goes."""

    screen: int = 6
    """Singles, leading around none in each way, that are followed with most derivatives kept."""
    polish: int = 4
    """Leading singles, of each way, that are followed to their most probable point with all derivatives computed anew."""
    within: float = 8.0
    """Singles whose log evidence is further than this behind the best of their way are not followed."""
    parents: int = 4
    """Leading singles from which pairs grow, and leading pairs from which triples grow."""
    pairs: int = 5
    """Leading pairs that are followed."""
    triples: int = 2
    pruned: int = 3
    """Times the leading hypothesis is tried with one effect less."""
    finish: int = 8
    """Leading hypotheses that are searched to the end."""


@dataclass(frozen=True)
class Candidate:
    """A hypothesis with its evidence, and the fit around which it was weighed."""

    named: Hypothesis
    weighed: Weighed
    fit: Fit
    cell: Cell
    """The most probable point of the grid."""
    loose: bool
    """Fitted with every other effect free within its tolerance; else with all others absent."""
    unknown: bool = False

    def prior(self, p: Parameters) -> Prior:
        """Of the effects, at the most probable point of the grid, in the linear problem of the fit."""
        return p.prior(p.mask(self.named), self.cell.spike, self.fit.linear.reach)

    @property
    def promised(self) -> float:
        """Log evidence of the linear problem."""
        return self.weighed.log_evidence

    @property
    def log_evidence(self) -> float:
        """The same, less what the linear problem promises and the model did not hold."""
        return self.promised - self.fit.short


def _evidence(c: Candidate) -> float:
    return c.log_evidence


class Search:
    """Weighs hypotheses of one problem, keeping what it has found."""

    def __init__(
        self, problem: Problem, grid: Grid = KNOWN, extent: Extent | None = None, effort: Effort = ALONE
    ) -> None:
        self.problem, self.extent, self._effort = problem, extent or Extent(), effort
        self._grids = {loose: grid.part(loose) for loose in (False, True)}
        self._tried: dict[tuple[Hypothesis, bool], Candidate] = {}
        calibrated = self._fit(NONE, False, START_SIZE, problem.parameters.mean, 4)
        self._keep(self._weigh(NONE, self._whole(calibrated), False))
        fitted = self._weigh(NONE, self._fit(NONE, True, START_SIZE, self._tried[NONE, False].fit, 3), True)
        self._keep(self._weigh(NONE, self._fit(NONE, True, fitted.cell.size, fitted.fit, 5), True))

    @property
    def found(self) -> dict[Hypothesis, Candidate]:
        """All hypotheses weighed; each stands with its better fit and the evidence of both."""
        out: dict[Hypothesis, Candidate] = {}
        for named in dict.fromkeys(h for h, _ in self._tried):
            both = [c for loose in (False, True) if (c := self._tried.get((named, loose))) is not None]
            best = max(both, key=_evidence)
            total = float(logsumexp([c.log_evidence for c in both]))
            out[named] = replace(best, weighed=replace(best.weighed, log_evidence=total + best.fit.short))
        return out

    def run(self) -> list[Candidate]:
        """All candidates of the catalogue, most probable data first."""
        singles = self._singles()
        pairs = self._grow(singles[: self.extent.parents], self.extent.pairs, PAIRS)
        if pairs and pairs[0].log_evidence > singles[0].log_evidence + 2.0:
            self._grow(pairs[: self.extent.parents], self.extent.triples, TRIPLES)
        self._prune()
        self._finish()
        self._effort.told(AFTER_SEARCH)
        return sorted(self.found.values(), key=lambda c: -c.log_evidence)

    def unknown(self, leading: Sequence[Candidate], shares: Sequence[float], temperature: float) -> Candidate:
        """The hypothesis that something outside the catalogue is at work, beside any of the leading hypotheses.

        `shares` are the prior probabilities of the leading hypotheses: something unknown beside an effect is as much rarer
        than something unknown alone as the effect is than none. Evidence is divided by the temperature, shares are not.
        """
        p = self.problem.parameters
        beside = [weigh(c.fit.linear, LARGE.part(c.loose), p, [c.named])[0] for c in leading]
        terms = np.array([w.log_evidence for w in beside]) / temperature + np.log(np.array(shares))
        i = int(np.argmax(terms))
        total = replace(beside[i], log_evidence=temperature * float(logsumexp(terms)))
        c = leading[i]
        return replace(c, weighed=total, cell=beside[i].peak(LARGE.part(c.loose)), unknown=True)

    def whole(self, c: Candidate) -> Candidate:
        """The same candidate with derivatives by all parameters, those of absent effects included."""
        return replace(c, fit=self._loosened(c.named, self._whole(c.fit), c.loose))

    def _singles(self) -> list[Candidate]:
        """Every single effect weighed around none; what looks promising there, or cannot be judged there, followed."""
        p, extent = self.problem.parameters, self.extent
        singles: list[Hypothesis] = [(e,) for e in p.ids]
        curved = {h for h in singles if self._curved(h)}
        here = {loose: self._weigh_around(self._tried[NONE, loose].fit, singles, loose) for loose in (False, True)}
        leading = {h for c in here.values() for h in sorted(singles, key=lambda h: -c[h].log_evidence)[: extent.screen]}
        followed = [h for h in singles if h in curved | leading]
        screened = dict(zip(followed, self._effort.each(self._screened, followed, *SINGLES), strict=True))
        for h in singles:
            for c in screened.get(h) or (here[False][h], here[True][h]):
                self._keep(c)
        best: list[Candidate] = []
        for loose in (False, True):
            own = sorted((c for c in self._of(1) if c.loose == loose), key=lambda c: -c.promised)
            best += [c for c in own[: extent.polish] if c.promised > max(map(_evidence, own)) - extent.within]
        for c in self._effort.each(lambda c: max(c, self._polished(c, 4), key=_evidence), best, *POLISHING):
            self._keep(c)
        return sorted(self._of(1), key=lambda c: -c.log_evidence)

    def _of(self, count: int) -> list[Candidate]:
        """What was tried of so many effects."""
        return [c for (named, _), c in self._tried.items() if len(named) == count]

    def _curved(self, named: Hypothesis) -> bool:
        """Whether an effect acts one way only, or has several points to begin at."""
        p = self.problem.parameters
        own = [i for i, e in enumerate(p.effects) if e in named]
        return any(p.lower[i] == 0 or (bool(p.starts) and len(p.starts[i]) > 1) for i in own)

    def _screened(self, named: Hypothesis) -> tuple[Candidate, Candidate]:
        """Two steps from each starting point; the best by evidence at the point reached, without and with tolerances."""
        strict = self._leading(named, False, ())
        return strict, self._leading(named, True, [strict.fit.theta])

    def _leading(self, named: Hypothesis, loose: bool, more: Sequence[Array]) -> Candidate:
        """The best of what is reached from the usual starting points and some more."""
        none = self._tried[NONE, loose]
        tried = [
            self._weigh(named, self._fit(named, loose, none.cell.size, start, 2, none.fit), loose)
            for start in (*self._starts(named, none.fit), *more)
        ]
        return max(tried, key=_evidence)

    def _starts(self, named: Hypothesis, none: Fit) -> list[Array | Fit]:
        """Where a search begins: the fit of none; for an effect that acts one way only, well within its range instead.

        Around zero, where such an effect ends, the small errors allowed to all the others can take its place.
        """
        p = self.problem.parameters
        if not self._curved(named):
            return [none]
        own = [i for i, e in enumerate(p.effects) if e in named]
        points: list[Array | Fit] = []
        for values in itertools.product(*(self._begin(i) for i in own)):
            point = none.theta.copy()
            point[own] = values
            points.append(point)
        return points

    def _begin(self, i: int) -> tuple[float, ...]:
        """Values of a named effect's parameter to begin at."""
        p = self.problem.parameters
        given = p.starts[i] if p.starts else ()
        if p.shapes and p.shapes[i]:
            return given or (0.0,)
        return tuple(v for v in given if v) or (BEGIN * float(p.sd[i]) if p.lower[i] == 0 else 0.0,)

    def _polished(self, c: Candidate, rounds: int) -> Candidate:
        return self._weigh(c.named, self._fit(c.named, c.loose, c.cell.size, c.fit, rounds), c.loose)

    def _grow(self, parents: Sequence[Candidate], follow: int, shares: tuple[float, float]) -> list[Candidate]:
        """Each parent with one effect more: weighed where the parent was fitted, the leading ones followed."""
        grown: dict[tuple[Hypothesis, bool], Candidate] = {}
        for parent in parents:
            around = parent.fit if parent.loose else self._whole(parent.fit)
            loosened = self._loosened(parent.named, around, parent.loose)
            for named, c in self._weigh_around(loosened, self._children(parent), parent.loose).items():
                key = (named, parent.loose)
                if key not in grown or grown[key].log_evidence < c.log_evidence:
                    grown[key] = c
        leading = sorted(grown.values(), key=lambda c: -c.promised)
        polished = self._effort.each(lambda c: self._polished(c, 2), leading[:follow], *shares)
        followed = {(c.named, c.loose): c for c in polished}
        # What was not followed is taken to lose as much as what was.
        typical = max(
            float(np.median([c.promised - followed[c.named, c.loose].promised for c in leading[:follow]])), 0.0
        )
        for c in leading:
            lost = replace(c.weighed, log_evidence=c.promised - typical)
            self._keep(followed.get((c.named, c.loose)) or replace(c, weighed=lost))
        return sorted((self._tried[key] for key in grown), key=lambda c: -c.log_evidence)

    def _prune(self) -> None:
        """The leading hypotheses of several effects with one effect less, searched from where they were found: a search for
        fewer effects that began at none may have ended elsewhere."""
        tried: set[tuple[Hypothesis, bool]] = set()
        steps = np.linspace(*PRUNING, self.extent.pruned + 1)
        for begin, end in itertools.pairwise(steps.tolist()):
            c = max(self._tried.values(), key=_evidence)
            fewer = [tuple(x for x in c.named if x != e) for e in c.named if len(c.named) > 1]
            fresh = [(h, c) for h in fewer if (h, c.loose) not in tried]
            tried |= {(h, c.loose) for h in fewer}
            for found in self._effort.each(self._fewer, fresh, begin, end):
                known = self._tried.get((found.named, found.loose))
                if known is None or found.log_evidence > known.log_evidence:
                    self._keep(found)
            if not fresh:
                return

    def _fewer(self, wanted: tuple[Hypothesis, Candidate]) -> Candidate:
        """Some of a candidate's effects, searched from where all of them were found."""
        named, c = wanted
        return self._weigh(named, self._fit(named, c.loose, c.cell.size, c.fit.theta, 6), c.loose)

    def _finish(self) -> None:
        """Leading hypotheses whose search was cut short are searched to the end."""
        for _ in range(self.extent.finish):
            best = max(map(_evidence, self._tried.values()))
            cut = [
                c for c in self._tried.values() if c.promised > best - self.extent.within and c.fit.short > UNFINISHED
            ]
            if not cut:
                return
            c = max(cut, key=lambda c: c.promised)
            reached = max(c, self._polished(c, 6), key=_evidence)
            # What the end of the search still promises is not counted again.
            settled = replace(reached.weighed, log_evidence=reached.log_evidence)
            self._keep(replace(reached, weighed=settled, fit=replace(reached.fit, short=0.0)))

    def _children(self, parent: Candidate) -> list[Hypothesis]:
        ids = self.problem.parameters.ids
        more: Iterable[str] = (e for e in ids if e not in parent.named)
        return [tuple(sorted((*parent.named, e), key=ids.index)) for e in more]

    def _fit(
        self, named: Hypothesis, loose: bool, size: float, start: Array | Fit, rounds: int, frozen: Fit | None = None
    ) -> Fit:
        p = self.problem.parameters
        return fit(self.problem, p.prior(p.mask(named), HELD * loose), size, start, rounds, frozen)

    def _whole(self, f: Fit) -> Fit:
        """The same fit with the derivatives by all parameters."""
        predicted, slope = self.problem.linearise(f.theta)
        return replace(f, slope=slope, linear=self.problem.linear(f.theta, predicted, slope))

    def _loosened(self, named: Hypothesis, f: Fit, loose: bool) -> Fit:
        return replace(f, linear=self.problem.loosened(f.linear, f.theta, f.predicted, named, loose))

    def _weigh_around(self, f: Fit, named: Sequence[Hypothesis], loose: bool) -> dict[Hypothesis, Candidate]:
        """Hypotheses in the linear problem of a fit that was made for another."""
        grid = self._grids[loose]
        found = weigh(f.linear, grid, self.problem.parameters, named)
        return {h: Candidate(h, w, f, w.peak(grid), loose) for h, w in zip(named, found, strict=True)}

    def _weigh(self, named: Hypothesis, fitted: Fit, loose: bool) -> Candidate:
        return self._weigh_around(self._loosened(named, fitted, loose), [named], loose)[named]

    def _keep(self, c: Candidate) -> None:
        self._tried[c.named, c.loose] = c
