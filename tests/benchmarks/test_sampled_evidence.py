"""What a sampler is given: where the world is linear and Gaussian, its integral is the diagnosis' evidence exactly."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import norm

from benchmarks.evidence import Hypothetical, hypothetical
from diagnosis.inference.problem import Problem
from diagnosis.judgement import LEAST_NAMED_SIZE
from model.effects.parameters import ParameterInfo
from tests.diagnosis.toy import toy_problem

POINTS = 90


def toy(truth: dict[str, float]) -> Problem:
    problem = toy_problem(5, truth, sd=3e-3)
    return changed(problem, lambda i: replace(i, group="calibration") if i.name == "area" else i)


def changed(problem: Problem, change: Callable[[ParameterInfo], ParameterInfo]) -> Problem:
    """The problem with other parameters."""
    infos = tuple(map(change, problem.parameters.infos))
    return replace(problem, parameters=replace(problem.parameters, infos=infos))


def integral(h: Hypothetical) -> float:
    """Log of the likelihood's mean over the unit square, by the midpoint rule."""
    at = (np.arange(POINTS) + 0.5) / POINTS
    values = [h.log_likelihood(h.prior(np.array([u, v]))) for u in at for v in at]
    return float(logsumexp(values)) - 2 * np.log(POINTS)


@pytest.mark.parametrize(
    ("truth", "named"),
    [
        pytest.param({"turned": 0.3}, "turned", marks=pytest.mark.long),
        ({}, "turned"),
        pytest.param({"bent": 0.5}, "bent", marks=pytest.mark.long),
    ],
)
def test_both_evidences_agree_in_a_linear_world(truth: dict[str, float], named: str) -> None:
    h = hypothetical(toy(truth), (named,), 0.1)
    assert len(h.sampled) == 2
    assert integral(h) == pytest.approx(h.laplace, abs=0.05)


def test_the_prior_leaves_small_sizes_out_and_keeps_within_bounds() -> None:
    problem = toy({})
    cut = changed(problem, lambda i: replace(i, low=-0.5) if i.name == "turned" else i)
    h = hypothetical(cut, ("turned",), 0.1)
    drawn = np.array([h.prior(np.array([u, 0.5]))[0] for u in np.linspace(0.001, 0.999, 999)])
    assert (np.abs(drawn) >= LEAST_NAMED_SIZE - 1e-9).all() and drawn.min() >= -0.5
    assert (np.diff(drawn) > 0).all()
    below, above = norm.cdf(-LEAST_NAMED_SIZE) - norm.cdf(-0.5), norm.sf(LEAST_NAMED_SIZE)
    assert (drawn < 0).mean() == pytest.approx(below / (below + above), abs=0.005)


def test_of_two_sizes_one_may_be_small() -> None:
    problem = toy({})
    joined = changed(problem, lambda i: replace(i, source="turned") if i.source == "bent" else i)
    h = hypothetical(joined, ("turned",), 0.1)
    rng = np.random.default_rng(1)
    drawn = np.array([h.prior(u)[:2] for u in rng.random((4000, 3))])
    small = np.abs(drawn) < LEAST_NAMED_SIZE
    assert not small.all(axis=1).any()
    inside = 1 - 2 * norm.sf(LEAST_NAMED_SIZE)
    assert small[:, 0].mean() == pytest.approx(inside * (1 - inside) / (1 - inside**2), abs=0.02)
    assert small[:, 1].mean() == pytest.approx(inside * (1 - inside) / (1 - inside**2), abs=0.02)
