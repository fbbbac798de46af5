"""Which hypotheses are weighed, and where each is linearised: none, all single effects, guided pairs and triples.

Effects are not linear at full size, so each hypothesis is weighed in the linear problem around its own most probable
point. Screening is cheap: every single effect is tried from two or three points (absent, full size up, full size down)
with one step each; only the leading ones are followed to the end. Pairs grow from the leading singles, triples from the
leading pairs, as long as naming one more effect pays for its prior.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from .evidence import KNOWN, LARGE, NONE, Cell, Grid, Hypothesis, Weighed, weigh
from .fit import Fit, fit
from .problem import Problem

Array = NDArray[np.float64]

START = Cell(spike=0.1, size=0.25, form=0.1)
"""With which the first fits are made."""


UNFINISHED = 0.5
"""A search that promises to lower the cost by more is not at its end."""


BEGIN = 0.6
"""Share of its scale at which the search for an effect that acts one way begins."""


@dataclass(frozen=True)
class Extent:
    """How far the search goes."""

    screen: int = 8
    """Singles, leading around none, that are followed with most derivatives kept."""
    polish: int = 4
    """Leading singles that are followed to their most probable point with all derivatives computed anew."""
    within: float = 8.0
    """Singles whose log evidence is further than this behind the best are not followed."""
    parents: int = 4
    """Leading singles from which pairs grow, and leading pairs from which triples grow."""
    pairs: int = 5
    """Leading pairs that are followed."""
    triples: int = 2
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
    unknown: bool = False

    @property
    def promised(self) -> float:
        """Log evidence of the linear problem."""
        return self.weighed.log_evidence

    @property
    def log_evidence(self) -> float:
        """The same, less what the linear problem promises and the model did not hold."""
        return self.promised - self.fit.short


class Search:
    """Weighs hypotheses of one problem, keeping what it has found."""

    def __init__(self, problem: Problem, grid: Grid = KNOWN, extent: Extent | None = None) -> None:
        self.problem, self.grid, self.extent = problem, grid, extent or Extent()
        self.none = self._none()
        self.found: dict[Hypothesis, Candidate] = {NONE: self.none}

    def run(self) -> list[Candidate]:
        """All candidates of the catalogue, most probable data first."""
        singles = self._singles()
        pairs = self._grow(singles[: self.extent.parents], self.extent.pairs)
        if pairs and pairs[0].log_evidence > singles[0].log_evidence + 2.0:
            self._grow(pairs[: self.extent.parents], self.extent.triples)
        self._finish()
        return sorted(self.found.values(), key=lambda c: -c.log_evidence)

    def _finish(self) -> None:
        """Leading hypotheses whose search was cut short are searched to the end."""
        for _ in range(self.extent.finish):
            best = max(c.log_evidence for c in self.found.values())
            open_ = [c for c in self.found.values() if c.promised > best - 3.0 and c.fit.short > UNFINISHED]
            if not open_:
                return
            c = max(open_, key=lambda c: c.promised)
            further = self._polished(c, 6)
            done = replace(further, fit=replace(further.fit, short=min(further.fit.short, UNFINISHED)))
            self.found[c.named] = done if done.fit.cost < c.fit.cost else replace(c, weighed=replace(c.weighed, log_evidence=c.log_evidence), fit=replace(c.fit, short=0.0))

    def unknown(self, leading: Sequence[Candidate], shares: Sequence[float], temperature: float) -> Candidate:
        """The hypothesis that something outside the catalogue is at work, beside any of the leading hypotheses.

        `shares` are the prior weights of the leading hypotheses among themselves; evidence is divided by the
        temperature, prior weights are not.
        """
        beside = [weigh(c.fit.linear, LARGE, self.problem.parameters, [c.named])[0] for c in leading]
        terms = np.array([w.log_evidence for w in beside]) / temperature + np.log(np.array(shares) / np.sum(shares))
        i = int(np.argmax(terms))
        total = replace(beside[i], log_evidence=temperature * float(logsumexp(terms)))
        return Candidate(leading[i].named, total, leading[i].fit, beside[i].peak(LARGE), unknown=True)

    def _none(self) -> Candidate:
        fitted = self._fit(NONE, START, self.problem.parameters.mean, 3)
        first = self._weigh(NONE, fitted)
        return self._weigh(NONE, self._fit(NONE, first.cell, fitted, 5))

    def _singles(self) -> list[Candidate]:
        """Every single effect weighed around none; what looks promising there, or cannot be judged there, followed."""
        p, extent = self.problem.parameters, self.extent
        singles: list[Hypothesis] = [(e,) for e in p.ids]
        around = weigh(self.none.fit.linear, self.grid, p, singles)
        here = {h: Candidate(h, w, self.none.fit, w.peak(self.grid)) for h, w in zip(singles, around, strict=True)}
        order = sorted(singles, key=lambda h: -here[h].log_evidence)
        first = set(order[: extent.screen]) | {h for h in singles if self._curved(h)}
        found = {h: self._screened(h) if h in first else here[h] for h in singles}
        for c in sorted(found.values(), key=lambda c: -c.promised)[: extent.polish]:
            if c.promised > max(x.log_evidence for x in found.values()) - extent.within:
                found[c.named] = self._polished(c, 4)
        self.found |= found
        return sorted(found.values(), key=lambda c: -c.log_evidence)

    def _curved(self, named: Hypothesis) -> bool:
        """Whether an effect acts one way only, or has several points to begin at."""
        p = self.problem.parameters
        own = [i for i, e in enumerate(p.effects) if e in named]
        return any(p.lower[i] == 0 or (bool(p.starts) and len(p.starts[i]) > 1) for i in own)

    def _screened(self, named: Hypothesis) -> Candidate:
        """A step or two from each starting point; the best by evidence at the point reached."""
        near = self._weigh(named, self.none.fit)
        rounds = 2 if self._curved(named) else 1
        tried = [self._weigh(named, self._fit(named, near.cell, s, rounds)) for s in self._starts(named)]
        return max(tried, key=lambda c: c.log_evidence)

    def _starts(self, named: Hypothesis) -> list[Array | Fit]:
        """Where a search begins: the fit of none; for an effect that acts one way only, well within its range instead.

        Around zero, where such an effect ends, the small errors allowed to all the others can take its place.
        """
        p, here = self.problem.parameters, self.none.fit.theta
        if not self._curved(named):
            return [self.none.fit]
        own = [i for i, e in enumerate(p.effects) if e in named]
        points: list[Array | Fit] = []
        for values in itertools.product(*(self._begin(i) for i in own)):
            point = here.copy()
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
        return self._weigh(c.named, self._fit(c.named, c.cell, c.fit, rounds))

    def _grow(self, parents: Sequence[Candidate], follow: int) -> list[Candidate]:
        """Each parent with one effect more: weighed where the parent was fitted, the leading ones followed."""
        grown: dict[Hypothesis, Candidate] = {}
        for parent in parents:
            children = self._children(parent)
            weighed = weigh(parent.fit.linear, self.grid, self.problem.parameters, children)
            for named, found in zip(children, weighed, strict=True):
                if named not in grown or grown[named].log_evidence < found.log_evidence:
                    grown[named] = Candidate(named, found, parent.fit, found.peak(self.grid))
        leading = sorted(grown.values(), key=lambda c: -c.promised)
        for c in leading[:follow]:
            grown[c.named] = self._polished(c, 2)
        # What was not followed is taken to lose as much as what was.
        typical = float(np.median([c.promised - grown[c.named].promised for c in leading[:follow]]))
        for c in leading[follow:]:
            grown[c.named] = replace(c, weighed=replace(c.weighed, log_evidence=c.promised - max(typical, 0.0)))
        self.found |= grown
        return sorted(grown.values(), key=lambda c: -c.log_evidence)

    def _children(self, parent: Candidate) -> list[Hypothesis]:
        ids = self.problem.parameters.ids
        more: Iterable[str] = (e for e in ids if e not in parent.named)
        return [tuple(sorted((*parent.named, e), key=ids.index)) for e in more]

    def _fit(self, named: Hypothesis, cell: Cell, start: Array | Fit, rounds: int) -> Fit:
        return fit(self.problem, self.problem.parameters.variance(named, cell.spike), cell.size, start, rounds)

    def _weigh(self, named: Hypothesis, fitted: Fit) -> Candidate:
        loose = self.problem.loosened(fitted.linear, fitted.theta, fitted.predicted, named)
        found = weigh(loose, self.grid, self.problem.parameters, [named])[0]
        return Candidate(named, found, replace(fitted, linear=loose), found.peak(self.grid))

