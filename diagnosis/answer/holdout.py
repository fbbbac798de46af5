"""A campaign that the fit never sees: what the named effect does to the tip error there.

The calibrated baseline and the best hypothesis, both fitted to the diagnosed data alone, predict the other campaign; what belongs
to a trial is at its expectation. The share closed counts from the noise floor of the diagnosed campaign; its interval comes from
drawing the other campaign's trials anew, within each spine length; of one trial its `PARTS`.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from model.effects.design import design_from_columns
from model.robot import LIMITS, Robot

from ..arrays import Array
from ..data.campaign import Campaign, places
from ..data.case import Case, states
from ..data.levels import SPINE_GAP, levels
from ..errors import BadCase, BadHoldout
from ..findings import Finding, finding
from ..inference.prepare import Prepared, table_columns
from ..judgement import EXPLAINS
from .attribute import Attribution
from .result import Holdout
from .unseen import closed

BY_ANALYSIS = {"thrust", "effects", "tolerances", "uncertainty", "area_factor", "posterior", "residual", "quoted_pressure",
               "quoted_time", "obstacle_azimuth_deg", *LIMITS}  # fmt: skip
"""Keys of robot.yaml that a diagnosis proposes or a fit writes, and limits: two that differ in these alone describe one body."""
PARTS = 8
"""Parts of equally many states that follow each other: as many as the trials of a usual campaign, each longer than a lag."""


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
