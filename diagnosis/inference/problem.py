"""The non-linear problem: a forward model with named parameters, measured values and their noise.

`Problem.whitened` makes the linear problem around a point; its evidence is the Laplace approximation there (Gauss-Newton
form), exact where the model is linear.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Ints, Mask
from ..data.noise import Noise
from ..judgement import BEYOND_SD, GEOMETRY_LAW_ERROR, LEAKAGE, LEAST_NAMED_SIZE, LOAD_SIZES, TENSE_SD
from .discrepancy import SmoothErrors
from .jacobian import Columns, Jacobian
from .linear import Linear, SizePrior

ONE_WAY_MEAN, ONE_WAY_SD, LIMIT = np.sqrt(0.75), 0.5, np.sqrt(3)
"""Mean, standard deviation and upper limit of a size uniform between zero and that limit, with root mean square 1."""


@dataclass(frozen=True, kw_only=True)
class FitParameter:
    """One parameter of a forward model, as `model.effects.parameters.ParameterInfo` describes it."""

    name: str
    source: str
    group: str
    unit: str
    sd: float
    low: float
    high: float
    role: str = "size"
    starts: tuple[float, ...] = (0.0,)
    tolerated: bool = True
    exact: bool = False
    least: float = 0.0
    recurs: bool = False
    lasts: bool = True
    load: bool = False


class FitForward(Protocol):
    """Required of a model of the measured values."""

    def predict(self, theta: Array, trial: bool = False, whole: bool = False) -> Array:
        """Predicted values (n,) at parameters (k,); a `trial` may return NaN for what would take long to find, and
        with `whole` a single state without equilibrium makes all values NaN."""

    def linearise(self, theta: Array, columns: Sequence[int] | None = None) -> tuple[Array, Array]:
        """Predicted values (n,) and their derivatives (n, k), by some of the parameters where columns are given."""

    def near(self, theta: Array) -> FitForward:
        """The same model, accelerated close to parameters (k,) where it can be."""
        return self


@runtime_checkable
class CopiedForward(FitForward, Protocol):
    """A model of which each value depends on one copy of each parameter, as on that of its trial."""

    def slopes(self, theta: Array, columns: Sequence[int] | None = None) -> tuple[Array, Array, Ints]:
        """Predicted values (n,), their derivatives (s, n) by the copies that they take, and the columns (s, n) of these."""


@dataclass(frozen=True, eq=False)
class MaskedForward:
    """A forward model of those values alone that a mask (n,) keeps."""

    forward: FitForward
    kept: Mask

    def predict(self, theta: Array, trial: bool = False, whole: bool = False) -> Array:
        """The predicted values kept, NaN where the rod has no equilibrium; `trial` and `whole` as in `FitForward.predict`."""
        try:
            return self.forward.predict(theta, trial, whole)[self.kept]
        except np.linalg.LinAlgError:
            # A step so far off that the rod cannot be solved counts as no equilibrium.
            return np.full(int(self.kept.sum()), np.nan)

    def linearise(self, theta: Array, columns: Sequence[int] | None = None) -> tuple[Array, Array]:
        """The same, and their derivatives."""
        predicted, slope = self.forward.linearise(theta, columns)
        return predicted[self.kept], slope[self.kept]

    def near(self, theta: Array) -> MaskedForward:
        """The same, accelerated close to parameters (k,)."""
        return replace(self, forward=self.forward.near(theta))


def derivatives(forward: FitForward, theta: Array, columns: Sequence[int] | None = None) -> tuple[Array, Columns]:
    """As the forward model's, without the zeros of parameters that few values depend on; where there is no derivative (next to a
    snap-through) it is 0."""
    if isinstance(forward, MaskedForward):
        predicted, of_all = derivatives(forward.forward, theta, columns)
        return predicted[forward.kept], of_all.rows(forward.kept)
    if isinstance(forward, CopiedForward):
        predicted, slope, column = forward.slopes(theta, columns)
        count = len(theta) if columns is None else len(columns)
        return predicted, Columns.of_copies(np.nan_to_num(slope, nan=0.0, posinf=0.0, neginf=0.0), column, count)
    predicted, whole = forward.linearise(theta, columns)
    return predicted, Columns.of(np.nan_to_num(whole, nan=0.0, posinf=0.0, neginf=0.0))


def _each(read: Callable[[FitParameter], Any], of_effects: bool = False) -> cached_property[NDArray[Any]]:
    """A column of `FitParameters`: an array of what is read of each parameter, or of those of effects alone."""
    return cached_property(lambda p: np.array([read(i) for i in p.infos if i.group == "effect" or not of_effects]))


def _of_effects(read: Callable[[FitParameters], Array]) -> cached_property[Array]:
    """A column of `FitParameters`, of the parameters of effects alone."""
    return cached_property(lambda p: read(p)[p.of_effect])


@dataclass(frozen=True)
class FitParameters:
    """The k parameters of a forward model; each has a normal prior about 0, cut at its bounds."""

    infos: tuple[FitParameter, ...]
    sd: Array
    """(k,) prior standard deviation, for an effect its plausible scale; of what repeats show, not that of `infos`."""
    least: tuple[float, ...]
    """(k) least size of a named effect, as a share of each parameter's scale."""
    narrow: bool = False
    """An effect that may be named below `LEAST_NAMED_SIZE` has a narrower tolerance, and counts as large from that size on."""
    changes: bool = False
    """Effects are changes since a reference: one-sided ones may have grown or shrunk."""

    names = cached_property[tuple[str, ...]](lambda p: tuple(i.name for i in p.infos))
    """(k)"""
    effects = cached_property[tuple[str, ...]](lambda p: tuple(i.source if i.group == "effect" else "" for i in p.infos))
    """(k) the catalogue's id each parameter belongs to; empty for calibration and nuisances."""
    ids = cached_property[tuple[str, ...]](lambda p: tuple(dict.fromkeys(e for e in p.effects if e)))
    """The effects, once each, in order."""
    lower, upper = _each(lambda i: i.low), _each(lambda i: i.high)
    """(k,)"""
    calibration = _each(lambda i: i.group == "calibration")
    """(k,) which parameters are fitted in every model, with wide priors."""
    of_effect = _each(lambda i: i.group == "effect")
    """(k,) which parameters belong to an effect."""
    recurs = _each(lambda i: i.recurs)
    """(k,) which parameters are drawn anew with each trial or repeat."""
    sizes = _each(lambda i: i.role == "size", of_effects=True)
    """(p,) which of the effects' parameters are sizes: they alone may differ from zero within a tolerance."""
    loads = _each(lambda i: i.role == "size" and i.load, of_effects=True)
    """(p,) which of these are in proportion to the body's stiffness: forces, masses, stiffnesses and compliances."""
    tolerable = _each(lambda i: i.tolerated, of_effects=True)
    """(p,) which of the effects' parameters may differ from zero though their effect is not named."""
    scale = _of_effects(lambda p: p.sd)
    """(p,) plausible scale of the effects' parameters."""
    low, high = _of_effects(lambda p: p.lower / p.sd), _of_effects(lambda p: p.upper / p.sd)
    """(p,) bounds of the effects' parameters, in units of their scale."""
    least_named = _of_effects(lambda p: np.array(p.least))
    """(p,) least size of a named effect, in units of its parameters' scales."""
    law_error = cached_property[dict[str, float]](
        lambda p: {i.source: GEOMETRY_LAW_ERROR if i.exact else 1.0 for i in p.infos if i.group == "effect"}
    )
    """By effect, the share of a law's error that it has: less where its law is geometry."""

    members = _of_effects(lambda p: (np.array(p.effects)[:, None] == np.array(p.ids)).astype(float))
    """(p, e) 1 where an effect's parameter belongs to the effect, in the order of `ids`."""

    def prior(self, named: Mask, spike: float, slab: float, effect_size: Array | None = None) -> SizePrior:
        """Prior with the parameters marked `named` (..., p) wide (loads `slab` scales) and the sizes of all other effects narrow.

        The narrow prior of a one-sided effect has the mean and variance of a size uniform up to a limit. Shape parameters
        keep their full prior; `effect_size`, see `Linear`, narrows it where the problem was linearised at a larger size than
        the limit, so that they do no more than they can at the limit.
        """
        side = np.zeros(len(self.low)) if self.changes else (self.low >= 0).astype(float) - (self.high <= 0)
        narrow = spike * self.least_named / LEAST_NAMED_SIZE if self.narrow else np.full(len(self.low), spike)
        mean, sd = narrow * ONE_WAY_MEAN * side, narrow * np.where(side == 0, 1.0, ONE_WAY_SD)
        narrowing = np.maximum(effect_size / (LIMIT * spike), 1.0) if effect_size is not None and spike > 0 else 1.0
        mean, variance = np.where(self.sizes, mean, 0.0), np.where(self.sizes, sd**2, float(spike > 0) / narrowing**2)
        mean, variance = np.where(self.tolerable, mean, 0.0), np.where(self.tolerable, variance, 0.0)
        return SizePrior(np.where(named, 0.0, mean), np.where(named, np.where(self.loads, slab**2, 1.0), variance), named)

    def of(self, used: Ints) -> FitParameters:
        """Some of the effects' parameters (u,) alone, those of an effect together."""
        chosen = np.flatnonzero(self.of_effect)[used]
        infos, least = (tuple(of_each[i] for i in chosen) for of_each in (self.infos, self.least))
        return replace(self, infos=infos, sd=self.sd[chosen], least=least)

    def scaled(self, prior: SizePrior) -> tuple[Array, Array]:
        """Standard deviation and mean (k,) of all parameters, in their units, under a prior of the effects."""
        sd, mean = self.sd.copy(), np.zeros_like(self.sd)
        sd[self.of_effect] *= np.sqrt(prior.variance)
        mean[self.of_effect] = prior.mean * self.scale
        return sd, mean

    def effect_size(self, theta: Array) -> Array:
        """(p,) size, in units of its scale, of the effect that a shape parameter belongs to at parameters (k,); 0 for sizes."""
        size = np.where(self.sizes, theta[self.of_effect] / self.scale, 0.0)
        return np.where(self.sizes, 0.0, np.sqrt(size**2 @ self.members) @ self.members.T)

    def prior_of(self, named: tuple[str, ...], spike: float = 0.0) -> SizePrior:
        """Prior with these effects named, however large, and all others absent or within a tolerance."""
        return self.prior(self.mask(named), spike, float(LOAD_SIZES.max()))

    def beyond_calibration(self, columns: Array, slope: Array | Columns, unit: Array | float = 1.0) -> Array:
        """Residuals of columns (n, c), the values in `unit` (n, 1) each, after least squares over all that is fitted in every
        model; derivatives `slope` (n, k) of the same values."""
        chosen, columns = self.calibration & ~self.of_effect, columns * unit
        free = (slope.take(chosen).whole if isinstance(slope, Columns) else slope[:, chosen]) * self.sd[chosen] * unit
        return columns - free @ np.linalg.lstsq(free, columns, rcond=None)[0] if free.size else columns

    def tense(self, *fits: Array) -> dict[int, float]:
        """Calibration and tolerances of the whole set-up that lie more than `BEYOND_SD` from 0 at the parameters (k,) of each of
        some fits, by index, as the first has them; none unless one of them, or of what drifts, lies more than `TENSE_SD` from
        there."""
        away = np.min([np.abs(theta) / self.sd for theta in fits], axis=0) * (~self.of_effect & ~self.recurs)
        least = np.where([i.lasts for i in self.infos], BEYOND_SD, TENSE_SD)
        return {i: float(fits[0][i]) for i in np.flatnonzero((away > least) & (away.max(initial=0.0) > TENSE_SD)).tolist()}

    def mask(self, chosen: tuple[str, ...]) -> Mask:
        """(p,) which of the effects' parameters belong to the chosen effects."""
        return np.array([e in chosen for e in self.effects if e])


