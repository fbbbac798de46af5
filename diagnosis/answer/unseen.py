"""The gap on states that no fit saw: how far it shrinks, and step by step, in mm rms where it is looked for.

Before: the baseline, calibrated with one area factor. After: the named effects fitted too, every other effect free within the
tolerance that the data ask for. The share closed counts from the noise floor, its interval comes from drawing trials anew.

A step (docs/explanations/diagnosis.md lists them) is the decrease of the rms from one model to the next, so that all steps add up
to the gap as given; on unseen states it can be negative. Its interval is the 95 % range over trials drawn anew and, for a cause,
over all orders of adding the causes.

Another campaign, that no fit sees, is predicted by the baseline and the best hypothesis, both fitted to the diagnosed data alone;
what belongs to a trial is at its expectation. The interval comes from drawing its trials anew, within each spine length; of one
trial its `PARTS`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from model.effects.design import design_from_columns
from model.robot import LIMITS, Robot

from ..arrays import Array, Ints, Mask, rms, rows_by
from ..data.campaign import Campaign, places
from ..data.case import Case, states
from ..data.levels import SPINE_GAP, levels
from ..errors import BadCase, BadHoldout
from ..findings import Finding, finding
from ..inference.candidate import Candidate
from ..inference.cross_validation import CrossValidation, Model
from ..inference.evidence import NONE, Hypothesis
from ..inference.executor import SINGLE_THREAD, DiagnosisStep, Executor
from ..inference.fit import Fit, fit, fit_alone
from ..inference.on_baseline import SHARE
from ..inference.posterior import UNKNOWN
from ..inference.prepare import TINY, Prepared, table_columns
from ..judgement import EXPLAINS, RIVAL_PROBABILITY, SMOOTH_SIZES, UNCONVERGED
from .attribute import Attribution, calibrated
from .decision import share_closed
from .result import Holdout, LengthShrink, Shrink, Step, StepName, Waterfall

BY_ANALYSIS = {"thrust", "effects", "tolerances", "uncertainty", "area_factor", "posterior", "residual", "quoted_pressure",
               "quoted_time", "obstacle_azimuth_deg", *LIMITS}  # fmt: skip
"""Keys of robot.yaml that a diagnosis proposes or a fit writes, and limits: two that differ in these alone describe one body."""
PARTS = 8
"""Parts of equally many states that follow each other: as many as the trials of a usual campaign, each longer than a lag."""


@dataclass(frozen=True)
class Unseen:
    """What states say that no fit saw; nothing where no state was held out."""

    shrink: Shrink | None = None
    residuals: Mapping[str, Array] = field(default_factory=dict)
    """Measured minus predicted (values,): calibrated, and explained by the best hypothesis."""
    rms_mm: Mapping[Hypothesis, float] = field(default_factory=dict)
    """By which leading hypotheses miss them."""
    waterfall: Waterfall | None = None


def candidate_model(p: Prepared, c: Candidate) -> Model:
    """The model of a hypothesis: named effects wide, the others within their tolerance."""
    return Model(c.prior(p.problem.parameters), c.weighed.peak.size, c.fit.theta)


def left_out(p: Prepared, executor: Executor) -> tuple[CrossValidation, str] | None:
    """States in parts, each of which is predicted by fits to the others, and how: by spine length, where there are three, else by
    pressure, else by trial; None where there is but one part."""
    part, how = levels(p.states.spine_length, SPINE_GAP), "leave one spine length out"
    if len(np.unique(part)) < 3:
        part, how = levels(p.states.highest, p.states.pressure_gap), f"leave one {p.robot.actuators.words.pressure} out"
        if len(np.unique(part[~p.states.pushed])) < 3:
            part, how = np.unique(p.states.trial, return_inverse=True)[1], "leave one trial out"
    return (CrossValidation(p.problem, part[p.labels.state], executor), how) if part.any() else None


def distance(p: Prepared, residual: Array) -> Array:
    """(states,) m by which residuals (values,) miss where the gap is looked for; NaN where nothing was measured or predicted."""
    return np.asarray(np.linalg.norm(p.gap(residual), axis=1))


def unseen_states(
    p: Prepared, baseline: Fit, best: Candidate, executor: Executor
) -> Callable[[Attribution], Callable[[], Unseen]]:
    """Predict held-out states by the baseline and by what leads. Call the result with the answer to start the refits of its
    rivals and for its waterfall, and what that returns to wait for them."""
    found = left_out(p, executor)
    if found is None:
        return lambda f: Unseen
    parts, how = found
    models = [Model(p.problem.parameters.prior_of(NONE), 0.0, baseline.theta), candidate_model(p, best)]
    residuals = dict(zip(("calibrated", "explained"), parts.residuals(models, DiagnosisStep.HELD_OUT_STATES)(), strict=True))
    before, after = (distance(p, residual) for residual in residuals.values())

    def of(f: Attribution) -> Callable[[], Unseen]:
        leading = [h for h, q in f.posterior.ranking[:4] if h != UNKNOWN and q > RIVAL_PROBABILITY]
        others = [h for h in leading if h not in (NONE, f.best.named)]
        refits = parts.residuals([candidate_model(p, f.posterior.candidates[h]) for h in others], DiagnosisStep.GAP_STEP_BY_STEP)
        step_by_step = waterfall(f, parts, how, before, after)

        def finish() -> Unseen:
            missed = {NONE: before, f.best.named: after}
            missed |= {h: distance(p, residual) for h, residual in zip(others, refits(), strict=True)}
            seen = np.isfinite(before) & np.isfinite(after)
            shrunk = closed(how, before[seen], after[seen], p.noise_floor, p.states.take(seen), p.states.trial[seen])
            return Unseen(shrunk, residuals, {h: 1e3 * rms(missed[h]) for h in leading}, step_by_step())

        return finish

    return of


def waterfall(f: Attribution, parts: CrossValidation, how: str, before: Array, after: Array) -> Callable[[], Waterfall]:
    """Start the refits that the section `waterfall` needs besides the errors (states,) m `before` and `after`; the function
    returned waits for them.

    Refitted are the model with tolerances, unless its errors are known, that model with a smooth discrepancy of each of
    `SMOOTH_SIZES`, and a model of each subset of the named causes without tolerances.
    """
    p, named = f.prepared, f.decision.effects
    with_tolerances = candidate_model(p, f.best if named else f.posterior.candidates[NONE])
    subsets = [s for k in range(1, len(named) + 1) for s in itertools.combinations(named, k)]
    tolerant_is_known = bool(named) or f.best.named == NONE
    prior, start = with_tolerances.prior, with_tolerances.theta
    by_size = {size: fit(p.problem, prior, size, start, 4, least_promise=UNCONVERGED) for size in SMOOTH_SIZES}
    smooth = [replace(with_tolerances, size=size, theta=refit.theta, smooth=True) for size, refit in by_size.items()]
    alone = (Model(p.problem.parameters.prior_of(s), 0.0, fit_alone(p.problem, s, f.best.fit.theta, 4).theta) for s in subsets)
    models = [*([] if tolerant_is_known else [with_tolerances]), *smooth, *alone]
    refits = parts.residuals(models, DiagnosisStep.GAP_STEP_BY_STEP)

    def finish() -> Waterfall:
        in_order = (distance(p, residual) for residual in refits())
        tolerant = after if tolerant_is_known else next(in_order)
        # the size that predicts best; none where a smooth function predicts worse than no function
        with_smooth = min([tolerant, *(next(in_order) for _ in smooth)], key=lambda e: float(np.nanmean(e**2)))
        by_causes = {frozenset[str](): before} | {frozenset(subset): next(in_order) for subset in subsets}
        return _steps(p, named, by_causes, (tolerant, with_smooth), how)

    return finish


def _simulator_as_it_is(p: Prepared) -> Array | None:
    """Errors (states,) m of the simulator in the rod's place, calibrated and not taken back to the rod."""
    if p.baseline is None:
        return None
    made = p.problem.parameters
    sd = np.where(np.array(made.names) == SHARE, TINY, made.sd)
    own = replace(p, problem=replace(p.problem, parameters=replace(made, sd=sd)))
    found = left_out(own, SINGLE_THREAD)
    assert found is not None
    (residual,) = found[0].residuals([Model(own.problem.parameters.prior_of(NONE), 0.0, calibrated(own).theta)])()
    return distance(own, residual)


