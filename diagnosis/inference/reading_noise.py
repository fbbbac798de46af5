"""The noise of a campaign's readings: estimated from its repeats (`data.noise_components`), and applied to its values.

Of stiffness trials a force error dF is expressed as the deflection dF / k, k the specimen's stiffness (N/m), so that specimens
of all lengths are compared in the unit of the tip's gap. The noise comes from repeats as for the robot: white noise of the force,
the error of the deflection (in place of the pressure's), and parameters of each trial: touch point, zero of the sensor, and the
spine's length and stiffness.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from model.condition import TIP
from model.effects.forward import ForwardModel
from model.effects.parameters import ParameterInfo

from ..arrays import Array, Ints, Mask, rms, rows_by, scattered
from ..data.campaign import Campaign, Labels
from ..data.noise import Lasting, Noise, blocks
from ..data.noise_components import PRESSURE, NoiseComponents, Repeated, Scatter, reading_rms
from ..data.noise_estimate import estimate_noise
from ..judgement import MEMORY
from .jacobian import Columns
from .problem import FitParameters

KINDS = ("tip", "turn", "marker", "force")
"""By `Labels.kind`."""
LONGEST_BLOCK = 40
"""Largest number of states of a trial with correlated errors."""
MOST_TELLING, MOST_REPEATS = 3000, 12
"""States, and repeats of each of their conditions, from which the noise is estimated in larger campaigns."""
USUAL = NoiseComponents({"tip": 0.3e-3, "turn": np.radians(0.3), "marker": 0.3e-3}, pressure=500.0)
"""Of cameras (white noise of a reading: m, rad, m) and regulators as usual."""
USUAL_PUSHES = NoiseComponents({"force": 0.03}, pressure=0.02e-3)
"""N, white noise of an averaged reading, and m, how well an arm repeats a small step."""
OFFSET = "pressure_offset.offset"
"""The parameter that changes readings as an error of the pressure does."""
PRESSURE_STEP = 500.0
"""Pa by which pressures are moved for a derivative."""


@dataclass(frozen=True)
class StiffnessTrials:
    """Noise and stiffness of the stiffness trials of a case."""

    noise_components: NoiseComponents
    """`channel` holds force (N), `pressure` the standard deviation of a deflection's reading (m)."""
    noise_floor: float
    """m of deflection, rms distance of a single reading from its condition's average."""
    stiffness: Array
    """(states,) N/m of the specimen; NaN for states of the robot."""
    unit: Array
    """(states,) N, size 1 of the discrepancy: standard error of a single reading; NaN for states of the robot."""
    names: frozenset[str]
    """Names of the parameters of single stiffness trials."""

    def load_level(self, states: Campaign) -> Array:
        """(states,) how strongly each is loaded, as a pressure (Pa) where there are any: a push by its share of the largest
        at this length."""
        out = states.highest.copy()
        top = max(float(out.max(initial=0.0)), 1.0)
        pushed = np.flatnonzero(states.pushed)
        for own in (pushed[rows] for rows in rows_by(states.trial[pushed])):
            out[own] = top * np.abs(states.deflection[own]) / max(float(np.abs(states.deflection[own]).max()), 1e-9)
        return out


def stiffness_trials(
    states: Campaign, labels: Labels, infos: Sequence[ParameterInfo], missed: Array, slope: Columns
) -> StiffnessTrials:
    """Noise and stiffness of a campaign's stiffness trials, from the baseline's residuals `missed` (n,) of all values and their
    derivatives `slope` (n, k), of which the forces are used."""
    rows = np.flatnonzero(labels.kind == 3)
    state = labels.state[rows]
    trial = states.trial[state]
    by_source = {
        source: slope.along(np.array([float(p.source == source) for p in infos]))[rows]
        for source in dict.fromkeys(p.source for p in infos if p.trial is not None)
    }
    stiffness = np.zeros(len(rows))  # N/m: derivative of the force by the place of contact
    for own in rows_by(trial):
        # Before contact there is no force; the specimen is the same.
        stiffness[own] = max(np.abs(by_source["touch"][own]).max(), 1e-9)
    data = Repeated(
        missed[rows, None],
        states.condition[state],
        ("force",),
        stiffness[:, None, None],
        {source: Scatter(values[:, None, None], trial) for source, values in by_source.items()},
        np.zeros(len(rows), bool),
        np.zeros((len(rows), 1, 0)),
        np.full(len(rows), -1),
        np.zeros(len(rows)),
    )
    default = {source: next(p.sd for p in infos if p.source == source) for source in by_source}
    noise = estimate_noise(data, replace(USUAL_PUSHES, trial=default))
    reading_sd = np.hypot(noise.channel["force"], noise.pressure * stiffness)
    total_sd = np.sqrt(reading_sd**2 + sum((noise.trial[k] * by_source[k]) ** 2 for k in by_source))
    from_repeats = reading_rms(replace(data, residual=data.residual / stiffness[:, None]), np.ones(1, bool))
    noise_floor = from_repeats if np.isfinite(from_repeats) else float(np.sqrt(np.mean((total_sd / stiffness) ** 2)))
    trials = set(trial.tolist())
    names = frozenset(p.name for p in infos if p.trial in trials)
    of_state = partial(scattered, (len(states),), state)
    return StiffnessTrials(noise, noise_floor, of_state(stiffness), of_state(total_sd), names)


