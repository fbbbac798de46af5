"""What is answered, as deep as the data carry. `sentences` has the words, docs/explanations/diagnosis.md explains them.

cause             named, with a probability of 0.9 at least, no relative outside the catalogue does the same, and no `doubts`
one of several    named with less: the data do not exclude others
stage             outside the catalogue; one stage of the chain asks for an error of its own
outside           outside the catalogue
none              no effect accounts for enough above the noise floor
noise             the same, and nowhere is the gap above the noise
too little data   the table lacks what it takes to name a cause
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from .. import judgement
from ..criticism.stage_errors import StageError
from ..findings import Finding, finding
from ..inference.evidence import NONE
from ..inference.posterior import UNKNOWN, EffectPosterior
from .decision import Decision
from .result import Carries, Conclusion, FittedRobot, Shrink
from .shrink import share_closed
from .size import Size


def rivals(d: Decision, posterior: EffectPosterior) -> tuple[str, ...]:
    """Effects of the 95 % set that are not named, most probable first; only where an effect is named and not sure."""
    if d.verdict != "effect" or d.probability >= judgement.CAUSE_PROBABILITY:
        return ()
    others = (h for h in posterior.credible_set if h not in (NONE, UNKNOWN, d.effects))
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
    """Why effects (id -> name) are no certain cause: their sizes, what they carry, what they leave on unseen states, and what the
    robot with them alone does. `alone`: names of effects that do as well without any calibration; `follows_law`: whether the
    readings follow the catalogue's. (That another is the cause if laws are more or less wrong needs no doubt: probabilities are
    means over how wrong they are.)"""
    low = {c.effect: c.low95_mm for c in budget}
    for effect, name in effects.items():
        if any(s.impossible for s in sizes if s.effect == effect):
            yield finding("cause_impossible", effect=name)
        elif low.get(effect, math.inf) < judgement.LEAST_NAMED_FLOORS * floor_mm:
            yield finding("cause_undetermined", effect=name)
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
        yield finding("fit_not_reached", effect=" and ".join(effects.values()), mm=fitted.left_mm, promised_mm=unseen.after_mm)


def conclude(d: Decision, gap: bool, asking: Sequence[StageError], tense: bool = False) -> Conclusion:
    """As deep as the data carry; `gap` whether it is anywhere above the noise floor, `tense` whether anything speaks against a
    certain cause, such as a number of robot.yaml that the fit moves far beyond its tolerance, or `doubts`."""
    if not d.enough:
        return "too little data"
    if d.verdict == "effect":
        sure = d.probability >= judgement.CAUSE_PROBABILITY and not tense and not d.relatives
        return "cause" if sure else "one of several"
    if d.verdict == "none":
        return "none" if gap else "noise"
    return "stage" if stage(asking) else "outside"


def stage(asking: Sequence[StageError]) -> StageError | None:
    """The stage that asks for an error of its own, with what the error goes with most; None where none stands out."""
    if not asking:
        return None
    gains = np.exp((np.array([e.gain for e in asking]) - max(e.gain for e in asking)) / judgement.TEMPERATURE)
    own = np.array([e.stage == asking[0].stage for e in asking])
    return asking[0] if gains[own].sum() >= judgement.STAGE_SHARE * gains.sum() else None
