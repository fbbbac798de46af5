"""A robot fitted with the effects that are asked for: the area factor, their parameters, and the tolerances of the set-up.

Problem and search are those of the diagnosis (noise, discrepancy, tolerances of single trials integrated out); what is written
down is the most probable point and how uncertain it is. Effects that are not named are absent.

    fitted = fit_effects(case, ["spine_slip"])
    fitted.robot          # for robot.yaml
    fitted.parameters     # area_factor, spine_slip.moment .. with sd and unit
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy.special import softmax

from model.calibration import AXES
from model.effects.catalogue import CATALOGUE
from model.effects.nominal import stated_effects, tolerances
from model.effects.spec import EffectSpec
from model.errors import BadEffect, nearest
from model.estimate import Estimate
from model.robot import THRUST, Robot, robot_from_dict
from model.shown import Shown
from model.stated import AREA_FACTOR
from recordings.trials import marker_columns

from .answer.attribute import calibrated
from .answer.headline import sized
from .answer.result import FittedRobot, Value
from .answer.sentences import beyond_tolerance, tracked_turn
from .answer.size import ByActuator, by_actuator
from .arrays import DIGITS, rms, rounded, rows_by
from .criticism.gaussian import Gaussian
from .data.campaign import Campaign
from .data.case import Case, states
from .data.noise_components import NoiseComponents
from .data.shift import shifted
from .edits.order import ORDER, contradicted
from .errors import BadCase
from .findings import Finding, finding
from .inference.candidate import Candidate
from .inference.evidence import KNOWN, weigh
from .inference.executor import Progress, no_progress, one_thread
from .inference.prepare import AREA, Prepared, prepare
from .inference.search import Search
from .inference.thrust import settled_and_edited
from .judgement import SIZE_SD_FACTOR, UNDETERMINED_SHARE

ALWAYS_CONSIDERED = "pressure_offset"
"""Noise of the pressure readings is found by its derivatives, whether or not it is fitted."""
RECURRING = {
    "spine_length": "spine_length", "spine_stiffness": "spine_stiffness", "turn": "repeat_turn", "shift": "repeat_shift",
}  # fmt: skip
"""Key of `posterior.noise` -> the tolerance that recurs with each trial or repeat."""
FEW_REPEATS = 8
"""Weight of the noise of all axes in the estimate for one axis, as a number of differences between repeats."""
FITTED_LAW_ERRORS = np.array([0.0, 0.01, 0.03, 0.1, 0.3])
"""Among which the data tell how wrong a law is here. (A diagnosis takes no law for exact, lest it be too sure of a name.)"""


@dataclass(frozen=True, kw_only=True, repr=False)
class Fitted(Shown, FittedRobot):
    """A fitted robot, and how well it describes the states it was fitted to (in-sample)."""

    robot: Robot
    """With effects, tolerances, area factor and posterior."""
    states: int
    trials: int
    findings: tuple[Finding, ...]
    area_factor: Estimate | None = None
    """Of the calibrated robot without effects, for all spine lengths, tolerances fitted too. None without tips. Its residual, m,
    is that of the tip."""
    by_actuator: tuple[ByActuator, ...] = ()
    """Of effects that are a factor on each actuator, relative to the mean."""
    left_out_mm: float | None = None
    """rms of the tip with effects and learnt residual, on settings that the residual did not learn from."""
    spine_modulus: Mapping[float, Estimate] = field(default_factory=dict)
    """Pa by spine length (m), from pushes."""
    body_modulus: Estimate | None = None
    """Pa, from pushes."""
    area_factor_by_length: Mapping[float, Estimate] = field(default_factory=dict)
    """One for each spine length (m), the set-up taken as exact, as the paper has it."""
    markers_mm: Mapping[int, float] = field(default_factory=dict)
    """rms of each marker that was fitted besides the tip, by its number."""

    def _rows(self) -> Iterator[tuple[str, Value]]:
        """All that was fitted, by name."""
        bodies = {"youngs_modulus": self.body_modulus} if self.body_modulus else {}
        for name, e in {**bodies, **{f"spine.modulus at {s:g} m": e for s, e in self.spine_modulus.items()}}.items():
            yield name, Value(e.value, e.standard_error, "Pa")
        for length, area in self.area_factor_by_length.items():
            yield f"area_factor at {length:g} m", Value(area.value, area.standard_error, "1")
        yield from self.parameters.items()
        for each in self.by_actuator:
            yield from each.by_name(self.robot.actuators.words).items()

    def _columns(self) -> dict[str, Any]:
        rows = [(name, v.value, v.sd, *v.interval, v.unit.strip("1"), v.note) for name, v in self._rows()]
        heads = ("parameter", "value", "sd", "low 95 %", "high 95 %", "unit", "note")
        return {head: [row[k] for row in rows] for k, head in enumerate(heads)}

    def __repr__(self) -> str:
        words = self.robot.actuators.words
        sizes = "; ".join(f"{name} = {sized(v, words)}" for name, v in [*self._rows()][:9])
        differs = "".join(f" ({each.says(words)})" for each in self.by_actuator)
        effects = (", ".join(self.effects) or "no effect") + differs
        tips = (
            f"{self.states} states in {self.trials} trials, {self.left_mm:.3g} mm rms (in-sample)" if self.states else "no tips"
        )
        return f"<Fitted: {self.robot.name} with {effects}, {tips}; {sizes or 'nothing could be fitted'}>"

    def as_dict(self) -> dict[str, Any]:
        """JSON-able; lengths in mm, fitted numbers in SI units."""
        posterior, area = self.robot.posterior, self.area_factor
        return {
            **{name: getattr(self, name) for name in ("effects", "states", "trials")},
            "calibrated_mm": self.calibrated_mm if area else None,
            "fitted_mm": self.left_mm if area else None,
            "spine_modulus": {f"{length:g}": e.as_dict() for length, e in self.spine_modulus.items()},
            "body_modulus": self.body_modulus.as_dict() if self.body_modulus else None,
            "area_factor": {**area.as_dict(), "rmse_m": area.rms_residual} if area else None,
            "area_factor_by_length": {
                f"{length:g}": {**one.as_dict(), "rmse_m": one.rms_residual} for length, one in self.area_factor_by_length.items()
            },
            "parameters": {n: asdict(p) for n, p in self.parameters.items()},
            "by_actuator": [asdict(each) for each in self.by_actuator],
            "in_sample": True,
            "findings": [asdict(f) for f in self.findings],
            "noise_floor_mm": 1e3 * posterior.noise.floor if posterior else None,
            "law_error": posterior.law_error if posterior else None,
            "discrepancy_mm": 1e3 * posterior.discrepancy if posterior else None,
            "residual_left_out_mm": self.left_out_mm,
            "markers_mm": dict(self.markers_mm),
        }


@one_thread()
def fit_effects(
    case: Case,
    effects: Sequence[str],
    catalogue: Mapping[str, EffectSpec] = CATALOGUE,
    progress: Progress = no_progress,
    residual: bool = False,
    start: Mapping[str, float] = MappingProxyType({}),
) -> Fitted:
    """Fit area factor, effects (none: the calibrated baseline) and tolerances to the states of a case.

    Effects that its robot.yaml has and that are not named stay as they are. `start`: parameter -> value, as `Fitted.parameters`
    has them, of a robot from which the search begins too, such as that of a diagnosis. Raises `BadEffect` for an effect that is
    not in the catalogue, `BadRobot` for one that robot.yaml states wrongly, `BadCase` when the table cannot be used, or is too
    short for a residual.
    """
    for effect in effects:
        if effect not in catalogue:
            raise BadEffect(f"effect {effect!r}: is not known, {nearest(effect, catalogue)}")
    named = tuple(id for id in catalogue if id in effects)
    case_states, findings = states(case)
    findings = (*shifted(case.table, case.robot.length), *findings)
    if case_states.pushed.all():
        raise BadCase("effects are fitted to tips, and no row has one: record a bending or elongation run")
    other_effects = {id: stated for id, stated in case.robot.effects.items() if id not in named}
    cleared: dict[str, Any] = {"effects": other_effects, "tolerances": {}, "posterior": None, "residual": None}
    robot = case.robot.model_copy(update=cleared | ({"thrust": None} if THRUST in named else {}))
    # edits leave a robot with effects as it is
    settled, edited = settled_and_edited(robot, case_states, catalogue, named)
    robot, case_states = edited.robot, edited.states
    if settled is not None and THRUST in robot.effects:  # how thrust gets into the walls is fitted with the rest
        shapes = {f"{THRUST}.{name}": shape.value for name, shape in robot.effects[THRUST].items() if name != "share"}
        robot = robot.model_copy(update={"effects": {id: effect for id, effect in robot.effects.items() if id != THRUST}})
        named, start = tuple(id for id in catalogue if id in (*named, THRUST)), {**shapes, **start}
    # an order that was found is part of the robot now
    settled_before = tuple(id for id in named if id in robot.effects)
    named = tuple(id for id in named if id not in settled_before)
    if ORDER in named and not contradicted(robot, case_states):
        made = f"with {edited.named} changed, " if edited.named else ""
        raise BadEffect(f"effect {ORDER}: {made}tips go to where the chambers push them, there is no other order; leave it out")
    findings = (*edited.concerns, *findings, *filter(None, [settled]), *(finding("as_read", text=w) for w in case.table.warnings))
    fit = fit_described(robot, case_states, named, catalogue, progress, residual, start)
    return replace(fit, effects=(*settled_before, *named), findings=(*findings, *fit.findings))


def fit_described(
    robot: Robot,
    campaign: Campaign,
    named: tuple[str, ...],
    catalogue: Mapping[str, EffectSpec],
    progress: Progress = no_progress,
    residual: bool = False,
    start: Mapping[str, float] = MappingProxyType({}),
    noise_components: NoiseComponents | None = None,
) -> Fitted:
    """Fit effects to the states of a robot whose conventions are settled and which was calibrated first; see `fit_effects`.
    `noise_components`: of these states, where they are known."""
    considered = {*named, *stated_effects(robot, catalogue), ALWAYS_CONSIDERED}
    some = {id: spec for id, spec in catalogue.items() if id in considered}
    p = prepare(robot, campaign, catalogue=some, noise_components=noise_components)
    progress("step 1 of 4: starting points", 0.0)
    search = Search(p.problem)
    progress("step 2 of 4: calibration", 0.0)
    baseline = calibrated(p)
    progress("step 3 of 4: effects", 0.0)
    known = {**start, AREA: p.area_parameter(start.get(AREA_FACTOR, p.forward.area_factor[0]))}
    begin = [np.array([known.get(name, 0.0) for name in p.problem.parameters.names])] if start else []
    fitted = search.fitted(named, [baseline.theta, *begin])
    progress("step 4 of 4: tolerances", 0.0)
    main = campaign.main
    # what recurs or drifts is at its expectation
    first, last = (p.problem.observed - p.problem.forward.predict(p.common(f.theta)) for f in (baseline, fitted.fit))
    before, missed = p.tip(first)[main], p.tip(last)[main]
    of_marker = {k: last[np.isin(p.labels.channel, own)] for k, own in enumerate(marker_columns(len(robot.markers)), 1)}
    rms_after = rms(missed)
    stated, posterior = _posterior(p, fitted, rms_after)
    described, left_out = _written(robot, p, named, stated, posterior), None
    if residual:
        from .fit_residual import learn_residual  # with scipy.optimize, an eighth of the start, which only a residual needs

        pressure, length = campaign.vented_at_zero[main], campaign.spine_length[main]
        learnt, left_out = learn_residual(campaign.trial[main], pressure, length, missed)
        described = described.model_copy(update={"residual": learnt})
    names, covariance = described.joint_uncertainty()
    own = {id: [k for k, name in enumerate(names) if name.partition(".")[0] == id] for id in named}
    each = (by_actuator(robot, some[id], stated, covariance[np.ix_(k, k)]) for id, k in own.items())
    tense = p.problem.parameters.tense(fitted.fit.theta)
    dof, states = AXES * len(campaign), len(campaign)
    area = Estimate(p.area_factor(baseline.theta), stated[AREA_FACTOR].sd, dof, states, rms(before))
    findings = (*tracked_turn(p, fitted.fit.theta), *([beyond_tolerance(p, fitted.fit, robot, tense)] if tense else ()))
    return Fitted(
        named, stated, 1e3 * rms_after, 1e3 * rms(before), robot=described, states=len(campaign),
        trials=len(np.unique(campaign.trial)), area_factor=area, findings=findings,
        by_actuator=tuple(filter(None, each)), left_out_mm=None if left_out is None else 1e3 * left_out,
        markers_mm={k: 1e3 * math.sqrt(AXES) * rms(values) for k, values in of_marker.items() if values.size},
    )  # fmt: skip


def _posterior(p: Prepared, c: Candidate, rms_after: float) -> tuple[dict[str, Value], dict[str, Any]]:
    """Written parameters (area factor, named effects, tolerances of the whole set-up) and robot.yaml's `posterior`; `rms_after`
    (m) of the fit."""
    parameters = p.problem.parameters
    linear = c.fit.linear(p.problem)
    # posterior rms of the model-form error (share) and of the discrepancy (units of `Linear.discrepancy`), on a grid of both
    grid = replace(KNOWN.part(c.with_tolerances), form_errors=FITTED_LAW_ERRORS)
    probability = softmax(weigh(linear, grid, parameters, [c.named])[0].log_terms)  # (spikes, sizes, form errors)
    # without a named effect, no law can be wrong: one form error, the first, 0
    law_error = float(np.sqrt(probability.sum(axis=(0, 1)) @ FITTED_LAW_ERRORS[: probability.shape[2]] ** 2))
    size = float(np.sqrt(probability.sum(axis=(0, 2)) @ grid.sizes**2))
    of_set_up, index_of = tolerances(p.robot), {AREA_FACTOR: parameters.names.index(AREA)}
    for i, (name, info) in enumerate(zip(parameters.names, parameters.infos, strict=True)):
        if parameters.effects[i] in c.named or (info.source in of_set_up and not info.recurs):
            index_of[name] = i
    columns = np.array(list(index_of.values()))
    covariance = Gaussian(linear, c.prior(parameters), size, law_error).covariance(parameters.of_effect, columns)
    scale, free = np.sqrt(np.diag(covariance)), parameters.scaled(c.prior(parameters))[0]
    area = float(p.forward.area_factor[0])
    stated: dict[str, Value] = {}
    for (name, i), relative_sd in zip(index_of.items(), scale.tolist(), strict=True):
        named = parameters.effects[i] in c.named
        value, value_sd = float(c.fit.theta[i]), (SIZE_SD_FACTOR if named else 1.0) * relative_sd * float(free[i])
        if name == AREA_FACTOR:
            value, value_sd = area * (1 + value), area * value_sd
        elif name in p.robot.stated:  # it counts from there
            value += p.robot.stated[name].value
        info, ends = parameters.infos[i], {"low": parameters.lower[i], "high": parameters.upper[i]}
        bound = next((end for end, at in ends.items() if np.isclose(c.fit.theta[i], at)), "")
        of_shape = info.role == "shape" and bound != ""  # its bounds are no physics
        undetermined = of_shape or (named and relative_sd > UNDETERMINED_SHARE)
        stated[name] = Value(rounded(value), rounded(value_sd), info.unit, not undetermined, bound)
    trials, components = len(np.unique(p.states.trial)), p.noise_components
    reading = rms(p.problem.noise.own[p.labels.kind == 0])
    # m^2 by which the mean square exceeds what the noise floor gives in as many trials, with two standard errors
    beyond_noise = max(rms_after**2 - p.noise_floor**2 * (1 + 2 * float(np.sqrt(2 / trials))), 0.0)
    # rounding must leave the correlations positive definite
    correlation = (1 - 1e-6) * covariance / np.outer(scale, scale)
    design = p.forward.design[~p.forward.design.stiffness]
    fitted = {name: getattr(design, name) for name in ("pressure", "tip_mass", *(["spine_length"] if p.robot.spine else []))}
    posterior = {
        "parameters": list(index_of),
        "area_factor_sd": stated[AREA_FACTOR].sd,
        "correlation": [[*np.round(correlation[i, :i], DIGITS).tolist(), 1.0] for i in range(len(columns))],
        "law_error": rounded(law_error),
        "discrepancy": rounded(float(np.sqrt(max((size * p.unit) ** 2, beyond_noise / 3)))),
        **{f"fitted_{name}": [rounded(end) for end in (of.min(), of.max())] for name, of in fitted.items()},
        "noise": {
            "floor": rounded(p.noise_floor),
            "reading": rounded(reading),
            "reading_by_axis": _by_axis(p, c, reading),
            "pressure": rounded(components.pressure),
            **{name: rounded(components.trial.get(source, 0.0)) for name, source in RECURRING.items()},
        },
    }
    return stated, posterior


def _by_axis(p: Prepared, c: Candidate, reading: float) -> list[float]:
    """Standard deviation (m) of a reading along x, y, z, as repeats show it beyond their pressure's error; of few, `reading`."""
    left, of_pressure = p.problem.observed - c.fit.predicted, (p.problem.noise.pressure_response**2).sum(axis=1)
    left, of_pressure = p.tip(left), p.tip(of_pressure)
    read = np.isfinite(left).all(axis=1)
    repeats = [np.flatnonzero(read)[own] for own in rows_by(p.states.condition[read])]
    each = (own.size * left[own].var(axis=0) - (own.size - 1) * of_pressure[own].mean(axis=0) for own in repeats)
    beyond = sum(each, np.zeros(3))
    variance = (np.maximum(beyond, 0.0) + FEW_REPEATS * reading**2) / (read.sum() - len(repeats) + FEW_REPEATS)
    return [rounded(sd) for sd in np.sqrt(variance).tolist()]


def _written(robot: Robot, p: Prepared, named: Sequence[str], stated: Mapping[str, Value], posterior: Mapping[str, Any]) -> Robot:
    """The robot with what was fitted (`stated`) as effects where `named`, else as tolerances, and with its posterior."""
    data = robot.model_dump() | {"area_factor": stated[AREA_FACTOR].value, "tolerances": {}, "posterior": posterior}
    data["effects"] = {id: own for id, own in data["effects"].items() if id not in named}
    for name, s in stated.items():
        id, _, parameter = name.partition(".")
        if parameter:
            own = data["effects" if id in named else "tolerances"].setdefault(id, {})
            own[parameter] = {"value": s.value, "sd": s.sd, "unit": s.unit}
    if "contact" in named:
        data["obstacle_azimuth_deg"] = rounded(float(np.degrees(np.arctan2(*p.forward.plane_direction[::-1]))))
    if named:
        data |= {"quoted_pressure": p.forward.scales.pressure, "quoted_time": p.forward.scales.time}
    return robot_from_dict(data)