def noise_of(states: Campaign, labels: Labels, noise: NoiseComponents, pushes: StiffnessTrials | None, response: Array) -> Noise:
    """Noise of the robot's values, with their response (n, r) to the pressure readings, and of the stiffness trials' forces."""
    state = labels.state
    made = robot_noise(noise, labels, states.trial, np.where(states.pushed, np.nan, states.time), response)
    white, by_pressure = made.sd * np.where(resting(states), noise.rest, 1.0)[state], made.pressure_response
    if pushes is not None:
        own = labels.kind == 3
        white[own] = pushes.noise_components.channel["force"]
        # The error of the deflection takes the place of the pressure's, in the first column.
        by_pressure[own] = 0.0
        by_pressure[own, 0] = pushes.noise_components.pressure * pushes.stiffness[state[own]]
    return replace(made, sd=white)


def robot_noise(noise: NoiseComponents, labels: Labels, trial: Ints, time: Array, response: Array) -> Noise:
    """Noise of values (n,) of the robot, all read alike, of states (s,) of a `trial`, measured or planned; `time` (s,) s, NaN
    where nothing lasts. `response` (n, r): of each value to the pressure readings of r regulators, per Pa."""
    block, time = blocks(trial, time, LONGEST_BLOCK)[labels.state], time[labels.state]

    def of_kind(by_name: Mapping[str, float], default: float) -> Array:
        return np.array([by_name.get(k, default) for k in KINDS])[labels.kind]

    sd, ones, lasting = of_kind(noise.channel, 1.0), np.ones(len(block)), Lasting.none(len(block))
    share = np.where(block < 0, 0.0, of_kind(noise.lasting, 0.0))
    if noise.lasting:
        number = np.unique(labels.channel, return_inverse=True)[1]
        lasting = Lasting(block, time, number, sd * np.sqrt(share), noise.lasting[PRESSURE] * ones, noise.memory * ones)
    return Noise(labels.state, sd * np.sqrt(1 - share), noise.pressure * response, lasting)


def floor_of(
    states: Campaign,
    labels: Labels,
    infos: tuple[ParameterInfo, ...],
    missed: Array,
    observed: Array,
    slope: Columns,
    response: Array,
    known: NoiseComponents | None,
    pace: float,
) -> tuple[NoiseComponents, float, float]:
    """Noise components of the robot's states, estimated from repeats unless `known`, and two values of the rms (m) of a tip
    reading about its repeats: after subtracting the model's prediction of each state (`missed` = `observed` - prediction) and
    what its parameters explain, and after regression on both and on the pressures, so that sizes in the model do not matter.
    Without repeats, usual values."""
    names = [name for name in dict.fromkeys(labels.channel.tolist()) if name != "force"]
    default = replace(USUAL, memory=MEMORY * pace)
    if not names:
        return default, _usual(default), _usual(default)
    of_robot = labels.kind < 3
    column = np.array([names.index(c) for c in labels.channel[of_robot]])

    def grid(values: Array) -> Array:
        """Values (n, ..) of the robot by state and channel (states, channels, ..); NaN where there was no reading."""
        return scattered((len(states), len(names), *values.shape[1:]), (labels.state[of_robot], column), values[of_robot])

    explained = _explained(infos, labels.kind, missed, slope)
    residual = grid(missed - explained)
    complete = np.flatnonzero(np.isfinite(residual).all(axis=1))
    complete = complete[telling(states.condition[complete], states.trial[complete])]
    number_of = {"trial": states.trial, "repeat": states.repeat}
    drawn_anew = {p.source: number_of[p.scope] for p in infos if p.scope in number_of}
    slots = {source: sorted({p.slot for p in infos if p.source == source}) for source in drawn_anew}
    # (n, a): each row takes one copy of each of a source's a parameters
    copies = {s: [slope.along(np.array([float(p.slot == k) for p in infos])) for k in of] for s, of in slots.items()}
    data = Repeated(
        residual[complete],
        states.condition[complete],
        tuple(KINDS[int(labels.kind[labels.channel == name][0])] for name in names),
        grid(response)[complete],
        {s: Scatter(grid(np.column_stack(copies[s]))[complete], of[complete]) for s, of in drawn_anew.items()},
        resting(states)[complete],
        grid(slope.take(np.array([p.scope == "campaign" for p in infos])).whole)[complete],
        blocks(states.trial, states.time, LONGEST_BLOCK)[complete],
        states.time[complete],
    )
    trial_sd = {source: next(p.sd for p in infos if p.source == source) for source in drawn_anew}
    noise = known or estimate_noise(data, replace(default, trial=trial_sd))
    if not noise.contrasts:
        return noise, _usual(noise), _usual(noise)
    tips = np.array([name in TIP for name in names])
    modelled = grid(np.column_stack([observed - missed, explained]))
    # the pressure of each regulator and its square, as shares of the highest: differences between tips to second order
    pressure = states.vented_at_zero
    read = np.column_stack([pressure[:, own[0]] for own in regulators(states.pressure, pressure)])
    read = read / max(float(read.max()), 1.0)
    predictors = [np.hstack([read, read**2])[:, None, :].repeat(len(names), axis=1), modelled]
    # a coefficient of their own in each channel
    each = np.einsum("ncm,cd->ncdm", np.concatenate(predictors, axis=2)[complete], np.eye(len(names)))
    as_read = replace(data, residual=grid(observed)[complete])
    regular = (of.reshape(len(each), len(names), -1) for of in (each, each[..., :-1]))  # with what is explained and without
    drifts = (np.concatenate([data.drift, of], axis=2) for of in regular)
    return noise, reading_rms(data, tips), min(reading_rms(replace(as_read, drift=drift), tips) for drift in drifts)


