"""A trend over time is found exactly as often by chance as it says."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from diagnosis.trend import CERTAIN, OF_TIME, _chance, _density, _score, log_odds


@pytest.mark.parametrize("n", [2, 3, 4, 5])
def test_the_distribution_of_a_score_is_that_of_all_orders(n: int) -> None:
    counted = np.zeros(n * (n - 1) + 1)
    for order in itertools.permutations(range(n)):
        counted[_score(np.array(order, float)) + n * (n - 1) // 2] += 1
    assert _chance(n) == pytest.approx(counted / counted.sum())


def test_repeats_that_all_rise_in_time_speak_for_a_cause_outside_the_catalogue() -> None:
    seven_lengths_three_repeats = 2 * (1 / 6) ** 7
    assert log_odds(seven_lengths_three_repeats) > 7.0


def test_repeats_in_any_order_speak_neither_for_nor_against_it() -> None:
    assert log_odds(1.0) == 0.0
    assert log_odds(0.3) < 0.1


def test_what_a_trend_adds_is_a_density_over_probabilities() -> None:
    p = np.logspace(np.log10(CERTAIN), 0, 20001)
    density = np.array([_density(x) for x in p])
    assert np.trapezoid(density, p) == pytest.approx(1.0, abs=1e-3)
    assert 0 < OF_TIME < 1
