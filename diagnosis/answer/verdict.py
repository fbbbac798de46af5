"""The conclusion, as precise as the data allow: the sections `data`, `attribute` and `budget`. `sentences` has the words,
docs/explanations/diagnosis.md explains them.

cause             named with a probability of at least 0.9; no relative outside the catalogue looks the same; no `doubts`;
                  or known before the diagnosis, which finds no other (`beside`)
one of several    named with less: the data cannot rule out others
stage             outside the catalogue; the evidence points to an error in one stage of the chain
outside           outside the catalogue
none              no effect explains enough above the noise floor
noise             the same, and the gap is nowhere above the noise
too little data   the table does not suffice to name a cause
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import get_args

import numpy as np

from model.robot import Robot
from recordings.trials import Table

from .. import judgement
from ..criticism.relatives import PLACES, RELATIVES, named_places
from ..criticism.stage_errors import StageError
from ..data.case import lacking
from ..findings import Finding, finding
from ..inference.candidate import Candidate
from ..inference.evidence import NONE, Hypothesis
from ..inference.posterior import UNKNOWN, EffectPosterior
from ..inference.prepare import Prepared
from .attribute import Attribution
from .decision import Decision, share_closed
from .distinguishability import visible
from .result import Attribute, Carries, Conclusion, Data, FittedRobot, Ranked, Role, Shrink, Value
from .size import Size, by_actuator, values


def data_section(p: Prepared, table: Table) -> Data:
    """Describe the data that were diagnosed."""
    repeated = p.noise_components.contrasts + (p.pushes.noise_components.contrasts if p.pushes is not None else 0)
    source = f"{repeated} differences between repeats" if repeated else "default noise of settled readings: no state was repeated"
    noise = p.noise_components.channel["tip"]
    if p.pushes is not None and p.pushes_only:
        noise = float(np.median(p.pushes.noise_components.channel["force"] / p.pushes.stiffness))
    channels = tuple(dict.fromkeys(p.labels.channel.tolist()))
    return Data(len(table), len(np.unique(p.states.trial)), channels, noise * 1e3, source, p.forward.scales.pressure)


def attribute_section(
    f: Attribution,
    significant: bool,
    heldout: Mapping[Hypothesis, float],
    why: Sequence[Finding],
    fitted: FittedRobot | None,
    doubtful: bool = False,
) -> Attribute:
    """Return the verdict and the ranking of the hypotheses, with the doubts (`why`) about the named effects.

    `significant`: the gap is above the noise floor somewhere; `heldout`: mm rms of hypotheses on unseen states; `fitted`:
    the robot with the named effects, whose sizes are stated; `doubtful`: robot.yaml is too far from the data to name a cause.
    """
    d, robot, specs = f.decision, f.prepared.robot, f.prepared.forward.catalogue
    leading, others = f.posterior.ranking[: judgement.LISTED], f.posterior.ranking[judgement.LISTED :]
    ranked = []
    for named, probability in (*leading, *(x for x in others if x[0] in (NONE, UNKNOWN))):
        candidate = f.posterior.candidates[named]
        own = candidate if named == d.effects else f.alone.get(named)
        found = {} if own is None else values(tuple(s for s in f.sizes(own, fitted) if s.effect in named))
        answered = named == (d.effects if d.verdict == "effect" else UNKNOWN)
        if d.verdict != "none":  # doubts take from all answers of the catalogue alike
            left = (1 - d.outside) / max(1 - f.posterior.probability(UNKNOWN), 1e-9)
            probability = d.probability if answered else d.outside if named == UNKNOWN else left * probability
        limited = d.limited and answered
        evidence = own_evidence(named, (candidate, f.best, own))
        unseen = heldout.get(named) if evidence is not None or named == d.effects else None
        factors = (by_actuator(robot, specs[e], found) for e in named if e in specs)
        in_words = {x.effect: tuple(x.says(robot.actuators.words, sd) for sd in (True, False)) for x in factors if x is not None}
        ranked.append(Ranked(named, probability, np.nan if evidence is None else evidence, unseen, found, limited, in_words))
    return Attribute(
        **vars(d),
        credible_set=f.posterior.credible_set,
        ranking=tuple(ranked),
        cannot_tell_apart=f.distinguishability.groups(f.posterior),
        stage_errors=f.stage_errors,
        conclusion=conclude(d, significant, f.stage_errors, doubtful or bool(why)),
        rivals=rivals(d, f.posterior) if d.probability < judgement.CAUSE_PROBABILITY else (),
        doubts=tuple(map(str, why)),
        missing=tuple(map(robot.actuators.words.fill, lacking(f.prepared.states))),
        at_places=at_places(f),
    )


def own_evidence(named: Hypothesis, candidates: Iterable[Candidate | None]) -> float | None:
    """Largest log evidence of fits of just this hypothesis, which no other stands for; NaN where none was searched to its end,
    None where there is none."""
    own = [c for c in candidates if c is not None and c.named == named]
    ended = [c.log_evidence for c in own if c.fit.predicted_decrease < judgement.SEPARATED_EVIDENCE]
    return max(ended, default=math.nan) if own else None


def at_places(f: Attribution) -> dict[str, dict[str, Value]]:
    """See `Attribute.at_places`."""
    out, fitted = {}, (r for r in f.relatives if r.sizes and r.relative in PLACES and r.relative in f.decision.relatives)
    for r in reversed(list(fitted)):  # the most probable one beside other effects counts
        names, unit = named_places(r.relative, f.prepared.robot), RELATIVES[r.relative].parameters[0].unit
        out[r.relative] = {name: Value(*size, unit) for name, size in zip(names, r.sizes, strict=True)}
    return out


def beside(a: Attribute, certain: str, robot: Robot) -> Attribute:
    """Return the section with the effect `certain`, which the robot has, as part of every hypothesis: without it none comes
    near the data. The probability is that of what is beyond it."""
    size = {f"{certain}.{name}": Value(s.value, s.sd, s.unit) for name, s in robot.causes[certain].items()}
    return replace(
        a,
        verdict="effect",
        effects=(certain, *a.effects),
        conclusion="cause" if a.conclusion in ("none", "noise") else a.conclusion,
        ranking=tuple(replace(r, effects=(certain, *r.effects), parameters={**size, **r.parameters}) for r in a.ranking),
        credible_set=tuple((certain, *named) for named in a.credible_set),
    )


def budget_section(f: Attribution) -> tuple[Carries, ...]:
    """Return each effect's part of the gap in mm, largest first within named, present and unseen."""
    parameters, best = f.prepared.problem.parameters, f.best
    linear = best.fit.linear(f.prepared.problem)
    reduced = linear.reduced(best.weighed.peak.size, best.weighed.peak.form_error)
    detectable = visible(reduced, parameters, best.weighed.peak.spike, linear.effect_size)
    # the model itself is no better than the unit of its discrepancy
    least_present = judgement.PRESENT_FLOORS * max(f.prepared.noise_floor, float(np.sqrt(3)) * f.prepared.unit)
    out = []
    for effect in parameters.ids:
        low, median, high = (1e3 * x for x in f.budget.interval(effect, 0.025, 0.5, 0.975))
        role: Role = "named" if effect in f.decision.effects else "present" if effect in detectable else "unseen"
        if role != "present" or median > 1e3 * least_present:
            out.append(Carries(effect, role, median, low, high))
    return tuple(sorted(out, key=lambda x: (get_args(Role).index(x.role), -x.mm)))


