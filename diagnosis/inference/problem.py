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

from ..data.noise import Noise
from .linear import Linear, Prior

Array = NDArray[np.float64]


TOLERATED = 0.12
"""Share of its scale that an effect usually has where no robot is otherwise perfect."""
KEPT, LEAST_LAW, SEED = 160, 1.0, 7
"""Most columns kept for the errors of tolerated laws; those are left out that even laws which are all wrong would not move by
as many standard deviations of the noise."""
ONE_WAY_MEAN, ONE_WAY_SD, LIMIT = np.sqrt(0.75), 0.5, np.sqrt(3)
"""Of a size that is evenly spread between nothing and a limit, when its root mean square is 1."""
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
    sources: tuple[str, ...] = ()
    """Effect, tolerance or calibration that each belongs to; empty: not known."""
    trials: tuple[int | None, ...] = ()
    """The trial whose own each is, None where it is common to all; empty: all are."""
    changes: bool = False
    """Effects are changes since a reference: those that act one way only may have grown or shrunk."""

    @property
    def of_effect(self) -> NDArray[np.bool_]:
        """(k,) which parameters belong to an effect."""
        return np.array([bool(e) for e in self.effects])

    @property
    def of_trial(self) -> NDArray[np.bool_]:
        """(k,) which parameters a trial has of its own."""
        return np.array([t is not None for t in self.trials or (None,) * len(self.names)])

    @property
    def ids(self) -> tuple[str, ...]:
        """The effects, once each, in order."""
        return tuple(dict.fromkeys(e for e in self.effects if e))

    @property
    def calibrated(self) -> NDArray[np.bool_]:
        """(k - p,) which of the other parameters are fitted in every model."""
        return np.array(self.calibration or (False,) * len(self.names), bool)[~self.of_effect]

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

    def prior(self, named: NDArray[np.bool_], spike: float, reach: Array | None = None) -> Prior:
        """When the parameters marked `named` (..., p) are wide and the sizes of all other effects held narrow.

        What acts one way only is tolerated one way only: its narrow prior has the mean and variance of a size evenly spread
        up to a limit. How a tolerated effect looks is as little known as how a named one does; where the problem is linear
        around a point, `reach` is `Linear.reach` there: what a look can do is what it can at the limit, not beyond.
        """
        way = np.zeros(len(self.low)) if self.changes else (self.low >= 0).astype(float) - (self.high <= 0)
        mean, sd = spike * ONE_WAY_MEAN * way, spike * np.where(way == 0, 1.0, ONE_WAY_SD)
        beyond = np.maximum(reach / (LIMIT * spike), 1.0) if reach is not None and spike > 0 else 1.0
        mean, variance = np.where(self.sizes, mean, 0.0), np.where(self.sizes, sd**2, float(spike > 0) / beyond**2)
        return Prior(np.where(named, 0.0, mean), np.where(named, 1.0, variance), named)

    def scaled(self, prior: Prior) -> tuple[Array, Array]:
        """Standard deviation and mean (k,) of all parameters, in their units, under a prior of the effects."""
        sd, mean = self.sd.copy(), self.mean.copy()
        sd[self.of_effect] *= np.sqrt(prior.variance)
        mean[self.of_effect] += prior.mean * self.scale
        return sd, mean

    def reach(self, theta: Array) -> Array:
        """(p,) how large, in units of its scale, the effect is at parameters (k,) to which a shape belongs; 0 for sizes."""
        size = np.where(self.sizes, theta[self.of_effect] / self.scale, 0.0)
        return np.where(self.sizes, 0.0, np.sqrt(size**2 @ self.members) @ self.members.T)

    def absent(self) -> Prior:
        """No effect at all."""
        return self.prior(self.mask(()), 0.0)

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
    """(n, a) columns that draw a factor of standard deviation 1, smooth over the states and one for all channels: how an
    effect's true law may differ from the catalogue's."""
    each: Array
    """(n, b) the same for each channel by itself: half of what a named effect's law may get wrong is such."""

    @cached_property
    def whitened_discrepancy(self) -> Array:
        """(n, m)."""
        return self.noise.whiten(self.discrepancy)

    @cached_property
    def _wrong(self) -> Array:
        """(n, a + b) columns of a law that is wrong by once its size in all channels, and once in each."""
        return np.hstack([self.alike, self.each])

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
            reach=p.reach(theta),
        )

    @cached_property
    def tolerated(self) -> Array:
        """(n, r) whitened columns for what the laws of effects that are not named may get wrong, smoothly over the states,
        when each is as large as is usually tolerated; a coefficient of 1 is all of it. The leading ones of many."""
        p = self.parameters
        sizes = np.flatnonzero(p.of_effect)[p.sizes]
        done = TOLERATED * self.linearise(p.mean, sizes.tolist())[1] * p.sd[sizes]
        every = self.noise.whiten(np.hstack([done * factor[:, None] for factor in self.alike.T]))
        drawn = np.random.default_rng(SEED).normal(size=(every.shape[1], min(KEPT, *every.shape)))
        basis = np.linalg.qr(every @ drawn)[0]
        inner = basis.T @ every
        value, vector = np.linalg.eigh(inner @ inner.T)
        kept = value > LEAST_LAW**2
        return np.asarray(basis @ (vector[:, kept] * np.sqrt(value[kept])))

    def loosened(
        self, linear: Linear, theta: Array, predicted: Array, named: tuple[str, ...], tolerating: bool
    ) -> Linear:
        """The linear problem with columns for what the laws of the effects that are there may get wrong, smoothly over the
        states; a coefficient of 1 is all of what a named effect does at theta, or of what those that are tolerated do."""
        columns, spill = [self.tolerated] if tolerating else [], 0.0
        for effect in named:
            without = theta.copy()
            without[[i for i, e in enumerate(self.parameters.effects) if e == effect]] = 0.0
            done = predicted - self.forward.predict(without)
            if np.isfinite(done).all() and done.any():
                columns.append(_leading(self.noise.whiten(np.sqrt(0.5) * done[:, None] * self._wrong)))
                spill = float(np.hypot(spill, AFTER * self._typical(done)))
        return replace(linear, form=np.hstack(columns), spill=spill) if columns else linear

    def _typical(self, done: Array) -> float:
        """What an effect does, rms over all values, in units of a discrepancy of size 1."""
        unit = np.sqrt((self.discrepancy**2).sum(axis=1))
        return float(np.sqrt(np.mean((done / np.maximum(unit, 1e-300)) ** 2)))

    def misfit(self, theta: Array) -> Array:
        """Whitened residual (n,)."""
        return self.noise.whiten(self.observed - self.forward.predict(theta))


def _leading(columns: Array) -> Array:
    """Fewer columns (n, r) with which unit normal coefficients draw nearly the same as with these (n, c)."""
    value, vector = np.linalg.eigh(columns.T @ columns)
    return np.asarray(columns @ vector[:, value > LEAST_LAW**2])
