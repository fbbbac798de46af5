"""A positive quantity over length, from a table of measured lengths, without kinks.

A robot stands at the very lengths of its table, give or take a millimetre. Where a curve has a kink there, half of its first
differences belong to one slope and half to another, and a search for the most probable length ends on the kink. So between
entries it is a monotone cubic (PCHIP, Fritsch and Carlson 1980); beyond them it goes on with the slope that it has there and
levels off: y = y_e exp(w tanh(s (l - l_e) / (w y_e))), w = ln 2, never below half the end entry y_e and never above twice.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOST_BEYOND = np.log(2.0)
"""Logarithm of the factor on an end entry that is approached far beyond it."""


def at(table: tuple[tuple[float, float], ...], length: Array) -> Array:
    """Values at lengths (...) of a table of (length, value), sorted by length.

    >>> at(((0.1, 1e6), (0.2, 2e6)), np.array([0.1, 0.15, 0.2])).tolist()
    [1000000.0, 1500000.0, 2000000.0]
    """
    first, last = table[0], table[-1]
    if len(table) < 2:
        return np.full(length.shape, first[1])
    curve, slope = _curve(table)
    out: Array = np.asarray(curve(np.clip(length, first[0], last[0])))
    for (end, value), beyond in ((first, length < first[0]), (last, length > last[0])):
        if beyond.any():
            rise = float(slope(end)) / (MOST_BEYOND * value) * (length - end)
            out = np.where(beyond, value * np.exp(MOST_BEYOND * np.tanh(rise)), out)
    return out


@lru_cache(maxsize=64)
def _curve(table: tuple[tuple[float, float], ...]) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """The curve between the ends, and its slope."""
    from scipy.interpolate import PchipInterpolator  # reading a robot needs none of it

    lengths, values = np.array(table).T
    curve = PchipInterpolator(lengths, values)
    return curve, curve.derivative()