@dataclass(frozen=True)
class FormError:
    """Model-form error at a point: of the laws of what is named there, and of what is tolerated."""

    named: tuple[str, ...]
    responses: Mapping[str, Array]
    """What named effects do to the values (n,), in their units, where that is known."""
    shared: bool = False
    """Tolerated effects are taken to be as at the reference of the derivatives."""


@dataclass(frozen=True)
class Problem:
    """Forward model, data and noise: all that the evidence of a hypothesis needs."""

    forward: FitForward
    parameters: FitParameters
    observed: Array
    """(n,) measured values, in the unit of each channel."""
    noise: Noise
    smooth: SmoothErrors
    """The discrepancy, and how an effect's true law may differ from the catalogue's (model-form error)."""

    def __getstate__(self) -> dict[str, Any]:
        """Without cached values."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @cached_property
    def whitened_discrepancy(self) -> Array:
        """(n, m)."""
        columns = self.smooth.discrepancy
        return self.noise.whiten(columns, into=columns)

    @cached_property
    def gram(self) -> Array:
        """(m, m) of these columns."""
        return np.asarray(self.whitened_discrepancy.T @ self.whitened_discrepancy)

    def jacobian(self, theta: Array) -> tuple[Array, Jacobian]:
        """Predicted values (n,) at parameters (k,), and their derivatives."""
        predicted, slope = derivatives(self.forward, theta)
        return predicted, Jacobian.of(slope.whitened(self.noise, self.parameters.sd))

    def whitened(self, theta: Array, predicted: Array, scaled: Columns) -> Linear:
        """The linear problem around parameters (k,), in units of their priors, from a prediction (n,) and a slope (n, k) that is
        whitened, by one prior standard deviation of each parameter (`scaled`)."""
        p = self.parameters
        shift = scaled.along(theta / p.sd)
        observed = self.noise.whiten(self.observed - predicted) + shift
        return Linear(
            observed,
            scaled.take(p.of_effect).whole,
            scaled.take(~p.of_effect),
            self.whitened_discrepancy,
            self.noise.log_sd,
            np.zeros((len(observed), 0)),
            gram=self.gram,
            effect_size=p.effect_size(theta),
        )

    def with_form_error(self, linear: Linear, theta: Array, wrong: FormError, tolerated: Array | None = None) -> Linear:
        """The linear problem with columns of model-form error, smooth over the states; a coefficient of 1 is all of what an
        effect does at theta. No law of material or contact is exact, whether its effect is named or (to first order) tolerated.
        `tolerated` (n, f): columns of what is, for those that share them."""
        columns, leakage = [np.zeros((len(linear.observed), 0))], 0.0
        unit = np.maximum(self.smooth.unit, 1e-300)
        for effect, response in wrong.responses.items():
            done = self.parameters.law_error[effect] * response
            columns.append(self.form_error_of(done))
            leakage = float(np.hypot(leakage, LEAKAGE * np.sqrt(np.mean((done / unit) ** 2))))
        known = tolerated if wrong.shared else None
        columns.append(self._tolerated(linear, theta, wrong.named) if known is None else known)
        return replace(linear, form_error=np.hstack(columns), leakage=leakage)

    def _tolerated(self, linear: Linear, theta: Array, named: tuple[str, ...]) -> Array:
        """Columns (n, f) of the model-form error of all effects that are not named."""
        p = self.parameters
        tolerated = [e not in named for e in p.ids]
        share = np.array([p.law_error[e] for e in p.ids])
        white = linear.effects @ ((theta[p.of_effect] / p.scale)[:, None] * p.members * share)[:, tolerated]
        # Any rotation of the effects' contributions has the same joint errors.
        return leading(np.hstack([np.zeros((len(white), 0)), *map(self.form_error_of, self.noise.colour(leading(white)).T)]))

    def response(self, theta: Array, predicted: Array, effect: str) -> Array:
        """Contribution of an effect to the values (n,): `predicted` at parameters (k,) less the prediction without it; NaN where
        there is no equilibrium without it."""
        without = np.where(np.array(self.parameters.effects) == effect, 0.0, theta)
        return np.asarray(predicted - self.forward.predict(without, whole=True))

    def form_error_of(self, done: Array) -> Array:
        """Columns (n, r), whitened, of the model-form error of an effect that contributes `done` (n,) to the values."""
        columns = self.smooth.laws(done)
        return leading(self.noise.whiten(columns, into=columns))


def leading(columns: Array) -> Array:
    """Fewer columns (n, r) with which unit normal coefficients draw nearly the same as with these (n, c)."""
    of_rows = columns.shape[0] < columns.shape[1]  # the same eigenvalues, of the smaller matrix
    value, vector = np.linalg.eigh(columns @ columns.T if of_rows else columns.T @ columns)
    # columns of model-form error below two standard deviations of the noise are left out
    kept = value > 2.0**2
    return np.asarray(vector[:, kept] * np.sqrt(value[kept]) if of_rows else columns @ vector[:, kept])
