"""The whole diagnosis of one case: pure, seeded, silent.

from diagnosis.diagnose import diagnose
answer = diagnose(case)          # case.robot, case.table
answer.statement, answer.attribute.verdict, answer.to_json()
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from model.effects.catalogue import CATALOGUE
from model.effects.spec import EffectSpec

from .answer import assemble, next_experiment
from .answer.attribute import Found, attribute
from .answer.holdout import hold_out, unmet
from .answer.result import Diagnosis, Locate, Proposal, Shrink
from .answer.shrink import shrink
from .answer.verdict import beside, statement
from .criticism.probability_calibration import USUAL_BEYOND
from .data.case import CaseLike, states
from .inference.effort import ALONE, Effort
from .inference.prepare import prepare


@dataclass(frozen=True)
class Options:
    """What is weighed, and what is computed beyond the attribution and the place of the gap."""

    quantify: bool = True
    """Held-out errors."""
    experiments: bool = True
    """What to do next."""
    catalogue: Mapping[str, EffectSpec] = field(default_factory=lambda: CATALOGUE)
    """The effects that are weighed."""
    holdout: CaseLike | None = None
    """A campaign that the fit never sees, on which the answer is tried."""
    effort: Effort = ALONE


def diagnose(case: CaseLike, options: Options | None = None) -> Diagnosis:
    """Diagnose a case; raises `DiagnosisError` when the table, or the campaign held out, cannot be used at all."""
    wanted = options or Options()
    own, concerns = states(case)
    other = unmet(case, wanted.holdout) if wanted.holdout is not None else None
    prepared = prepare(case.robot, own, catalogue=wanted.catalogue)
    found = attribute(prepared, wanted.effort)
    shrunk, unseen = shrink(prepared, found.calibrated, found.best) if wanted.quantify else (None, None)
    proposals = next_experiment.propose(prepared, found.posterior, found.apart) if wanted.experiments else ()
    tried = hold_out(found, other) if other is not None else None
    wanted.effort.told(1.0)
    where = assemble.where(found, {e: spec.stage for e, spec in wanted.catalogue.items()})
    detail = assemble.detail(found, unseen, tried)
    said = _statement(found, where, shrunk, proposals, detail.get("stiffness"))
    return Diagnosis(
        statement=said + (f" {tried.statement}" if tried is not None else ""),
        data=assemble.data(prepared, case.table),
        locate=where,
        attribute=assemble.which(found, unseen),
        shrink=shrunk,
        next_experiment=proposals,
        concerns=(*concerns, *_unrepeatable(prepared.floor.beyond)),
        detail=detail,
    )


def _unrepeatable(beyond: float) -> tuple[str, ...]:
    if beyond < USUAL_BEYOND:
        return ()
    return (
        f"repeats of the same state differ {beyond:.1f} times more than instruments and spines grown anew usually do: "
        "look for what changes from trial to trial before believing a cause",
    )


def _statement(
    f: Found, where: Locate, shrunk: Shrink | None, proposals: tuple[Proposal, ...], pushes: Mapping[str, Any] | None
) -> str:
    named = f.decision.effects
    alike = (group for group in f.rivals if set(named) & set(group))
    rivals = tuple(dict.fromkeys(e for group in alike for e in group if e not in named))
    text = statement(f.decision, f.posterior, where, shrunk, rivals, proposals[0].do if proposals else None,
                     f.signs.outlier_trial, f.probability_calibration.bench)  # fmt: skip
    return text if pushes is None or where.of == "deflection" else f"{text} {beside(pushes, f.decision)}"
