"""Confounding: how much of each effect a calibration takes over, and which numbers of robot.yaml it may stand for.

The share is 1 - |e - P e|^2 / |e|^2, e the effect's tip displacements at its plausible scale and P the projection onto
what the calibration can fit. Near 1, a calibration leaves nothing of the effect in the residual.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from model.robot import Robot

from ..inference.problem import Parameters
from ..judgement import AREA_SD, GAIN_SD, GEOMETRY_SD
from .result import Origin

Array = NDArray[np.float64]


def confounded_shares(parameters: Parameters, slope: Array, weight: Array, calibration: Array) -> dict[str, float]:
    """Share 0..1 of each effect that a calibration takes over, see above; 1 for an effect that moves no value.

    `calibration` (n, c): derivatives of the values by the c numbers that are calibrated. `slope` (n, k): by all k parameters.
    `weight` (n,) of each value, 0 for values that do not count.
    """
    basis, singular, _ = np.linalg.svd(weight[:, None] * calibration, full_matrices=False)
    # P = basis basis^T; columns that only rounding makes differ from zero span nothing
    basis = basis[:, singular > 1e-10 * max(float(singular.max(initial=0.0)), 1e-300)]
    out = {}
    for effect in parameters.ids:
        of_effect = [i for i, e in enumerate(parameters.effects) if e == effect]
        moved = weight[:, None] * slope[:, of_effect] * parameters.sd[of_effect]
        squared = float((moved**2).sum())
        left = moved - basis @ (basis.T @ moved)
        out[effect] = 1.0 - float((left**2).sum()) / squared if squared > 0 else 1.0
    return out


def origins(robot: Robot, stiffness: float, modulus_sd: float) -> tuple[Origin, ...]:
    """Numbers that an area factor may stand for, most probable first.

    Pressures bend a body in proportion to k = g a r / (E I): regulator gain g, chambers' area a and distance r from the axis,
    modulus E, second moment of area I. `stiffness` is 1 / k, as a ratio to that of robot.yaml. With independent log errors
    d_i ~ N(0, s_i^2) whose sum is d, those given d are N(w_i d, s_i^2 (1 - w_i)), w_i = s_i^2 / sum s^2; the probability is that
    of |d_i| > |d| / 2 on the side of d. `modulus_sd`: relative, s of E; 0 where E I is measured.
    """
    path, name = robot.actuators.path_radius, robot.actuators.words.kind
    powers = {f"{name}.path_radius": (-1.0, GEOMETRY_SD / path), "pressures": (-1.0, GAIN_SD)}
    if robot.chambers is not None:
        powers["chambers.radius"] = (-0.5, 2 * GEOMETRY_SD / robot.chambers.radius)
        powers["area_factor"] = (-1.0, AREA_SD)
    if modulus_sd > 0 and robot.bending_stiffness is not None:
        powers["bending_stiffness"] = (1.0, modulus_sd)
    elif modulus_sd > 0:
        outer, inner = robot.outer_radius, robot.inner_radius
        by_wall = 4 * float(np.hypot(outer**3, inner**3)) / (outer**4 - inner**4)
        powers |= {"youngs_modulus": (1.0, modulus_sd), "outer_radius": (0.25, GEOMETRY_SD * by_wall)}
    d, total = abs(np.log(stiffness)), sum(s**2 for _, s in powers.values())
    out = []
    for name, (power, s) in powers.items():
        w = s**2 / total
        p = float(ndtr(d * (w - 0.5) / (s * np.sqrt(1 - w))))
        out.append(Origin(name, float(stiffness**power), p))
    return tuple(sorted(out, key=lambda o: -o.probability))
