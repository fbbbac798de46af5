"""The linear-Gaussian problem around a point, and its evidence.

    y = A theta + N u + g D w + f F z + e,     e, u, w, z ~ N(0, I),  theta_j ~ N(m_j, v_j)

after whitening by the noise and scaling every column by its prior. y are the measured values, theta the catalogue's effects in
units of their plausible scale, u the nuisances, D w a smooth discrepancy of size g, F z the model-form error of the named
effects, of size f. u, w and z are integrated out in closed form for each pair (g, f), which leaves a small problem in theta.
There any choice of the priors m, v (which effects are present, how narrow the others are) costs one small factorisation.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dtrtri

from ..arrays import Array, Mask
from .arrow import cholesky
from .jacobian import Columns


@dataclass(frozen=True)
class SizePrior:
    """Normal prior of the effects' p parameters, in units of their scale; a variance of 0 leaves a parameter at its mean."""

    mean: Array
    """(..., p)"""
    variance: Array
    """(..., p)"""
    wide: Mask
    """(..., p) parameters of named effects."""


@dataclass(frozen=True)
class Linear:
    """A whitened linear problem; columns are scaled so that a coefficient of 1 is one prior standard deviation."""

    observed: Array
    """(n,) whitened, with the prediction at theta = u = w = 0 taken off."""
    effects: Array
    """(n, p) A."""
    nuisance: Columns
    """(n, q) N."""
    discrepancy: Array
    """(n, m) D, for a discrepancy of size 1."""
    log_noise: float
    """Sum of the logarithms of the noise's standard deviations (half its log determinant)."""
    form_error: Array
    """(n, f) F, model-form error of size 1: as large as the effects themselves; no columns where nothing is named."""
    leakage: float = 0.0
    """Size of the discrepancy that a model-form error of size 1 adds, in units of D."""
    gram: Array | None = None
    """(m, m) D^T D where it is known."""
    effect_size: Array | None = None
    """(p,) see `Parameters.effect_size`; None where no parameter is a shape parameter."""

    def discrepancy_size(self, size: float, form_error: float) -> float:
        """Size of the discrepancy, the leakage of a model-form error of size `form_error` included."""
        return float(np.hypot(size, form_error * self.leakage))

    def reductions(self, sizes: Array, form_errors: Array) -> Reduced:
        """The problems (s, f) in theta alone, for each size g (s,) of the discrepancy and f (f,) of the model-form error.

        From the products of X = [A y] and E = [D F], what f F explains is taken off once for each f, then for each g what g D
        does of the remainder.
        """
        x_gram, errors_by_x, error_gram, half_log_det = self._products
        m, r, c, (n, p) = self.discrepancy.shape[1], self.form_error.shape[1], len(x_gram), self.effects.shape
        out = Reduced(*(np.empty((len(sizes), len(form_errors), *shape)) for shape in ((p, p), (p,), ())))
        for k, form_error in enumerate(form_errors.tolist()):
            used = r if form_error else 0  # columns of size 0 are left out
            by_form = form_error * np.hstack([errors_by_x[m : m + used], error_gram[m : m + used, :m]])
            of_form, form_log_det = _integrated_out(form_error**2 * error_gram[m : m + used, m : m + used], by_form)
            of_x, of_smooth = of_form[:, :c], of_form[:, c:]
            x_left, smooth_by_x = x_gram - of_x.T @ of_x, errors_by_x[:m] - of_smooth.T @ of_x
            smooth_gram = error_gram[:m, :m] - of_smooth.T @ of_smooth
            for j, size in enumerate(sizes.tolist()):
                smooth = self.discrepancy_size(size, form_error)
                used = m if smooth else 0
                half, log_det = _integrated_out(smooth**2 * smooth_gram[:used, :used], smooth * smooth_by_x[:used])
                left = x_left - half.T @ half  # X^T C^-1 X, C the covariance of y given theta
                out.information[j, k], out.score[j, k] = 0.5 * (left[:p, :p] + left[:p, :p].T), left[:p, p]
                log_dets = half_log_det + form_log_det + log_det
                out.base[j, k] = -0.5 * (left[p, p] + n * np.log(2 * np.pi)) - log_dets - self.log_noise
        return out

    @cached_property
    def _products(self) -> tuple[Array, Array, Array, float]:
        """X^T X, E^T X and E^T E of X = [A y] and the error columns E = [D F], less what the nuisances N explain, and half the
        log determinant of those: all that is needed of the n values."""
        x, errors = (self.effects, self.observed[:, None]), (self.discrepancy, self.form_error)
        c, across = self.effects.shape[1] + 1, self.form_error.T @ self.discrepancy
        smooth = self.discrepancy.T @ self.discrepancy if self.gram is None else self.gram
        error_gram = np.block([[smooth, across.T], [across, self.form_error.T @ self.form_error]])
        along_nuisance = np.hstack([self.nuisance.against(columns) for columns in (*x, *errors)])
        nuisance = self.nuisance.normal(np.zeros((len(self.observed), 0))).plus(np.ones(len(along_nuisance))).factorised()
        taken = nuisance.quadratic(along_nuisance)
        x_gram, errors_by_x = (np.block([[left.T @ right for right in x] for left in of]) for of in (x, errors))
        return x_gram - taken[:c, :c], errors_by_x - taken[c:, :c], error_gram - taken[c:, c:], nuisance.half_log_det

    def reduced(self, size: float, form_error: float) -> Reduced:
        """The same for one size each."""
        return self.reductions(np.array([size]), np.array([form_error]))[0, 0]


