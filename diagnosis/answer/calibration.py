"""The calibration: the area factor, numbers of robot.yaml that may have caused it, and another simulator's difference."""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import replace

import numpy as np
from scipy.special import expit, ndtr

from model.body import body_of
from model.effects.design import design_from_columns
from model.effects.forward import ForwardModel
from model.robot import Robot

from ..arrays import Mask, rms
from ..criticism.gaussian import Gaussian
from ..data.campaign import Campaign
from ..inference.on_baseline import SHARE, least_squares
from ..inference.prepare import AREA, MODULUS, TINY, possible, table_columns
from ..inference.problem import derivatives
from ..judgement import AREA_SD, BEYOND_SD, GAIN_SD, GEOMETRY_SD, MATERIAL_SD, OUTSTANDING_FLOORS, REDUCIBLE_RATIO, TENSE_SD
from .attribute import Attribution
from .result import Alike, Calibration, Origin, SetUp, Simulator

DETERMINED = 0.5
"""Share of its standard deviation in robot.yaml below which the data determine the modulus by themselves."""
AT_BOUND = 1e-3
"""Share of the area factor within which it has reached a limit of the fit."""
ALIKE = (("tip_payload", "mass"), ("body_modulus", "excess"), ("self_weight", "excess"))
"""Parameters that bend a robot more or less in every state, as the area factor does, and are no factor on it."""
ALIKE_RATIO, ALIKE_LOST = 1.1, 0.05
"""Times what calibration leaves up to which they do the same; share of states that may have no equilibrium."""


def calibration(f: Attribution, fitted: Mapping[str, float] | None = None, stated: Container[int] = ()) -> Calibration | None:
    """The section `calibration`: the area factor of the calibrated baseline, or of the robot `fitted` with what is named
    (EFFECT.PARAMETER -> value), next to robot.yaml's; None where there is none, as of stiffness trials alone. `stated`: indices
    of the numbers that are stated to be beyond their tolerance: the modulus among them has one value."""
    p = f.prepared
    if p.pushes_only or AREA not in p.problem.parameters.names:
        return None
    if p.baseline is not None:
        return Calibration(p.area_factor(f.calibrated.theta), p.baseline.area_factor)
    robot, states = p.described or (p.robot, p.states)
    stated_factor = float(np.mean(robot.area_factor_at(states.spine_length[~p.states.pushed])))
    theta = dict(zip(p.problem.parameters.names, f.calibrated.theta.tolist(), strict=True)) if fitted is None else fitted
    modulus = p.robot.youngs_modulus / robot.youngs_modulus * (1 + theta.get(MODULUS, 0.0))
    parameters, factor = p.problem.parameters, float(p.forward.area_factor[0]) * (1 + theta[AREA])
    area, modulus_at = (parameters.names.index(name) for name in (AREA, MODULUS))
    at_bound = min(abs(theta[AREA] - limit[area]) for limit in (parameters.lower, parameters.upper)) < AT_BOUND
    # whether the data know the modulus better than robot.yaml does, as where the body's weight bends it
    where = f.best.weighed.peak
    posterior = Gaussian(f.best.fit.linear(p.problem), f.best.prior(parameters), where.size, where.form_error)
    determined = bool(posterior.covariance(parameters.of_effect, np.array([modulus_at]))[0, 0] < DETERMINED**2)
    determined = determined or (modulus_at in stated and bool(abs(theta[MODULUS]) > BEYOND_SD * parameters.sd[modulus_at]))
    result = Calibration(factor, stated_factor, modulus, at_bound=at_bound, determined=determined)
    # stiffness trials measure the modulus, which is then no origin
    modulus_sd = 0.0 if p.states.pushed.any() else robot.uncertainty.youngs_modulus or MATERIAL_SD
    possible_origins = origins(robot, result.stiffness if modulus_sd else result.stiffness / modulus, modulus_sd)
    unclear = determined or f.decision.verdict == "unknown"  # no number of robot.yaml, or what is unknown may be behind it
    return replace(_with_set_up(result, f), origins=() if unclear else possible_origins, alike=alike(f, robot, states))


