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
    """Share 0..1 of each effect that `calibration` (n, c), columns of free parameters, takes over.

    `slope` (n, k) derivatives by the parameters; `weight` (n,) of each value, 0 for values that are not looked at.
    """
    free = weight[:, None] * calibration
    basis, size, _ = np.linalg.svd(free, full_matrices=False)
    basis = basis[:, size > 1e-10 * max(float(size.max(initial=0.0)), 1e-300)]
    out = {}
    for effect in parameters.ids:
        own = [i for i, e in enumerate(parameters.effects) if e == effect]
        columns = weight[:, None] * slope[:, own] * parameters.sd[own]
        total = float((columns**2).sum())
        left = columns - basis @ (basis.T @ columns)
        out[effect] = 1.0 - float((left**2).sum()) / total if total > 0 else 1.0
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
