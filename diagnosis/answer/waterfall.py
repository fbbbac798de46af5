"""The gap on states that the fits did not see: how far it shrinks, and step by step, in mm rms where it is looked for.

    as given          the model of robot.yaml, nothing fitted
    calibration       one area factor, and the tolerances of geometry, frames and trials
    simulator         where one takes the rod's place: how far it is taken back to the rod
    cause             each effect that is named, the largest first
    tolerances        every other effect, within the tolerance that the data ask for
    regular           what a smooth function of the state, fitted to what is left of other states, predicts of this one
    irregular         what is left above the noise floor
    noise             the noise floor: repeats of a state differ by as much

A step is the decrease of the rms from one model to the next, so that all steps add up to the gap as given; on unseen states it
can be negative. Its interval is the 95 % range over trials drawn anew and, for a cause, over all orders of adding the causes.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..arrays import Array, Mask
from ..data.levels import SPINE_GAP, levels
from ..inference.cross_validation import Model
from ..inference.evidence import NONE, Hypothesis
from ..inference.executor import SINGLE_THREAD, DiagnosisStep, Executor
from ..inference.fit import fit
from ..inference.posterior import UNKNOWN
from ..inference.prepare import Prepared, prepare
from ..judgement import RIVAL_PROBABILITY, SMOOTH_SIZES, UNCONVERGED
from .attribute import Attribution, Begun, calibrated
from .result import Absorbed, Shrink, Step, StepName, Waterfall
from .shrink import HeldOut, HeldOutErrors, baseline_model, candidate_model, closed, resampled, rms


@dataclass(frozen=True)
class Unseen:
    """What states say that no fit saw; nothing where no state was held out."""

    shrink: Shrink | None = None
    errors: HeldOutErrors | None = None
    rms_mm: Mapping[Hypothesis, float] = field(default_factory=dict)
    """By which leading hypotheses miss them."""
    waterfall: Waterfall | None = None


class UnseenStates:
    """Held-out states, as the baseline and what leads predict them; refits of all else once the answer is known."""

    def __init__(self, p: Prepared, begun: Begun, executor: Executor) -> None:
        self._p, self._held_out = p, HeldOut.of(p, executor)
        if self._held_out is not None:
            models = [baseline_model(p, begun.calibrated), candidate_model(p, begun.weighed.best)]
            self._errors = HeldOutErrors(*self._held_out.errors(models, DiagnosisStep.HELD_OUT_STATES)())

    def of(self, f: Attribution) -> Callable[[], Unseen]:
        """Start the refits that an answer needs: of its rivals and for its waterfall; the function returned waits for them."""
        p, held_out = self._p, self._held_out
        if held_out is None:
            return Unseen
        errors, leading = self._errors, [h for h, q in f.posterior.ranking[:4] if h != UNKNOWN and q > RIVAL_PROBABILITY]
        others = [h for h in leading if h not in (NONE, f.best.named)]
        refits = held_out.errors([candidate_model(p, f.posterior.candidates[h]) for h in others], DiagnosisStep.GAP_STEP_BY_STEP)
        step_by_step = waterfall(f, held_out, errors)

        def finish() -> Unseen:
            errors_of = {NONE: errors.before, f.best.named: errors.after, **dict(zip(others, refits(), strict=True))}
            rms_mm = {h: 1e3 * rms(errors_of[h].distance) for h in leading}
            before, after = errors.before.distance, errors.after.distance
            seen = np.isfinite(before) & np.isfinite(after)
            shrunk = closed(held_out.how, before[seen], after[seen], p.noise_floor, p.states.take(seen))
            return Unseen(shrunk, errors, rms_mm, step_by_step())

        return finish


def waterfall(f: Attribution, held_out: HeldOut, errors: HeldOutErrors) -> Callable[[], Waterfall]:
    """Start the refits that the section `waterfall` needs besides the held-out `errors`; the function returned waits for them.

    Refitted are the model with tolerances, unless its errors are known, that model with a smooth discrepancy of each of
    `SMOOTH_SIZES`, and a model of each subset of the named causes without tolerances.
    """
    p, named = f.prepared, f.decision.effects
    with_tolerances, subsets = candidate_model(p, f.best if named else f.none), _subsets(named)
    tolerant_is_known = bool(named) or f.best.named == NONE
    smooth = [_smooth(p, with_tolerances, size) for size in SMOOTH_SIZES]
    models = [*([] if tolerant_is_known else [with_tolerances]), *smooth, *(_only(f, s) for s in subsets)]
    refits, absorbed = held_out.errors(models, DiagnosisStep.GAP_STEP_BY_STEP), _absorbed(f, held_out.executor)

    def finish() -> Waterfall:
        in_order = (missed.distance for missed in refits())
        tolerant = errors.after.distance if tolerant_is_known else next(in_order)
        # the size that predicts best; none where a smooth function predicts worse than no function
        with_smooth = min([tolerant, *(next(in_order) for _ in smooth)], key=lambda e: float(np.nanmean(e**2)))
        by_causes = {frozenset[str](): errors.before.distance}
        by_causes |= {frozenset(subset): next(in_order) for subset in subsets}
        return replace(_steps(p, named, by_causes, (tolerant, with_smooth), held_out.how), absorbed=absorbed())

    return finish


def _subsets(named: Hypothesis) -> list[Hypothesis]:
    return [s for k in range(1, len(named) + 1) for s in itertools.combinations(named, k)]


def _smooth(p: Prepared, model: Model, size: float) -> Model:
    """The same model with a smooth discrepancy that predicts too."""
    theta = fit(p.problem, model.prior, size, model.theta, 4, least_promise=UNCONVERGED).theta
    return replace(model, size=size, theta=theta, smooth=True)


def _only(f: Attribution, named: Hypothesis) -> Model:
    """These effects and no tolerance of others."""
    problem, p = f.prepared.problem, f.prepared.problem.parameters
    prior = p.prior(p.mask(named), 0.0)
    start = np.where(np.isin(p.effects, ["", *named]), f.best.fit.theta, p.mean)
    return Model(prior, 0.0, fit(problem, prior, 0.0, start, 4).theta)


def _simulator_as_it_is(p: Prepared) -> Array | None:
    """Errors (states,) m of the simulator in the rod's place, calibrated and not taken back to the rod."""
    if p.baseline is None:
        return None
    own = p.simulator_as_it_is
    held_out = HeldOut.of(own, SINGLE_THREAD)
    assert held_out is not None
    return held_out.errors([baseline_model(own, calibrated(own))])()[0].distance


