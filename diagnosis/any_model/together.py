"""More causes at once than a search follows: cause after cause is added to the best hypothesis of as many as that, or taken away
again, whatever makes the data most probable, until nothing repays its prior."""

from __future__ import annotations

from dataclasses import replace

from .. import judgement
from ..inference.candidate import Candidate
from ..inference.evidence import Hypothesis
from ..inference.posterior import log_weight
from ..inference.search import LAST_ROUNDS, Search


def together(search: Search) -> list[Candidate]:
    """The hypotheses of more causes that were weighed."""
    ids, most = search.problem.parameters.ids, max(judgement.PRIOR_OF_NUMBER)

    def weight(c: Candidate) -> float:
        return log_weight(c.named, c.log_evidence, len(ids))

    out: dict[Hypothesis, Candidate] = {}
    here = max((c for c in search.tried if len(c.named) == most and not c.with_tolerances), key=weight, default=None)
    whole = None if here is None else here.fit.with_all_derivatives(search.problem).with_form_error(search.problem, here.named)
    while here is not None and whole is not None:
        added = [tuple(e for e in ids if e in (*here.named, new)) for new in ids if new not in here.named]
        found = search.around(whole, added, False)
        for taken in here.named if len(here.named) > most + 1 else ():
            found += search.around(whole.without_law(taken), [tuple(e for e in here.named if e != taken)], False)
        out = {c.named: c for c in found} | out
        first = max(found, key=weight, default=here)
        fitted = search.fit(first.named, False, judgement.FIT_DISCREPANCY_SIZE, first.fit.theta, LAST_ROUNDS)
        whole = fitted.with_all_derivatives(search.problem).with_form_error(search.problem, first.named)
        (first,) = search.around(whole, [first.named], False)
        here = replace(first, turns=1, ended=True) if weight(first) > weight(here) else None
        if here is not None:
            out[here.named] = here
    return [*out.values()]
