"""The whole diagnosis of one case: pure, seeded, silent.

from diagnosis.diagnose import diagnose

answer = diagnose(case)          # case.robot, case.table
answer.statement, answer.attribute.verdict, answer.to_json()
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from model.effects.catalogue import CATALOGUE
from model.effects.spec import EffectSpec
from model.robot import THRUST
from model.stated import AREA_FACTOR

from .answer import assemble, sentences
from .answer.attribute import Attribution, attribute, begin
from .answer.calibration import alone_as_good, calibration, simulator
from .answer.detail import detail
from .answer.experiments import propose
from .answer.headline import headline
from .answer.holdout import evaluate_holdout, unseen_states
from .answer.locate import locate
from .answer.result import Diagnosis, FittedRobot, Value
from .answer.rivals import Rivals
from .answer.size import sizes
from .answer.verdict import behaves_like, doubted, doubts
from .answer.waterfall import Unseen, UnseenStates
from .data.baseline import Baseline
from .data.case import CaseLike, lacking, states
from .edits.order import ORDER
from .edits.search import Edited
from .errors import BadCase
from .findings import Finding, finding
from .fit_effects import fit_described
from .inference.executor import SINGLE_THREAD, Executor, one_thread
from .inference.prepare import AREA, prepare
from .inference.thrust import settled_and_edited


@dataclass(frozen=True)
class Options:
    """Which effects are considered, and what is computed besides attribution and location of the gap."""

    quantify: bool = True
    """Held-out errors."""
    experiments: bool = True
    """What to do next."""
    catalogue: Mapping[str, EffectSpec] = field(default_factory=lambda: CATALOGUE)
    """The effects that are considered."""
    holdout: CaseLike | None = None
    """A campaign that is not fitted, on which the answer is tested."""
    baseline: Baseline | None = None
    """What another simulator predicts of the rows of the case's table, in the rod's place."""
    executor: Executor = SINGLE_THREAD


@dataclass(frozen=True)
class Examined:
    """An answer and what it rests on."""

    diagnosis: Diagnosis
    rivals: Rivals
    first: Edited


def diagnose(case: CaseLike, options: Options | None = None) -> Diagnosis:
    """Diagnose a case: where the gap lies, its most probable cause, how far it shrinks, and what to do next.

    `case` has a robot and its table of trials. Raises `BadCase` or `BadHoldout` when the table, or the campaign held out,
    cannot be used.

    >>> from collections import namedtuple
    >>> from pathlib import Path
    >>> from model.robot import load_robot
    >>> from recordings.table_file import read_csv
    >>> case = namedtuple("Case", "robot table")(load_robot(Path("robot.yaml")), read_csv(Path("campaign/trials.csv")))
    >>> one = {"chamber_azimuth": CATALOGUE["chamber_azimuth"]}
    >>> answer = diagnose(case, Options(quantify=False, experiments=False, catalogue=one))
    >>> answer.data.rows, answer.data.trials, answer.locate.of
    (18, 6, 'tip')
    """
    return examine(case, options).diagnosis


@one_thread
def examine(case: CaseLike, options: Options | None = None) -> Examined:
    """The same with the hypotheses that are still in play, which predict what an experiment would give."""
    wanted = options or Options()
    own, findings = states(case)
    other = unseen_states(case, wanted.holdout) if wanted.holdout is not None else None
    predicted = wanted.baseline.take(own.row) if wanted.baseline is not None else None
    settled, first = None, Edited(case.robot, own)
    if predicted is None:
        settled, first = settled_and_edited(case.robot, own, wanted.catalogue, wanted.catalogue)
    try:
        prepared = prepare(first.robot, first.states, catalogue=wanted.catalogue, baseline=predicted)
    except np.linalg.LinAlgError as error:
        raise BadCase(
            "the model of robot.yaml is too far from these data to be compared with them: check youngs_modulus, area_factor and "
            "gravity of robot.yaml, and the units of the table"
        ) from error
    if first.changes:
        prepared = replace(prepared, described=(case.robot, own))
        other = None if other is None else first.moved(other)
    stages = {e: spec.stage for e, spec in wanted.catalogue.items()}
    begun = begin(prepared, wanted.executor)
    # Another process fits relatives of what leads, and later predicts what was held out, while this one does the rest.
    unseen_by = UnseenStates(prepared, begun, wanted.executor).of if wanted.quantify else lambda f: Unseen
    found = attribute(prepared, stages, begun)
    predicting = unseen_by(found)
    rivals = Rivals.of(prepared, found.posterior, found.distinguishability)
    proposals = propose(prepared, rivals, found.posterior, wanted.executor) if wanted.experiments else ()
    tested = evaluate_holdout(found, other) if other is not None else None
    where = locate(found, stages)
    held_out = predicting()
    exactly = found.decision.verdict != "unknown"
    found = replace(found, decision=behaves_like(found.decision, found.best.named, found.posterior, held_out.shrink))
    words = case.robot.actuators.words
    names = {e: spec.name(words) for e, spec in wanted.catalogue.items()}
    fitted, values = None, None
    if found.decision.effects and predicted is None and where.of == "tip":
        fitted = confirmed(found, first, wanted.catalogue)
        values = {name: v.value for name, v in fitted.parameters.items()}
        values[AREA] = prepared.area_parameter(values[AREA_FACTOR])
    shown = detail(found, fitted, held_out.errors, tested, names)
    scale, tense = calibration(found, values), found.tense(values)
    far = tuple(sentences.far_off(scale.stiffness, words)) if scale is not None and predicted is None else ()
    alone, size, carried = alone_as_good(scale, found), sizes(prepared, found.best), assemble.budget_section(found)
    named = {e: sentences.with_id(e, names) for e in found.decision.effects}
    as_good = [sentences.with_id(e, names) for e in alone]
    why: tuple[Finding, ...] = ()
    if named:
        why = tuple(doubts(named, size, carried, held_out.shrink, fitted, where.noise_floor_mm, as_good))
        why += () if exactly else (finding("law_of_another_form", effect=" and ".join(named.values())),)
        found = replace(found, decision=doubted(found.decision, why, len(alone)))
    unsure = bool(far or first.numbers or tense)
    which = assemble.attribute_section(found, where.significant, held_out.rms_mm, why, fitted, unsure)
    facts = sentences.Facts(
        found.decision, which.conclusion, where, carried, held_out.shrink, held_out.waterfall,
        which.rivals, next((x.do for x in proposals if x.separates), None), found.best.named, found.asking,
        found.misfit.outlier_trial, tuple(map(words.fill, lacking(first.states))), simulator(found), scale, first.named, names,
        words, fitted,
    )  # fmt: skip
    text = sentences.statement(facts)
    if first.changes:
        shown["first_calibration"] = first.detail()
        text = f"Calibrated first: {'; '.join(map(str, first.changes))}. {'Beyond that: ' if first.with_order else ''}{text}"
    if "stiffness" in shown and where.of == "tip":
        text += f" {sentences.stiffness_sentence(shown['stiffness'], found.decision)}"
    if first.with_order:
        which = assemble.beside(which, ORDER, first.robot)
    if settled is not None and which.verdict == "none":
        which, text = assemble.beside(which, THRUST, first.robot), f"{settled.finding}. Beyond that: {text}"
    findings = (
        *first.concerns,
        *findings,
        *([settled.finding] if settled is not None else ()),
        *why,
        *far,
        *sentences.beyond_tolerance(prepared.problem.parameters, tense, first.robot),
        *sentences.scatter(prepared.noise_components.excess_scatter),
        *sentences.against(size, found.decision.effects, found.asking, names, words),
        *([finding("residual_ignored")] if case.robot.residual is not None else ()),
    )
    changed = first.named or sentences.changed_by(facts)
    beyond = first.at_bound or (scale is not None and scale.at_bound)
    by_calibration = sentences.closed_by_calibration(facts)
    closed = None if held_out.shrink is None else held_out.shrink.share_closed
    answer = Diagnosis(
        statement=text + (f" {shown['holdout']['statement']}" if tested is not None else ""),
        data=assemble.data_section(prepared, case.table),
        locate=where,
        attribute=which,
        shrink=held_out.shrink,
        next_experiment=proposals,
        findings=findings,
        detail=shown,
        budget=facts.budget,
        waterfall=held_out.waterfall,
        calibration=scale,
        fitted=fitted,
        headline=first.headline
        or headline(
            which, wanted.catalogue, words, facts.missing, by_calibration, closed, changed, beyond, bool(alone), first.robot
        ),
    )
    return Examined(answer, rivals, first)


def confirmed(f: Attribution, first: Edited, catalogue: Mapping[str, EffectSpec]) -> FittedRobot:
    """The robot with what is named alone, fitted by the code of `lab fit --with` from where the diagnosis found it and from its
    own starts."""
    p, theta = f.prepared, f.prepared.common(f.best.fit.theta)
    start = dict(zip(p.problem.parameters.names, theta.tolist(), strict=True)) | {AREA_FACTOR: p.area_factor(theta)}
    known = p.noise_components
    made = fit_described(first.robot, first.states, f.decision.effects, catalogue, start=start, noise_components=known)
    values = {n: Value(s.value, s.sd, s.unit, n not in made.undetermined) for n, s in made.parameters.items()}
    return FittedRobot(made.effects, values, made.fitted_mm, made.calibrated_mm)