def _steps(
    p: Prepared, named: Hypothesis, by_causes: Mapping[frozenset[str], Array], after: Sequence[Array], how: str
) -> Waterfall:
    """The waterfall of errors (states,) m: `by_causes` of the models with some of the causes and no tolerance, `after` of those
    with tolerances and with a smooth discrepancy. Each step is the rms before it less the rms after it; the last two end at the
    noise floor and at 0."""
    given, as_it_is = np.linalg.norm(p.gap(p.problem.observed - p.given), axis=1), _simulator_as_it_is(p)
    before = [given, *([] if as_it_is is None else [as_it_is])]
    seen: Mask = np.asarray(np.isfinite([*by_causes.values(), *before, *after]).all(axis=0))  # predicted by every model
    again = resampled(p.states.trial[seen])
    weights = np.vstack([np.ones(again.shape[1]), again])

    def rms_of(errors: Array) -> Array:
        """(draws,) m, the data as they are first."""
        return np.asarray(np.sqrt(weights @ errors[seen] ** 2 / weights.sum(axis=1)))

    of_causes = {causes: rms_of(errors) for causes, errors in by_causes.items()}
    order: Hypothesis = ()  # each cause the one that takes most of what the causes before it leave
    while rest := [e for e in named if e not in order]:
        order = (*order, min(rest, key=lambda e: float(of_causes[frozenset((*order, e))][0])))

    def in_any_order(effect: str) -> Array:
        """(..,) m that a cause takes: over draws, and over which others were added before it."""
        others = [causes for causes in of_causes if effect not in causes]
        return np.concatenate([of_causes[causes] - of_causes[causes | {effect}] for causes in others])

    titles: list[tuple[StepName, str | None]] = [("calibration", None)]
    titles += [("simulator", None)] * (len(before) - 1)
    titles += [("cause", e) for e in order]
    titles += [("tolerances", None), ("regular", None), ("irregular", None), ("noise", None)]
    levels_m = [*map(rms_of, before), *(of_causes[frozenset(order[:k])] for k in range(len(order) + 1)), *map(rms_of, after)]
    levels_m += [np.full(len(weights), p.noise_floor), np.zeros(len(weights))]
    steps = []
    for (name, effect), higher, lower in zip(titles, levels_m[:-1], levels_m[1:], strict=True):
        decrease = higher - lower
        low, high = np.quantile(decrease if effect is None else in_any_order(effect), [0.025, 0.975])
        steps.append(Step(name, effect, *(1e3 * float(x) for x in (decrease[0], low, high, lower[0]))))
    return Waterfall(how, int(seen.sum()), 1e3 * float(levels_m[0][0]), tuple(steps), None)


def _absorbed(f: Attribution, executor: Executor) -> Callable[[], Absorbed | None]:
    """Start what shows how much of the tip's gap an area factor for each spine length would hide, each pressure left out in
    turn: call the result for it. It is None for pushes, a simulator, one length, or fewer than three pressures."""
    p = f.prepared
    length, pressure = levels(p.states.spine_length, SPINE_GAP), levels(p.states.highest, p.states.pressure_gap)
    if p.pushes_only or p.baseline is not None or len(np.unique(length)) < 2 or len(np.unique(pressure)) < 3:
        return lambda: None
    how = f"leave one {p.robot.actuators.words.pressure} out"
    models = [baseline_model(p, f.calibrated), *([candidate_model(p, f.best)] if f.decision.effects else [])]
    errors = HeldOut(p, pressure, how, executor).errors(models, DiagnosisStep.GAP_STEP_BY_STEP)

    def absorbed() -> Absorbed:
        by_length = prepare(p.robot, p.states, "per_length", catalogue={}, noise_components=p.noise_components)
        (per_length,) = HeldOut(by_length, pressure, how).errors([baseline_model(by_length, calibrated(by_length))])()
        one_factor, *with_causes = (missed.distance for missed in errors())
        finite = np.isfinite([one_factor, per_length.distance, *with_causes]).all(axis=0)
        of_causes = next((1e3 * rms(errors_m[finite]) for errors_m in with_causes), None)
        return Absorbed(how, 1e3 * rms(one_factor[finite]), 1e3 * rms(per_length.distance[finite]), of_causes)

    return absorbed
