"""Model discrepancy: a smooth remainder that no effect of the catalogue explains, a Gaussian process over the states.

Kernel: squared exponential over spine length, pressure and the other settings of a state; the two branches and
different kinds of experiment are correlated only in part. Its standard deviation grows with pressure.
Instead of the kernel its leading eigenvectors are used, which makes the process a few dozen columns with unit prior.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Ints
from ..judgement import BRANCH_DISTANCE, CORRELATION_LENGTH, CORRELATION_PRESSURE, DISCREPANCY_AT_REST

DECIMALS, MOST_PLACES = 3, 1000
"""Share of a correlation length to which places are rounded, doubled until at most this many places remain: the work grows
with their cube, and within a tenth of a correlation length the process hardly changes."""


@dataclass(frozen=True)
class Settings:
    """Coordinates of n states in units of the correlation length."""

    place: Array
    """(n, d) coordinates: spine length, pressure, branch, and those of other experiments."""
    size: Array
    """(n,) relative size of the discrepancy."""


def settings(spine_length: Array, pressure: Array, branch: Array, kind: NDArray[np.generic], robot_length: float) -> Settings:
    """Coordinates of n states, all (n,): spine length m, highest pressure Pa, branch -1 or 1, kind of experiment (any label)."""
    highest = max(float(np.max(np.abs(pressure), initial=0.0)), 1.0)
    share = pressure / highest
    kind_number = np.unique(kind, return_inverse=True)[1]
    # One axis for each kind of experiment: any two lie 1.5 correlation lengths apart.
    kinds = 1.5 / np.sqrt(2) * np.eye(kind_number.max(initial=0) + 1)[kind_number]
    length = spine_length / (CORRELATION_LENGTH * robot_length)
    place = np.column_stack([length, share / CORRELATION_PRESSURE, BRANCH_DISTANCE * branch, kinds])
    return Settings(place, DISCREPANCY_AT_REST + (1 - DISCREPANCY_AT_REST) * np.abs(share))


def bases(where: Settings, state: Ints, channel: NDArray[np.str_], unit: float, robot_length: float) -> tuple[Array, Array]:
    """Columns of a discrepancy of size 1 over values (n,), each of a state and a channel, and the basis of the model-form error
    (see `Problem`): half of its variance is shared by all channels, half is drawn anew for each.

    `unit`: size 1 of the tip's discrepancy, m.
    """
    names, number = np.unique(channel, return_inverse=True)
    # A bend that moves the tip by d turns it by about 2 d / L; forces have a unit of their own at each state.
    size = np.array([2 * unit / robot_length if n.startswith("r") else 1.0 if n == "force" else unit for n in names])
    draws = eigenfunctions(where.place)
    return by_channel(draws * where.size[:, None], state, number, size), half_shared(draws[state], number)


def eigenfunctions(place: Array) -> Array:
    """(n, m) leading eigenfunctions of the kernel at places (n, d) in correlation lengths; coefficients of unit variance draw a
    process of size 1."""
    grain = 10.0**-DECIMALS
    distinct, index = np.unique(np.round(place, DECIMALS), axis=0, return_inverse=True)
    while len(distinct) > MOST_PLACES:
        grain *= 2
        distinct, index = np.unique(np.round(place / grain), axis=0, return_inverse=True)
        distinct *= grain
    squared = ((distinct[:, None, :] - distinct[None, :, :]) ** 2).sum(axis=-1)
    value, vector = np.linalg.eigh(np.exp(-0.5 * squared))
    kept = value > 2e-3 * value.max()
    return np.asarray((vector[:, kept] * np.sqrt(value[kept]))[index.reshape(-1)])


def half_shared(draws: Array, channel: Ints) -> Array:
    """Columns (n, m * channels): the process `draws` (n, m) with half of its variance shared by all channels (n,), half drawn anew
    for each."""
    root = np.linalg.cholesky(0.5 * (1 + np.eye(channel.max() + 1)))
    return (draws[:, :, None] * root[channel][:, None, :]).reshape(len(draws), -1)


def by_channel(states: Array, state: Ints, channel: Ints, unit: Array) -> Array:
    """Columns (n, m * channels): the process `states` (states, m) drawn anew for each channel of size `unit` (channels,)."""
    n, m = len(state), states.shape[1]
    out = np.zeros((n, m * len(unit)))
    for c, size in enumerate(unit):
        own = np.flatnonzero(channel == c)
        out[own, c * m : (c + 1) * m] = size * states[state[own]]
    return out
