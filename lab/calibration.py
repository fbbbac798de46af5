"""What measured data says about a robot: moduli from stiffness trials, the effective chamber area from bending states."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from diagnosis.fit_effects import Fitted, fit_effects
from diagnosis.inference.executor import Progress, no_progress
from model.calibration import AXES, AreaFit, fit_area_factor_by_length, fit_body_modulus, fit_spine_modulus
from model.estimate import Estimate
from model.robot import Robot
from model.stated import AREA_FACTOR
from recordings.trials import Table

from .files.inputs import Case


@dataclass(frozen=True)
class Calibration:
    """What the data says about the robot's parameters; None or empty where it says nothing."""

    robot: Robot
    """With the spine's and body's measured moduli and one area factor a length."""
    spine_modulus: Mapping[float, Estimate]
    body_modulus: Estimate | None
    area_factor: AreaFit | None
    """One for all lengths, with the tolerances of the set-up: the calibrated model of a diagnosis. None without tips."""
    area_factor_by_length: Mapping[float, AreaFit]
    """One for each length (m), the set-up taken as exact, as the paper has it."""

    def __repr__(self) -> str:
        found = {"body modulus": (self.body_modulus, "Pa")} if self.body_modulus else {}
        found |= {f"spine modulus at {s:g} m": (e, "Pa") for s, e in self.spine_modulus.items()}
        found |= {f"area factor at {s:g} m": (a.factor, "") for s, a in self.area_factor_by_length.items()}
        if self.area_factor is not None:
            found["area factor"] = self.area_factor.factor, ""
        lines = [f"{n} {e.value:.4g} ± {e.standard_error:.2g} {unit}".rstrip() for n, (e, unit) in found.items()]
        return f"<Calibration of {self.robot.name}: {'; '.join(lines[:9]) or 'nothing could be fitted'}>"

    def as_dict(self) -> dict[str, Any]:
        """JSON-able; SI units."""
        return {
            "spine_modulus": {f"{k:g}": _number(v) for k, v in self.spine_modulus.items()},
            "body_modulus": _number(self.body_modulus) if self.body_modulus else None,
            "area_factor": _area(self.area_factor) if self.area_factor else None,
            "area_factor_by_length": {f"{k:g}": _area(v) for k, v in self.area_factor_by_length.items()},
        }


def _number(e: Estimate) -> dict[str, float]:
    low, high = e.interval
    return {"value": e.value, "standard_error": e.standard_error, "low95": low, "high95": high, "n": e.n}


def _area(a: AreaFit) -> dict[str, float]:
    return {**_number(a.factor), "rmse_m": a.rmse}


def _one_for_all(f: Fitted) -> AreaFit:
    numbers = AXES * f.states
    rms = 1e-3 * f.calibrated_mm / math.sqrt(AXES)
    return AreaFit(Estimate(f.calibrated_area_factor, f.parameters[AREA_FACTOR].sd, numbers, numbers, rms))


def calibrate(case: Case, progress: Progress = no_progress) -> Calibration:
    """Calibrate moduli of spine and body from pushes, and area factors from tips. Raises DiagnosisError, ModelError."""
    robot = case.robot
    spine = _spine_modulus(case)
    if spine and robot.spine is not None:
        modulus = {**robot.spine.modulus, **{k: e.value for k, e in spine.items()}}
        robot = robot.model_copy(update={"spine": robot.spine.model_copy(update={"modulus": dict(sorted(modulus.items()))})})
    body = _body_modulus(case)
    one_for_all, by_length = None, dict[float, AreaFit]()
    if case.table.with_tip.any():
        condition, tip, trial = case.tips
        one_for_all = _one_for_all(fit_effects(case, (), progress=progress))
        by_length = fit_area_factor_by_length(robot, condition, tip, trial)
        robot = robot.with_area_factor({k: a.factor.value for k, a in by_length.items()})
    return Calibration(robot, spine, body, one_for_all, by_length)


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
    found = fit_body_modulus(case.robot, pushes.get("deflection"), pushes.get("force"), trial=pushes.trial)
    place_error = 3 * (case.robot.uncertainty.push_place or 0.0) / case.robot.length * found.value
    return replace(found, standard_error=math.hypot(found.standard_error, place_error))


def _pushes(case: Case, specimen: str) -> Table:
    """The states of stiffness trials of a specimen that have a force."""
    table = case.of("stiffness")
    return table.take((table.get("specimen") == specimen) & np.isfinite(table.get("force")))
