"""What measured data says about a robot: moduli from stiffness trials, the effective chamber area from bending states."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from diagnosis.findings import finding
from diagnosis.fit_effects import Fitted, fit_effects
from diagnosis.inference.executor import Progress, no_progress
from model.body import body_of
from model.calibration import fit_area_factor_by_length, fit_spine_modulus, fit_stiffness, youngs_modulus
from model.estimate import Estimate
from recordings.trials import Table

from .files.inputs import Case


def calibrate(case: Case, progress: Progress = no_progress) -> Fitted:
    """Calibrate moduli of spine and body from pushes, and area factors from tips, with the thrust that these settle where the
    robot states none. Raises DiagnosisError, ModelError."""
    robot = case.robot
    spine = _spine_modulus(case)
    if spine and robot.spine is not None:
        modulus = {**robot.spine.modulus, **{k: e.value for k, e in spine.items()}}
        robot = robot.model_copy(update={"spine": robot.spine.model_copy(update={"modulus": dict(sorted(modulus.items()))})})
    body = _body_modulus(case)
    if not case.table.with_tip.any():
        return Fitted(
            (), {}, math.nan, math.nan, robot=robot, states=0, trials=0,
            findings=tuple(finding("as_read", text=text) for text in case.table.warnings), spine_modulus=spine, body_modulus=body,
        )  # fmt: skip
    condition, tip, trial = case.tips
    fitted = fit_effects(case, (), progress=progress)
    robot = robot.replace(thrust=fitted.robot.thrust)
    by_length = fit_area_factor_by_length(robot, condition, tip, trial)
    robot = robot.replace(area_factor={k: a.value for k, a in by_length.items()})
    return replace(fitted, robot=robot, spine_modulus=spine, body_modulus=body, area_factor_by_length=by_length)


def _spine_modulus(case: Case) -> dict[float, Estimate]:
    pushes = _pushes(case, "spine")
    if not len(pushes) or case.robot.spine is None:
        return {}
    nominal = np.round(pushes.spine_length, 3)
    lengths = {x: float(pushes.spine_length[nominal == x].mean()) for x in set(nominal.tolist())}
    found = fit_spine_modulus(
        case.robot.spine.radius, [lengths[x] for x in nominal.tolist()], pushes.get("deflection"), pushes.get("force"),
        trial=pushes.trial,
    )  # fmt: skip
    # E goes with the cube of the length; 0.1 mm of the drum's reading are not known, with the play of cord and clamp
    length_sd = math.hypot(0.1e-3, case.robot.uncertainty.push_place or 0.0)
    return {x: replace(e, standard_error=math.hypot(e.standard_error, 3 * length_sd / x * e.value)) for x, e in found.items()}


def _body_modulus(case: Case) -> Estimate | None:
    pushes = _pushes(case, "body")
    pushes = pushes.take(pushes.spine_length < 1e-3)
    if not len(pushes):
        return None
    slope = fit_stiffness(pushes.get("deflection"), pushes.get("force"), trial=pushes.trial)
    found = youngs_modulus(slope, case.robot.length, body_of(case.robot).mean_second)
    place_error = 3 * (case.robot.uncertainty.push_place or 0.0) / case.robot.length * found.value
    return replace(found, standard_error=math.hypot(found.standard_error, place_error))


def _pushes(case: Case, specimen: str) -> Table:
    """The states of stiffness trials of a specimen that have a force."""
    table = case.table.take(case.table.pushed)
    return table.take((table.get("specimen") == specimen) & np.isfinite(table.get("force")))