def _with_set_up(c: Calibration, f: Attribution) -> Calibration:
    """The calibration with how far body and set-up move what the gap is of, to first order."""
    problem, theta = f.prepared.problem, f.calibrated.theta
    p, slope = problem.parameters, f.calibrated.derivatives(problem).every
    lasting, body = ~p.of_effect & ~p.recurs, np.isin(p.names, (AREA, MODULUS))

    def moves(chosen: Mask) -> float:
        return 1e3 * rms(f.prepared.gap(problem.noise.colour(slope.along(np.where(chosen, theta / p.sd, 0.0)))))

    out = []
    for i in np.flatnonzero(lasting & ~p.calibration & ~body):
        own, number = np.arange(len(theta)) == i, p.infos[i]
        out.append(SetUp(number.name.removesuffix(".excess"), abs(float(theta[i])), float(p.sd[i]), number.unit, moves(own)))
    least = 1e3 * OUTSTANDING_FLOORS * f.prepared.noise_floor
    return replace(c, body_mm=moves(body), set_up=tuple(sorted((s for s in out if s.mm >= least), key=lambda s: -s.mm)))


def alike(f: Attribution, robot: Robot, states: Campaign) -> tuple[Alike, ...]:
    """Effects of `ALIKE` of which one alone, with robot.yaml's area factor, leaves the tip errors as small as calibration does;
    least first, none where the gap is hardly above the noise floor."""
    p = f.prepared
    effects = {id: p.forward.catalogue[id] for id, _ in ALIKE if id in p.forward.catalogue}
    if not effects or robot.stated or rms(p.gap(p.problem.observed - p.given)) < REDUCIBLE_RATIO * p.noise_floor:
        return ()
    table = table_columns(states)
    forward = ForwardModel(robot, design_from_columns(robot, table, ("x", "y", "z")), "one", effects, sized=p.forward.scales)
    infos = possible(forward, robot)
    names = [i.name for i in infos]
    observed = forward.observe(table)
    tolerances = [k for k, i in enumerate(infos) if i.group == "nuisance" and i.lasts and i.name != MODULUS]  # it is alike itself
    most_left = max(OUTSTANDING_FLOORS * p.noise_floor, ALIKE_RATIO * rms(p.gap(p.problem.observed - f.calibrated.predicted)))
    as_good = []
    for k in [names.index(key) for id, name in ALIKE if (key := f"{id}.{name}") in names]:
        free, sd = [k, *tolerances], np.array([np.inf, *(infos[i].sd for i in tolerances)])  # the effect has no prior
        low, high = ([getattr(infos[i], side) for i in free] for side in ("low", "high"))
        theta, left = least_squares(forward, observed, free, sd / (p.noise_floor / np.sqrt(3)), low, high)
        remaining = float(np.sqrt(3 * np.nanmean(left**2))) if np.isfinite(left).mean() > 1 - ALIKE_LOST else np.inf
        beyond = any(abs(theta[i]) > TENSE_SD * infos[i].sd for i in tolerances)
        if remaining <= most_left and infos[k].low < theta[k] < infos[k].high and not beyond:
            as_good.append(Alike(names[k], float(theta[k]), infos[k].unit, 1e3 * remaining))
    return tuple(sorted(as_good, key=lambda a: a.left_mm))


def alone_as_good(c: Calibration | None, f: Attribution) -> tuple[str, ...]:
    """Effects that are not named and alone, with robot.yaml's area factor, leave nothing above the noise floor."""
    most = REDUCIBLE_RATIO * 1e3 * f.prepared.noise_floor
    near = (a.parameter.partition(".")[0] for a in (c.alike if c is not None else ()) if a.left_mm <= most)
    return tuple(effect for effect in near if effect not in f.decision.effects)


