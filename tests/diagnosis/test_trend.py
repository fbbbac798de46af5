"""A trend over time is found exactly as often by chance as it says."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from diagnosis.criticism.trend import _kendall_s, _kendall_s_distribution


@pytest.mark.parametrize("n", [2, 3, 4, 5])
def test_the_distribution_of_a_score_is_that_of_all_orders(n: int) -> None:
    counted = np.zeros(n * (n - 1) + 1)
    for order in itertools.permutations(range(n)):
        counted[_kendall_s(np.array(order, float)) + n * (n - 1) // 2] += 1
    assert _kendall_s_distribution(n) == pytest.approx(counted / counted.sum())