def _steps(
    p: Prepared, named: Hypothesis, by_causes: Mapping[frozenset[str], Array], after: Sequence[Array], how: str
) -> Waterfall:
    """The waterfall of errors (states,) m: `by_causes` of the models with some of the causes and no tolerance, `after` of those
    with tolerances and with a smooth discrepancy. Each step is the rms before it less the rms after it; the last two end at the
    noise floor and at 0."""
    given, as_it_is = distance(p, p.problem.observed - p.given), _simulator_as_it_is(p)
    before = [given, *([] if as_it_is is None else [as_it_is])]
    seen: Mask = np.asarray(np.isfinite([*by_causes.values(), *before, *after]).all(axis=0))  # predicted by every model

    def rms_of(errors: Array) -> Array:
        return np.sqrt(mean_squares(errors[seen], p.states.trial[seen]))

    of_causes = {causes: rms_of(errors) for causes, errors in by_causes.items()}
    order: Hypothesis = ()  # each cause the one that takes most of what the causes before it leave
    while rest := [e for e in named if e not in order]:
        order = (*order, min(rest, key=lambda e: float(of_causes[frozenset((*order, e))][0])))

    titles: list[tuple[StepName, str | None]] = [("calibration", None)]
    titles += [("simulator", None)] * (len(before) - 1)
    titles += [("cause", e) for e in order]
    titles += [("tolerances", None), ("regular", None), ("irregular", None), ("noise", None)]
    levels_m = [*map(rms_of, before), *(of_causes[frozenset(order[:k])] for k in range(len(order) + 1)), *map(rms_of, after)]
    levels_m += [np.full_like(levels_m[0], level) for level in (p.noise_floor, 0.0)]
    steps = []
    for (name, effect), higher, lower in zip(titles, levels_m[:-1], levels_m[1:], strict=True):
        decrease = taken = higher - lower
        if effect is not None:  # over draws, and over which others were added before it
            taken = np.concatenate([of_causes[c] - of_causes[c | {effect}] for c in of_causes if effect not in c])
        low, high = np.quantile(taken, [0.025, 0.975])
        steps.append(Step(name, effect, *(1e3 * float(x) for x in (decrease[0], low, high, lower[0]))))
    lost = int((np.isfinite(given) & ~seen).sum())
    return Waterfall(how, int(seen.sum()), 1e3 * float(levels_m[0][0]), tuple(steps), lost)


