"""The sections `data`, `attribute` and `budget` of the answer, from what was found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import get_args

import numpy as np

from model.robot import Robot
from recordings.trials import Table

from ..data.case import lacking
from ..findings import Finding
from ..inference.evidence import NONE, Hypothesis
from ..inference.posterior import UNKNOWN
from ..inference.prepare import Prepared
from ..judgement import PRESENT_FLOORS
from .attribute import Attribution
from .distinguishability import visible
from .result import Attribute, Carries, Data, FittedRobot, Ranked, Role, Value
from .size import as_fitted, sizes, values
from .verdict import conclude, rivals

LISTED = 12
"""Hypotheses shown in the ranking, besides none and unknown, which always are."""


def data_section(p: Prepared, table: Table) -> Data:
    """What was diagnosed."""
    repeated = p.noise_components.contrasts + (p.pushes.noise_components.contrasts if p.pushes is not None else 0)
    source = (
        f"{repeated} differences between repeats" if repeated else "default noise of settled readings, since nothing was repeated"
    )
    noise = p.noise_components.channel["tip"]
    if p.pushes is not None and p.pushes_only:
        noise = float(np.median(p.pushes.noise_components.channel["force"] / p.pushes.stiffness))
    channels = tuple(dict.fromkeys(p.labels.channel.tolist()))
    return Data(len(table), len(np.unique(p.states.trial)), channels, noise * 1e3, source)


def attribute_section(
    f: Attribution,
    significant: bool,
    heldout: Mapping[Hypothesis, float],
    why: Sequence[Finding],
    fitted: FittedRobot | None,
    doubtful: bool = False,
) -> Attribute:
    """Verdict and ranking of the hypotheses, with the doubts `why` what is named is not certain.

    `significant`: whether the gap is above the noise floor anywhere; `heldout`: mm rms of hypotheses on unseen states; `fitted`:
    the robot with what is named, whose sizes are stated; `doubtful`: robot.yaml is too far from the data for a certain cause.
    """
    d = f.decision
    leading, others = f.posterior.ranking[:LISTED], f.posterior.ranking[LISTED:]
    ranked = []
    for named, probability in (*leading, *(x for x in others if x[0] in (NONE, UNKNOWN))):
        candidate = f.posterior.candidates[named]
        size = values(as_fitted(sizes(f.prepared, candidate), fitted if named == d.effects else None))
        if d.verdict == "effect":  # where that was decided against the ranking, its probabilities are the decision's
            probability = d.probability if named == d.effects else d.outside if named == UNKNOWN else probability
        ranked.append(Ranked(named, probability, candidate.log_evidence, heldout.get(named), size))
    return Attribute(
        **vars(d),
        credible_set=f.posterior.credible_set,
        ranking=tuple(ranked),
        cannot_tell_apart=f.cannot_tell_apart,
        stage_errors=f.asking,
        conclusion=conclude(d, significant, f.asking, doubtful or bool(why)),
        rivals=rivals(d, f.posterior),
        doubts=tuple(map(str, why)),
        missing=tuple(map(f.prepared.robot.actuators.words.fill, lacking(f.prepared.states))),
    )


def beside(a: Attribute, certain: str, robot: Robot) -> Attribute:
    """The section where an effect that the robot has is part of every hypothesis, because none without it comes near the data;
    what is unknown is so beside it."""
    size = {f"{certain}.{name}": Value(s.value, s.sd, s.unit) for name, s in robot.effects[certain].items()}
    return replace(
        a,
        verdict="effect",
        effects=(certain, *a.effects),
        conclusion="cause" if a.conclusion in ("none", "noise") else a.conclusion,
        ranking=tuple(replace(r, effects=(certain, *r.effects), parameters={**size, **r.parameters}) for r in a.ranking),
        credible_set=tuple((certain, *named) for named in a.credible_set),
    )


def budget_section(f: Attribution) -> tuple[Carries, ...]:
    """What each effect carries of the gap, largest first within named, present and unseen."""
    parameters, best = f.prepared.problem.parameters, f.best
    linear = best.linear(f.prepared.problem)
    reduced = linear.reduced(best.grid_point.size, best.grid_point.form_error)
    detectable = visible(reduced, parameters, best.grid_point.spike, linear.effect_size)
    # the model itself is no better than the unit of its discrepancy
    least_present = PRESENT_FLOORS * max(f.prepared.noise_floor, float(np.sqrt(3)) * f.prepared.unit)
    out = []
    for effect in parameters.ids:
        low, median, high = (1e3 * x for x in f.budget.interval(effect, 0.025, 0.5, 0.975))
        role: Role = "named" if effect in f.decision.effects else "present" if effect in detectable else "unseen"
        if role != "present" or median > 1e3 * least_present:
            out.append(Carries(effect, role, median, low, high))
    return tuple(sorted(out, key=lambda x: (get_args(Role).index(x.role), -x.mm)))
