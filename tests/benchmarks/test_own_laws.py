"""What the very laws of a world tell: the evidence, the draws and the shares."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from benchmarks.own_laws import ANALYSES, Case, Evidence, Judged, calibrated, figures

RNG = np.random.default_rng(3)
X, N, Y = RNG.normal(size=(12, 3)), RNG.normal(size=(12, 2)), 2 * RNG.normal(size=12)
EVIDENCE = Evidence(Y, N, X)


def density(variance: np.ndarray) -> float:
    covariance = np.eye(12) + N @ N.T + (X * variance) @ X.T
    return float(multivariate_normal(np.zeros(12), covariance).logpdf(Y))


@pytest.mark.parametrize("variance", [(1.0, 0.0, 0.0), (0.3, 2.0, 0.0), (1.0, 1.0, 4.0)])
def test_log_evidence_is_that_of_the_normal_density(variance: tuple[float, ...]) -> None:
    v, none = np.array(variance), np.zeros(3)
    assert EVIDENCE.log(v) - EVIDENCE.log(none) == pytest.approx(density(v) - density(none))


def test_draws_have_the_posterior_s_mean_and_covariance() -> None:
    v = np.array([0.5, 0.0, 2.0])
    drawn = EVIDENCE.draws(v, np.random.default_rng(4).normal(size=(200_000, 3)))
    noise = np.linalg.inv(np.eye(12) + N @ N.T)
    kept = X[:, [0, 2]]
    covariance = np.linalg.inv(np.diag(1 / v[[0, 2]]) + kept.T @ noise @ kept)
    assert drawn[:, 1] == pytest.approx(0.0)
    assert drawn[:, [0, 2]].mean(axis=0) == pytest.approx(covariance @ kept.T @ noise @ Y, abs=0.01)
    assert np.cov(drawn[:, [0, 2]].T) == pytest.approx(covariance, abs=0.01)


def test_what_an_area_factor_takes_up_is_not_carried() -> None:
    area = RNG.normal(size=(2, 3, 6))
    other = np.zeros((2, 3, 6))
    other[..., 1] = 1e-3
    area[..., 1] = 0.0
    assert calibrated([area], area) == pytest.approx(np.zeros((1, 1)), abs=1e-9)
    assert calibrated([other + area], area) == pytest.approx(np.ones((1, 1)))


def test_shares_are_of_those_that_they_say() -> None:
    def case(stratum: str, named: tuple[str, ...], p: float, odds: float, leaves: float = 0.0, causes: str = "") -> Case:
        answers = dict.fromkeys(ANALYSES, Judged(named[:1], p, odds, named))
        return Case(stratum, frozenset(causes.split()), {"contact": 5.0, "base_tilt": 1.0}, 1.0, leaves, answers)

    cases = [
        case("clean", ("contact",), 0.95, -5.0), case("cluttered", ("base_tilt",), 0.95, 1.0),
        case("pairs", ("contact", "base_tilt"), 0.5, -1.0, causes="contact base_tilt"),
        case("cluttered_pairs", ("contact",), 0.5, -1.0, causes="contact base_tilt"),
        case("outside", (), 0.5, 0.5, leaves=1.0), case("cluttered_outside", (), 0.5, 2.0, leaves=3.0),
    ]  # fmt: skip
    (found, *_) = figures(cases).values()
    assert [value.split(" (")[0] for value in found.values()] == [
        "1 of 1", "0 of 1", "1 of 2", "1 of 1", "0 of 1", "1 of 2", "1 of 2", "2 of 2", "1 of 1", "1 of 1",
    ]  # fmt: skip
