"""What calibration changes: the area factor, the numbers of robot.yaml it may stand for, and another simulator's difference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import ndtr

from model.robot import Robot

from ..inference.on_baseline import SHARE
from ..inference.prepare import AREA, MODULUS
from ..judgement import AREA_SD, GAIN_SD, GEOMETRY_SD, MATERIAL_SD
from .attribute import Attribution
from .result import Calibration, Origin, Simulator

AT_BOUND = 1e-3
"""Share of the area factor within which it has reached a limit of the fit."""


def calibration(f: Attribution) -> Calibration | None:
    """The section `calibration`: the one area factor of the calibrated baseline next to robot.yaml's."""
    p = f.prepared
    if p.baseline is not None or p.pushes_only or AREA not in p.problem.parameters.names:
        return None
    robot, states = p.described or (p.robot, p.states)
    own = ~p.states.pushed
    given = float(np.mean(robot.area_factor_at(states.spine_length[own])))
    theta = dict(zip(p.problem.parameters.names, f.calibrated.theta.tolist(), strict=True))
    modulus = p.robot.youngs_modulus / robot.youngs_modulus * (1 + theta.get(MODULUS, 0.0))
    area = p.problem.parameters.infos[p.problem.parameters.names.index(AREA)]
    at_bound = min(abs(theta[AREA] - area.low), abs(theta[AREA] - area.high)) < AT_BOUND
    found = Calibration(p.area_factor(f.calibrated.theta), given, modulus, at_bound=at_bound)
    # stiffness trials measure the modulus
    known = 0.0 if p.states.pushed.any() else robot.uncertainty.youngs_modulus or MATERIAL_SD
    return replace(found, origins=origins(robot, found.stiffness if known else found.stiffness / modulus, known))


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


def simulator(f: Attribution) -> Simulator | None:
    """How the simulator in the rod's place differs from the rod under the leading hypothesis; None without one."""
    p, fitted = f.prepared, f.best.fit
    if p.baseline is None:
        return None
    parameters = p.problem.parameters
    at = parameters.names.index(SHARE)
    rod, theirs = fitted.theta.copy(), fitted.theta.copy()
    rod[at], theirs[at] = 1.0, 0.0
    own = p.labels.kind == 0
    difference = (p.problem.forward.predict(theirs) - p.problem.forward.predict(rod))[own]
    count = len(np.unique(p.labels.state[own]))
    free = [i for i in np.flatnonzero(parameters.calibration).tolist() if i != at]
    slope = p.problem.linearise(fitted.theta, free)[1][own]
    left = difference - slope @ np.linalg.lstsq(slope, difference, rcond=None)[0]
    share = float(fitted.theta[at])
    differs, beyond = (float(np.sqrt(d @ d / count)) * 1e3 for d in (difference, left))
    return Simulator(p.baseline.name, p.baseline.area_factor, differs, beyond, share, share * beyond)
