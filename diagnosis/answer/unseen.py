"""What states say that no fit saw: how far the gap shrinks, how leading hypotheses predict, the gap step by step."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from ..inference.evidence import NONE, Hypothesis
from ..inference.executor import DiagnosisStep, Executor
from ..inference.posterior import UNKNOWN
from ..judgement import RIVAL_PROBABILITY
from .attribute import Attribution
from .result import Shrink, Waterfall
from .shrink import HeldOut, HeldOutErrors, candidate_model, shrink
from .waterfall import waterfall


@dataclass(frozen=True)
class Unseen:
    """Nothing where no state was held out."""

    shrink: Shrink | None = None
    errors: HeldOutErrors | None = None
    rms_mm: Mapping[Hypothesis, float] = field(default_factory=dict)
    """By which leading hypotheses miss them."""
    waterfall: Waterfall | None = None


def unseen(f: Attribution, executor: Executor) -> Callable[[], Unseen]:
    """Start all refits; the function that is returned waits for them."""
    held_out = HeldOut.of(f.prepared, executor)
    if held_out is None:
        return Unseen
    shrinking, listing = shrink(f.prepared, f.calibrated, f.best, held_out), _leading_rms(f, held_out)
    falling = waterfall(f, held_out)

    def found() -> Unseen:
        shrunk, errors = shrinking()
        return Unseen(shrunk, errors, listing(errors), falling(errors))

    return found


def _leading_rms(f: Attribution, held_out: HeldOut) -> Callable[[HeldOutErrors], dict[Hypothesis, float]]:
    """Start the refits of the leading hypotheses that `shrink` does not make; the function that is returned waits for them and
    returns the rms error (mm) of each leading hypothesis on states that it did not see."""
    leading = [h for h, share in f.posterior.ranking[:4] if h != UNKNOWN and share > RIVAL_PROBABILITY]
    rest = [h for h in leading if h not in (NONE, f.best.named)]
    errors = held_out.errors(
        [candidate_model(f.prepared, f.posterior.candidates[h]) for h in rest], DiagnosisStep.HELD_OUT_STATES
    )

    def found(unseen: HeldOutErrors) -> dict[Hypothesis, float]:
        known = {NONE: unseen.before, f.best.named: unseen.after, **dict(zip(rest, errors(), strict=True))}
        return {h: 1e3 * float(np.sqrt(np.nanmean(known[h].distance ** 2))) for h in leading}

    return found
