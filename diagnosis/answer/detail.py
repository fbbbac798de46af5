"""The section `detail` of the answer: what its figures show. Lengths in m, base frame, unless their name says otherwise.

Three models predict the measured values: `given` (robot.yaml), `calibrated`, and `explained` by the best hypothesis; what they
predict of states that their fits did not see ends in `unseen`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from ..arrays import Array, rms
from ..data.levels import SPINE_GAP, levels
from ..inference.prepare import Prepared
from ..inference.reading_noise import StiffnessTrials
from ..judgement import BENCHMARK, TIED
from .attribute import Attribution
from .result import FittedRobot
from .size import by_actuator, values


def detail(f: Attribution, fitted: FittedRobot | None, unseen: Mapping[str, Array], names: Mapping[str, str]) -> dict[str, Any]:
    """The section `detail`, plain values for JSON; `fitted`: the robot with what is named, `unseen`: residuals of states that no
    fit saw, `names`: effect -> plain name."""
    p = f.prepared
    models = {"calibrated": p.common(f.calibrated.theta), "explained": p.common(f.best.fit.theta)}
    predicted = {name: p.problem.forward.predict(theta) for name, theta in models.items()}
    named_sizes = f.sizes(f.best, fitted)
    section: dict[str, Any] = {
        "misfit": {
            "excess_scatter": p.noise_components.excess_scatter,
            "outlier_trial": f.outlier_trial,
            "outlier_state": p.states.farthest(p.points(predicted["explained"]), f.outlier_trial),
            "law_error_gain": f.best.weighed.law_error_gain,
        },
        "best_hypothesis": list(f.best.named),
        "actuators": p.robot.actuators.words.kind,
        "calibrated_on": BENCHMARK,
        "sizes": [asdict(size) | {"impossible": size.impossible} for size in named_sizes],
        "distinguishability": _separations(f),
        "shapes": _worst_shapes(p, models, predicted),
        "states": _states(p, predicted, unseen),
        "names": names,
    }
    specs = [p.forward.catalogue[e] for e in f.decision.effects if e in p.forward.catalogue]
    factors = [by_actuator(p.robot, spec, values(named_sizes)) for spec in specs]
    section["by_actuator"] = [asdict(e) for e in factors if e is not None]
    if p.pushes is not None:
        section["stiffness"] = _stiffness(p, p.pushes, predicted, unseen)
    return section


def _states(p: Prepared, predicted: Mapping[str, Array], unseen: Mapping[str, Array]) -> dict[str, Any]:
    """Settings and tips, measured and predicted, of the states with a tip; `predicted`: all values (n,) by model."""
    of_robot = ~p.states.pushed
    s = p.states.take(of_robot)
    tips = {"tip": p.states.tip, **{name: p.tip(values) for name, values in predicted.items()}}
    if unseen and not p.pushes_only:
        tips |= {"given": p.tip(p.given), **{f"{name}_unseen": p.states.tip - p.tip(left) for name, left in unseen.items()}}
    return {
        "spine_length": s.spine_length.tolist(),
        "pressure": s.highest.tolist(),
        "branch": s.branch.tolist(),
        "chambers": [list(c) for c in s.chambers],
        **{name: tip[of_robot].tolist() for name, tip in tips.items()},
    }


def _worst_shapes(p: Prepared, models: Mapping[str, Array], predicted: Mapping[str, Array]) -> list[dict[str, Any]]:
    """Shapes of the state of each chamber group and spine length that a model misses most, at most four, by models of parameters
    (k,) that predict values (n,); a simulator has none."""
    if p.baseline is not None:
        return []
    tips = {name: p.tip(values) for name, values in predicted.items()}
    distance = np.max([np.linalg.norm(p.states.tip - tip, axis=1) for tip in tips.values()], axis=0)
    length = levels(p.states.spine_length, SPINE_GAP)
    worst: dict[tuple[tuple[int, ...], int], int] = {}
    for i in sorted(np.flatnonzero(np.isfinite(distance)).tolist(), key=lambda i: -distance[i]):
        worst.setdefault((p.states.chambers[i], int(length[i])), i)
    if not worst:
        return []
    # A fitted robot may be a little longer than its description: beyond the tip stands for the tip.
    arcs = np.append(np.linspace(0.0, p.robot.length, 24), 2 * p.robot.length)
    curves = {name: p.forward.shapes(theta, arcs) for name, theta in models.items()}
    return [
        {
            "trial": int(p.states.trial[i]),
            "step": int(p.states.trials["step"][i]),
            "spine_length": float(p.states.spine_length[i]),
            "pressure": float(p.states.highest[i]),
            "branch": str(p.states.trials["branch"][i]),
            "chambers": list(p.states.chambers[i]),
            "measured_tip": p.states.tip[i].tolist(),
            "measured_markers": p.states.trials.markers[i].tolist(),
            **{name: {"tip": tips[name][i].tolist(), "backbone": curves[name][i].tolist()} for name in models},
        }
        for i in list(worst.values())[:4]
    ]


def _stiffness(
    p: Prepared, pushes: StiffnessTrials, predicted: Mapping[str, Array], unseen: Mapping[str, Array]
) -> dict[str, Any]:
    """Force (N), deflection and what each model gives for the force, by reading of the stiffness trials."""
    pushed = p.states.pushed
    errors = {name: p.deflection(p.problem.observed - y) for name, y in {"as given": p.given, **predicted}.items()}
    errors |= {f"unseen: {name}": p.deflection(left) for name, left in unseen.items()}
    forces = {"force": p.problem.observed, **predicted}
    return {
        "waterfall_mm": {name: 1e3 * rms(error) for name, error in errors.items()},
        "floor_mm": pushes.noise_floor * 1e3,
        "floor_from_repeats": pushes.noise_components.contrasts > 0,
        "trial": p.states.trial[pushed].tolist(),
        "specimen": [s or "spine" for s in p.states.trials.get("specimen")[pushed].tolist()],
        "spine_length": p.states.spine_length[pushed].tolist(),
        "deflection": p.states.deflection[pushed].tolist(),
        "stiffness": pushes.stiffness[pushed].tolist(),
        **{name: (pushes.stiffness * p.deflection(y))[pushed].tolist() for name, y in forces.items()},
    }


def _separations(f: Attribution) -> dict[str, Any]:
    """Separations with the discrepancy integrated out; the most probable effects first, with their probability."""
    d = f.distinguishability
    weight = [f.posterior.of_effect(e) for e in d.effects]
    order = sorted(range(len(d.effects)), key=lambda i: -weight[i])
    return {
        "effects": [d.effects[i] for i in order],
        "weight": [weight[i] for i in order],
        "separation": d.separation[np.ix_(order, order)].tolist(),
        "tied_below": TIED,
    }
