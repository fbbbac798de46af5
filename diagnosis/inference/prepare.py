"""From a case to the problem that is solved: forward model, measured values, noise floor, discrepancy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from model.condition import States
from model.effects.catalogue import CATALOGUE
from model.effects.design import design_from_columns
from model.effects.forward import ForwardModel
from model.effects.parameters import ParameterInfo
from model.effects.scales import STANDARD, Scales
from model.effects.spec import EffectSpec
from model.prediction.campaign import predict_campaign
from model.robot import Robot
from recordings.trials import TIP, Table, marker_columns

from ..arrays import Array, Mask, scattered
from ..data.campaign import Campaign, Labels, places
from ..data.noise_components import NoiseComponents
from ..edits.order import leave_out
from ..errors import FAR_OFF, BadCase
from ..judgement import DISCREPANCY_UNIT_RANGE, LEAST_NAMED_FLOORS, LEAST_NAMED_SIZE, LEAST_NOISE_FLOOR, OF_MOVED
from .budget import BudgetPart
from .discrepancy import settings, smooth_errors
from .jacobian import Columns
from .on_baseline import SHARE, Baseline, OnBaseline, on_baseline
from .problem import FitForward, FitParameter, FitParameters, MaskedForward, Problem, derivatives
from .reading_noise import StiffnessTrials, floor_of, noise_of, pressure_response, stiffness_trials

AREA, MODULUS = "area.excess", "youngs_modulus.excess"
"""The parameters of the one area factor, and of the modulus' error."""
PAYLOAD, FRAME, OBSTACLE = "tip_payload.mass", "frame_misalignment", "contact"
STIFFER = replace(STANDARD, stiffness=2 * STANDARD.stiffness)
"""Scales by which those of loads differ from the standard ones."""
TINY = 1e-12
"""m."""


@dataclass(frozen=True)
class Prepared:
    """A problem and what its values mean."""

    robot: Robot
    states: Campaign
    problem: Problem
    labels: Labels
    noise_components: NoiseComponents
    noise_floor: float
    """m, root mean square distance of a single tip reading from its condition's average; the noise floor. Differences explained
    by the states' own readings are no noise, unless removing them would increase it."""
    unit: float
    """m, size 1 of the discrepancy."""
    forward: ForwardModel
    kept: Mask
    """Which of its observations were measured, and have an equilibrium."""
    pushes: StiffnessTrials | None
    """Noise of the stiffness trials; None where there are none."""
    baseline: OnBaseline | None = None
    """The baseline in the rod's place; None: the rod itself."""
    described: tuple[Robot, Campaign] | None = None
    """Robot and states as they were given, where `robot` and `states` were calibrated first (`edits.search`)."""

    @property
    def pushes_only(self) -> bool:
        """Whether the gap is that of stiffness trials, as no state has a tip."""
        return bool(self.states.pushed.all())

    def area_factor(self, theta: Array) -> float:
        """The one area factor at parameters (k,)."""
        return float(self.forward.area_factor[0] * (1 + theta[self.problem.parameters.names.index(AREA)]))

    def area_parameter(self, area_factor: float) -> float:
        """The parameter at which `area_factor` is this: their inverse."""
        return float(area_factor / self.forward.area_factor[0] - 1)

    def common(self, theta: Array) -> Array:
        """Parameters (k,) with those of single trials and of this campaign's drift at 0: the model's prediction for a
        new trial."""
        return np.where([p.lasts for p in self.forward.parameters], theta, 0.0)

    @cached_property
    def given(self) -> Array:
        """(values,) by robot.yaml as it stands, with its area factor for each spine length, or by the simulator that takes its
        place; nothing fitted."""
        out = self.problem.forward.predict(np.zeros_like(self.problem.parameters.sd))
        if not self.pushes_only and self.baseline is None:
            own = self.labels.kind == 0
            bent = ~self.states.pushed
            robot, states = self.described or (self.robot, self.states)
            without_residual = robot.model_copy(update={"residual": None})
            predicted = predict_campaign(without_residual, table_columns(states.take(bent)), self.forward.catalogue).tip
            tip = scattered((len(self.states), 3), bent, predicted) + (self.states.tip - states.tip)
            out[own] = tip[self.labels.state[own], self.labels.axis[own]]
        return out

    def tip(self, values: Array) -> Array:
        """(states, 3) the tip's values of (n,) values; NaN where not measured."""
        return places(len(self.states), self.labels.state, self.labels.channel, values)

    def points(self, values: Array) -> Array:
        """(1 + k, states, 3) tip and markers of (n,) values; NaN where not measured."""
        of_values = partial(places, len(self.states), self.labels.state, self.labels.channel, values)
        return np.stack([of_values(axes) for axes in (TIP, *marker_columns(len(self.states.points) - 1))])

    def deflection(self, values: Array) -> Array:
        """(states,) m: forces among values (n,) as deflections of each specimen under them, NaN elsewhere."""
        own = self.labels.kind == 3
        force = scattered((len(self.states),), self.labels.state[own], values[own])
        return force if self.pushes is None else force / self.pushes.stiffness

    def gap(self, values: Array) -> Array:
        """(states, 3) m where the gap is looked for: tips, or, of stiffness trials alone, the deflection along x."""
        if not self.pushes_only:
            return self.tip(values)
        return np.pad(self.deflection(values)[:, None], ((0, 0), (0, 2)))


