"""Whether repeats of the same state change with time: what no effect of the catalogue does.

How strongly a trial bends is taken as one number: its readings beside the average of their repeats, along what more
chamber area would do (of stiffness trials alone: along what a stiffer specimen would do). Trials of one spine length are
then ranked by it and by time; the sum of Kendall's S over all spine lengths has an exact distribution when time does not
matter (M. G. Kendall, Biometrika 30, 1938). Nothing of the model but the direction enters, so errors of the model
cannot pass for a trend.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..data.levels import SPINE_GAP, levels
from ..inference.prepare import Prepared

Array = NDArray[np.float64]


def trend(p: Prepared, slope: Array) -> float:
    """Probability that repeats would be ordered in time as well as they are, by chance; 1 where nothing was repeated.

    `slope` (n, k) of the problem's values; of it only the calibration's columns are used.
    """
    strength, length, time = _trials(p, slope)
    total, distribution = 0, np.ones(1)
    for one in np.unique(length):
        own = np.flatnonzero(length == one)
        if own.size < 2:
            continue
        order = own[np.argsort(time[own], kind="stable")]
        total += _kendall_s(strength[order])
        distribution = np.convolve(distribution, _kendall_s_distribution(own.size))
    largest = len(distribution) // 2
    values = np.arange(-largest, largest + 1)
    return float(distribution[np.abs(values) >= abs(total)].sum())


def _trials(p: Prepared, slope: Array) -> tuple[Array, Array, Array]:
    """Of each trial of the main sweep: how strongly it bends, its spine length (level), when it was."""
    labels, problem = p.labels, p.problem
    channels = np.unique(labels.channel, return_inverse=True)[1]
    same = np.unique(np.column_stack([p.states.condition[labels.state], channels]), axis=0, return_inverse=True)[1]
    same = same.reshape(-1)
    # A robot bends more, a specimen of a stiffness trial is stiffer.
    along = ("spine_stiffness", "youngs_modulus") if p.pushes_only else ("area",)
    area = slope[:, [i for i, source in enumerate(problem.parameters.sources) if source in along]].sum(axis=1)

    def beside(values: Array) -> Array:
        count = np.bincount(same)
        return values - (np.bincount(same, values) / count)[same]

    missed, response = problem.noise.whiten(beside(problem.observed)), problem.noise.whiten(area)
    level = levels(p.states.spine_length, SPINE_GAP)
    found = []
    for t in np.unique(labels.trial[labels.experiment == 0]):
        own = (labels.trial == t) & (labels.experiment == 0)
        states = np.unique(labels.state[own])
        strength = float(response[own] @ missed[own]) / max(float(response[own] @ response[own]), 1e-300)
        times = p.states.time[states]
        when = float(np.nanmean(times)) if np.isfinite(times).any() else float(t)
        found.append((strength, float(level[states[0]]), when))
    strength_, length, time = np.array(found).reshape(-1, 3).T
    return strength_, length, time


def _kendall_s(values: Array) -> int:
    """Kendall's S: pairs in rising order less pairs in falling order."""
    i, j = np.triu_indices(len(values), 1)
    return int(np.sign(values[j] - values[i]).sum())


def _kendall_s_distribution(n: int) -> Array:
    """Probabilities of S = -n (n - 1) / 2 .. n (n - 1) / 2 (every value, odd steps are zero) for n values in random order."""
    inversions = np.ones(1)
    for k in range(2, n + 1):
        inversions = np.convolve(inversions, np.ones(k) / k)
    out = np.zeros(2 * len(inversions) - 1)
    out[::2] = inversions
    return out
