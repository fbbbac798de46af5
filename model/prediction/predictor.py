"""States in, readings out: checked arrays, in batches on several cores, with intervals and gradients where they are wanted."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from model.arrays import Array, Mask, Order
from model.condition import HOLD, NOMINAL_VACUUM, RATE, States, conditions
from model.effects.catalogue import CATALOGUE
from model.effects.forward import ForwardModel, InputChange
from model.effects.spec import EffectSpec
from model.errors import BadCondition
from model.prediction.residual import LearntResidual, residual_of
from model.prediction.spread import PRESSURE, standard_deviations, uncertain
from model.robot import THRUST, Robot
from model.shown import Shown, by_axis
from model.stated import AREA_FACTOR

BATCH = 4096
"""States that are worked on together: their arrays stay within a processor's cache."""
PRESSURE_STEP, LENGTH_STEP = 50.0, 1e-5
"""Pa and m by which inputs are varied for a gradient."""
PRESSURE_NOISE = 2e3
"""Pa by which a reading of a regulator may lie outside the robot's limits."""
FITTED_NOISE = 0.02
"""Share of the highest pressure or mass fitted, or of the robot's length, by which a state may lie outside what was fitted."""
NORMAL_95 = 1.959963984540054


@dataclass(frozen=True)
class Prediction(Shown):
    """What is expected of n states; NaN where the rod has no equilibrium. Base frame, SI."""

    tip: Array
    """(n, 3) m, as the cameras read it."""
    orientation: Array
    """(n, 4) unit quaternion w, x, y, z of the tip, w >= 0."""
    shape: Array
    """(n, k, 3) m at the arc lengths that were asked for, the robot's markers unless given."""
    model_sd: Array | None = None
    """(n, 3) m: standard deviation of where the tip is (parameters, law error, discrepancy, pressure, spine grown anew)."""
    sd: Array | None = None
    """(n, 3) m: the same of a reading of it, its noise included."""
    orientation_sd: Array | None = None
    """(n, 3) rad, about the base frame's axes, as `model_sd`, without discrepancy."""
    shape_sd: Array | None = None
    """(n, k, 3) m, as `sd`."""
    tip_by_pressure: Array | None = None
    """(n, 3, chambers) m/Pa."""
    tip_by_length: Array | None = None
    """(n, 3) m/m: by the spine's length."""
    outside: Mask | None = None
    """(n,) whether a state is outside the robot's limits or what was fitted, see `outside_known`: nothing was measured there.
    None from `campaign`."""

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        """(n, 3) m: as an array a prediction is its tips."""
        return np.array(self.tip, dtype)

    def __len__(self) -> int:
        return len(self.tip)

    def __getitem__(self, key: Any) -> Any:
        return self.tip[key]

    @property
    def converged(self) -> Mask:
        """(n,) whether the rod has a trusted equilibrium."""
        return np.asarray(np.isfinite(self.tip).all(axis=1))

    def __repr__(self) -> str:
        given = [f.name for f in fields(self) if getattr(self, f.name) is not None]
        return f"<Prediction: {len(self.tip)} states, {int((~self.converged).sum())} without an equilibrium; {', '.join(given)}>"

    def _columns(self) -> dict[str, Any]:
        tip, reading = by_axis("tip {} [mm]", self.tip), by_axis("sd of a reading of {} [mm]", self.sd)
        return {**tip, **reading, **by_axis("orientation {}", self.orientation, 1, "wxyz")}

    def interval(self, model_only: bool = False) -> tuple[Array, Array]:
        """Ends (n, 3) m of the 95 % interval of a reading of the tip, or of where it is; raises `BadCondition` without."""
        sd = self.model_sd if model_only else self.sd
        if sd is None:
            raise BadCondition("interval: was not asked for, give intervals=True")
        return self.tip - NORMAL_95 * sd, self.tip + NORMAL_95 * sd


