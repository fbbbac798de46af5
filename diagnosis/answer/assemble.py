"""The sections of the answer, from what was found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from recordings.trials import Table

from ..inference.evidence import NONE, Hypothesis
from ..inference.on_baseline import SHARE
from ..inference.posterior import UNKNOWN
from ..inference.prepare import AREA, MODULUS, Prepared
from ..inference.stiffness_trials import StiffnessTrials
from ..judgement import BENCHMARK, MATERIAL_SD, TIED
from . import locate
from .attribute import Attribution
from .confounding import confounded_shares, origins
from .holdout import Holdout
from .result import STAGES, Attribute, Calibration, Data, Locate, Ranked, Simulator
from .shapes import worst_states
from .shrink import HeldOutErrors
from .size import sizes, values
from .verdict import conclude, rivals

Array = NDArray[np.float64]

LISTED = 12
"""Hypotheses shown in the ranking, besides none and unknown, which always are."""


def data_section(p: Prepared, table: Table) -> Data:
    """The section `data`: what was diagnosed."""
    repeated = p.noise_components.contrasts + (p.pushes.noise_components.contrasts if p.pushes is not None else 0)
    source = (
        f"{repeated} differences between repeats" if repeated else "default noise of settled readings, since nothing was repeated"
    )
    channels = tuple(dict.fromkeys(p.labels.channel.tolist()))
    noise = p.noise_components.channel["tip"]
    if p.pushes is not None and p.pushes_only:
        noise = float(np.median(p.pushes.noise_components.channel["force"] / p.pushes.stiffness))
    return Data(len(table), len(np.unique(p.states.trial)), channels, noise * 1e3, source)


def locate_section(f: Attribution, stages: Mapping[str, str]) -> Locate:
    """The section `locate`: where the gap of the calibrated baseline lies; `stages` effect id -> stage of the chain."""
    p = f.prepared
    missed = p.problem.observed - p.problem.forward.predict(p.common(f.calibrated.theta))
    gap = p.gap(missed)
    seen = np.asarray(np.isfinite(gap).all(axis=1))
    own = p.states.take(seen)
    by = locate.cells(own, gap[seen], p.noise_floor, {s: m[seen] for s, m in _markers(p, missed).items()}, _pushes(p, missed))
    rmse = float(np.sqrt((gap[seen] ** 2).sum(axis=1).mean()))
    significant = any(c.significant for group in by.values() for c in group)
    stage = dict.fromkeys(STAGES, 0.0) | f.posterior.by_stage(stages)
    numerical = float("nan") if p.baseline is not None else locate.numerical_error(p.robot, own) * 1e3
    what: Literal["tip", "deflection"] = "deflection" if p.pushes_only else "tip"
    return Locate(rmse * 1e3, p.noise_floor * 1e3, significant, by, stage, numerical, what)


def calibration_section(f: Attribution) -> Calibration | None:
    """The section `calibration`: the one area factor of the calibrated baseline next to robot.yaml's."""
    p = f.prepared
    if p.baseline is not None or p.pushes_only or AREA not in p.problem.parameters.names:
        return None
    robot, states = p.described or (p.robot, p.states)
    own = ~p.states.pushed
    given = float(np.mean(robot.area_factor_at(states.spine_length[own])))
    theta = dict(zip(p.problem.parameters.names, f.calibrated.theta.tolist(), strict=True))
    modulus = p.robot.youngs_modulus / robot.youngs_modulus * (1 + theta.get(MODULUS, 0.0))
    found = Calibration(p.area_factor(f.calibrated.theta), given, modulus)
    # stiffness trials tell the modulus
    known = 0.0 if p.states.pushed.any() else robot.uncertainty.youngs_modulus or MATERIAL_SD
    return replace(found, origins=origins(robot, found.stiffness if known else found.stiffness / modulus, known))


def _pushes(p: Prepared, missed: Array) -> locate.Pushes | None:
    """Deflections of the stiffness trials that the model misses; None where there are none."""
    if p.pushes is None:
        return None
    own = p.states.pushed
    return locate.Pushes(p.states.take(own), p.deflection(missed)[own], p.pushes.noise_floor)


def _markers(p: Prepared, missed: Array) -> dict[float, Array]:
    """Arc length m -> (states, 3) m."""
    out = {}
    for k, s in enumerate(p.robot.markers, 1):
        own = np.char.startswith(p.labels.channel, f"m{k}")
        out[float(s)] = np.full((len(p.states), 3), np.nan)
        out[float(s)][p.labels.state[own], p.labels.axis[own]] = missed[own]
    return out