def closed(
    how: str, before: Array, after: Array, floor: float, states: Campaign, trial: Ints, kind: Ints | None = None
) -> Shrink:
    """The section `shrink`, from errors (n,) m of states that the fits did not see; `how` they were left out. Its interval draws
    trials (n,) anew, see `interval_closed`."""
    share = share_closed(rms(before), rms(after), floor)
    interval = None if share is None else interval_closed(before, after, floor, trial, kind)
    by_length = tuple(
        LengthShrink(float(np.round(states.spine_length[i].mean(), 6)), 1e3 * rms(before[i]), 1e3 * rms(after[i]), len(i))
        for i in rows_by(levels(states.spine_length, SPINE_GAP))
    )
    return Shrink(how, 1e3 * rms(before), 1e3 * rms(after), 1e3 * floor, share, interval, by_length)


def interval_closed(
    before: Array, after: Array, floor: float, trial: Ints, kind: Ints | None = None
) -> tuple[float, float] | None:
    """95 % interval of the share closed, from tip errors (n,) m of states; None from fewer than two trials.

    Trials are drawn anew among those of the same `kind` (n,), where given; kinds of one trial are drawn together.
    """
    if len(np.unique(trial)) < 2:
        return None
    # m^2 above the floor in each draw, before and after, as in `share_closed`
    reducible, remaining = (mean_squares(e, trial, kind)[1:] - floor**2 for e in (before, after))
    shares = 1 - remaining[reducible > 0] / reducible[reducible > 0]
    if not shares.size:
        return None
    low, high = np.quantile(shares, [0.025, 0.975])
    return float(low), float(high)


def mean_squares(errors: Array, trial: Ints, kind: Ints | None = None, draws: int = 500, seed: int = 31337) -> Array:
    """(1 + draws,) m^2 of errors (n,) m: of the data as they are, and with trials (n,) drawn anew among those of their kind."""
    _, first_state, index = np.unique(trial, return_index=True, return_inverse=True)
    _, of_trial, count = np.unique((trial * 0 if kind is None else kind)[first_state], return_inverse=True, return_counts=True)
    rng = np.random.default_rng(seed)
    drawn = np.tile(np.arange(len(of_trial)), (1 + draws, 1))
    for group in rows_by(np.where(count[of_trial] < 2, -1, of_trial)):
        drawn[1:, group] = group[rng.integers(0, group.size, (draws, group.size))]
    return np.asarray(np.bincount(index, errors**2)[drawn].sum(axis=1) / np.bincount(index)[drawn].sum(axis=1))


