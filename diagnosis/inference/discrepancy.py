"""Model discrepancy: a smooth remainder that no effect of the catalogue explains, a Gaussian process over the states.

Kernel: squared exponential over spine length, pressure and the other settings of a state; the two branches and
different kinds of experiment are correlated only in part. Its standard deviation grows with pressure.
Instead of the kernel its leading eigenvectors are used, which makes the process a few dozen columns with unit prior.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Ints, Mask
from ..judgement import BRANCH_DISTANCE, CORRELATION_LENGTH, CORRELATION_PRESSURE, DISCREPANCY_AT_REST

DECIMALS, MOST_PLACES = 3, 1000
"""Decimals of a correlation length to which places are rounded, and places from which the process is made, as the work grows with
their cube."""
SMALLEST_SHARE = 2e-3
"""Least variance of an eigenfunction, as a share of the largest."""


def settings(
    spine_length: Array, pressure: Array, branch: Array, kind: NDArray[np.generic], robot_length: float
) -> tuple[Array, Array]:
    """Coordinates (n, d) of n states in correlation lengths, and the relative size (n,) of the discrepancy there, from (n,) each:
    spine length m, highest pressure Pa, branch -1 or 1, kind of experiment (any label)."""
    share = pressure / max(float(np.max(np.abs(pressure), initial=0.0)), 1.0)
    kind_number = np.unique(kind, return_inverse=True)[1]
    # One axis for each kind of experiment: any two lie 1.5 correlation lengths apart.
    kinds = 1.5 / np.sqrt(2) * np.eye(kind_number.max(initial=0) + 1)[kind_number]
    length = spine_length / (CORRELATION_LENGTH * robot_length)
    place = np.column_stack([length, share / CORRELATION_PRESSURE, BRANCH_DISTANCE * branch, kinds])
    return place, DISCREPANCY_AT_REST + (1 - DISCREPANCY_AT_REST) * np.abs(share)


@dataclass(frozen=True, eq=False)
class SmoothErrors:
    """Errors of the model that are smooth over the states of n values: a discrepancy, drawn anew for each channel, and relative
    errors of laws, half of whose variance is shared by all channels. Unit normal coefficients draw each from its columns."""

    draws: Array
    """(n, m) columns of a process of size 1 at each value's state."""
    channel: Ints
    """(n,) number of each value's channel."""
    channels: int
    size: Array
    """(n,) standard deviation of a discrepancy of size 1 where the process has 1, in the unit of each value."""

    @property
    def discrepancy(self) -> Array:
        """(n, m * channels) columns of a discrepancy of size 1."""
        return self._columns(self.size, np.eye(self.channels))

    @property
    def unit(self) -> Array:
        """(n,) standard deviation of a discrepancy of size 1."""
        return np.asarray(self.size * np.linalg.norm(self.draws, axis=1))

    def drawn(self, coefficients: Array) -> Array:
        """(n,) the discrepancy of size 1 with these coefficients (m * channels,)."""
        return np.asarray(self.size * (self.draws * coefficients.reshape(-1, self.channels).T[self.channel]).sum(axis=1))

    def laws(self, response: Array) -> Array:
        """(n, m * channels) columns of a relative error of size 1 of a law that contributes `response` (n,) to the values."""
        return self._columns(response, np.asarray(np.linalg.cholesky(0.5 * (1 + np.eye(self.channels))), float))

    def _columns(self, size: Array, root: Array) -> Array:
        sized = self.draws * size[:, None]
        return (sized[:, :, None] * root[self.channel][:, None, :]).reshape(len(size), -1)

    def take(self, kept: Mask) -> SmoothErrors:
        """Of some of the values."""
        return replace(self, draws=self.draws[kept], channel=self.channel[kept], size=self.size[kept])

    def then(self, other: SmoothErrors) -> SmoothErrors:
        """With those of other values after these, in channels of their own."""
        wide = max(self.draws.shape[1], other.draws.shape[1])
        draws = np.vstack([np.pad(e.draws, ((0, 0), (0, wide - e.draws.shape[1]))) for e in (self, other)])
        channel = np.concatenate([self.channel, self.channels + other.channel])
        return SmoothErrors(draws, channel, self.channels + other.channels, np.concatenate([self.size, other.size]))


def smooth_errors(
    where: tuple[Array, Array], state: Ints, channel: NDArray[np.str_], unit: float, robot_length: float
) -> SmoothErrors:  # fmt: skip
    """Smooth errors of values (n,), each of a state (`where`, see `settings`) and a channel; `unit`: size 1 of the tip's
    discrepancy, m."""
    names, number = np.unique(channel, return_inverse=True)
    # A bend that moves the tip by d turns it by about 2 d / L; forces have a unit of their own at each state.
    size = np.array([2 * unit / robot_length if n.startswith("r") else 1.0 if n == "force" else unit for n in names])
    return SmoothErrors(eigenfunctions(where[0])[state], number, len(names), size[number] * where[1][state])


def eigenfunctions(place: Array, most: int | None = None) -> Array:
    """(n, m) leading eigenfunctions of the kernel at places (n, d) in correlation lengths, the last the largest, at most this
    many; coefficients of unit variance draw a process of size 1. Of more places than `MOST_PLACES` by Nystroem's method."""
    distinct, index = np.unique(np.round(place, DECIMALS), axis=0, return_inverse=True)
    chosen = np.sort(np.random.default_rng(0).permutation(len(distinct))[:MOST_PLACES])
    square = (distinct**2).sum(axis=1)
    kernel = np.exp(distinct @ distinct[chosen].T - 0.5 * np.add.outer(square, square[chosen]))
    value, vector = np.linalg.eigh(kernel[chosen])
    kept = np.flatnonzero(value > SMALLEST_SHARE * value.max())[-(most or len(value)) :]
    return np.asarray((kernel @ (vector[:, kept] / np.sqrt(value[kept])))[index.reshape(-1)])
