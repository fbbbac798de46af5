"""Noise of stiffness trials, and their forces as deflections.

A force error dF is expressed as the deflection dF / k, k the specimen's stiffness (N/m), so that specimens of all lengths
are compared in the unit of the tip's gap. The noise comes from repeats as for the robot: white noise of the force, the
error of the deflection (in place of the pressure's), and parameters of each trial: touch point, zero of the sensor, and
the spine's length and stiffness.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from model.effects.parameters import ParameterInfo

from ..arrays import Array
from ..data.campaign import Campaign, Labels
from ..data.noise_components import NoiseComponents, Repeated, Scatter, reading_rms
from ..data.noise_estimate import estimate_noise

PUSH_SOURCES = ("touch", "zero")
"""Parameters of each stiffness trial besides its spine's."""
DEFAULT_FORCE_NOISE = 0.03
"""N, white noise of an averaged reading."""
DEFAULT_DEFLECTION_NOISE = 0.02e-3
"""m, how well an arm repeats a small step."""


@dataclass(frozen=True)
class StiffnessTrials:
    """What is known of the stiffness trials of a case."""

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
        for t in np.unique(states.trial[states.pushed]):
            own = states.pushed & (states.trial == t)
            out[own] = top * np.abs(states.deflection[own]) / max(float(np.abs(states.deflection[own]).max()), 1e-9)
        return out


def stiffness_trials(
    states: Campaign, labels: Labels, infos: Sequence[ParameterInfo], missed: Array, slope: Array
) -> StiffnessTrials:
    """Noise and stiffness of a campaign's stiffness trials, from the baseline's residuals `missed` (n,) of all values and their
    derivatives `slope` (n, k), of which the forces are used."""
    rows = np.flatnonzero(labels.kind == 3)
    state, trial = labels.state[rows], labels.trial[rows]
    by_source = {
        source: slope[rows][:, [i for i, p in enumerate(infos) if p.source == source]].sum(axis=1)
        for source in dict.fromkeys(p.source for p in infos if p.trial is not None)
    }
    stiffness = np.zeros(len(rows))  # N/m: derivative of the force by the place of contact
    for t in np.unique(trial):
        # Before contact there is no force; the specimen is the same.
        stiffness[trial == t] = np.abs(by_source["touch"][trial == t]).max()
    stiffness = np.maximum(stiffness, 1e-9)
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
    noise = estimate_noise(data, NoiseComponents({"force": DEFAULT_FORCE_NOISE}, DEFAULT_DEFLECTION_NOISE, default, 1.0, 0))
    reading_sd = np.hypot(noise.channel["force"], noise.pressure * stiffness)
    total_sd = np.sqrt(reading_sd**2 + sum((noise.trial[k] * by_source[k]) ** 2 for k in by_source))
    from_repeats = reading_rms(replace(data, residual=data.residual / stiffness[:, None]), np.ones(1, bool))
    noise_floor = from_repeats if np.isfinite(from_repeats) else float(np.sqrt(np.mean((total_sd / stiffness) ** 2)))

    def by_state(values: Array) -> Array:
        out = np.full(len(states), np.nan)
        out[state] = values
        return out

    trials = set(trial.tolist())
    names = frozenset(p.name for p in infos if p.trial in trials)
    return StiffnessTrials(noise, noise_floor, by_state(stiffness), by_state(total_sd), names)