def attribute_section(f: Attribution, significant: bool, heldout: Mapping[Hypothesis, float]) -> Attribute:
    """The section `attribute`: verdict and ranking; `heldout` is the mm rms of hypotheses on unseen states, `significant` whether
    the gap is above the noise floor anywhere."""
    listed, rest = f.posterior.ranking[:LISTED], f.posterior.ranking[LISTED:]
    ranked = []
    for named, probability in (*listed, *(x for x in rest if x[0] in (NONE, UNKNOWN))):
        candidate = f.posterior.candidates[named]
        size = values(sizes(f.prepared, candidate))
        ranked.append(Ranked(named, probability, candidate.log_evidence, heldout.get(named), size))
    d = f.decision
    return Attribute(
        verdict=d.verdict,
        effects=d.effects,
        probability=d.probability,
        credible_set=f.posterior.credible_set,
        ranking=tuple(ranked),
        cannot_tell_apart=f.cannot_tell_apart,
        stage_errors=f.asking,
        conclusion=conclude(d, significant, f.asking, bool(f.tense)),  # tense: far beyond a stated tolerance
        rivals=rivals(d, f.posterior),
        relatives=d.relatives,
    )


def beside(a: Attribute, certain: str) -> Attribute:
    """The section where an effect is part of every hypothesis, because none without it comes near the data; what is unknown is
    so beside it."""
    ranking = tuple(replace(r, effects=(certain, *r.effects)) for r in a.ranking)
    return replace(
        a,
        verdict="effect",
        effects=(certain, *a.effects),
        conclusion="cause" if a.conclusion in ("none", "noise") else a.conclusion,
        ranking=ranking,
        credible_set=tuple((certain, *named) for named in a.credible_set),
    )


def detail_section(
    f: Attribution, unseen: HeldOutErrors | None, holdout: Holdout | None, names: Mapping[str, str]
) -> dict[str, Any]:
    """The section `detail`: what the figures show. Tips in m, base frame.

    Three predictions (n,) of the measured values are compared: of the robot as given (robot.yaml), calibrated, and `explained` by
    the best hypothesis; `unseen` are the errors of states, each predicted by a fit without its fold. `states` are those with a
    tip; stiffness trials (`pushed`) have a section of their own.
    """
    p = f.prepared
    observed = p.problem.observed
    given, slope = p.given, p.problem.forward.linearise(p.problem.parameters.mean)[1]
    calibrated, explained = (p.problem.forward.predict(p.common(t)) for t in (f.calibrated.theta, f.best.fit.theta))
    made: dict[str, Any] = {
        "misfit": asdict(f.misfit),
        "tolerance_of_other_effects": f.best.grid_point.spike,
        "discrepancy_mm": f.best.grid_point.size * p.unit * 1e3,
        "waterfall_mm": {
            "as given": _rms(p, observed - given),
            "calibrated": _rms(p, observed - calibrated),
            "with the best hypothesis": _rms(p, observed - explained),
            "noise floor": p.noise_floor * 1e3,
        },
        "best_hypothesis": list(f.best.named),
        "confounding": _confounding(p, slope),
        "floor": {
            "channel": dict(p.noise_components.channel),
            "pressure": p.noise_components.pressure,
            "trial": dict(p.noise_components.trial),
            "lasting": dict(p.noise_components.lasting),
            "memory": p.noise_components.memory,
        },
        "actuators": p.robot.actuators.words.kind,
        "calibrated_on": BENCHMARK,
        "sizes": [asdict(size) | {"impossible": size.impossible} for size in sizes(p, f.best)],
        "distinguishability": _separations(f),
        "shapes": worst_states(p, f.calibrated.theta, f.best.fit.theta),
        "states": _states(p, calibrated, explained),
    }
    if (simulator := simulator_section(f)) is not None:
        made["baseline"] = asdict(simulator)
    if unseen is not None:
        made["unseen_m"] = {
            "before": unseen.before.distance.tolist(), "after": unseen.after.distance.tolist(), "how": unseen.how,
        }  # fmt: skip
        if not p.pushes_only:
            made["states"] |= {
                "given": p.tip(given)[~p.states.pushed].tolist(),
                "calibrated_unseen": (p.states.tip - unseen.before.vector)[~p.states.pushed].tolist(),
                "explained_unseen": (p.states.tip - unseen.after.vector)[~p.states.pushed].tolist(),
            }
    if p.pushes is not None:
        made["stiffness"] = _stiffness(p, p.pushes, {"as given": given, "calibrated": calibrated, "explained": explained})
        if unseen is not None:
            pairs = (("unseen: calibrated", unseen.before.deflection), ("unseen: explained", unseen.after.deflection))
            made["stiffness"]["waterfall_mm"] |= {name: _rms_of(error) for name, error in pairs}
    if holdout is not None:
        made["holdout"] = asdict(holdout) | {"statement": holdout.statement(names)}
    return made


