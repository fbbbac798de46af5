"""The whole diagnosis of one case: pure, seeded, silent.

from diagnosis.diagnose import diagnose

answer = diagnose(case)          # case.robot, case.table
answer.statement, answer.attribute.verdict, answer.to_json()
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from model.effects.catalogue import CATALOGUE
from model.effects.spec import EffectSpec
from model.robot import THRUST
from model.stated import AREA_FACTOR

from . import judgement
from .answer import sentences, verdict
from .answer.attribute import Attribution, attribute, calibrated, related_ahead
from .answer.calibration import alone_as_good, calibration, simulator
from .answer.decision import behaves_like, capped, doubted
from .answer.detail import detail
from .answer.experiments import propose
from .answer.headline import headline
from .answer.locate import locate
from .answer.result import Diagnosis, FittedRobot
from .answer.rivals import Rivals
from .answer.unseen import Unseen, evaluate_holdout, other_campaign, unseen_states
from .data.campaign import Campaign
from .data.case import Case, states
from .data.drift import drift
from .data.shift import shifted
from .edits.order import ORDER
from .edits.search import Edited
from .errors import FAR_OFF, BadCase
from .findings import Finding, finding
from .fit_effects import fit_described
from .inference.budget import weighed
from .inference.executor import SINGLE_THREAD, Executor, one_thread
from .inference.on_baseline import Baseline
from .inference.prepare import AREA, Prepared, parts, prepare
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
    holdout: Case | None = None
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


def diagnose(case: Case, options: Options | None = None) -> Diagnosis:
    """Diagnose a case: where the gap lies, its most probable cause, how far it shrinks, and what to do next.

    `case` has a robot and its table of trials. Raises `BadCase` or `BadHoldout` when the table, or the campaign held out,
    cannot be used.

    >>> from pathlib import Path
    >>> from model.robot import load_robot
    >>> from recordings.table_file import read_csv
    >>> case = Case(load_robot(Path("robot.yaml")), read_csv(Path("campaign/trials.csv")))
    >>> one = {"chamber_azimuth": CATALOGUE["chamber_azimuth"]}
    >>> answer = diagnose(case, Options(quantify=False, experiments=False, catalogue=one))
    >>> answer.data.rows, answer.data.trials, answer.locate.of
    (18, 6, 'tip')
    """
    return examine(case, options).diagnosis


@one_thread()
def examine(case: Case, options: Options | None = None) -> Examined:
    """Diagnose as `diagnose` does; also the hypotheses still in play, which predict what an experiment would give."""
    options = options or Options()
    prepared, settled, edited, findings, held_out_states = _prepared(case, options)
    leading = weighed(prepared.problem, parts(prepared), options.executor)
    # Another process fits relatives of what leads, and later predicts what was held out, while this one does the rest.
    relatives, baseline = related_ahead(prepared, leading, options.executor), calibrated(prepared)
    predicting = unseen_states(prepared, baseline, leading.best, options.executor) if options.quantify else lambda f: Unseen
    causes = attribute(prepared, leading, baseline, relatives)
    del leading, relatives  # with derivatives of the search, most of the memory
    predict_unseen = predicting(causes)
    rivals = Rivals(prepared, causes.posterior, causes.distinguishability)
    proposals = propose(causes, rivals, options.executor) if options.experiments else ()
    location = locate(causes)
    unseen = predict_unseen()
    follows_law = causes.decision.verdict != "unknown"
    closed = None if (shrunk := unseen.shrink) is None else shrunk.share_closed
    decision = behaves_like(causes.decision, causes.best.named, causes.posterior, closed)
    if shrunk is not None and shrunk.after_mm > judgement.LEFT_FLOORS * shrunk.floor_mm:
        decision = capped(decision, closed)
    causes = replace(causes, decision=decision)
    words = case.robot.actuators.words
    names = {e: spec.name(words) for e, spec in options.catalogue.items()}
    holdout = evaluate_holdout(causes, held_out_states) if held_out_states is not None else None
    reasons: tuple[Finding, ...] = ()
    fitted, values = None, None  # the robot with what is named, and its parameters
    if causes.decision.effects and options.baseline is None and location.of == "tip":
        fitted = confirmed(causes, edited, options.catalogue)
        values = {name: v.value for name, v in fitted.parameters.items()}
        values[AREA] = prepared.area_parameter(values[AREA_FACTOR])
    details = detail(causes, fitted, unseen.residuals, names)
    # what speaks against the cause: numbers of robot.yaml that are far off, and doubts of what is named
    tense = causes.tense(values)
    adjusted = calibration(causes, values, {i for moved in tense.values() for i in moved})
    far = tuple(sentences.far_off(adjusted.stiffness, words)) if adjusted is not None and options.baseline is None else ()
    alone, named_sizes = alone_as_good(adjusted, causes), causes.sizes(causes.best, fitted)
    carries = verdict.budget_section(causes)
    named = {e: sentences.with_id(e, names) for e in causes.decision.effects}
    own_errors = causes.stage_errors[:2] if named else ()
    first = [*shifted(case.table, case.robot.length), *(f for f in (settled,) if f is not None and f.code == "thrust_likely")]
    first += drift(edited.states.take(~edited.states.pushed))
    unsettled = (*far, *edited.changes, *tense, *first)
    if named:
        floor_mm, as_good = location.noise_floor_mm, [sentences.with_id(e, names) for e in alone]
        reasons = tuple(verdict.doubts(named, named_sizes, carries, unseen.shrink, fitted, floor_mm, as_good, follows_law))
        others = [sentences.with_id(e, names) for e in verdict.rivals(causes.decision, causes.posterior)]
        if others and (straight := case.table.moved_to_model):
            reasons = (finding("cause_hidden_at_rest", others=" or ".join(others), straight=straight), *reasons)
        causes = replace(causes, decision=doubted(causes.decision, (*reasons, *unsettled), len(alone)))
    too_far = partial(sentences.beyond_tolerance, prepared, causes.best.fit, edited.robot)
    stated = {} if causes.decision.verdict == "unknown" else tense  # a cause that is not known moves them, too
    answer = Diagnosis(
        statement="",
        data=verdict.data_section(prepared, case.table),
        locate=location,
        attribute=verdict.attribute_section(causes, location.significant, unseen.rms_mm, reasons, fitted, bool(unsettled)),
        shrink=unseen.shrink,
        next_experiment=proposals,
        findings=(
            *edited.concerns,
            *first,
            *(f for f in (*findings, settled) if f is not None and f not in first),
            *reasons,
            *far,
            *sentences.to_look_at(prepared, {size.name: size for size in named_sizes}),
            *sentences.tracked_turn(prepared, causes.best.fit.theta),
            *(too_far(moved, fit, sentences.within_with_effect(causes, moved, names)) for fit, moved in stated.items()),
            *sentences.scatter(prepared, location.noise_floor_mm),
            *sentences.ramps_assumed(edited.states, [options.catalogue[e] for e in causes.decision.effects], words),
            *(finding("stage_error", stage=e.stage, varies=words.fill(e.varies), gain=e.gain) for e in own_errors),
            *([finding("residual_ignored")] if case.robot.residual is not None else ()),
            *(finding("as_read", text=text) for text in case.table.warnings),
        ),
        detail=details | ({"first_calibration": edited.detail()} if edited.changes else {}),
        budget=carries,
        waterfall=unseen.waterfall,
        holdout=holdout,
        calibration=adjusted,
        simulator=simulator(causes),
        fitted=fitted,
    )
    # what was settled before the diagnosis comes before its statement, and is a cause, too
    text, section = sentences.statement(answer), answer.attribute
    if edited.changes:
        text = f"Calibrated first: {'; '.join(map(str, edited.changes))}. {'Beyond that: ' if edited.with_order else ''}{text}"
    if edited.with_order:
        section = verdict.beside(section, ORDER, edited.robot)
    if settled is not None and settled not in first and section.verdict == "none":
        section, text = verdict.beside(section, THRUST, edited.robot), f"{settled}. Beyond that: {text}"
    answer = replace(answer, statement=text, attribute=section)
    changed = edited.named or sentences.changed_by(answer)
    beyond = edited.at_bound or (adjusted is not None and adjusted.at_bound)
    by_calibration = sentences.closed_by_calibration(answer)
    line = edited.headline or headline(answer, options.catalogue, by_calibration, changed, beyond, bool(alone))
    return Examined(replace(answer, headline=line), rivals, edited)


def _prepared(case: Case, options: Options) -> tuple[Prepared, Finding | None, Edited, tuple[Finding, ...], Campaign | None]:
    """The problem of a case; the thrust and the edits of robot.yaml that were settled before, findings on the table, and the
    states that are held out, edited alike."""
    campaign, findings = states(case)
    held_out, on_robots = other_campaign(case, options.holdout) if options.holdout is not None else (None, ())
    findings += on_robots
    baseline = options.baseline.take(campaign.row) if options.baseline is not None else None
    settled, edited = None, Edited(case.robot, campaign)
    if baseline is None:
        settled, edited = settled_and_edited(case.robot, campaign, options.catalogue, options.catalogue)
    try:
        catalogue = dict(options.catalogue)
        if edited.robot.thrust == "walls":  # stated or settled, the share that they take is known no better than its law
            catalogue[THRUST] = replace(catalogue[THRUST], tolerated=True)
        prepared = prepare(edited.robot, edited.states, catalogue=catalogue, baseline=baseline)
    except np.linalg.LinAlgError as error:
        raise BadCase(f"the model of robot.yaml is too far from these data to be compared with them: {FAR_OFF}") from error
    if edited.changes:
        prepared = replace(prepared, described=(case.robot, campaign))
        held_out = None if held_out is None else edited.moved(held_out)
    return prepared, settled, edited, findings, held_out


def confirmed(f: Attribution, edited: Edited, catalogue: Mapping[str, EffectSpec]) -> FittedRobot:
    """The robot with what is named alone, fitted by the code of `lab fit --with` from where the diagnosis found it and from its
    own starts."""
    p, theta = f.prepared, f.prepared.common(f.best.fit.theta)
    start = dict(zip(p.problem.parameters.names, theta.tolist(), strict=True)) | {AREA_FACTOR: p.area_factor(theta)}
    noise = p.noise_components
    fit = fit_described(edited.robot, edited.states, f.decision.effects, catalogue, start=start, noise_components=noise)
    return FittedRobot(fit.effects, fit.parameters, fit.left_mm, fit.calibrated_mm)
