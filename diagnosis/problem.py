"""The non-linear problem: a forward model with named parameters, measured values and their noise.

`Problem.at(theta)` makes the linear problem around a point; its evidence is then the Laplace approximation there
(Gauss-Newton form), exact where the model is linear.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .linear import Linear
from .noise import Noise

Array = NDArray[np.float64]


AFTER = 0.3
"""Of a law's error, the part that may also lie where the law does nothing, such as what a memory leaves behind."""


class Forward(Protocol):
    """What is asked of a model of the measured values."""

    def predict(self, theta: Array) -> Array:
        """Predicted values (n,) at parameters (k,)."""

    def linearise(self, theta: Array, columns: Sequence[int] | None = None) -> tuple[Array, Array]:
        """Predicted values (n,) and their derivatives (n, k), by some of the parameters where columns are given."""


@dataclass(frozen=True)
class Parameters:
    """The k parameters of a forward model; each has a normal prior, cut at its bounds."""

    names: tuple[str, ...]
    effects: tuple[str, ...]
    """The catalogue's id each parameter belongs to; empty for calibration and nuisances."""
    mean: Array
    sd: Array
    """Prior standard deviation; for an effect its plausible scale."""
    lower: Array
    upper: Array
    units: tuple[str, ...]
    shapes: tuple[bool, ...] = ()
    """Parameters that say how an effect looks and do nothing where its size is zero; empty: none is."""
    calibration: tuple[bool, ...] = ()
    """Parameters that are fitted in every model, with wide priors; empty: none is."""
    starts: tuple[tuple[float, ...], ...] = ()
    """Values from which a search begins when the parameter's effect is named; empty: at the mean alone."""

    @property
    def of_effect(self) -> NDArray[np.bool_]:
        """(k,) which parameters belong to an effect."""
        return np.array([bool(e) for e in self.effects])

    @property
    def ids(self) -> tuple[str, ...]:
        """The effects, once each, in order."""
        return tuple(dict.fromkeys(e for e in self.effects if e))

    @property
    def scale(self) -> Array:
        """(p,) plausible scale of the effects' parameters."""
        return self.sd[self.of_effect]

    @property
    def low(self) -> Array:
        """(p,) lower bounds of the effects' parameters, in units of their scale."""
        return (self.lower / self.sd)[self.of_effect]

    @property
    def high(self) -> Array:
        """(p,) upper bounds of the same."""
        return (self.upper / self.sd)[self.of_effect]

    @property
    def sizes(self) -> NDArray[np.bool_]:
        """(p,) which of the effects' parameters are sizes: they alone may be a little off zero without being named."""
        shapes = np.array(self.shapes or (False,) * len(self.names))
        return ~shapes[self.of_effect]

    @cached_property
    def members(self) -> Array:
        """(p, e) 1 where an effect's parameter belongs to the effect, in the order of `ids`."""
        return np.array([[float(e == one) for one in self.ids] for e in self.effects if e])

    def variance(self, chosen: tuple[str, ...], spike: float) -> Array:
        """(p,) prior variances in units of the scale when some effects are named and the others held narrow."""
        return np.where(self.mask(chosen), 1.0, spike**2 * self.sizes)

    def mask(self, chosen: tuple[str, ...]) -> NDArray[np.bool_]:
        """(p,) which of the effects' parameters belong to the chosen effects."""
        return np.array([e in chosen for e in self.effects if e])


@dataclass(frozen=True)
class Problem:
    """Everything needed to weigh hypotheses."""

    forward: Forward
    parameters: Parameters
    observed: Array
    """(n,) measured values, in the unit of each channel."""
    noise: Noise
    discrepancy: Array
    """(n, m) columns of a discrepancy of size 1."""
    alike: Array
    """(n, a) columns that draw a smooth factor over the states, of standard deviation 1: how an effect's true law may
    differ from the catalogue's."""

    @cached_property
    def whitened_discrepancy(self) -> Array:
        """(n, m)."""
        return self.noise.whiten(self.discrepancy)

    @cached_property
    def _gram(self) -> Array:
        return np.asarray(self.whitened_discrepancy.T @ self.whitened_discrepancy)

    def linearise(self, theta: Array, columns: Sequence[int] | None = None) -> tuple[Array, Array]:
        """As the forward model's; a state next to its point of snapping has no derivative and is left where it is."""
        predicted, slope = self.forward.linearise(theta, columns)
        return predicted, np.nan_to_num(slope, nan=0.0, posinf=0.0, neginf=0.0)

    def at(self, theta: Array) -> Linear:
        """The linear problem around parameters (k,), in units of their priors."""
        return self.linear(theta, *self.linearise(theta))

    def linear(self, theta: Array, predicted: Array, slope: Array) -> Linear:
        """The same from a prediction (n,) and slope (n, k) that are known already."""
        p = self.parameters
        own = p.of_effect
        scaled = self.noise.whiten(slope * p.sd)
        shift = scaled @ ((theta - p.mean) / p.sd)
        observed = self.noise.whiten(self.observed - predicted) + shift
        none = np.zeros((len(observed), 0))
        return Linear(
            observed,
            scaled[:, own],
            scaled[:, ~own],
            self.whitened_discrepancy,
            self.noise.log_sd,
            none,
            gram=self._gram,
        )

    def loosened(self, linear: Linear, theta: Array, predicted: Array, named: tuple[str, ...]) -> Linear:
        """The linear problem with columns for what each named effect's law may get wrong, smoothly over the states; a
        coefficient of 1 is all of what the effect does at theta."""
        columns, spill = [], 0.0
        for effect in named:
            without = theta.copy()
            without[[i for i, e in enumerate(self.parameters.effects) if e == effect]] = 0.0
            done = predicted - self.forward.predict(without)
            if np.isfinite(done).all() and done.any():
                columns.append(self.noise.whiten(done[:, None] * self.alike))
                spill = float(np.hypot(spill, AFTER * self._typical(done)))
        return replace(linear, form=np.hstack(columns), spill=spill) if columns else linear

    def _typical(self, done: Array) -> float:
        """What an effect does, rms over all values, in units of a discrepancy of size 1."""
        unit = np.sqrt((self.discrepancy**2).sum(axis=1))
        return float(np.sqrt(np.mean((done / np.maximum(unit, 1e-300)) ** 2)))

    def misfit(self, theta: Array) -> Array:
        """Whitened residual (n,)."""
        return self.noise.whiten(self.observed - self.forward.predict(theta))