def _states(p: Prepared, calibrated: Array, explained: Array) -> dict[str, Any]:
    """Settings and tips (m), measured and predicted, of the states with a tip; the predictions (n,) are of all values."""
    with_tip = ~p.states.pushed
    states = p.states.take(with_tip)
    return {
        "trial": states.trial.tolist(),
        "spine_length": states.spine_length.tolist(),
        "pressure": states.highest.tolist(),
        "branch": states.branch.tolist(),
        "experiment": states.kind.tolist(),
        "chambers": [list(c) for c in states.chambers],
        "tip": states.tip.tolist(),
        "calibrated": p.tip(calibrated)[with_tip].tolist(),
        "explained": p.tip(explained)[with_tip].tolist(),
    }


def simulator_section(f: Attribution) -> Simulator | None:
    """How the simulator in the rod's place differs from the rod, as far as the leading hypothesis tells; None without one."""
    p, fitted = f.prepared, f.best.fit
    if p.baseline is None:
        return None
    parameters = p.problem.parameters
    at = parameters.names.index(SHARE)
    rod, simulator = fitted.theta.copy(), fitted.theta.copy()
    rod[at], simulator[at] = 1.0, 0.0
    own = p.labels.kind == 0
    difference = (p.problem.forward.predict(simulator) - p.problem.forward.predict(rod))[own]
    count = len(np.unique(p.labels.state[own]))
    free = [i for i in np.flatnonzero(parameters.calibration).tolist() if i != at]
    slope = p.problem.linearise(fitted.theta, free)[1][own]
    left = difference - slope @ np.linalg.lstsq(slope, difference, rcond=None)[0]
    share = float(fitted.theta[at])
    differs, beyond = (float(np.sqrt(d @ d / count)) * 1e3 for d in (difference, left))
    return Simulator(p.baseline.name, p.baseline.area_factor, differs, beyond, share, share * beyond)


def _stiffness(p: Prepared, pushes: StiffnessTrials, predicted: Mapping[str, Array]) -> dict[str, Any]:
    """Force, deflection and what each model gives for it, by reading; N and m."""
    own = p.states.pushed
    noise = pushes.noise_components
    forces = {name: pushes.stiffness * p.deflection(y) for name, y in predicted.items()}
    missed = {name: _rms_of(p.deflection(p.problem.observed - y)) for name, y in predicted.items()}
    return {
        "waterfall_mm": missed,
        "floor_mm": pushes.noise_floor * 1e3,
        "floor_from_repeats": noise.contrasts > 0,
        "floor": {**noise.channel, "deflection": noise.pressure, "trial": dict(noise.trial)},
        "trial": p.states.trial[own].tolist(),
        "specimen": [r.specimen or "spine" for r, pushed in zip(p.states.rows, own, strict=True) if pushed],
        "spine_length": p.states.spine_length[own].tolist(),
        "deflection": p.states.deflection[own].tolist(),
        "stiffness": pushes.stiffness[own].tolist(),
        "force": (pushes.stiffness * p.deflection(p.problem.observed))[own].tolist(),
        **{name: force[own].tolist() for name, force in forces.items() if name != "as given"},
    }


def _rms_of(error: Array) -> float:
    """mm."""
    return float(np.sqrt(np.nanmean(error**2))) * 1e3


def _separations(f: Attribution) -> dict[str, Any]:
    """Separations with the discrepancy integrated out; the most probable effects first, with their probability."""
    weight = {e: f.posterior.of_effect(e) for e in f.distinguishability.effects}
    order = sorted(range(len(f.distinguishability.effects)), key=lambda i: -weight[f.distinguishability.effects[i]])
    effects = [f.distinguishability.effects[i] for i in order]
    separation = f.distinguishability.separation[np.ix_(order, order)].tolist()
    return {"effects": effects, "weight": [weight[e] for e in effects], "separation": separation, "tied_below": TIED}


def _rms(p: Prepared, missed: Array) -> float:
    """Root mean square of the gap, mm."""
    return float(np.sqrt(np.nanmean((p.gap(missed) ** 2).sum(axis=1)))) * 1e3


def _confounding(p: Prepared, slope: Array) -> dict[str, dict[str, float]]:
    """Share of each effect's tip displacement that a calibration takes over: one area factor, or one for each spine length."""
    parameters = p.problem.parameters
    if AREA not in parameters.names:
        return {}
    weight = np.where(p.labels.kind == 0, 1.0, 0.0)
    area = slope[:, [parameters.names.index(AREA)]]
    length = np.round(p.states.spine_length[p.labels.state], 2)
    per_length = np.hstack([area * (length == x)[:, None] for x in np.unique(length)])
    return {
        "one": confounded_shares(parameters, slope, weight, area),
        "per_length": confounded_shares(parameters, slope, weight, per_length),
    }