class Predictor:
    """The model of one robot, its effects and tolerances included, made once and used often.

    `catalogue`: effects of one's own besides the project's; `cores`: threads (all unless given). Raises `BadRobot` for an
    effect that robot.yaml states wrongly.

    >>> from pathlib import Path
    >>> from model.robot import load_robot
    >>> at = Predictor(load_robot(Path("robot.yaml")))
    >>> at([[60e3, 60e3, 60e3, 0, 0, 0, 0, 0, 0]], spine_length=0.1).tip.round(2)
    array([[-0.01, -0.01,  0.4 ]])
    """

    def __repr__(self) -> str:
        r = self.robot
        return f"<Predictor of {r.name}: {len(r.actuators.azimuths_deg)} actuators, effects: {', '.join(r.effects) or 'none'}>"

    def __init__(self, robot: Robot, catalogue: Mapping[str, EffectSpec] = CATALOGUE, cores: int | None = None) -> None:
        self.robot, self._residual = robot, residual_of(robot)
        self._forward = ForwardModel.of_single_states(robot, catalogue)
        self._cores = cores if cores is not None else len(os.sched_getaffinity(0))

    def __call__(
        self,
        pressures: ArrayLike,
        spine_length: ArrayLike = 0.0,
        tip_mass: ArrayLike | None = None,
        roll: ArrayLike = 0.0,
        *,
        vacuum: float = NOMINAL_VACUUM,
        rate: float = RATE,
        hold: float = HOLD,
        arcs: ArrayLike | None = None,
        intervals: bool = False,
        gradient: bool = False,
    ) -> Prediction:
        """Readings of n states, each reached from rest by one ramp of `rate` (Pa/s) and read `hold` (s) after its end.

        `pressures` (n, chambers) or (chambers,) Pa gauge as read; `spine_length` m, `tip_mass` kg (robot.yaml's unless
        given) and `roll` rad, each one number or (n,). `vacuum` Pa below ambient is the one at which the spine's moduli
        hold. Rate and hold matter to effects with memory alone. `arcs` (k,) m from the base. Raises `BadCondition`.
        """
        states = conditions(self.robot, spine_length, pressures, tip_mass, roll, vacuum=vacuum, rate=rate, hold=hold)
        along = None if arcs is None else np.asarray(arcs, float).reshape(-1)
        if along is not None and (beyond := along[(along < 0) | (along > self.robot.length)]).size:
            raise BadCondition(f"arcs: {beyond[0]:g} m must lie between 0 and the robot's length {self.robot.length:g} m")

        outside, notes = outside_known(self.robot, states.pressure, states.spine_length, states.tip_mass)
        for note in notes:
            warnings.warn(f"{note}; `.outside` marks them", stacklevel=2)

        def part(rows: Order) -> Prediction:
            return predicted(self._forward.at(states[rows], along), self._residual, intervals, gradient)

        n = len(states)
        # Rods that are solved together share their steps, and alike ones need fewer: by spine length to 2 cm, then by pressure
        alike = np.lexsort((states.pressure.sum(axis=1), np.round(states.spine_length / 0.02)))
        order = alike if n > BATCH else np.arange(n)
        batches = [order[k : k + BATCH] for k in range(0, n, BATCH)]
        if self._cores < 2 or len(batches) < 2:
            parts = [part(rows) for rows in batches]
        else:
            with ThreadPoolExecutor(self._cores) as pool:
                parts = list(pool.map(part, batches))
        return replace(_joined(parts, order), outside=outside)


def outside_known(
    robot: Robot, pressure: Array, spine_length: ArrayLike, tip_mass: ArrayLike | None = None
) -> tuple[Mask, list[str]]:
    """(n,) whether states are outside the robot's limits or what its posterior was fitted to, and one line for each kind.

    `pressure` (n, actuators) Pa, `spine_length` (n,) m, `tip_mass` kg (robot.yaml's unless given). Raises `BadCondition` for a
    tendon that pushes."""
    words, length = robot.actuators.words, np.asarray(spine_length, float)[:, None]
    mass = np.broadcast_to(np.reshape(robot.tip_mass if tip_mass is None else tip_mass, (-1, 1)), length.shape)
    pushing = robot.tendons is not None and bool((pressure < -PRESSURE_NOISE).any())
    limits = (0.0, np.full(pressure.shape[1], np.inf) if pushing else robot.pressure_limits)
    driven = (words.pressures, pressure, words.pascal, words.unit)
    kinds = {"limits": driven, "fitted_pressure": driven, "fitted_spine_length": ("spine lengths", length, 0.01, "cm")}
    kinds["fitted_tip_mass"] = ("tip masses", mass, 1.0, "kg")
    outside, notes = np.zeros(len(pressure), bool), list[str]()
    for name, (quantity, values, scale, unit) in kinds.items():
        ends = limits if name == "limits" else getattr(robot.posterior, name, None)
        if ends is None:
            continue
        low, high = ends
        beyond = np.maximum(low - values, values - high)
        row, column = np.unravel_index(int(np.nan_to_num(beyond).argmax()), beyond.shape)
        actuator = f" of {words.actuator} {column + 1}" if values is pressure else ""
        worst = f"{values[row, column] / scale:g} {unit}{actuator} in row {row + 1}"
        if pushing:
            raise BadCondition(f"{worst}: a tendon cannot push; the least tension is 0 N")
        noise, of, more = PRESSURE_NOISE, f"the limits of {robot.name}", ""
        if name != "limits":
            noise = FITTED_NOISE * (robot.length if values is length else float(max(-low, high)))
            of, more = "to which robot.yaml was fitted", "; predictions there extrapolate, and no interval covers that"
        own = np.any(beyond > noise, axis=1)
        if own.any():
            shown = (" or ".join(dict.fromkeys(f"{x / scale:.4g}" for x in np.ravel(end))) for end in ends)
            between = " to ".join(dict.fromkeys(shown))
            having = f"{own.sum()} of {len(own)} states have {quantity} outside {between} {unit}"
            notes.append(f"{having}, {of}: {worst} is farthest{more}")
        outside |= own
    return outside, notes


