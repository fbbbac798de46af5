"""The parts of the answer, from what was found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from recordings.trials import Table

from ..inference.evidence import NONE
from ..inference.posterior import UNKNOWN
from ..inference.prepare import Prepared
from ..inference.stand import Stand
from . import locate
from .attribute import Found
from .confounding import absorbed
from .distinguishability import TIED
from .holdout import Holdout
from .result import STAGES, Attribute, Data, Locate, Ranked
from .shapes import worst
from .shrink import Unseen, candidate_model, folds, unseen_error
from .size import sizes, values

Array = NDArray[np.float64]

MM = 1e3
LISTED = 12
"""Hypotheses shown in the ranking, besides none and unknown, which always are."""
PREDICTED = 4
"""Leading hypotheses whose held-out error is computed."""


def data(p: Prepared, table: Table) -> Data:
    """What was diagnosed."""
    repeated = p.floor.contrasts + (p.stand.floor.contrasts if p.stand is not None else 0)
    source = (
        f"{repeated} differences between repeats"
        if repeated
        else "usual values of settled readings: nothing was repeated"
    )
    channels = tuple(dict.fromkeys(p.labels.channel.tolist()))
    noise = p.floor.channel["tip"]
    if p.stand is not None and p.pushes_only:
        noise = float(np.median(p.stand.floor.channel["force"] / p.stand.stiffness))
    return Data(len(table), len(np.unique(p.states.trial)), channels, noise * MM, source)


def where(f: Found, stages: Mapping[str, str]) -> Locate:
    """Where the gap of the calibrated baseline lies; `stages` effect id -> stage of the chain."""
    p = f.prepared
    missed = p.problem.observed - p.problem.forward.predict(p.shared(f.calibrated.theta))
    gap = p.gap(missed)
    seen = np.asarray(np.isfinite(gap).all(axis=1))
    own = p.states.take(seen)
    by = locate.cells(
        own, gap[seen], p.reading, {s: m[seen] for s, m in _markers(p, missed).items()}, _pushes(p, missed)
    )
    rmse = float(np.sqrt((gap[seen] ** 2).sum(axis=1).mean()))
    significant = any(c.significant for group in by.values() for c in group)
    stage = dict.fromkeys(STAGES, 0.0) | f.posterior.by_stage(stages)
    numerical = locate.numerical_error(p.robot, own) * MM
    what: Literal["tip", "deflection"] = "deflection" if p.pushes_only else "tip"
    return Locate(rmse * MM, p.reading * MM, significant, by, stage, numerical, what)


def _pushes(p: Prepared, missed: Array) -> locate.Pushes | None:
    if p.stand is None:
        return None
    own = p.states.pushed
    return locate.Pushes(p.states.take(own), p.deflection(missed)[own], p.stand.reading)


def _markers(p: Prepared, missed: Array) -> dict[float, Array]:
    """Arc length m -> (states, 3) m."""
    out = {}
    for k, s in enumerate(p.robot.markers, 1):
        own = np.char.startswith(p.labels.channel, f"m{k}")
        out[float(s)] = np.full((len(p.states), 3), np.nan)
        out[float(s)][p.labels.state[own], p.labels.axis[own]] = missed[own]
    return out


def which(f: Found, unseen: Unseen | None) -> Attribute:
    """The verdict with its ranking; held-out errors of the leading hypotheses where `unseen` was computed."""
    p = f.prepared
    fold = folds(p)[0]
    ranked = []
    always = [x for x in f.posterior.ranking[LISTED:] if x[0] in (NONE, UNKNOWN)]
    for rank, (named, probability) in enumerate((*f.posterior.ranking[:LISTED], *always)):
        c = f.posterior.candidates[named]
        heldout = None
        if unseen is not None and rank < PREDICTED and named != UNKNOWN:
            known = unseen.before if named == NONE else unseen.after if named == f.best.named else None
            errors = unseen_error(p, candidate_model(p, c), fold)[0] if known is None else known
            heldout = float(np.sqrt(np.nanmean(errors**2))) * MM
        ranked.append(
            Ranked(named, probability, c.log_evidence, heldout, values(sizes(p, c, f.probability_calibration.spread)))
        )
    d = f.decision
    return Attribute(d.verdict, d.effects, d.probability, f.posterior.credible_set, tuple(ranked), f.rivals)


def detail(f: Found, unseen: Unseen | None, holdout: Holdout | None) -> dict[str, Any]:
    """What the figures show beyond the contract. Tips in m, base frame; states are those with a tip."""
    p = f.prepared
    of_robot = p.states.take(~p.states.pushed)
    observed = p.problem.observed
    given, slope = p.problem.forward.linearise(p.problem.parameters.mean)
    calibrated, explained = (p.problem.forward.predict(p.shared(t)) for t in (f.calibrated.theta, f.best.fit.theta))
    made: dict[str, Any] = {
        "signs": vars(f.signs) | {"trend": f.trend},
        "tolerance_of_other_effects": f.best.cell.spike,
        "discrepancy_mm": f.best.cell.size * p.unit * MM,
        "waterfall_mm": {
            "as given": _rms(p, observed - given),
            "calibrated": _rms(p, observed - calibrated),
            "with the best hypothesis": _rms(p, observed - explained),
            "noise floor": p.reading * MM,
        },
        "best_hypothesis": list(f.best.named),
        "masking": _masking(p, slope),
        "floor": {"channel": dict(p.floor.channel), "pressure": p.floor.pressure, "trial": dict(p.floor.trial)},
        "bench": f.probability_calibration.bench,
        "sizes": [
            asdict(size) | {"impossible": size.impossible}
            for size in sizes(p, f.best, f.probability_calibration.spread)
        ],
        "apart": _apart(f),
        "shapes": worst(p, f.calibrated.theta, f.best.fit.theta),
        "states": {
            "trial": of_robot.trial.tolist(),
            "spine_length": of_robot.spine_length.tolist(),
            "pressure": of_robot.highest.tolist(),
            "branch": of_robot.branch.tolist(),
            "experiment": of_robot.kind.tolist(),
            "tip": of_robot.tip.tolist(),
            "calibrated": p.tip(calibrated)[~p.states.pushed].tolist(),
            "explained": p.tip(explained)[~p.states.pushed].tolist(),
        },
    }
    if unseen is not None:
        made["unseen_m"] = {"before": unseen.before.tolist(), "after": unseen.after.tolist(), "how": unseen.how}
    if p.stand is not None:
        made["stiffness"] = _stiffness(
            p, p.stand, {"as given": given, "calibrated": calibrated, "explained": explained}
        )
        if unseen is not None:
            pairs = (("unseen: calibrated", unseen.stand_before), ("unseen: explained", unseen.stand_after))
            made["stiffness"]["waterfall_mm"] |= {name: _rms_of(error) for name, error in pairs}
    if holdout is not None:
        made["holdout"] = asdict(holdout) | {"statement": holdout.statement}
    return made


def _stiffness(p: Prepared, held: Stand, predicted: Mapping[str, Array]) -> dict[str, Any]:
    """Force, deflection and what each model gives for it, by reading; N and m."""
    own = p.states.pushed
    forces = {name: held.stiffness * p.deflection(y) for name, y in predicted.items()}
    missed = {name: _rms_of(p.deflection(p.problem.observed - y)) for name, y in predicted.items()}
    return {
        "waterfall_mm": missed,
        "floor_mm": held.reading * MM,
        "floor": {**held.floor.channel, "deflection": held.floor.pressure, "trial": dict(held.floor.trial)},
        "trial": p.states.trial[own].tolist(),
        "specimen": [r.specimen or "spine" for r, pushed in zip(p.states.rows, own, strict=True) if pushed],
        "spine_length": p.states.spine_length[own].tolist(),
        "deflection": p.states.deflection[own].tolist(),
        "stiffness": held.stiffness[own].tolist(),
        "force": (held.stiffness * p.deflection(p.problem.observed))[own].tolist(),
        **{name: force[own].tolist() for name, force in forces.items() if name != "as given"},
    }


def _rms_of(error: Array) -> float:
    """mm."""
    return float(np.sqrt(np.nanmean(error**2))) * MM


def _apart(f: Found) -> dict[str, Any]:
    """Separations at the honest floor; effects of most weight first, with that weight."""
    weight = {e: f.posterior.of_effect(e) for e in f.apart.effects}
    order = sorted(range(len(f.apart.effects)), key=lambda i: -weight[f.apart.effects[i]])
    effects = [f.apart.effects[i] for i in order]
    separation = f.apart.separation[np.ix_(order, order)].tolist()
    return {"effects": effects, "weight": [weight[e] for e in effects], "separation": separation, "tied_below": TIED}


def _rms(p: Prepared, missed: Array) -> float:
    """Root mean square of the gap, mm."""
    return float(np.sqrt(np.nanmean((p.gap(missed) ** 2).sum(axis=1)))) * MM


def _masking(p: Prepared, slope: Array) -> dict[str, dict[str, float]]:
    """Share of each effect's tip displacement that a calibration absorbs: one area factor, or one a spine length."""
    parameters = p.problem.parameters
    if "area.excess" not in parameters.names:
        return {}
    weight = np.where(p.labels.kind == 0, 1.0, 0.0)
    area = slope[:, [parameters.names.index("area.excess")]]
    length = np.round(p.states.spine_length[p.labels.state], 2)
    each = np.hstack([area * (length == x)[:, None] for x in np.unique(length)])
    return {
        "one": absorbed(parameters, slope, weight, area),
        "per_length": absorbed(parameters, slope, weight, each),
    }
