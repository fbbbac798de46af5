"""The Jacobian: derivatives of the measured values by the parameters, most of them shared by many searches.

Most searches recompute only the derivatives by the effects they name; all others are those of one point, the base. The base is
stored and sent to another process once; a fit keeps what it recomputed. Derivatives are made by `ForwardModel.slopes`
(model/effects/forward.py), asked by `Problem.jacobian` and `fit`, and kept as they are used: whitened.

Many columns are zero in most rows: a parameter of one trial (its spine, its mounting) moves the values of that trial alone. More
trials mean more such columns, each with as few numbers as before; stored densely they would grow with the square of the trials.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_array, csr_array, hstack

from ..arrays import Array, Ints, Mask
from ..data.noise import Noise
from .arrow import Arrow

FEW = 1 / 16
"""Largest share of the rows for which a parameter with copies elsewhere is stored by its rows."""


@dataclass(frozen=True, eq=False)
class Columns:
    """A matrix A (n, c), in two parts."""

    dense: Array
    """(n, d)"""
    at: Ints
    """(d,) which of the c columns they are."""
    sparse: csr_array
    """(n, s)"""
    rest: Ints
    """(s,) which of the c columns they are."""

    @classmethod
    def of(cls, whole: Array) -> Columns:
        """From a matrix (n, c)."""
        # a column with more zeros is kept by its other numbers
        few = np.count_nonzero(whole, axis=0) < 0.25 * len(whole)
        at, rest = np.flatnonzero(~few), np.flatnonzero(few)
        return cls(np.ascontiguousarray(whole[:, at]), at, csr_array(whole[:, rest]), rest)

    @classmethod
    def of_copies(cls, slope: Array, column: Ints, count: int) -> Columns:
        """From slopes (s, n), each of the column (s, n) that its row takes, -1 for none, of `count` columns."""
        single = (column == column[:, :1]).all(axis=1) & (column >= 0).any(axis=1)  # slots that have one column in all rows
        one, shared, slope, column = column[single, :1].ravel(), slope[single], slope[~single], column[~single]
        few = np.bincount(column[column >= 0], minlength=count) < FEW * slope.shape[1]
        few[one] = False
        at, rest, place = np.setdiff1d(np.flatnonzero(~few), one), np.flatnonzero(few), np.empty(count, np.int64)
        place[at], place[rest] = np.arange(at.size), np.arange(rest.size)
        of_few, dense = few[column] & (column >= 0), np.zeros((slope.shape[1], one.size + at.size))
        dense[:, : one.size] = shared.T
        slot, row = np.nonzero(~of_few & (column >= 0))
        dense[row, one.size + place[column[slot, row]]] = slope[slot, row]
        slot, row = np.nonzero(of_few & (slope != 0))
        sparse = csr_array((slope[slot, row], (row, place[column[slot, row]])), shape=(slope.shape[1], rest.size))
        return cls(dense, np.concatenate([one, at]), sparse, rest)

    @classmethod
    def nothing(cls, rows: int, count: int) -> Columns:
        """Zeros (rows, count)."""
        return cls(np.zeros((rows, 0)), np.zeros(0, np.int64), csr_array((rows, count)), np.arange(count))

    @property
    def shape(self) -> tuple[int, int]:
        """(n, c)."""
        return len(self.dense), self.at.size + self.rest.size

    @property
    def whole(self) -> Array:
        """(n, c); not to be changed."""
        if not self.rest.size and (np.diff(self.at) > 0).all():
            return self.dense
        out = np.empty(self.shape)
        out[:, self.at], out[:, self.rest] = self.dense, self.sparse.toarray()
        return out

    def along(self, step: Array) -> Array:
        """(n,) A x of a step x (c,)."""
        return np.asarray(self.dense @ step[self.at] + self.sparse @ step[self.rest])

    def against(self, values: Array) -> Array:
        """(c,) or (c, m) A^T x of values x (n,) or (n, m)."""
        out = np.empty((self.shape[1], *values.shape[1:]))
        out[self.at], out[self.rest] = self.dense.T @ values, self.sparse.T @ values
        return out

    def normal(self, more: Array, gram: Array | None = None) -> Arrow:
        """(c + m, c + m) [A M]^T [A M] with more columns M (n, m) behind them; `gram` (m, m) M^T M where it is known."""
        at, sparse = np.concatenate([self.at, self.shape[1] + np.arange(more.shape[1])]), self.sparse.T
        beside = more.T @ self.dense
        shared = np.block([[self.dense.T @ self.dense, beside.T], [beside, more.T @ more if gram is None else gram]])
        across = np.hstack([sparse @ self.dense, sparse @ more])
        return Arrow(at, shared, self.rest, across, csc_array(sparse @ self.sparse))

    def take(self, chosen: Mask) -> Columns:
        """Those of the columns that are chosen (c,); neighbours are not copied."""
        place = np.cumsum(chosen) - 1
        dense, sparse = np.flatnonzero(chosen[self.at]), chosen[self.rest]
        run = slice(dense[0], dense[-1] + 1) if dense.size and (np.diff(dense) == 1).all() else dense
        kept = self.sparse[:, np.flatnonzero(sparse)]
        return Columns(self.dense[:, run], place[self.at[dense]], kept, place[self.rest[sparse]])

    def rows(self, chosen: Mask | Ints) -> Columns:
        """Some of the rows, marked (n,) or by their indices (r,)."""
        if chosen.dtype == bool and chosen.all():
            return self
        return Columns(self.dense[chosen], self.at, self.sparse[np.arange(len(self.dense))[chosen]], self.rest)

    def replaced(self, at: Ints, by: Columns) -> Columns:
        """The same with columns `at` (b,) replaced by others (n, b)."""
        kept = np.ones(self.shape[1], bool)
        kept[at] = False
        dense, sparse = kept[self.at], kept[self.rest]
        return Columns(
            np.hstack([self.dense[:, dense], by.dense]), np.concatenate([self.at[dense], at[by.at]]),
            csr_array(hstack([self.sparse[:, np.flatnonzero(sparse)], by.sparse], format="csr")),
            np.concatenate([self.rest[sparse], at[by.rest]]),
        )  # fmt: skip

    def whitened(self, noise: Noise, scale: Array) -> Columns:
        """The same times `scale` (c,), as they would look with independent noise of standard deviation 1."""
        dense = self.dense * scale[self.at]
        sparse = _by_block(self.sparse, noise.block, noise.whiten) * scale[self.rest]
        return Columns(noise.whiten(dense, into=dense), self.at, csr_array(sparse), self.rest)

    def coloured(self, noise: Noise, scale: Array) -> Columns:
        """The inverse of `whitened`."""
        sparse = _by_block(self.sparse, noise.block, noise.colour) / scale[self.rest]
        return Columns(noise.colour(self.dense) / scale[self.at], self.at, csr_array(sparse), self.rest)


@dataclass(frozen=True, eq=False)
class Jacobian:
    """Derivatives (n, k) of the values, whitened by the noise, by one prior standard deviation of each parameter: columns of its
    own, all others those of its base, or zeros where it has none."""

    parameters: int
    """k."""
    at: Ints
    """(c,) which parameters its own columns are of."""
    own: Columns
    """(n, c)"""
    base: Jacobian | None = None
    tolerated: Array | None = None
    """Of a base: columns (n, f) of the model-form error of what is tolerated at its point, where they are known."""
    left: str | None = None
    """Name of the base that it has where it came from, see `candidate.light`."""

    @classmethod
    def of(cls, slope: Columns) -> Jacobian:
        """Of derivatives (n, k), all its own."""
        return cls(slope.shape[1], np.arange(slope.shape[1]), slope)

    @property
    def flat(self) -> Jacobian:
        """The same as a base for others: all columns its own."""
        return self if self.at.size == self.parameters else Jacobian.of(self.every)

    @property
    def shared(self) -> Jacobian:
        """With this as the base, and nothing recomputed."""
        return Jacobian(self.parameters, np.zeros(0, np.int64), Columns.nothing(self.own.shape[0], 0), self)

    @property
    def every(self) -> Columns:
        """(n, k) W."""
        if self.at.size == self.parameters:
            return self.own
        known = Columns.nothing(self.own.shape[0], self.parameters) if self.base is None else self.base.own
        return known.replaced(self.at, self.own) if self.at.size else known


def _by_block(columns: csr_array, block_of: Ints, change: Callable[[Array], Array]) -> csr_array:
    """Columns (n, c), changed by a matrix that mixes rows of one block (n,) alone. A column that is zero throughout a block stays
    zero there, so only pairs of a block and a non-zero column are changed, block by block in few dense columns (`packed`)."""
    if not columns.nnz:
        return columns
    n, count = columns.shape
    row = np.repeat(np.arange(n), np.diff(columns.indptr))
    pair, pair_of = np.unique(block_of[row] * count + columns.indices, return_inverse=True)
    block, column = np.divmod(pair, count)
    place = np.arange(len(pair)) - np.searchsorted(block, block)
    width = int(place.max()) + 1
    packed, column_at = np.zeros((n, width)), np.zeros((int(block_of.max()) + 1, width), np.int64)
    packed[row, place[pair_of]], column_at[block, place] = columns.data, column
    changed = change(packed)
    return csr_array((changed.ravel(), column_at[block_of].ravel(), np.arange(0, n * width + 1, width)), shape=columns.shape)
