"""From a case to the problem that is solved: forward model, measured values, noise floor, discrepancy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from model.effects.catalogue import CATALOGUE
from model.effects.design import design_from_columns
from model.effects.forward import ForwardModel
from model.effects.parameters import ParameterInfo
from model.effects.spec import EffectSpec
from model.robot import Robot
from recordings.trials import TEXTS

from .case import PRESSURE_GAP, States
from .discrepancy import Settings, by_channel, columns, settings
from .errors import BadCase
from .floor import Components, Repeated, components, reading_rms
from .noise import Noise
from .problem import Parameters, Problem

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

TIP = ("x", "y", "z")
KINDS = ("tip", "turn", "marker")
USUAL = {"tip": 0.3e-3, "turn": np.radians(0.3), "marker": 0.3e-3}
"""Usual white noise of a reading: m, rad, m."""
USUAL_PRESSURE = 500.0
"""Pa."""
STIFFNESS_ONLY = ("force_bias", "arm_compliance", "contact_offset")
IDLE = 5e3
"""Pa; a chamber that never reads more within a trial is vented."""
STEP = 500.0
"""Pa by which pressures are moved for a derivative."""
LEAST_UNIT, MOST_UNIT = 0.2e-3, 2e-3
"""m, between which the unit of the discrepancy is kept."""


@dataclass(frozen=True)
class Labels:
    """What each of n measured values is."""

    state: Ints
    """(n,) index into the states."""
    channel: NDArray[np.str_]
    kind: Ints
    """(n,) 0 tip, 1 orientation, 2 marker."""
    axis: Ints
    """(n,) which of its kind's three axes."""
    trial: Ints
    experiment: Ints
    """(n,) kind of experiment, see `States.kind`."""


@dataclass(frozen=True)
class Prepared:
    """A problem and what its values mean."""

    robot: Robot
    states: States
    problem: Problem
    labels: Labels
    floor: Components
    reading: float
    """m, root mean square distance of a single tip reading from its condition's average; the noise floor."""
    unit: float
    """m, size 1 of the discrepancy."""
    forward: ForwardModel

    def shared(self, theta: Array) -> Array:
        """Parameters (k,) with what each trial has of its own set to nothing: what a model can say of the next trial."""
        by_trial = np.array(["[trial=" in name for name in self.problem.parameters.names])
        return np.where(by_trial, self.problem.parameters.mean, theta)

    def tip(self, values: Array) -> Array:
        """(states, 3) the tip's values of (n,) values; NaN where not measured."""
        out = np.full((len(self.states), 3), np.nan)
        own = self.labels.kind == 0
        out[self.labels.state[own], self.labels.axis[own]] = values[own]
        return out


class Kept:
    """A forward model of which some values are not looked at."""

    def __init__(self, forward: ForwardModel, kept: NDArray[np.bool_]) -> None:
        self._forward, self._kept = forward, kept

    def predict(self, theta: Array) -> Array:
        """Predicted values that are kept; NaN where the rod has no equilibrium."""
        try:
            return self._forward.predict(theta)[self._kept]
        except np.linalg.LinAlgError:
            # A trial step that throws a rod far off: as good as no equilibrium.
            return np.full(int(self._kept.sum()), np.nan)

    def linearise(self, theta: Array, columns: Sequence[int] | None = None) -> tuple[Array, Array]:
        """Predicted values that are kept, and their derivatives."""
        predicted, slope = self._forward.linearise(theta, columns)
        return predicted[self._kept], slope[self._kept]