def prepare(
    robot: Robot,
    states: Campaign,
    catalogue: Mapping[str, EffectSpec] = CATALOGUE,
    baseline: Baseline | None = None,
    noise_components: NoiseComponents | None = None,
    sized: Scales | None = None,
) -> Prepared:
    """The problem of a case; raises `BadCase` when the model cannot be solved where the robot was.

    `baseline`: what another simulator predicts of these states, in the rod's place; it has one area factor. `noise_components`:
    of the noise where they are known, else they are estimated from repeats. `sized`: scales of effects, where they are not
    those of these states alone.
    """
    robot, catalogue = _as_placed(robot, states, catalogue)
    table = table_columns(states if baseline is None else replace(states, history=None))
    design = design_from_columns(robot, table)
    effects = leave_out(robot, states, observable_effects(robot, design, catalogue))
    on_simulator = on_baseline(robot, design, table, effects, baseline) if baseline is not None else None
    forward = on_simulator.forward if on_simulator is not None else ForwardModel(robot, design, catalogue=effects, sized=sized)
    whole: FitForward = on_simulator or forward
    predicted, slope = derivatives(whole, np.zeros(len(forward.parameters)))
    if states.pushed.all():
        # effects that change none of the values are left out
        some = np.concatenate([slope.at[slope.dense.any(axis=0)], slope.rest[np.unique(slope.sparse.nonzero()[1])]])
        moved = {forward.parameters[i].source for i in some.tolist()}
        effects = {id: spec for id, spec in forward.catalogue.items() if id in moved}
        whole = forward = ForwardModel(robot, design, catalogue=effects, sized=sized)
        predicted, slope = derivatives(whole, np.zeros(len(forward.parameters)))
    observed = forward.observe(table)
    kept = np.isfinite(observed) & np.isfinite(predicted)
    if not kept.any():
        raise BadCase(f"the rod model has no equilibrium at any measured state: {FAR_OFF}")
    labels = Labels(forward.observations.row[kept], forward.observations.channel[kept].astype(np.str_))
    made = parameters(possible(forward, robot))
    missed, response = (observed - predicted)[kept], pressure_response(forward, states, made, slope)[kept]
    slope = slope.rows(kept)
    floor, beside_model, beside_readings = floor_of(
        states, labels, forward.parameters, missed, observed[kept], slope, response, noise_components, forward.scales.time
    )
    pushes = stiffness_trials(states, labels, forward.parameters, missed, slope) if states.pushed.any() else None
    noise = noise_of(states, labels, floor, pushes, response)
    if pushes is not None and states.pushed.all():
        known_floor = beside_model = pushes.noise_floor
    else:
        known_floor = max(beside_readings, LEAST_NOISE_FLOOR)
    unit = float(np.clip(beside_model / np.sqrt(3), *np.multiply(robot.length, DISCREPANCY_UNIT_RANGE)))
    load = states.highest if pushes is None else pushes.load_level(states)
    where = settings(states.spine_length, load, states.branch, states.kind, robot.length)
    smooth = smooth_errors(where, labels.state, labels.channel, unit, robot.length)
    if pushes is not None:
        smooth = replace(smooth, size=smooth.size * np.where(labels.kind == 3, pushes.unit[labels.state], 1.0))
    # of trials what their repeats show, of all others what the effect declares
    shown = [pushes.noise_components if pushes is not None and p.name in pushes.names else floor for p in made.infos]
    sd = np.array([of.trial.get(p.source, p.sd) for of, p in zip(shown, made.infos, strict=True)])
    turn = f"{OBSTACLE}.turn"
    if robot.obstacle_azimuth_deg is None and turn in made.names and OBSTACLE not in robot.effects:
        left, at = made.beyond_calibration(missed[:, None], slope)[:, 0], made.names.index(turn)
        sd[at] = _face_obstacle(forward, states, labels, observed[kept], left, float(sd[at]))
    problem = Problem(
        MaskedForward(whole, kept),
        replace(made, sd=sd, least=least_sizes(made, slope.take(made.of_effect).whole, made, slope, labels, known_floor)),
        observed[kept],
        noise,
        smooth,
    )
    return Prepared(robot, states, problem, labels, floor, known_floor, unit, forward, kept, pushes, on_simulator)