def predicted(
    forward: ForwardModel, residual: LearntResidual | None, intervals: bool = False, gradient: bool = False
) -> Prediction:
    """What a model predicts of its states for the robot as robot.yaml describes it, `residual` added to the tip.

    `intervals`: with standard deviations (see `spread`); `gradient`: with the tip's slopes by pressures and spine length.
    """
    robot, states = forward.robot, forward.design
    zero = np.zeros(len(forward.parameters))
    learnt = None
    if residual is not None:
        learnt = residual(states.pressure, states.spine_length, intervals=intervals, gradient=gradient)
    learnt_mean, unexplained = (0.0, None) if learnt is None else (learnt.mean, learnt.variance)
    if not gradient and not intervals:
        r = forward.read(zero)
        return Prediction(r.tip[0] + learnt_mean, r.orientation[0], r.markers[0])
    names, covariance = uncertain(robot) if intervals else ((), np.zeros((0, 0)))
    parameters = [name for name in names if name != PRESSURE]
    chambers = states.pressure.shape[1] if gradient else 0
    changes = _changes(states, len(parameters) < len(names), gradient)
    r, slopes = forward.motions(zero, ["area.excess" if name == AREA_FACTOR else name for name in parameters], changes)
    fields: dict[str, Any] = {}
    if intervals:
        if AREA_FACTOR in parameters:  # area.excess is relative to it
            slopes[parameters.index(AREA_FACTOR)] /= forward.area_factor[:, None]
        of_names = slopes[[len(parameters) if name == PRESSURE else parameters.index(name) for name in names]]
        has_law_error = robot.posterior is not None and robot.posterior.law_error > 0
        without_effect = [forward.read(_without(forward, id)) for id in robot.effects] if has_law_error else []
        fields |= standard_deviations(robot, covariance, r, of_names, without_effect, unexplained)
    if gradient:
        tip = slopes[-chambers - 1 :, :, :3]
        fields["tip_by_pressure"], fields["tip_by_length"] = tip[:-1].transpose(1, 2, 0), tip[-1]
        if learnt is not None and learnt.by_pressure is not None and learnt.by_length is not None:
            fields["tip_by_pressure"] = fields["tip_by_pressure"] + learnt.by_pressure
            fields["tip_by_length"] = fields["tip_by_length"] + learnt.by_length
    return Prediction(r.tip[0] + learnt_mean, r.orientation[0], r.markers[0], **fields)


def _changes(states: States, together: bool, each: bool) -> InputChange:
    """Of the pressure of all chambers in use, where `together`; of each chamber, then of the spine's length, where `each`."""
    n, chambers = states.pressure.shape
    by = np.concatenate([[PRESSURE_STEP] * (together + each * chambers), [LENGTH_STEP] * each])
    pressure, length = np.zeros((len(by), n, chambers)), np.zeros((len(by), 1))
    if together:
        pressure[0] = PRESSURE_STEP * states.used
    if each:
        pressure[range(len(by) - chambers - 1, len(by) - 1), :, range(chambers)] = PRESSURE_STEP
        length[-1] = LENGTH_STEP
    return InputChange(pressure, length, by)


def _without(forward: ForwardModel, id: str) -> Array:
    """(p,) parameters with which an effect of the robot is absent; of thrust on the walls, how it gets into them."""
    stated = {n: s for n, s in forward.robot.stated.items() if forward.robot.thrust != "walls" or n != f"{THRUST}.share"}
    return np.array([-stated[p.name].value if p.source == id and p.name in stated else 0.0 for p in forward.parameters])


def _joined(parts: Sequence[Prediction], order: Order) -> Prediction:
    back = np.argsort(order)
    columns = {f.name: [getattr(p, f.name) for p in parts] for f in fields(Prediction)}
    joined: Any = {name: None if values[0] is None else np.concatenate(values)[back] for name, values in columns.items()}
    return Prediction(**joined)
