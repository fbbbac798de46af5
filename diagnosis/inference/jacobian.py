"""The Jacobian: derivatives of the measured values by the parameters, of which many searches share most.

Most searches take anew the derivatives by what they name alone; all others are those of one point, the base. Those are kept once,
whitened once, and go to another process once; a fit keeps what it took anew. Derivatives are made by
`ForwardModel.linearise` (model/effects/forward.py), asked by `Problem.jacobian` and `fit`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..arrays import Array, Ints
from .columns import Columns

Whiten = Callable[[Columns, Ints], Columns]
"""Columns by some of the parameters, as `Problem.white` makes them of noise 1 and prior standard deviation 1."""
Between = Callable[[Columns, Columns], Array]
"""A^T C^-1 B of whitened columns A and B, C their covariance with a discrepancy."""


@dataclass(frozen=True, eq=False)
class Jacobian:
    """Derivatives (n, k): columns of its own, all others those of its base, or zeros where it has none."""

    parameters: int
    """k."""
    at: Ints
    """(c,) which parameters its own columns are of."""
    own: Columns
    """(n, c) in the parameters' units."""
    base: Jacobian | None = None
    tolerated: Array | None = None
    """Of a base: columns (n, f) of the model-form error of what is tolerated at its point, where they are known."""
    left: str | None = None
    """Name of the base that it has where it came from, see `candidate.light`."""
    _made: dict[Any, Any] = field(default_factory=dict, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        """Without what is made of it."""
        return vars(self) | {"_made": {}}

    @classmethod
    def of(cls, slope: Array) -> Jacobian:
        """Of derivatives (n, k), all its own."""
        return cls(slope.shape[1], np.arange(slope.shape[1]), Columns.of(slope))

    @property
    def flat(self) -> Jacobian:
        """The same as a base for others: all columns its own."""
        return Jacobian(self.parameters, np.arange(self.parameters), self.every)

    @property
    def shared(self) -> Jacobian:
        """With this as the base, and nothing taken anew."""
        return Jacobian(self.parameters, np.zeros(0, np.int64), Columns.nothing(self.own.shape[0], 0), self)

    @property
    def every(self) -> Columns:
        """(n, k) in the parameters' units."""
        return self._filled(None if self.base is None else self.base.own, self.own)

    @property
    def whole(self) -> Array:
        """The same as one array."""
        return self.every.whole

    def along(self, step: Array) -> Array:
        """(n,) by how much the values change along a step (k,), in the parameters' units."""
        own = self.own.along(step[self.at])
        if self.base is None:
            return own
        rest = step.copy()
        rest[self.at] = 0.0
        return np.asarray(self.base.own.along(rest) + own)

    def white(self, whiten: Whiten) -> Columns:
        """(n, k) W: whitened, by one prior standard deviation of each parameter."""
        return self._filled(None if self.base is None else self.base._own_white(whiten), self._own_white(whiten))

    def against(self, white: Array, whiten: Whiten) -> Array:
        """(k,) W^T x of whitened values x (n,)."""
        out = np.zeros(self.parameters) if self.base is None else self.base._own_white(whiten).against(white)
        out[self.at] = self._own_white(whiten).against(white)
        return out

    def information(self, size: float, between: Between, whiten: Whiten) -> Array:
        """(k, k) W^T C^-1 W with a discrepancy of this size."""
        if self.base is None:
            out, own = np.zeros((self.parameters, self.parameters)), self._own_white(whiten)
        else:
            known, own = self.base._own_white(whiten), self._own_white(whiten)
            if size not in self.base._made:
                self.base._made[size] = between(known, known)
            out, across = self.base._made[size].copy(), between(known, own)
            out[:, self.at], out[self.at, :] = across, across.T
        out[np.ix_(self.at, self.at)] = between(own, own)
        return out

    def _own_white(self, whiten: Whiten) -> Columns:
        if "white" not in self._made:
            self._made["white"] = whiten(self.own, self.at)
        made: Columns = self._made["white"]
        return made

    def _filled(self, known: Columns | None, own: Columns) -> Columns:
        """(n, k) of what the columns of the base, and its own, have become."""
        return (known or Columns.nothing(own.shape[0], self.parameters)).replaced(self.at, own)