def _explained(infos: Sequence[ParameterInfo], kind: Ints, missed: Array, slope: Columns) -> Array:
    """(n,) what parameters that last explain of what the model misses of the robot, to first order, if they may leave as much
    again (far off, it is not linear): where it is wrong, repeats at unequal pressures differ by more than their noise."""
    own, lasts = kind < 3, np.array([p.lasts for p in infos])
    missed, kind, columns = missed[own], kind[own], slope.take(lasts).rows(own).whole * [p.sd for p in infos if p.lasts]
    columns = columns[:, columns.any(axis=0)]
    left = np.array([np.hypot(USUAL.channel[k], np.nan_to_num(rms(missed[kind == i]))) for i, k in enumerate(KINDS[:3])])[kind]
    white = columns / left[:, None]
    x = np.linalg.solve(white.T @ white + np.eye(len(white.T)), white.T @ (missed / left))
    return np.nan_to_num(scattered(own.shape, own, columns @ x))


def telling(condition: Ints, trial: Ints) -> Mask:
    """(n,) states of whole trials that suffice to estimate the noise: all up to `MOST_TELLING`; else, condition by condition,
    `MOST_REPEATS` of its trials, trials and conditions taken all over the campaign. The work grows with their cube."""
    chosen = np.zeros(len(trial), bool)
    if len(trial) <= MOST_TELLING:
        return ~chosen
    for c in _all_over(np.unique(condition)):
        chosen |= np.isin(trial, _all_over(np.unique(trial[condition == c]))[:MOST_REPEATS])
        if chosen.sum() >= MOST_TELLING:
            break
    return chosen


def _all_over(values: Ints) -> Ints:
    """The values in an order whose every beginning is spread evenly, by multiples of the golden ratio."""
    return values[np.argsort((np.arange(len(values)) * (np.sqrt(5) - 1) / 2) % 1, kind="stable")]


def _usual(noise: NoiseComponents) -> float:
    """m, rms of a tip reading with the white noise of its three channels."""
    return float(np.sqrt(3)) * noise.channel["tip"]


def resting(states: Campaign) -> Mask:
    """(n,) states that were read at rest, not while ramping."""
    return ~(states.trials.get("hold") <= 0)


def pressure_response(forward: ForwardModel, states: Campaign, parameters: FitParameters, slope: Columns) -> Array:
    """(n, r) d(value)/d(pressure reading) of each of r regulators, per Pa; 0 where none is inflated, or no equilibrium is found,
    whose values are left out anyway.

    `slope` (n, k): derivatives of the values by the k `parameters`, each in its unit. Where one regulator alone is inflated,
    the offset of all pressures (Pa) moves what its reading moves, so its slope is taken; elsewhere a difference quotient.
    """
    row, pressure = forward.observations.row, states.vented_at_zero
    regulator_chambers = regulators(states.pressure, pressure)
    inflated = np.array([pressure[:, group].max(axis=1) > 0 for group in regulator_chambers]).T
    by_offset = (inflated.sum(axis=1) == 1) & (OFFSET in parameters.names)
    offset = slope.along((np.array(parameters.names) == OFFSET).astype(float))
    out = (inflated & by_offset[:, None])[row] * offset[:, None]
    by_difference = (~by_offset & inflated.any(axis=1))[row]
    if by_difference.any():
        for r, group in enumerate(regulator_chambers):
            change = np.zeros(pressure.shape)
            change[:, group] = PRESSURE_STEP * inflated[:, [r]]
            out[by_difference, r] = forward.respond(change)[by_difference] / PRESSURE_STEP
    return np.asarray(np.nan_to_num(out))


def regulators(read: Array, pressure: Array) -> list[Ints]:
    """Indices of the chambers on each regulator; of regulators that inflate a chamber in any state, or one of all if none does.

    `read` (n, chambers) Pa: chambers on one regulator have one sensor, so their readings are equal in all n states. `pressure`
    (n, chambers) Pa: the same, those of vented chambers set to zero.
    """
    groups = rows_by(np.unique(read.T, axis=0, return_inverse=True)[1].reshape(-1))
    return [chambers for chambers in groups if (pressure[:, chambers] > 0).any()] or [np.arange(pressure.shape[1])]
