"""The linear problem keeps its answers where columns are huge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.inference.columns import Columns
from tests.diagnosis.toy import toy_problem


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
