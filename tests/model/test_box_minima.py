"""The quadratic within bounds, against SciPy's bounded least squares."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from model.prediction.box_minima import box_minima

Array = NDArray[np.float64]


def minimum(curve: Array, score: Array, low: Array, high: Array) -> Array:
    return box_minima(curve[None], -score[None], low[None], high[None])[0]


def problem(seed: int, n: int) -> tuple[Array, Array, Array, Array]:
    """Curvature with columns of very different size, and bounds of which many are zero or hold."""
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(n + 20, n)) * 10 ** rng.uniform(-1, 2, n)
    curve = np.eye(n) + columns.T @ columns
    score = columns.T @ rng.normal(size=n + 20) * 30
    low = np.where(rng.random(n) < 0.4, 0.0, -rng.uniform(0.5, 3, n))
    return curve, score, low, rng.uniform(0.5, 3, n)


@pytest.mark.parametrize("seed", range(20))
def test_it_is_the_minimum_within_the_bounds(seed: int) -> None:
    curve, score, low, high = problem(seed, 60)
    root = np.linalg.cholesky(curve)
    known = lsq_linear(root.T, np.linalg.solve(root, score), (low, high), method="bvls", tol=1e-14).x
    assert ((known == low) | (known == high)).sum() > 10
    np.testing.assert_allclose(minimum(curve, score, low, high), known, atol=1e-7)


def test_what_is_held_too_early_comes_back() -> None:
    # Alone the second would run out of its bound; it comes back when the first is held.
    curve, score = np.array([[1.0, 0.9], [0.9, 1.0]]), np.array([4.0, 3.2])
    x = minimum(curve, score, np.array([-1.0, -0.1]), np.array([1.0, 9.0]))
    np.testing.assert_allclose(x, [1.0, 2.3])