def _as_placed(robot: Robot, states: Campaign, catalogue: Mapping[str, EffectSpec]) -> tuple[Robot, Mapping[str, EffectSpec]]:
    """Robot and catalogue where the map moved tip and markers to the model at rest: nobody knows where they were, nor, unless
    robot.yaml states it, how the cameras' frame is turned about z."""
    if not states.trials.moved_to_model:
        return robot, catalogue
    unknown = {"frame_shift": OF_MOVED * robot.length, "marker_shift": OF_MOVED * robot.length, "tracked_turn": OF_MOVED}
    placed = robot.model_copy(update={"uncertainty": robot.uncertainty.model_copy(update=unknown)})
    if FRAME not in catalogue or robot.uncertainty.frame_turn is not None:
        return placed, catalogue
    turned = tuple(replace(p, scale=OF_MOVED) if p.name == "z" else p for p in catalogue[FRAME].parameters)
    return placed, {**catalogue, FRAME: replace(catalogue[FRAME], parameters=turned)}


def _face_obstacle(forward: ForwardModel, states: Campaign, labels: Labels, observed: Array, left: Array, turn: float) -> float:
    """Turn the model to the likeliest side of an obstacle that robot.yaml does not place; return how far from there it may stand
    (rad, at least `turn`): the circular standard deviation (-2 log R)^(1/2) <= pi, R = |sum p| / sum |p|, of tips p from rest.

    On that side tips get less far, by what calibration leaves (`left` (n,)), in proportion to how much farther they would get
    than half as far as any.
    """
    tip, turns, (x, y) = labels.kind == 0, np.arange(-6.0, 6.0) * (np.pi / 6), forward.plane_direction.tolist()
    where, shape = (labels.state[tip], labels.axis[tip]), (int(labels.state.max()) + 1, 3)
    short, reached = (np.nan_to_num(scattered(shape, where, values[tip])[:, :2]) for values in (-left, observed - left))
    rest = (states.highest <= states.pressure_gap)[: len(reached)]
    reached -= reached[rest].mean(axis=0) if rest.any() else 0.0  # else a body that sags seems to move one way
    together = np.linalg.norm(reached.sum(axis=0)) / max(float(np.linalg.norm(reached, axis=1).sum()), TINY)
    spread = max(turn, min(float(np.sqrt(-2 * np.log(np.clip(together, TINY, 1.0)))), np.pi))
    sides = np.array([np.cos(turns) * x - np.sin(turns) * y, np.sin(turns) * x + np.cos(turns) * y])
    farther = np.maximum(reached @ sides - 0.5 * (reached @ sides).max(axis=0), 0.0)
    gain = (farther * (short @ sides)).sum(axis=0) / np.maximum(np.linalg.norm(farther, axis=0), TINY)
    gain[np.abs(turns) > 3 * spread] = 0.0
    if gain.max() > 0:
        forward.face(sides[:, gain.argmax()])
    return spread


