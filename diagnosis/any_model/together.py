"""More causes at once than a search follows: cause after cause is added to the best hypothesis of as many as that, or taken away
again, whatever makes the data most probable, until nothing repays its prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from .. import judgement
from ..inference.candidate import Candidate
from ..inference.evidence import KNOWN, Hypothesis, weigh
from ..inference.fit import Fit, fit
from ..inference.posterior import log_weight
from ..inference.search import LAST_ROUNDS, Search

ALONE = KNOWN.part(False)


def together(search: Search) -> list[Candidate]:
    """The hypotheses of more causes that were weighed."""
    problem, p, most = search.problem, search.problem.parameters, max(judgement.PRIOR_OF_NUMBER)

    def weight(c: Candidate) -> float:
        return log_weight(c.named, c.log_evidence, len(p.ids))

    def around(f: Fit, named: Sequence[Hypothesis]) -> list[Candidate]:
        found = weigh(f.linear(problem), ALONE, p, named) if named else []
        return [Candidate(h, w, f, w.peak(ALONE), False) for h, w in zip(named, found, strict=True)]

    alone = [c for c in search.tried if len(c.named) == most and not c.with_tolerances]
    out: dict[Hypothesis, Candidate] = {}
    here = max(alone, key=weight, default=None)
    while here is not None:
        whole = here.fit.with_all_derivatives(problem).with_form_error(problem, here.named)
        found = around(whole, [tuple(e for e in p.ids if e in (*here.named, new)) for new in p.ids if new not in here.named])
        for taken in here.named if len(here.named) > most + 1 else ():
            found += around(whole.without_law(taken), [tuple(e for e in here.named if e != taken)])
        out = {c.named: c for c in found} | out
        first = max(found, key=weight, default=here)
        prior = p.prior(p.mask(first.named), 0.0)
        fitted = fit(problem, prior, judgement.FIT_DISCREPANCY_SIZE, first.fit.theta, LAST_ROUNDS)
        (first,) = around(fitted.with_all_derivatives(problem).with_form_error(problem, first.named), [first.named])
        better = weight(first) > weight(here)
        here = replace(first, turns=1, ended=True) if better else None
        if here is not None:
            out[here.named] = here
    return [*out.values()]
