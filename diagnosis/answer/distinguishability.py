"""Distinguishability: which effects these data cannot tell apart.

T_ij is the misfit (chi-square) that would be left if effect i were at work with size t and effect j were fitted
instead, everything else refitted too: T = t (H_ii - H_ij (H_jj + I)^-1 H_ji) t. Below 9 the two are tied: the right one
would lead by less than three standard deviations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..inference.linear import Reduced
from ..inference.problem import Parameters
from ..judgement import TIED

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Distinguishability:
    """Separations between single effects."""

    effects: tuple[str, ...]
    separation: Array
    """(e, e) T of row's effect against column's; the diagonal holds T against no effect at all."""

    def rivals(self, effect: str) -> tuple[str, ...]:
        """Effects that these data cannot tell from this one: T below `TIED`."""
        i = self.effects.index(effect)
        return tuple(e for j, e in enumerate(self.effects) if j != i and self.separation[i, j] < TIED)

    def detectable(self, effect: str) -> bool:
        """Whether T against no effect at all reaches `TIED`."""
        i = self.effects.index(effect)
        return bool(self.separation[i, i] >= TIED)


def distinguishability(
    reduced: Reduced,
    parameters: Parameters,
    effects: Sequence[str],
    size: Array,
    spike: float,
    effect_size: Array | None = None,
) -> Distinguishability:
    """Separations of `effects`, each with its parameters at `size` (p,) in units of the scale.

    `reduced` has the discrepancy integrated out; the other effects are free within `spike` of their scale, their shape
    parameters as `effect_size` (p,) allows (see `Parameters.prior`).
    """
    n = len(effects)
    out = np.zeros((n, n))
    for i, one in enumerate(effects):
        for j, other in enumerate(effects):
            if j >= i:
                pair = (one,) if i == j else (one, other)
                information, mask = _information(reduced, parameters, pair, spike, effect_size)
                own = parameters.mask((one,))[mask]
                rest = ~own
                out[i, j] = _chi_square_left(information, own, rest, size[mask])
                out[j, i] = _chi_square_left(information, rest, own, size[mask]) if i != j else out[i, j]
    return Distinguishability(tuple(effects), out)


def visible(
    reduced: Reduced, parameters: Parameters, effects: Sequence[str], spike: float, effect_size: Array | None = None
) -> tuple[str, ...]:
    """The effects that would be seen at their plausible size, as `distinguishability` judges it."""
    found = []
    for one in effects:
        information, mask = _information(reduced, parameters, (one,), spike, effect_size)
        own = parameters.mask((one,))[mask]
        size = np.where(parameters.sizes, 1.0, 0.0)[mask]
        if _chi_square_left(information, own, ~own, size) >= TIED:
            found.append(one)
    return tuple(found)


def _information(
    reduced: Reduced, p: Parameters, pair: tuple[str, ...], spike: float, effect_size: Array | None
) -> tuple[Array, NDArray[np.bool_]]:
    """Information about the parameters of `pair`, all other effects integrated out within their spikes."""
    mask = p.mask(pair)
    other = ~mask
    root = np.sqrt(p.prior(mask, spike, effect_size).variance[other])
    full = reduced.information
    inner = np.eye(int(other.sum())) + root[:, None] * full[np.ix_(other, other)] * root[None, :]
    across = full[np.ix_(mask, other)] * root
    return full[np.ix_(mask, mask)] - across @ np.linalg.solve(inner, across.T), mask


def _chi_square_left(information: Array, own: NDArray[np.bool_], rest: NDArray[np.bool_], size: Array) -> float:
    """Misfit left of `own` at `size` when `rest` is fitted under its prior."""
    at = size[own]
    among = information[np.ix_(rest, rest)] + np.eye(int(rest.sum()))
    across = information[np.ix_(own, rest)]
    left = information[np.ix_(own, own)] - across @ np.linalg.solve(among, across.T)
    return float(at @ left @ at)