def _integrated_out(gram: Array, across: Array) -> tuple[Array, float]:
    """L^-1 across (r, c) and log det L, where L L^T = 1 + gram (r, r), which is overwritten. Of gram = X^T X and across = X^T Y,
    (1 + X X^T)^-1 takes (L^-1 across)^T (L^-1 across) off Y^T Y, and log det L is half log det (1 + X X^T)."""
    if not len(gram):
        return across, 0.0
    gram[np.diag_indices_from(gram)] += 1.0
    root = cholesky(gram)
    return np.asarray(solve_triangular(root, across, lower=True, check_finite=False)), float(np.log(np.diag(root)).sum())


@dataclass(frozen=True)
class Reduced:
    """log p(y | theta) = base + g.theta - theta.H.theta / 2, all else integrated out, of one problem or of several (...)."""

    information: Array
    """(..., p, p) H."""
    score: Array
    """(..., p) g."""
    base: Array
    """(...) log p(y | theta = 0)."""

    def __getitem__(self, at: tuple[int, ...]) -> Reduced:
        return Reduced(self.information[at], self.score[at], self.base[at])

    def update(self, prior: SizePrior) -> tuple[Array, Array, Array]:
        """log p(y) (...), mean (..., p) and root K (..., p, p) of the covariance K^T K of theta, under priors (..., p)."""
        root = np.sqrt(prior.variance)
        factor = cholesky(np.eye(root.shape[-1]) + root[..., :, None] * self.information * root[..., None, :])
        log_det = np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(axis=-1)
        # K = L^-1 R with the factor L, inverted in place, and R = diag(root)
        for of_one in factor.reshape(-1, *factor.shape[-2:]):
            dtrtri(of_one.T, overwrite_c=1)
        factor *= root[..., None, :]
        # slope of log p(y | theta) at the mean
        left = self.score - (prior.mean[..., None, :] @ self.information)[..., 0, :]
        pulled = (factor @ left[..., None])[..., 0]
        there = self.base + 0.5 * ((self.score + left) * prior.mean).sum(axis=-1)
        mean = prior.mean + (pulled[..., None, :] @ factor)[..., 0, :]
        return np.asarray(there - log_det + 0.5 * (pulled**2).sum(axis=-1)), mean, factor
