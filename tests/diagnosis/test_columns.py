"""Columns in two parts do what the whole matrix does."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.data.noise import Lasting, Noise
from diagnosis.inference.columns import Columns
from tests.diagnosis.toy import toy_problem

RNG = np.random.default_rng(3)
N, TRIALS = 60, 6
TRIAL = np.repeat(np.arange(TRIALS), N // TRIALS)


def matrix() -> np.ndarray:
    """Columns that all rows have, two of each trial, one of two trials together, and one of nothing, in no order."""
    one_hot = (TRIAL[:, None] == np.arange(TRIALS)).astype(float)
    two = (TRIAL[:, None] == 2).astype(float) + (TRIAL[:, None] == 3)
    parts = [np.ones((N, 3)), one_hot, one_hot, two * (np.arange(N) % 2)[:, None], np.zeros((N, 1))]
    whole = np.hstack(parts)
    return (RNG.normal(size=whole.shape) * whole)[:, RNG.permutation(whole.shape[1])]


def noise() -> Noise:
    """Values of two channels in one state, whose errors last within half a trial; of the last trial nothing does."""
    state, half = np.arange(N) // 2, np.arange(N) // (N // TRIALS // 2)
    block = np.where(TRIAL == TRIALS - 1, -1, RNG.permutation(half.max() + 1)[half])
    some = RNG.uniform(0.5, 2.0, (3, N))
    lasting = Lasting(block, 3.0 * state, np.arange(N) % 2, some[0], np.full(N, 0.4), np.full(N, 7.0))
    return Noise(state, some[1], some[2][:, None], lasting)


def test_products_are_those_of_the_whole() -> None:
    a, b, x = matrix(), matrix()[:, :9], RNG.normal(size=(N, 4))
    one, other = Columns.of(a), Columns.of(b)
    assert one.at.size and one.rest.size
    assert one.shape == a.shape and one.whole == pytest.approx(a)
    assert one.against(x) == pytest.approx(a.T @ x) and one.against(x[:, 0]) == pytest.approx(a.T @ x[:, 0])
    assert one.times(other) == pytest.approx(a.T @ b)
    step = RNG.normal(size=a.shape[1])
    assert one.along(step) == pytest.approx(a @ step)


def test_parts_are_those_of_the_whole() -> None:
    a, new = matrix(), matrix()[:, :5]
    chosen, seen, at = RNG.random(a.shape[1]) < 0.5, TRIAL != 2, np.array([11, 0, 3, 7, 15])
    assert Columns.of(a).take(chosen).whole == pytest.approx(a[:, chosen])
    assert Columns.of(a).rows(seen).whole == pytest.approx(a[seen])
    replaced = a.copy()
    replaced[:, at] = new
    assert Columns.of(a).replaced(at, Columns.of(new)).whole == pytest.approx(replaced)
    nothing = Columns.nothing(N, 20).replaced(at, Columns.of(new))
    assert nothing.whole[:, at] == pytest.approx(new) and np.count_nonzero(nothing.whole) == np.count_nonzero(new)


def test_whitened_by_parts_is_the_whole_whitened_and_what_is_zero_in_a_block_stays_so() -> None:
    a, errors = matrix(), noise()
    scale = RNG.uniform(0.5, 2.0, a.shape[1])
    white = Columns.of(a).whitened(errors, scale)
    assert white.whole == pytest.approx(errors.whiten(a * scale))
    assert np.count_nonzero(white.sparse.data) <= 2 * np.count_nonzero(a[:, white.rest])
    empty = Columns.of(np.ones((N, 2))).whitened(errors, np.ones(2))
    assert empty.whole == pytest.approx(errors.whiten(np.ones((N, 2))))


def test_huge_columns_that_are_nearly_the_same_are_reduced_all_the_same() -> None:
    problem = toy_problem(3, {})
    theta = problem.parameters.mean
    linear = problem.linear(theta, *problem.linearise(theta))
    column = np.random.default_rng(1).normal(size=(len(linear.observed), 1))
    near = 1e-3 * np.random.default_rng(2).normal(size=(len(column), 20))
    plain = replace(linear, nuisance=Columns.of(1e3 * (column + near)))
    huge = replace(linear, nuisance=Columns.of(1e9 * (column + 1e-9 * near)))
    for one in (plain, huge):
        found = one.reduced(0.0, 0.0)
        assert np.isfinite(found.base) and np.linalg.eigvalsh(found.information).min() > -1e-6 * found.information.max()
    # One direction is lost, whatever the size of what takes it.
    alone = replace(linear, nuisance=Columns.of(1e5 * column)).reduced(0.0, 0.0)
    assert huge.reduced(0.0, 0.0).misfit == pytest.approx(alone.misfit, rel=0.05)