def prepare(
    robot: Robot,
    states: States,
    area: Literal["one", "per_length"] = "one",
    catalogue: Mapping[str, EffectSpec] = CATALOGUE,
) -> Prepared:
    """The problem of a case; raises `BadCase` when the model cannot be solved where the robot was."""
    table = table_columns(states)
    forward = ForwardModel(robot, design_from_columns(robot, table), area, seen_by(states, catalogue))
    observed, sd = forward.observe(table)
    start = np.zeros(len(forward.parameters))
    predicted, slope = forward.linearise(start)
    kept = np.isfinite(sd) & np.isfinite(predicted)
    if not kept.any():
        raise BadCase(
            "the rod model has no equilibrium at any measured state: check robot.yaml's stiffness and area factor"
        )
    labels = _labels(forward, states, kept)
    made = parameters(forward.parameters)
    response = by_pressure(forward, states, made, slope)[kept]
    floor, reading = _floor(states, labels, forward.parameters, (observed - predicted)[kept], slope[kept], response)
    white = (
        np.array([floor.channel[k] for k in KINDS])[labels.kind]
        * np.where(resting(states), floor.rest, 1.0)[labels.state]
    )
    noise = Noise(labels.state, white, floor.pressure * response)
    known = reading if np.isfinite(reading) else float(np.sqrt(3)) * floor.channel["tip"]
    unit = float(np.clip(known / np.sqrt(3), LEAST_UNIT, MOST_UNIT))
    smooth, alike = _smooth(robot, states, labels, unit)
    problem = Problem(
        Kept(forward, kept), _scattered(made, forward.parameters, floor), observed[kept], noise, smooth, alike
    )
    return Prepared(robot, states, problem, labels, floor, known, unit, forward)


def seen_by(states: States, catalogue: Mapping[str, EffectSpec]) -> Mapping[str, EffectSpec]:
    """A catalogue without the effects of stiffness trials, which states of the robot cannot show."""
    forces = any(r.protocol == "stiffness" for r in states.rows)
    return {id: spec for id, spec in catalogue.items() if forces or id not in STIFFNESS_ONLY}


def table_columns(states: States) -> dict[str, NDArray[np.generic]]:
    """The table's columns of the states, spine lengths not below zero, vented chambers at zero gauge."""
    cells = [row.cells() for row in states.rows]
    names = dict.fromkeys(name for row in cells for name in row)
    table = {name: np.array([row.get(name, "" if name in TEXTS else np.nan) for row in cells]) for name in names}
    pressures = {f"p{i}": column for i, column in enumerate(vented(states).T, 1)}
    return table | {"spine_length": states.spine_length} | pressures


def vented(states: States) -> Array:
    """(n, chambers) Pa, readings with those of vented chambers set to zero.

    A chamber that is open to the room is at zero gauge; what its sensor reads there is the sensor's own error, which
    would otherwise bend the model.
    """
    out = states.pressure.copy()
    for t in np.unique(states.trial):
        own = np.flatnonzero(states.trial == t)
        out[np.ix_(own, np.flatnonzero(out[own].max(axis=0) < IDLE))] = 0.0
    out[out.max(axis=1) < PRESSURE_GAP] = 0.0
    return out


def parameters(infos: tuple[ParameterInfo, ...]) -> Parameters:
    """The forward model's table as the diagnosis sees it."""
    return Parameters(
        names=tuple(p.name for p in infos),
        effects=tuple(p.source if p.group == "effect" else "" for p in infos),
        mean=np.zeros(len(infos)),
        sd=np.array([p.sd for p in infos]),
        lower=np.array([p.low for p in infos]),
        upper=np.array([p.high for p in infos]),
        units=tuple(p.unit for p in infos),
        shapes=tuple(p.role == "shape" for p in infos),
        calibration=tuple(p.group == "calibration" for p in infos),
        starts=tuple(p.starts for p in infos),
    )


def _labels(forward: ForwardModel, states: States, kept: NDArray[np.bool_]) -> Labels:
    row = forward.observations.row[kept]
    channel = forward.observations.channel[kept].astype(np.str_)
    turn, marker = np.char.startswith(channel, "r"), np.char.startswith(channel, "m")
    axis = np.array(["xyz".index(name[-1]) for name in channel], np.int64)
    kind = np.where(turn, 1, np.where(marker, 2, 0)).astype(np.int64)
    return Labels(row, channel, kind, axis, states.trial[row], states.kind[row])