def origins(robot: Robot, stiffness: float, modulus_sd: float) -> tuple[Origin, ...]:
    """Numbers that an area factor may stand for, most probable first.

    Pressures bend a body in proportion to k = g a r / (E I): regulator gain g, chambers' area a and distance r from the axis,
    modulus E, second moment of area I. `stiffness` is 1 / k, as a ratio to that of robot.yaml. With independent log errors
    d_i ~ N(0, s_i^2) whose sum is d, those given d are N(w_i d, s_i^2 (1 - w_i)), w_i = s_i^2 / sum s^2; the probability is that
    of |d_i| > |d| / 2 on the side of d. `modulus_sd`: relative, s of E; 0 where E I is measured. The section is drawn
    without the chambers' cavities. Of a softer body, where no area factor makes up for them yet, it is as probable before as
    not that they change E I, by exp(c).
    """
    path, name = float(np.mean(robot.actuators.path_radius)), robot.actuators.words.kind
    powers = {f"{name}.path_radius": (-1.0, GEOMETRY_SD / path), "pressures": (-1.0, GAIN_SD)}
    if robot.chambers is not None:
        powers["chambers.radius"] = (-0.5, 2 * GEOMETRY_SD / float(np.mean(robot.chambers.radius)))
        powers["area_factor"] = (-1.0, robot.uncertainty.area_factor or AREA_SD)
    if modulus_sd > 0 and robot.bending_stiffness is not None:
        powers["bending_stiffness"] = (1.0, modulus_sd)
    elif modulus_sd > 0:
        outer, inner = robot.outer_radius, robot.inner_radius
        by_wall = 4 * float(np.hypot(outer**3, inner**3)) / (outer**4 - inner**4)
        powers |= {"youngs_modulus": (1.0, modulus_sd), "outer_radius": (0.25, GEOMETRY_SD * by_wall)}
    d, total = abs(np.log(stiffness)), sum(s**2 for _, s in powers.values())
    out, change, cavities = [], 0.0, 0.0  # the cavities' -c, and the probability that they change E I
    if robot.chambers is not None and robot.bending_stiffness is None and robot.area_factor == 1.0 and stiffness < 1:
        area = robot.chambers.area * robot.chambers.shares
        second = float((area * (area / (4 * np.pi) + (path * robot.chambers.levers) ** 2 / 2)).sum())
        change = -float(np.log(max(1 - second / body_of(robot).mean_second, TINY)))
        cavities = float(expit(change * (d - change / 2) / total))
        if change > d / 2:
            out.append(Origin("cavities", float(np.exp(-change)), cavities))
    for name, (power, s) in powers.items():
        w = s**2 / total
        alone, beside = (float(ndtr((w * rest - d / 2) / (s * np.sqrt(1 - w)))) for rest in (d, d - change))
        out.append(Origin(name, float(stiffness**power), (1 - cavities) * alone + (0 if change > d / 2 else cavities * beside)))
    return tuple(sorted(out, key=lambda o: -o.probability))


def simulator(f: Attribution) -> Simulator | None:
    """How far the tips of a simulator that takes the rod's place lie from the rod's under the leading hypothesis, rms in mm, in
    all and beyond what calibration makes up; None without one. Its share s: y = rod + (1 - s) (simulator - rod)."""
    p, fitted = f.prepared, f.best.fit
    if p.baseline is None:
        return None
    parameters = p.problem.parameters
    share_index, tips = parameters.names.index(SHARE), p.labels.kind == 0
    count = len(np.unique(p.labels.state[tips]))
    free = [share_index, *(i for i in np.flatnonzero(parameters.calibration).tolist() if i != share_index)]
    slope = derivatives(p.problem.forward, fitted.theta, free)[1].whole[tips]
    difference, slope = -slope[:, 0], slope[:, 1:]  # m; y is linear in s
    beyond_area = difference - slope @ np.linalg.lstsq(slope, difference, rcond=None)[0]
    share = float(fitted.theta[share_index])
    in_all_mm, beyond_mm = (float(np.sqrt(d @ d / count)) * 1e3 for d in (difference, beyond_area))
    stated_factor = float(np.mean(p.robot.area_factor_at(p.states.spine_length[~p.states.pushed])))
    return Simulator(p.baseline.name, p.baseline.area_factor, in_all_mm, beyond_mm, share, share * beyond_mm, stated_factor)