# ------------------------------------------------------------------ a campaign that the fit never sees
def other_campaign(diagnosed: Case, other: Case) -> tuple[Campaign, tuple[Finding, ...]]:
    """The states of `other` with a tip, and a finding if its robot.yaml differs in keys of `BY_ANALYSIS`; raises `BadHoldout`
    when it has no such state, has another robot or shares states."""
    differing = [key for key in Robot.model_fields if getattr(diagnosed.robot, key) != getattr(other.robot, key)]
    if foreign := [key for key in differing if key not in BY_ANALYSIS]:
        raise BadHoldout(
            f"its robot.yaml differs from the diagnosed one in {', '.join(foreign)}; hold out a campaign of the same robot, or "
            "give both the same robot.yaml with --robot"
        )
    try:
        campaign, _ = states(other)
    except BadCase as e:
        raise BadHoldout(str(e)) from e
    with_tip = campaign.take(~campaign.pushed)
    if not len(with_tip) or not diagnosed.table.with_tip.any():
        empty = "the held-out campaign" if not len(with_tip) else "the diagnosed campaign"
        raise BadHoldout(
            f"a held-out test compares tips, and {empty} has none: stiffness trials alone cannot be held out, "
            "nor tested on a bending run; diagnose and hold out bending or elongation runs"
        )
    # no two readings have the same tip, pressures and spine length to the last digit
    known, others = (np.column_stack([t.tip, t.pressures, t.spine_length]) for t in (diagnosed.table, with_tip.trials))
    fitted_states = set(map(tuple, known.tolist()))
    if shared := sum(tuple(state) in fitted_states for state in others.tolist()):
        raise BadHoldout(
            f"{shared} of its {len(with_tip)} states are among those diagnosed, so the fit saw them; "
            "give a campaign that is not among the inputs"
        )
    return with_tip, (finding("held_out_as_diagnosed", keys=", ".join(differing)),) if differing else ()


def evaluate_holdout(f: Attribution, other: Campaign) -> Holdout:
    """Predict the states `other` of another campaign with what was found; raises `BadHoldout`."""
    before, after = (_tip_errors(f.prepared, other, theta) for theta in (f.calibrated.theta, f.best.fit.theta))
    predicted = np.isfinite(before) & np.isfinite(after)
    if not predicted.any():
        raise BadHoldout("the rod model has no equilibrium at any of its states: check pressures, masses and units")
    before, after, kept = before[predicted], after[predicted], other.take(predicted)
    length, trials = levels(kept.spine_length, SPINE_GAP), len(np.unique(kept.trial))
    parts = kept.trial if trials > 1 else np.arange(len(kept)) * PARTS // len(kept)
    shrunk = closed("predicted by fits to the diagnosed campaign", before, after, f.prepared.noise_floor, kept, parts, length)
    named, interval = f.decision.verdict == "effect", shrunk.ci95
    verdict: Literal["confirmed", "contradicted", "open"] = "open"
    if named and interval is not None:
        verdict = "confirmed" if interval[0] >= EXPLAINS else "contradicted" if interval[1] < 0 else "open"
    return Holdout(
        **vars(shrunk), states=len(kept), trials=trials, unsolved=int((~predicted).sum()),
        hypothesis=f.best.named, named=named, verdict=verdict,
    )  # fmt: skip


def _tip_errors(p: Prepared, own: Campaign, theta: Array) -> Array:
    """Tip distance (n,) m at the lasting parameters of `theta`, those of trials at 0; NaN where the rod has no equilibrium."""
    forward = p.forward.on(design_from_columns(p.robot, table_columns(own)))
    fitted = dict(zip(p.problem.parameters.names, theta, strict=True))
    predicted = forward.predict(np.array([fitted.get(i.name, 0.0) if i.lasts else 0.0 for i in forward.parameters]))
    tip = places(len(own), forward.observations.row, forward.observations.channel, predicted)
    return np.asarray(np.linalg.norm(own.tip - tip, axis=1))