def parts(prepared: Prepared) -> tuple[BudgetPart, ...]:
    """The tips of a campaign, and the forces of its stiffness trials."""
    state, pushes = prepared.labels.state, prepared.pushes
    of_tips, of_pushes = (np.flatnonzero(prepared.labels.kind == k) for k in (0, 3))
    found = [(of_tips, np.ones(len(of_tips)), prepared.noise_floor)]
    if pushes is not None:
        found.append((of_pushes, 1 / pushes.stiffness[state[of_pushes]], pushes.noise_floor))
    return tuple(BudgetPart(rows, unit, floor, len(np.unique(state[rows]))) for rows, unit, floor in found if rows.size)


def observable_effects(robot: Robot, design: States, catalogue: Mapping[str, EffectSpec]) -> Mapping[str, EffectSpec]:
    """A catalogue without the effects that these states cannot show."""
    return {id: spec for id, spec in catalogue.items() if spec.shown is None or spec.shown(robot, design)}


def table_columns(states: Campaign) -> dict[str, NDArray[np.generic]]:
    """The table's columns of states and history (`unread`), spine lengths not below zero, vented chambers at zero gauge."""
    pressures = {f"p{i}": column for i, column in enumerate(states.vented_at_zero.T, 1)}
    table = states.trials.replaced({"spine_length": states.spine_length, **pressures})
    if states.history is None:
        return {name: table[name] for name in table.columns}
    both = Table.stacked([table, Table(table_columns(states.history))])
    order = np.lexsort((np.concatenate([states.row, states.history.row]), both.pushed))
    return {name: both[name][order] for name in both.columns} | {"unread": order >= len(states)}


def possible(forward: ForwardModel, robot: Robot) -> tuple[ParameterInfo, ...]:
    """The forward model's parameters without impossible sizes: no more mass is removed from the tip than hangs there."""
    stated, tips = robot.stated.get(PAYLOAD), ~forward.design.stiffness
    hanging = float(forward.design.tip_mass[tips].min(initial=np.inf)) + (stated.value if stated is not None else 0.0)
    return tuple(replace(i, low=max(i.low, -hanging)) if i.name == PAYLOAD else i for i in forward.parameters)


def parameters(infos: tuple[ParameterInfo, ...]) -> FitParameters:
    """The forward model's table as the diagnosis sees it."""
    names = [f.name for f in fields(FitParameter) if f.name != "load"]
    every = (FitParameter(**{n: getattr(i, n) for n in names}, load=STIFFER.of(i.unit) != STANDARD.of(i.unit)) for i in infos)
    own = tuple(replace(p, group="calibration") if p.name == SHARE else p for p in every)
    return FitParameters(own, np.array([p.sd for p in own]), (LEAST_NAMED_SIZE,) * len(own))


def least_sizes(
    made: FitParameters, by_effects: Array, beside: FitParameters, slope: Columns, labels: Labels, floor: float
) -> tuple[float, ...]:
    """Size of each effect's parameter, as a share of its scale, at which it carries `LEAST_NAMED_FLOORS` noise floors (m) of the
    tip beyond the calibration, to first order at zero, at most `LEAST_NAMED_SIZE`; at least what its effect asks for. Derivatives
    (n, p) by these, and by all parameters `beside`, among them those of the calibration."""
    tips, out = labels.kind == 0, np.full(len(made.infos), LEAST_NAMED_SIZE)
    if not tips.any():
        return tuple(out.tolist())
    left = beside.beyond_calibration(by_effects[tips] * made.scale, slope.rows(tips))
    carried = np.sqrt((left**2).sum(axis=0) / len(np.unique(labels.state[tips])))
    out[made.of_effect] = np.minimum(LEAST_NAMED_SIZE, LEAST_NAMED_FLOORS * floor / np.maximum(carried, TINY))
    return tuple(np.maximum(out, [p.least / p.sd for p in made.infos]).tolist())
