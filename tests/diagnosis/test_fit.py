"""The search for a most probable point where a size and how it looks multiply each other: a narrow curved valley."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from diagnosis.data.noise import Noise
from diagnosis.inference.fit import fit
from diagnosis.inference.problem import Problem
from tests.diagnosis.toy import parameter, parameters

Array = NDArray[np.float64]

N = 60
SD = 0.01


class Valley:
    """A bend and a tilt that do nearly the same, the bend growing along the robot: y = tilt + bend (1 + growth s)."""

    def __init__(self) -> None:
        self._s = np.linspace(-1, 1, N)
        self.parameters = parameters(
            parameter("bend.size", "bend", low=-9.0, high=9.0),
            parameter("bend.growth", "bend", low=-3.0, high=3.0, role="shape"),
            parameter("tilt", low=-9.0, high=9.0),
        )

    def near(self, theta: Array) -> "Valley":
        return self

    def predict(self, theta: Array, trial: bool = False, whole: bool = False) -> Array:
        return self.linearise(theta)[0]

    def linearise(self, theta: Array, columns: Sequence[int] | None = None) -> tuple[Array, Array]:
        size, growth, tilt = theta
        along = 1 + 0.3 * growth * self._s + 0.05 * self._s**2
        slope = np.column_stack([along, 0.3 * size * self._s, np.ones(N)])
        return tilt + size * along, slope if columns is None else slope[:, list(columns)]


def valley(truth: Array) -> Problem:
    forward = Valley()
    y = forward.predict(truth) + SD * np.random.default_rng(4).normal(size=N)
    noise = Noise(np.arange(N), np.full(N, SD), np.zeros((N, 1)))
    return Problem(forward, forward.parameters, y, noise, np.zeros((N, 0)), np.ones((N, 1)), np.zeros((N, 0)))


def test_a_few_rounds_go_along_a_curved_valley_to_its_end() -> None:
    problem = valley(np.array([1.2, -0.7, -0.5]))
    p = problem.parameters

    def residual(theta: Array) -> Array:
        return np.concatenate([problem.noise.whiten(problem.observed - problem.forward.predict(theta)), theta])

    start = np.array([0.2, -2.9, 0.5])
    known = float(least_squares(residual, start).cost)
    found = fit(problem, p.prior(p.mask(("bend",)), 0.0), 0.0, start, 6)
    assert found.cost < known + 1.0
    assert found.predicted_decrease < 1.0
