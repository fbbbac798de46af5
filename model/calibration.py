"""Calibration: the effective chamber area from tip positions, the moduli from stiffness trials.

The paper fits A_effect alone, once per spine length; fitting it once for all lengths is what shows whether it
absorbs something else. Both are here, with the error each leaves.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from model.arrays import Array
from model.body import annulus_second_moment
from model.condition import States
from model.errors import BadCondition, NotIdentified
from model.estimate import Estimate, estimate, readings
from model.robot import Robot
from model.rods import FINE, solve
from model.rods.beam import bending_compliance
from model.section import rods_of


def fit_stiffness(deflection: ArrayLike, force: ArrayLike, trial: ArrayLike | None = None) -> Estimate:
    """The slope (N/m) of force (n,) N over deflection (n,) m.

    The intercept is free, so neither a sensor zero nor a late touch point biases the slope; the paper divides single readings.
    With `trial` (n,) each trial has its own intercept, and the slope is common. Raises `NotIdentified` with too few
    readings or no spread in deflection, `BadCondition` on shapes.
    """
    n = np.size(deflection)
    data = readings(n, deflection=deflection, force=force)
    labels = np.zeros(n) if trial is None else np.asarray(trial)
    if labels.shape != (n,):
        raise BadCondition(f"trial: shape {labels.shape}, must be ({n},)")
    trials, own, count = np.unique(labels, return_inverse=True, return_counts=True)
    # from the mean of each reading's own trial
    dy, df = (data[name] - (np.bincount(own, data[name]) / count)[own] for name in ("deflection", "force"))
    spread = float(dy @ dy)
    if not spread > 0:
        raise NotIdentified("deflection: all readings of a trial are at the same place, no slope can be fitted")
    slope = float(dy @ df) / spread
    return estimate(slope, dy, df - slope * dy, 1 + trials.size, labels if trial is not None else None)


def youngs_modulus(stiffness: Estimate, length: float, second_moment: float) -> Estimate:
    """E (Pa) of a cantilever of a length (m) and a second moment (m^4), from the slope F / y (N/m) at its end; eq. 8, 9.

    >>> round(youngs_modulus(fit_stiffness([0.0, 0.01, 0.02], [0.0, 0.05, 0.1]), 0.3, 1e-6).value)
    45000
    """
    if not (length > 0 and second_moment > 0):
        raise BadCondition(f"cantilever of length {length:g} m with second moment {second_moment:g} m^4: must be positive")
    return stiffness.scaled(float(bending_compliance((0.0, length), (second_moment,))))


AXES = 3
"""Readings that the tip of a state gives."""
LEAST_FACTOR, MOST_FACTOR = 0.05, 20.0
"""Bounds of A_effect / A_norm."""


def fit_area_factor(robot: Robot, condition: States, tip: ArrayLike, trial: ArrayLike | None = None) -> Estimate:
    """Fit one area factor A_effect / A_norm for all states, by least squares on the measured tips (n, 3) m, base frame; the
    estimate's `n` counts tips, its residual is their rms distance, m.

    `trial` (n,) lets the readings of a trial err together. Raises `NotIdentified` when the tips do not depend on
    the factor or it runs into its bounds, `SolveFailed` when a state has no equilibrium at the fitted value.

    >>> from pathlib import Path
    >>> from model.condition import conditions
    >>> from model.robot import load_robot
    >>> robot = load_robot(Path("robot.yaml"))
    >>> states = conditions(robot, 0.1, [[p] * 3 + [0.0] * 6 for p in (40e3, 80e3)])
    >>> tips = solve(rods_of(robot.replace(area_factor=1.1), states), FINE).tip
    >>> round(fit_area_factor(robot, states, tips).value, 3)
    1.1
    """
    measured = readings(len(condition), AXES, tip=tip)["tip"]
    if not np.any(condition.pressure):
        raise NotIdentified("pressure: all zero, the tips say nothing about the area factor")

    def residuals(x: Array) -> Array:
        result = solve(rods_of(robot.replace(area_factor=float(x[0])), condition), FINE)
        # A state without equilibrium at a trial value counts as one robot length off: the search turns back.
        return np.where(result.converged[:, None], result.tip - measured, robot.length).ravel()

    start = float(np.mean(robot.area_factor_at(condition.spine_length)))
    from scipy.optimize import least_squares  # an eighth of the start of a diagnosis, which does not need it

    solution = least_squares(residuals, [start], bounds=(LEAST_FACTOR, MOST_FACTOR), diff_step=1e-5, xtol=1e-10, ftol=1e-12)
    value = float(solution.x[0])
    # The search stays inside its bounds: a value that would leave them ends just short of one.
    if not 1.01 * LEAST_FACTOR < value < 0.99 * MOST_FACTOR:
        raise NotIdentified(
            f"area factor: {value:g} is at its bound ({LEAST_FACTOR:g}..{MOST_FACTOR:g}): "
            "check the units of pressure and tip, and the chamber order"
        )
    predicted = solve(rods_of(robot.replace(area_factor=value), condition), FINE).trusted().tip
    labels = None if trial is None else np.repeat(np.asarray(trial), 3)
    found = estimate(value, solution.jac[:, 0], (measured - predicted).ravel(), 1, labels)
    return replace(found, n=len(measured), rms_residual=math.sqrt(AXES) * found.rms_residual)


def fit_area_factor_by_length(
    robot: Robot, condition: States, tip: ArrayLike, trial: ArrayLike | None = None
) -> dict[float, Estimate]:
    """The paper's calibration: a factor of its own for each spine length (m). Raises as `fit_area_factor`."""
    measured = readings(len(condition), AXES, tip=tip)["tip"]
    trials = None if trial is None else np.asarray(trial)
    return {
        length: fit_area_factor(robot, condition[rows], measured[rows], None if trials is None else trials[rows])
        for length, rows in condition.by_spine_length()
    }


def fit_spine_modulus(
    radius: float, spine_length: ArrayLike, deflection: ArrayLike, force: ArrayLike, trial: ArrayLike | None = None
) -> dict[float, Estimate]:
    """Apparent E (Pa) of the bare spine of `radius` (m) for each spine length (m), eq. 9: Table II."""
    n = np.size(deflection)
    data = readings(n, spine_length=spine_length, deflection=deflection, force=force)
    lengths = np.round(data["spine_length"], 4)
    moduli = {}
    for length in np.unique(lengths):
        of_length = lengths == length
        trials = None if trial is None else np.asarray(trial)[of_length]
        slope = fit_stiffness(data["deflection"][of_length], data["force"][of_length], trials)
        moduli[float(length)] = youngs_modulus(slope, float(length), annulus_second_moment(radius))
    return moduli