def _floor(
    states: States, labels: Labels, infos: tuple[ParameterInfo, ...], missed: Array, slope: Array, response: Array
) -> tuple[Components, float]:
    """Components of the noise, and the rms of a single tip reading (m)."""
    names = list(dict.fromkeys(labels.channel.tolist()))
    column = np.array([names.index(c) for c in labels.channel])

    def grid(values: Array) -> Array:
        out = np.full((len(states), len(names), *values.shape[1:]), np.nan)
        out[labels.state, column] = values
        return out

    residual = grid(missed)
    whole = np.isfinite(residual).all(axis=1)
    by_trial = {
        source: slope[:, [i for i, p in enumerate(infos) if p.source == source]].sum(axis=1)
        for source in dict.fromkeys(p.source for p in infos if "[trial=" in p.name)
    }
    kinds = tuple(KINDS[int(labels.kind[labels.channel == name][0])] for name in names)
    data = Repeated(
        residual[whole],
        states.condition[whole],
        states.trial[whole],
        kinds,
        grid(response)[whole],
        {source: grid(values)[whole] for source, values in by_trial.items()},
        resting(states)[whole],
    )
    trial = {source: next(p.sd for p in infos if p.source == source) for source in by_trial}
    found = components(data, Components({k: USUAL[k] for k in KINDS}, USUAL_PRESSURE, trial, 1.0, 0))
    return found, reading_rms(data, np.array([name in TIP for name in names]))


def resting(states: States) -> NDArray[np.bool_]:
    """(n,) states that were read at rest, not while ramping."""
    return np.array([r.hold is None or r.hold > 0 for r in states.rows])


def by_pressure(forward: ForwardModel, states: States, made: Parameters, slope: Array) -> Array:
    """(n, r) d(value)/d(pressure reading) of each regulator, per Pa: none where all chambers are vented."""
    row, pressure = forward.observations.row, vented(states)
    together = regulators(pressure)
    inflated = np.array([pressure[:, own].max(axis=1) > 0 for own in together]).T
    alone = inflated.sum(axis=1) == 1
    out = np.where(inflated & alone[:, None], 1.0, 0.0)[row] * slope[:, [made.names.index("pressure_offset.offset")]]
    several = (~alone & inflated.any(axis=1))[row]
    if several.any():
        for r, own in enumerate(together):
            change = np.zeros(pressure.shape)
            change[:, own] = STEP * inflated[:, [r]]
            out[several, r] = forward.respond(change)[several] / STEP
    return np.asarray(np.nan_to_num(out))


def regulators(pressure: Array) -> list[Ints]:
    """Chambers (indices) that are inflated together wherever they are (n, chambers) Pa: taken as fed by one regulator."""
    pattern = np.unique(pressure > 0, axis=0).T
    _, member = np.unique(pattern, axis=0, return_inverse=True)
    groups = [np.flatnonzero(member.reshape(-1) == k) for k in range(member.max(initial=-1) + 1)]
    found = [own for own in groups if pattern[own[0]].any()]
    return found or [np.arange(pressure.shape[1])]


def _scattered(made: Parameters, infos: tuple[ParameterInfo, ...], floor: Components) -> Parameters:
    """The priors of what a trial has of its own as wide as the repeats show."""
    sd = np.array([floor.trial.get(p.source, p.sd) for p in infos])
    return replace(made, sd=sd)


def _smooth(robot: Robot, states: States, labels: Labels, unit: float) -> tuple[Array, Array]:
    """Columns of a discrepancy of size 1, and of a smooth factor over the states."""
    where = settings(states.spine_length, states.highest, states.branch, states.kind, robot.length)
    channels = sorted(set(labels.channel.tolist()))
    number = np.array([channels.index(c) for c in labels.channel])
    # A bend that moves the tip by d turns it by about 2 d / L.
    size = np.array([2 * unit / robot.length if name.startswith("r") else unit for name in channels])
    alike = columns(Settings(where.place, np.ones(len(states))))
    return by_channel(alike * where.size[:, None], labels.state, number, size), alike[labels.state]
