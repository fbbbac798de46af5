"""The verdict and its wording.

    best supported     one cause leads; called confirmed only after an experiment that the fit did not see agrees
    tied with ..       others explain the data as well; what would break the tie is named
    outside the catalogue
    below the floor    nothing significant

Probabilities are given with the benchmark that they were calibrated on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..criticism.probability_calibration import ProbabilityCalibration
from ..criticism.stage_errors import StageError
from ..inference.evidence import NONE
from ..inference.posterior import UNKNOWN, Posterior
from .result import Carries, Locate, Shrink, Verdict


@dataclass(frozen=True)
class Decision:
    """What is answered."""

    verdict: Verdict
    effects: tuple[str, ...]
    probability: float


def _present(budget: Sequence[Carries], digits: int) -> str:
    """What is there without being a cause."""
    found = ", ".join(f"{c.effect} {c.mm:.{digits}f} mm" for c in budget if c.role == "present")
    return f" Also present: {found}." if found else ""


def decide(posterior: Posterior, calibrated: ProbabilityCalibration, enough: bool) -> Decision:
    """Effect, none or unknown; with too little data (`enough` false) nothing is named however well it fits."""
    outside = posterior.probability(UNKNOWN)
    named, probability = next((h, p) for h, p in posterior.ranking if h != UNKNOWN)
    if not enough or outside >= calibrated.unknown_threshold:
        return Decision("unknown", (), outside)
    if named == NONE:
        return Decision("none", (), probability)
    return Decision("effect", named, probability)


def statement(
    d: Decision, posterior: Posterior, where: Locate, shrunk: Shrink | None, rivals: Sequence[str], tie_breaker: str | None,
    odd_trial: int | None, benchmark: str, budget: Sequence[Carries] = (),
    asking: Sequence[StageError] = (),
) -> str:  # fmt: skip
    """The verdict in a few sentences; `tie_breaker` is the experiment that would separate the candidates best."""
    gap, floor = where.gap_rmse_mm, where.noise_floor_mm
    # Deflections of stiffness trials are small.
    what, digits = ("the tip", 2) if where.of == "tip" else ("the deflections of the stiffness trials", 3)
    head = f"The calibrated model misses {what} by {gap:.{digits}f} mm rms; the noise floor is {floor:.{digits}f} mm."
    sure = f"p = {d.probability:.2f}, {benchmark}"
    if d.verdict == "none":
        return f"{head} No cause: nothing carries enough above the noise floor ({sure}).{_present(budget, digits)}"
    if d.verdict == "unknown":
        odd = f" Trial {odd_trial} does not fit with the others: look at it first." if odd_trial is not None else ""
        near = next((h for h, _ in posterior.ranking if h not in (NONE, UNKNOWN)), None)
        nearest = f" What comes nearest is {' and '.join(near)}, which does not explain it." if near else ""
        asks = (
            f" The readings ask for an error of the {asking[0].stage} that goes with {asking[0].dependence}."
            if asking
            else ""
        )
        return f"{head} No cause can be named: outside the catalogue, or too little data ({sure}).{asks}{nearest}{odd}"
    tied = f", tied with {', '.join(rivals)}" if rivals else ""
    broken = f", broken by: {tie_breaker}" if rivals and tie_breaker else ""
    share = "; ".join(
        f"{c.effect} carries {c.mm:.{digits}f} mm, {c.low95_mm:.{digits}f} to {c.high95_mm:.{digits}f}"
        for c in budget
        if c.role == "named"
    )
    carried = f" After calibration {share}." if share else ""
    text = f"{head} Best supported cause: {' and '.join(d.effects)} ({sure}){tied}{broken}.{carried}"
    if shrunk is None:
        return text + _present(budget, digits)
    closed = (
        f", {min(shrunk.share_closed, 1.0) * 100:.0f} % of what can be closed"
        if shrunk.share_closed is not None
        else ""
    )
    left = f"With it {shrunk.after_mm:.{digits}f} mm are left on data that the fit did not see{closed}."
    return f"{text}{_present(budget, digits)} {left}"


def stiffness_sentence(pushes: Mapping[str, Any], d: Decision) -> str:
    """A sentence about the stiffness trials beside tips; `pushes` is the diagnosis' detail of them."""
    missed, floor = pushes["waterfall_mm"], pushes["floor_mm"]
    text = (
        f"Of the stiffness trials it misses the deflections by {missed['calibrated']:.3f} mm rms (floor {floor:.3f} mm)"
    )
    if d.verdict != "effect":
        return f"{text}."
    return f"{text}, with the cause by {missed['explained']:.3f} mm."
