"""95 % intervals of what a bench finds: exact for shares, by bootstrap for everything else."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta

Array = NDArray[np.float64]
RESAMPLES = 2000


@dataclass(frozen=True)
class Interval:
    """A value with its 95 % interval, from n cases; NaN from none."""

    value: float
    low: float
    high: float
    n: int


def share(right: Array) -> Interval:
    """Share of trues with its Clopper-Pearson interval (Biometrika 26, 1934)."""
    n, k = len(right), int(np.sum(right))
    if n == 0:
        return Interval(np.nan, np.nan, np.nan, 0)
    return Interval(k / n, *clopper_pearson(k, n), n)


def counted(right: Sequence[bool] | Array, nothing: str = "none") -> str:
    """How many of how many are true, with the interval of their share, in words; `nothing` where there are none at all."""
    found = share(np.array(right, float))
    return f"{int(np.sum(right))} of {found.n} ({found.low:.2f} .. {found.high:.2f})" if found.n else nothing


def clopper_pearson(hits: int, n: int) -> tuple[float, float]:
    """95 % interval of a share."""
    low = float(beta.ppf(0.025, hits, n - hits + 1)) if hits else 0.0
    return low, float(beta.ppf(0.975, hits + 1, n - hits)) if hits < n else 1.0


def bootstrap(values: Array, statistic: Callable[[Array], float], seed: int = 0) -> Interval:
    """A statistic of the cases (first axis) with its percentile interval."""
    n = len(values)
    if n == 0:
        return Interval(np.nan, np.nan, np.nan, 0)
    rng = np.random.default_rng(seed)
    drawn = [statistic(values[rng.integers(n, size=n)]) for _ in range(RESAMPLES)]
    low, high = np.percentile(drawn, [2.5, 97.5])
    return Interval(float(statistic(values)), float(low), float(high), n)
