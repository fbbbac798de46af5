"""Normal equations in arrow form: a few shared parameters, and many that each belong to a single trial.

With A = [S L], S (n, s) the dense columns of shared parameters and L (n, l) the sparse ones of single trials or repeats,

    A^T A = [[S^T S, S^T L], [L^T S, L^T L]],

where L^T L is nearly block diagonal. It is factorised as a sparse matrix, and the Schur complement of the shared parameters,
S^T S - S^T L (L^T L)^-1 L^T S, as a dense one. Work and memory grow with the trials, not with their square or cube.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import cho_solve, solve_triangular
from scipy.sparse import csc_array, dia_array
from scipy.sparse.linalg import splu

from model.prediction.box_minima import projected

from ..arrays import Array, Ints, Mask

ROUNDING = (0.0, 1e-14, 1e-12, 1e-10, 1e-8)
"""Relative increases of the diagonal that are tried until a matrix can be factorised."""


@dataclass(frozen=True, eq=False)
class Arrow:
    """A symmetric matrix (c, c)."""

    at: Ints
    """(s,) which rows and columns are shared."""
    shared: Array
    """(s, s)"""
    rest: Ints
    """(l,) which are sparse."""
    across: Array
    """(l, s)"""
    local: csc_array
    """(l, l)"""

    def scaled(self, scale: Array) -> Arrow:
        """diag(scale) A diag(scale) with scale (c,); shared ones of scale 0 are left out."""
        kept = scale[self.at] != 0
        of_at, of_rest = scale[self.at[kept]], scale[self.rest]
        local = self.local.copy()
        local.data = local.data * of_rest[local.indices] * of_rest[self._column]
        shared = self.shared[np.ix_(kept, kept)] * np.outer(of_at, of_at)
        return Arrow(self.at[kept], shared, self.rest, self.across[:, kept] * of_rest[:, None] * of_at, local)

    def plus(self, diagonal: Array) -> Arrow:
        """A + diag(diagonal) with diagonal (c,)."""
        shared = self.shared.copy()
        shared[np.diag_indices(self.at.size)] += diagonal[self.at]
        return replace(self, shared=shared, local=_with_more(self.local, diagonal[self.rest]))

    @cached_property
    def _column(self) -> Ints:
        """The column of each number of the sparse block."""
        return np.repeat(np.arange(self.rest.size), np.diff(self.local.indptr))

    def times(self, x: Array) -> Array:
        """(c,) the product with x (c,); 0 for parameters left out."""
        out, shared, local = np.zeros_like(x), x[self.at], x[self.rest]
        out[self.at] = self.shared @ shared + self.across.T @ local
        out[self.rest] = self.across @ shared + self.local @ local
        return out

    def within(self, slope: Array, low: Array, high: Array) -> Array:
        """The x (c,) within low .. high that minimises x.A.x / 2 + slope.x."""
        product, solved = (lambda x: self.times(x[0])[None]), (lambda free, x: self.factorised(free[0]).solve(x[0])[None])
        return projected(product, solved, slope[None], low[None], high[None])[0]

    @cached_property
    def sparse_factors(self) -> Any:
        """L and U of the sparse block, which is positive definite; the diagonal raised as in `cholesky`."""
        for share in ROUNDING:
            raised = _with_more(self.local, share * self.local.diagonal()) if share else self.local
            with suppress(RuntimeError):  # exactly singular
                found = splu(raised, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
                if (found.U.diagonal() > 0).all():
                    return found
        raise np.linalg.LinAlgError("a matrix that must be positive definite is not")

    def solved(self, values: Array) -> Array:
        """The sparse block's inverse times values (l, ..)."""
        return np.asarray(self.sparse_factors.solve(values)) if self.rest.size else values

    @cached_property
    def eliminated(self) -> tuple[Array, Array]:
        """(l, s) the sparse block's inverse times what is across, and (s, s) the Schur complement, whatever is free of it."""
        pulled = self.solved(self.across)
        return pulled, self.shared - self.across.T @ pulled

    def factorised(self, free: Mask | None = None) -> Factors:
        """Factorise the free part (c,), where the rest is 0."""
        of_at, of_rest = (np.ones(i.size, bool) if free is None else free[i] for i in (self.at, self.rest))
        if of_rest.all():
            return Factors(self, of_at)
        local, kept = self.local.copy(), of_rest[self.local.indices] & of_rest[self._column]
        local.data = np.where(kept, local.data, local.indices == self._column)  # fixed parameters have a diagonal of 1
        return Factors(replace(self, across=self.across * of_rest[:, None], local=local), of_at)


class Factors:
    """A positive definite arrow, factorised."""

    def __init__(self, arrow: Arrow, kept: Mask) -> None:
        """`kept` (s,) which of the shared ones are solved for."""
        pulled, schur = arrow.eliminated
        self._a, self._at = arrow, arrow.at[kept]
        self._across, self._pulled = arrow.across[:, kept], pulled[:, kept]
        self.root = cholesky(schur[np.ix_(kept, kept)])
        """(s, s) lower Cholesky factor of the Schur complement, in the order of `Arrow.at`."""

    def solve(self, values: Array) -> Array:
        """(c, ..) A^-1 times values (c, ..), which are 0 for parameters left out."""
        at, rest, out = self._at, self._a.rest, np.zeros_like(values)
        first = self._a.solved(values[rest])
        out[at] = shared = cho_solve((self.root, True), values[at] - self._across.T @ first, check_finite=False)
        out[rest] = first - self._pulled @ shared
        return out

    @property
    def half_log_det(self) -> float:
        """Half the logarithm of the determinant."""
        of_local = self._a.sparse_factors.U.diagonal() if self._a.rest.size else np.ones(0)
        return 0.5 * float(np.log(of_local).sum()) + float(np.log(np.diag(self.root)).sum())

    def quadratic(self, values: Array) -> Array:
        """(m, m) V^T A^-1 V of values (c, m)."""
        local = values[self._a.rest]
        first = self._a.solved(local)
        half = solve_triangular(self.root, values[self._at] - self._across.T @ first, lower=True, check_finite=False)
        return np.asarray(local.T @ first + half.T @ half)


def cholesky(matrix: Array) -> Array:
    """Lower Cholesky factors (..., n, n); the diagonal is raised by the smallest sufficient share in `ROUNDING`."""
    for share in ROUNDING:
        with suppress(np.linalg.LinAlgError):
            return np.asarray(np.linalg.cholesky(matrix * (1 + share * np.eye(matrix.shape[-1])) if share else matrix))
    raise np.linalg.LinAlgError("a matrix that must be positive definite is not")


def _with_more(matrix: csc_array, diagonal: Array) -> csc_array:
    """A sparse matrix (l, l) plus diag(diagonal)."""
    return csc_array(matrix + dia_array((diagonal[None], [0]), shape=matrix.shape))
