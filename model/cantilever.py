"""Stiffness trials: from force and deflection to Young's modulus by beam theory (equations 8 and 9 of the paper).

The beam is `model.rods.beam`, the rod's limit of small deflections, solved for E. The paper divides single
readings; here F is regressed on y with a free intercept, so a sensor zero or a late touch point does not bias the
modulus.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from model.errors import BadCondition, NotIdentified
from model.estimate import Estimate, estimate, readings
from model.rods.beam import bar_deflection

Array = NDArray[np.float64]
Labels = NDArray[np.generic]


def fit_stiffness(
    deflection: ArrayLike, force: ArrayLike, force_sd: ArrayLike | None = None, trial: ArrayLike | None = None
) -> Estimate:
    """The slope (N/m) of force (n,) N over deflection (n,) m, weighted by 1 / force_sd^2 (N) where given.

    With `trial` (n,) each trial has its own intercept, and the slope is common. Raises `NotIdentified` with too few
    readings or no spread in deflection, `BadCondition` on shapes.
    """
    n = np.size(deflection)
    columns = readings(n, deflection=deflection, force=force, force_sd=np.ones(n) if force_sd is None else force_sd)
    y, f, sd = columns["deflection"], columns["force"], columns["force_sd"]
    if (sd <= 0).any():
        raise BadCondition(f"force_sd: {sd.min():g} N, must be positive")
    labels = np.zeros(n) if trial is None else np.asarray(trial)
    if labels.shape != (n,):
        raise BadCondition(f"trial: shape {labels.shape}, must be ({n},)")
    names = np.unique(labels)
    weight = 1 / sd**2
    mean_y, mean_f = (_trial_means(values, weight, labels, names) for values in (y, f))
    dy, df = (y - mean_y) / sd, (f - mean_f) / sd
    spread = float(dy @ dy)
    if not spread > 0:
        raise NotIdentified("deflection: all readings of a trial are at the same place, no slope can be fitted")
    slope = float(dy @ df) / spread
    weighted = estimate(slope, dy, df - slope * dy, 1 + names.size, labels if trial is not None else None)
    rms = float(np.sqrt(np.mean((sd * (df - slope * dy)) ** 2)))
    return Estimate(slope, weighted.standard_error, weighted.dof, n, rms)


def youngs_modulus(stiffness: Estimate, length: float, second_moment: float, load_at: float | None = None) -> Estimate:
    """E (Pa) from the slope F / y (N/m), eq. 8 solved for E; eq. 9 when the load is at the end.

    `length` of the cantilever and `load_at` (the end when None) in m, `second_moment` in m^4.
    """
    x = length if load_at is None else load_at
    if not (length > 0 and 0 < x <= length and second_moment > 0):
        raise BadCondition(
            f"cantilever of length {length:g} m loaded at {x:g} m with second moment {second_moment:g} m^4: "
            "all must be positive and the load within the length"
        )
    return stiffness.scaled(bar_deflection(length, x, second_moment))


def _trial_means(values: Array, weight: Array, labels: Labels, names: Labels) -> Array:
    """The weighted mean of each reading's own trial, (n,)."""
    means = np.empty_like(values)
    for name in names:
        own = labels == name
        means[own] = np.average(values[own], weights=weight[own])
    return means
