"""Noise components estimated by maximum a posteriori, with log-normal priors at the instruments' defaults.

By Newton's method within bounds, damped. Second derivatives are the average information and, close to the end, symmetric updates
of rank one of what the gradients differ by from it (as Dennis, Gay and Welsch 1981 do for least squares).

The contrasts v are normal with covariance C = B + U U^T: B of the readings, block by block of conditions that share trials, U the
columns of what a trial has of its own and of drift. With a = C^-1 v the loss has the gradient

    d(log det C / 2 + v^T C^-1 v / 2) = tr((C^-1 - a a^T) dC) / 2

and the average information (the mean of the observed and the expected one but for second derivatives of C, which cancel on
average; Gilmour, Thompson and Cullis 1995)

    A_xy = (dC_x a)^T C^-1 (dC_y a) / 2.

Channels j share nothing but the error of the pressures: with M the covariance (k, k) of contrasts of a regulator's reading, R_j
the response (k, k r) of channel j to r regulators, diagonal for each, and D_j the covariance (k, k) of what it has of its own,

    B_ij = D_j [i = j] + R_i (1 x M) R_j^T,     B^-1 = D^-1 - D^-1 R K R^T D^-1,
    K = ((1 x M)^-1 + T)^-1 = L (1 + L^T T L)^-1 L^T,     T = R^T D^-1 R,     L L^T = 1 x M,

so no matrix is larger than k or k r, and none of all channels is ever made.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, eigh
from scipy.linalg.lapack import dpotri
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from model.prediction.box_minima import box_minima

from .. import judgement
from ..arrays import Array, Ints, rows_by
from .noise_components import PRESSURE, NoiseComponents, Repeated, contrasts

MOST_CONTRASTS = 150
"""Largest number of contrasts with correlated errors."""
STEPS, ENOUGH = 100, 1e-9
"""Most steps, and the promised decrease of the loss below which no step is taken."""
LEAST, HELD = 0.1, 0.1
"""Least curvature in any direction, and first damping, relative to the average information."""


def estimate_noise(data: Repeated, default: NoiseComponents) -> NoiseComponents:
    """Components at the maximum of their posterior density; `default`, the centre of their priors, where nothing was repeated."""
    contrast = contrasts(data.condition)
    if not len(contrast):
        return default
    loss = Loss(data, contrast, default)
    return loss.components(lowest(loss))


def lowest(loss: Loss) -> Array:
    """The point (x,) of least loss (minus the log posterior density) within its bounds, from 0, the centre of the priors.

    The curvature is the average information at each point (`Point.curve`) plus a `remainder` (x, x) learnt on the way.
    """
    x = np.zeros(len(loss.centre))
    here, remainder, damping = loss(x), np.zeros((len(x), len(x))), 0.0
    for _ in range(STEPS):
        step, promised = _step(here, here.curve + remainder, damping, loss.low - x, loss.high - x)
        if promised < ENOUGH:
            break
        there = loss(x + step)
        if promised < 1.0:  # close to the end
            missed = there.slope - here.slope - (there.curve + remainder) @ step
            along = float(missed @ step)
            if abs(along) > 1e-8 * float(np.linalg.norm(missed) * np.linalg.norm(step)):  # else ill-conditioned
                remainder = remainder + np.outer(missed, missed) / along
        if here.value - there.value > 0.1 * promised:
            x, here, damping = x + step, there, damping / 4 if damping > HELD else 0.0
        else:
            damping = max(4 * damping, HELD)
    return x


def _step(here: Point, curve: Array, damping: float, low: Array, high: Array) -> tuple[Array, float]:
    """The step (x,) to the minimum within bounds of slope . s + s . H s / 2, and how much lower that is there. H is `curve` with
    its eigenvalues relative to the average information raised to LEAST, and `damping` added."""
    size, way = eigh(curve, here.curve)
    way = here.curve @ way
    curve = (way * (np.maximum(size, LEAST) + damping)) @ way.T
    # the longest step in each logarithm or logit
    low, high = np.maximum(low, -2.0), np.minimum(high, 2.0)
    (step,) = box_minima(curve[None], here.slope[None], low[None], high[None])
    return step, -float(here.slope @ step + 0.5 * step @ curve @ step)


@dataclass(frozen=True)
class Point:
    """Minus the log posterior at one point, its gradient (x,) and its curvature (x, x) by average information."""

    value: float
    slope: Array
    curve: Array


class Loss:
    """Minus the log posterior of the components at a point x, each number of which counts from the centre of its prior.

    x[:g]              logarithm of the standard deviation of each of g kinds of channel
    x[g], x[g + 1]     of the pressure reading, and of the factor `rest`
    x[g + 2 : sds]     of each component of the trials
    x[sds : -1]        logit of the share that lasts, of each kind and of the pressure reading
    x[-1]              logarithm of the memory
    """

    def __init__(self, data: Repeated, contrast: Array, default: NoiseComponents) -> None:
        """`contrast` (k, n): see `contrasts`; `default`: centres of the priors."""
        self._kinds, self._names = list(default.channel), list(data.scatter)
        g, self.sds = len(self._kinds), len(self._kinds) + 2 + len(self._names)
        sds = np.log([*default.channel.values(), default.pressure, default.rest, *(default.trial[k] for k in self._names)])
        logit = np.log(judgement.LASTING_SHARE / (1 - judgement.LASTING_SHARE))
        self.centre = np.array([*sds, *[logit] * (g + 1), np.log(default.memory)])
        counts = [self.sds, g + 1, 1]
        self._prior_sd = np.repeat([judgement.COMPONENT_LOG_SD, judgement.LASTING_LOGIT_SD, judgement.MEMORY_LOG_SD], counts)
        self._lasts = float((data.block >= 0).any())
        longest = np.log(judgement.LONGEST_MEMORY / judgement.MEMORY)
        self.low = np.repeat([-np.log(judgement.COMPONENT_RANGE), -6.0 * self._lasts, -3.0 * self._lasts], counts)
        self.high = np.repeat([np.log(judgement.COMPONENT_RANGE), 6.0 * self._lasts, longest * self._lasts], counts)
        k, c = len(contrast), data.residual.shape[1]
        self._count = k
        own, each = np.array([self._kinds.index(kind) for kind in data.group]), np.eye(len(self.centre))
        # rows (.., x) with a one at the number that each of `_ByParameter` is a derivative by
        self._sd, self._share, self._others = each[own], each[self.sds + own], each[[g, g + 1, self.sds + g, -1]]
        drift = judgement.DRIFT_SD * np.einsum("kn,ncd->kcd", contrast, data.drift)
        # one column for each parameter of each trial or repeat
        apart = [(s.response, (s.part[:, None] == np.unique(s.part)).astype(float)) for s in data.scatter.values()]
        made = [np.einsum("kn,nca,nt->kcta", contrast, *of, optimize=True).reshape(k, c, -1) for of in apart]
        every = [*made, drift]
        columns, self._of = np.concatenate(every, axis=2), np.repeat(np.arange(len(every)), [x.shape[2] for x in every])
        self._named = self._of[None, :] == np.arange(len(self._names))[:, None]
        self._parts = [_Part(data, contrast[own], columns[own]) for own in _together(contrast, data.block)]

    def components(self, x: Array) -> NoiseComponents:
        """The components at a point."""
        g, at = len(self._kinds), self.centre + x
        sd, share = np.exp(at[: self.sds]), self._lasts / (1 + np.exp(-at[self.sds : -1]))
        return NoiseComponents(
            channel=dict(zip(self._kinds, sd[:g].tolist(), strict=True)),
            pressure=float(sd[g]),
            trial=dict(zip(self._names, sd[g + 2 :].tolist(), strict=True)),
            rest=float(sd[g + 1]),
            contrasts=self._count,
            excess=dict(zip([PRESSURE, *self._names], np.exp([x[g], *x[g + 2 : self.sds]]).tolist(), strict=True)),
            lasting=dict(zip([*self._kinds, PRESSURE], share.tolist(), strict=True)) if self._lasts else {},
            memory=float(np.exp(at[-1])),
        )

    def __call__(self, x: Array) -> Point:
        """The loss at a point, by Woodbury's identity: C^-1 = B^-1 - B^-1 U K^-1 U^T B^-1, K = 1 + U^T B^-1 U, of which each part
        has its own B and its own columns of U. `inner` is K, `remainders` a = C^-1 v, `changes` dC a of each parameter."""
        noise, g = self.components(x), len(self._kinds)
        scale = np.array([*noise.trial.values(), 1.0])[self._of]
        columns = [p.columns * scale[p.at] for p in self._parts]
        solved = [p.solved(noise, u) for p, u in zip(self._parts, columns, strict=True)]
        inner, pulled = np.eye(len(scale)), np.zeros(len(scale))
        for p, u, s in zip(self._parts, columns, solved, strict=True):
            inner[np.ix_(p.at, p.at)] += u.T @ s.columns
            pulled[p.at] += s.columns.T @ p.value
        inverse, log_det = _inverse(inner)
        total, weight = sum(s.log_det for s in solved) + log_det, inverse @ pulled
        total += 0.5 * (sum(float(p.value @ s.value) for p, s in zip(self._parts, solved, strict=True)) - float(pulled @ weight))
        gradient = np.zeros(len(x))
        along, spread = np.zeros(len(scale)), np.zeros(len(scale))
        remainders = [s.value - s.columns @ weight[p.at] for p, s in zip(self._parts, solved, strict=True)]
        for p, u, s, a in zip(self._parts, columns, solved, remainders, strict=True):
            w = s.columns @ inverse[np.ix_(p.at, p.at)]
            # C^-1 of the part is its B^-1 less the first of these columns times the second, transposed
            of_part = p.gradient(s, np.column_stack([w, a]), np.column_stack([s.columns, a]), noise)
            gradient += of_part.sd @ self._sd + of_part.share @ self._share + of_part.others @ self._others
            along[p.at] += u.T @ a
            spread[p.at] += np.einsum("nu,nu->u", u, w)
        gradient[g + 2 : self.sds] = [spread[own].sum() - (along[own] ** 2).sum() for own in self._named]
        information, shared = np.zeros((len(x), len(x))), np.zeros((len(scale), len(x)))
        for p, u, s, a in zip(self._parts, columns, solved, remainders, strict=True):
            of = p.changes(s, a, noise)
            changes = of.sd[..., None] * self._sd + of.share[..., None] * self._share + of.others @ self._others
            changes = changes.reshape(len(a), -1)
            # of a component with columns U (k c, u) and x = ln of its standard deviation: 2 U (U^T a)
            changes[:, g + 2 : self.sds] = 2 * u @ np.where(self._named[:, p.at], along[p.at], 0.0).T
            information += changes.T @ s.solve(changes)
            shared[p.at] += s.columns.T @ changes
        information -= shared.T @ inverse @ shared
        prior = 1 / self._prior_sd**2
        return Point(total + 0.5 * float(x**2 @ prior), gradient + prior * x, 0.5 * information + np.diag(prior))


@dataclass(frozen=True)
class _Solved:
    """B^-1 of one part, applied to the contrasts and to the columns U, and half its log determinant."""

    solve: Callable[[Array], Array]
    """B^-1 applied to further columns (k c, u)."""
    own: Array
    """(c, k, k) its blocks of single channels."""
    shared: Array
    """(k, k) R^T B^-1 R, summed over regulators."""
    value: Array
    columns: Array
    log_det: float
    lasting: Array
    """(k, k) covariance of contrasts of what lasts, of variance one."""
    grown: Array
    """(k, k) its derivative by the logarithm of the memory."""


@dataclass(frozen=True)
class _ByParameter:
    """By ln sd and the logit of what lasts, of each channel; by the pressure's sd, rest, the pressure's share and the memory:
    a gradient (c,), (c,), (4,), or what a vector is turned into (k, c), (k, c), (k, c, 4)."""

    sd: Array
    share: Array
    others: Array


class _Part:
    """k contrasts (k, n) whose errors go together, in c channels, and which of the columns (k, c, u) are theirs."""

    def __init__(self, data: Repeated, contrast: Array, columns: Array) -> None:
        """`at` are those of the columns that are not zero here, `value` (k c,) the contrasts of the residuals."""
        self.at = np.flatnonzero(columns.any(axis=(0, 1)))
        self.columns = columns[..., self.at].reshape(len(contrast) * columns.shape[1], -1)
        used = np.flatnonzero(np.abs(contrast).max(axis=0) > 0)
        self._contrast, self._kinds = contrast[:, used], data.group
        self.value = (contrast @ data.residual).ravel()
        block, time = data.block[used], data.time[used]
        apart = np.abs(time[:, None] - time[None, :])
        self._apart = np.where((block[:, None] == block[None, :]) & (block[:, None] >= 0), apart, np.inf)
        np.fill_diagonal(self._apart, 0.0)
        # A contrast's weights squared sum to one: the response of its states, averaged.
        weight = contrast**2
        self._resting = weight @ data.resting
        self._response = np.einsum("kn,ncr->ckr", weight, data.pressure_response)

    def solved(self, noise: NoiseComponents, columns: Array) -> _Solved:
        """B^-1 (see the top of the file) of the contrasts and of columns (k c, u), and half the log determinant of B."""
        ratio, a = self._apart / noise.memory, self._contrast
        kept = np.exp(-ratio)
        lasting, grown = (a @ of_states @ a.T for of_states in (kept, np.where(np.isfinite(ratio), ratio, 0.0) * kept))
        (c, k, r), share, white = self._response.shape, noise.lasting.get(PRESSURE, 0.0), self._white(noise)
        shares = {kind: noise.lasting.get(kind, 0.0) for kind in self._kinds}
        by_kind = {k: _inverse(noise.channel[k] ** 2 * (s * lasting + (1 - s) * np.diag(white))) for k, s in shares.items()}
        apart = np.array([by_kind[kind][0] for kind in self._kinds])
        # D^-1 R of each channel, (c, k, k r): contrasts and regulators as one axis
        spread = (apart[..., None] * self._response[:, None]).reshape(c, k, k * r)
        factor = np.kron(np.linalg.cholesky(noise.pressure**2 * ((1 - share) * np.eye(k) + share * lasting)), np.eye(r))
        together = self._gathered(spread)
        inner, log_det = _inverse(np.eye(k * r) + factor.T @ together @ factor)
        middle = factor @ inner @ factor.T  # K

        def solve(values: Array) -> Array:
            solution = apart @ values.reshape(k, c, -1).swapaxes(0, 1)
            solution -= spread @ (middle @ self._gathered(solution))
            return solution.swapaxes(0, 1).reshape(k * c, -1)

        solved = solve(np.column_stack([self.value, columns]))
        shared = (together - together @ middle @ together).reshape(k, r, k, r)
        return _Solved(
            solve, apart - (spread @ middle) @ spread.swapaxes(1, 2), np.einsum("krlr->kl", shared), solved[:, 0], solved[:, 1:],
            sum(by_kind[kind][1] for kind in self._kinds) + log_det, lasting, grown,
        )  # fmt: skip

    def _gathered(self, values: Array) -> Array:
        """(k r, u) R^T of values (c, k, u)."""
        return np.asarray(np.einsum("ckr,cku->kru", self._response, values).reshape(-1, values.shape[2]))

    def _white(self, noise: NoiseComponents) -> Array:
        """(k,) white variance, as a factor on that of states read while ramping."""
        return np.asarray(1 + (noise.rest**2 - 1) * self._resting)

    def gradient(self, solved: _Solved, left: Array, right: Array, noise: NoiseComponents) -> _ByParameter:
        """tr((B^-1 - left right^T) dB) / 2 for each parameter; `left` and `right` are columns (k c, u)."""
        (c, k, r), white = self._response.shape, self._white(noise)
        left, right = (x.reshape(k, c, -1).swapaxes(0, 1) for x in (left, right))
        half = 0.5 * (solved.own - left @ right.swapaxes(1, 2))
        diagonal = np.einsum("ckk->ck", half)
        by_left, by_right = (self._gathered(x).reshape(k, r, -1) for x in (left, right))
        shared = 0.5 * (solved.shared - np.einsum("kru,lru->kl", by_left, by_right, optimize=True))
        by_lasting, by_growth = ((half * own).sum(axis=(1, 2)) for own in (solved.lasting, solved.grown))
        by_channel = by_lasting, diagonal @ white, by_growth, diagonal @ self._resting
        by_regulators = np.trace(shared), (shared * solved.lasting).sum(), (shared * solved.grown).sum()
        return self._by_parameter(by_channel, by_regulators, noise, lambda of_channels: of_channels.sum())

    def changes(self, solved: _Solved, values: Array, noise: NoiseComponents) -> _ByParameter:
        """dB of each parameter, applied to values (k c,)."""
        lasting, grown = solved.lasting, solved.grown
        c, k, r = self._response.shape
        a = values.reshape(k, c)
        at_once = self._gathered(a.T[..., None]).reshape(k, r)

        def spread(of_regulators: Array) -> Array:
            return np.asarray(np.einsum("ckr,kr->kc", self._response, of_regulators))

        by_channel = lasting @ a, self._white(noise)[:, None] * a, grown @ a, self._resting[:, None] * a
        by_regulators = spread(at_once), spread(lasting @ at_once), spread(grown @ at_once)
        return self._by_parameter(by_channel, by_regulators, noise, lambda of_channels: of_channels)

    def _by_parameter(
        self, by_channel: tuple[Array, Array, Array, Array], by_regulators: tuple[Array, Array, Array],
        noise: NoiseComponents, together: Callable[[Array], Array],
    ) -> _ByParameter:  # fmt: skip
        """Derivatives by the parameters, by the chain rule through the parts of B: of each channel (.., c) the covariance of what
        lasts, of what does not, the first's growth with the memory, and the white noise of states at rest; of the regulators
        (..) what does not last, what lasts, and its growth with the memory. `together`: sums over channels what they share."""
        slow, white, longer, resting = by_channel
        at_once, kept, grown = by_regulators
        var, share = np.array([(noise.channel[kind] ** 2, noise.lasting.get(kind, 0.0)) for kind in self._kinds]).T
        of_pressure, pressure_share = noise.pressure**2, noise.lasting.get(PRESSURE, 0.0)
        others = (
            2 * of_pressure * ((1 - pressure_share) * at_once + pressure_share * kept),
            2 * noise.rest**2 * together(var * (1 - share) * resting),
            of_pressure * pressure_share * (1 - pressure_share) * (kept - at_once),
            together(var * share * longer) + of_pressure * pressure_share * grown,
        )
        return _ByParameter(
            2 * var * (share * slow + (1 - share) * white), var * share * (1 - share) * (slow - white), np.stack(others, -1)
        )


def _inverse(matrix: Array) -> tuple[Array, float]:
    """Inverse of a positive definite matrix, and half its log determinant."""
    factor = cholesky(matrix, lower=True, check_finite=False)
    lower = dpotri(factor, lower=1)[0]
    return lower + np.tril(lower, -1).T, float(np.log(np.diag(factor)).sum())


def _together(contrast: Array, block: Ints) -> list[Ints]:
    """The contrasts (k, n), by index, whose errors go together as their states are of the same blocks."""
    used = (contrast != 0) & (block >= 0)
    links = csr_array(used @ (block[:, None] == np.unique(block)[None, :]).astype(float))
    of_parts = rows_by(connected_components(links @ links.T, directed=False)[1])
    return [own[k : k + MOST_CONTRASTS] for own in of_parts for k in range(0, len(own), MOST_CONTRASTS)]
