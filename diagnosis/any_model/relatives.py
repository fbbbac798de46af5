"""Relatives of the listed causes, weighed in their place (as `criticism.relatives` are of the soft robot's effects)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from model.cause import Cause

from .. import judgement
from ..inference.candidate import Candidate
from ..inference.evidence import KNOWN, Hypothesis, weigh
from ..inference.fit import fit
from ..inference.problem import FitParameters
from .built import FREE_ROUNDS, Built


@dataclass(frozen=True)
class Related:
    """A relative next to causes of the list."""

    cause: Cause
    named: Hypothesis
    log_evidence: float


def related(b: Built, causes: Iterable[Cause], candidates: Sequence[Candidate]) -> tuple[Related, ...]:
    """Relatives in the place of each cause that candidates name, and alone where they name none, the most probable first."""
    out: dict[tuple[str, Hypothesis], Related] = {}
    for c in candidates:
        for cause in causes:
            if c.named and cause.name not in c.named:
                continue
            for relative in cause.relatives:
                beside = tuple(e for e in c.named if e != cause.name)
                if (relative.name, beside) not in out and any(p.source == relative.name for p in b.of_relatives):
                    out[relative.name, beside] = _fitted(b, relative, beside, c)
    return tuple(sorted(out.values(), key=lambda r: -r.log_evidence))


def _fitted(b: Built, relative: Cause, beside: Hypothesis, c: Candidate) -> Related:
    """A relative and the causes beside it, fitted from a candidate with the relative at its plausible size on every side."""
    own = [p for p in b.of_relatives if p.source == relative.name]
    infos, p = (*b.parameters, *own), b.problem.parameters
    least = (*p.least_of_each, *(judgement.LEAST_NAMED_SIZE for _ in own))
    wider = FitParameters(infos, np.array([*p.sd, *(x.sd for x in own)]), least)
    problem = replace(b.problem, forward=b.model.by(infos), parameters=wider)
    named = (*beside, relative.name)
    kept = np.where(np.isin(p.effects, ["", *beside]), c.fit.theta, 0.0)
    starts = [np.append(kept, [x.sides[min(side, len(x.sides) - 1)] for x in own]) for side in (0, 1)]
    fits = (fit(problem, wider.prior_of(named), judgement.FIT_DISCREPANCY_SIZE, s, FREE_ROUNDS) for s in starts)
    best = min(fits, key=lambda f: f.cost)
    whole = best.with_all_derivatives(problem).with_form_error(problem, named)
    (w,) = weigh(whole.linear(problem), KNOWN, wider, [named])
    return Related(relative, named, w.log_evidence - best.predicted_decrease)


def alike(among: Sequence[Related], named: Hypothesis, log_evidence: float) -> tuple[str, ...]:
    """Relatives, in words, that explain the data as well as what is named or better, the best first; where nothing is named,
    better by `SEPARATED_EVIDENCE`. `log_evidence`: of that."""
    least = log_evidence + judgement.SEPARATED_EVIDENCE * (-1 if named else 1)
    return tuple(dict.fromkeys(r.cause.says or r.cause.name for r in among if r.log_evidence > least))