def rivals(d: Decision, posterior: EffectPosterior) -> tuple[str, ...]:
    """Return the effects of the 95 % set that are not named, most probable first; none where no effect is named."""
    others = (h for h in posterior.credible_set if d.verdict == "effect" and h not in (NONE, UNKNOWN, d.effects))
    return tuple(dict.fromkeys(e for h in others for e in h if e not in d.effects))


def doubts(
    effects: Mapping[str, str],
    sizes: Sequence[Size],
    budget: Sequence[Carries],
    unseen: Shrink | None,
    fitted: FittedRobot | None,
    floor_mm: float,
    alone: Sequence[str] = (),
    follows_law: bool = True,
) -> Iterator[Finding]:
    """Yield the reasons why effects (id -> name) are not a certain cause: their sizes, their part of the gap, the error left on
    unseen states, and the fit of the robot with them alone. `alone`: effects that do as well without any calibration;
    `follows_law`: the readings follow the catalogue's law. (Probabilities already average over how wrong laws may be.)"""
    low = {c.effect: c.low95_mm for c in budget}
    for effect, name in effects.items():
        if any(s.impossible for s in sizes if s.effect == effect):
            yield finding("cause_impossible", effect=name)
        elif low.get(effect, math.inf) < judgement.LEAST_NAMED_FLOORS * floor_mm:
            yield finding("cause_undetermined", effect=name, low_mm=low[effect], floor_mm=floor_mm)
    yield from (finding("cause_or_calibration", effect=name) for name in alone[:1])
    partial = {s.effect for s in sizes if s.mean < s.least}
    if other_forms := [name for effect, name in effects.items() if effect in partial or not follows_law]:
        yield finding("law_of_another_form", effect=" and ".join(other_forms))
    if unseen is None:
        return
    if unseen.after_mm > max(judgement.LEFT_FLOORS * unseen.floor_mm, judgement.LEFT_SHARE * unseen.before_mm):
        yield finding("gap_remains", mm=unseen.after_mm)
    by_itself = None if fitted is None else share_closed(fitted.calibrated_mm, fitted.left_mm, floor_mm)
    promised = unseen.share_closed or 0.0
    if fitted is not None and by_itself is not None and by_itself < judgement.EXPLAINS * promised:
        effect = " and ".join(effects.values())
        yield finding("fit_not_reached", effect=effect, alone=max(by_itself, 0.0), together=promised)


def conclude(d: Decision, gap: bool, asking: Sequence[StageError], tense: bool = False) -> Conclusion:
    """Return the most precise conclusion that the data allow. `gap`: it is above the noise floor somewhere; `tense`: there are
    `doubts`, or the fit moves a number of robot.yaml far beyond its tolerance."""
    if not d.enough:
        return "too little data"
    if d.verdict == "effect":
        sure = d.probability >= judgement.CAUSE_PROBABILITY and not tense and not d.relatives
        return "cause" if sure else "one of several"
    if d.verdict == "none":
        return "none" if gap else "noise"
    return "stage" if stage(asking) else "outside"


def stage(asking: Sequence[StageError]) -> StageError | None:
    """Return the stage that needs an error of its own, with the variable it depends on most; None if no stage stands out."""
    if not asking:
        return None
    gains = np.exp((np.array([e.gain for e in asking]) - max(e.gain for e in asking)) / judgement.TEMPERATURE)
    own = np.array([e.stage == asking[0].stage for e in asking])
    return asking[0] if gains[own].sum() >= judgement.STAGE_SHARE * gains.sum() else None
