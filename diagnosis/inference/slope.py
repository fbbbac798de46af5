"""Derivatives of the measured values by the parameters, of which many searches share most.

Most searches take anew the derivatives by what they name alone; all others are those of one point. Those are kept once, whitened
once, and go to another process once; a fit keeps what it took anew.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..data.noise import Noise
from .columns import Columns

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

Between = Callable[[Columns, Columns], Array]
"""A^T C^-1 B of whitened columns A and B, C their covariance with a discrepancy."""


@dataclass(frozen=True, eq=False)
class Reference:
    """Derivatives at one point, and what linear problems make of them, once."""

    slope: Columns
    """(n, k) in the parameters' units."""
    noise: Noise
    sd: Array
    """(k,) prior standard deviations."""
    tolerated: Array | None = None
    """(n, f) columns of the model-form error of what is tolerated at that point, where they are known."""
    _information: dict[float, Array] = field(default_factory=dict, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        """Without what is made of it."""
        kept = ("slope", "noise", "sd", "tolerated")
        return {"_information": {}, **{name: getattr(self, name) for name in kept}}

    @cached_property
    def white(self) -> Columns:
        """(n, k) W: whitened, by one prior standard deviation of each parameter."""
        return self.slope.whitened(self.noise, self.sd)

    def information(self, size: float, between: Between) -> Array:
        """(k, k) W^T C^-1 W with a discrepancy of this size."""
        if size not in self._information:
            self._information[size] = between(self.white, self.white)
        return self._information[size]


@dataclass(frozen=True, eq=False)
class Slope:
    """Derivatives (n, k): those of a reference, or zeros, but for some columns of its own."""

    reference: Reference | None
    at: Ints
    """(c,) which parameters these columns are of."""
    columns: Columns
    """(n, c) in the parameters' units."""
    parameters: int
    """k."""
    left: str | None = None
    """Name of the reference that it has where it came from, see `candidate.light`."""

    @classmethod
    def of(cls, slope: Array) -> Slope:
        """Of derivatives (n, k)."""
        return cls(None, np.arange(slope.shape[1]), Columns.of(slope), slope.shape[1])

    @classmethod
    def at_reference(cls, reference: Reference) -> Slope:
        """Those of a reference."""
        n, k = reference.slope.shape
        return cls(reference, np.zeros(0, np.int64), Columns.nothing(n, 0), k)

    @property
    def every(self) -> Columns:
        """(n, k) in the parameters' units."""
        return self.filled(None if self.reference is None else self.reference.slope, self.columns)

    @property
    def whole(self) -> Array:
        """The same as one array."""
        return self.every.whole

    def along(self, step: Array) -> Array:
        """(n,) by how much the values change along a step (k,), in the parameters' units."""
        own = self.columns.along(step[self.at])
        if self.reference is None:
            return own
        rest = step.copy()
        rest[self.at] = 0.0
        return np.asarray(self.reference.slope.along(rest) + own)

    def filled(self, known: Columns | None, own: Columns) -> Columns:
        """(n, k) of what the reference and the own columns have become."""
        if known is None:
            known = Columns.nothing(own.shape[0], self.parameters)
        return known.replaced(self.at, own)


class White:
    """W: derivatives whitened, by one prior standard deviation of each parameter."""

    def __init__(self, slope: Slope, noise: Noise, sd: Array) -> None:
        self._slope, self._own = slope, slope.columns.whitened(noise, sd[slope.at])

    @property
    def every(self) -> Columns:
        """(n, k)."""
        reference = self._slope.reference
        return self._slope.filled(None if reference is None else reference.white, self._own)

    def against(self, white: Array) -> Array:
        """(k,) W^T x of whitened values x (n,)."""
        reference = self._slope.reference
        out = np.zeros(self._slope.parameters) if reference is None else reference.white.against(white)
        out[self._slope.at] = self._own.against(white)
        return out

    def information(self, size: float, between: Between) -> Array:
        """(k, k) W^T C^-1 W with a discrepancy of this size."""
        reference, at = self._slope.reference, self._slope.at
        if reference is None:
            out = np.zeros((self._slope.parameters, self._slope.parameters))
        else:
            out = reference.information(size, between).copy()
            across = between(reference.white, self._own)
            out[:, at], out[at, :] = across, across.T
        out[np.ix_(at, at)] = between(self._own, self._own)
        return out
