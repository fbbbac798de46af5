"""Intervals of sizes that physics bounds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import truncnorm

from diagnosis.answer.size import cut_quantile


@pytest.mark.parametrize(
    ("mean", "low", "high"), [(0.3, -1.0, 2.0), (0.0, 5.0, np.inf), (0.0, -np.inf, -21.0), (4.0, 0.0, 0.5)]
)
def test_quantiles_of_a_cut_normal_keep_their_digits_however_far_out_the_bounds_are(
    mean: float, low: float, high: float
) -> None:
    cut = truncnorm((low - mean) / 0.7, (high - mean) / 0.7, mean, 0.7)
    for share in (0.05, 0.5, 0.95):
        assert cut_quantile(mean, 0.7, low, high, share) == pytest.approx(cut.ppf(share), rel=1e-9, abs=1e-12)
