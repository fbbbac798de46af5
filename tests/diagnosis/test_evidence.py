"""Evidence is the marginal likelihood, to rounding, wherever it can be computed another way; columns in two parts
do what the whole matrix does."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm, uniform

from diagnosis.data.noise import Lasting, Noise
from diagnosis.inference.evidence import Grid, weigh
from diagnosis.inference.fit import fit
from diagnosis.inference.jacobian import Columns
from diagnosis.inference.linear import Linear, SizePrior
from diagnosis.inference.problem import FitParameters
from diagnosis.judgement import LARGEST_TOLERATED_SIZE, LEAST_NAMED_SIZE
from model.prediction.box_minima import box_minima
from tests.diagnosis import toy
from tests.diagnosis.toy import toy_problem

WIDE = np.ones(3, bool)
RNG = np.random.default_rng(7)
NO_FORM = np.array([0.0])
ONE = Grid(np.array([0.1]), np.array([1.0]), np.array([1.0]), np.array([0.0]), np.array([1.0]), NO_FORM)


def small_problem() -> Linear:
    effects, nuisance, discrepancy = (RNG.normal(size=(12, k)) for k in (3, 2, 4))
    return Linear(RNG.normal(size=12), effects, Columns.of(nuisance), discrepancy, 1.7, np.zeros((12, 0)))


def parameters(p: int, lower: float = -np.inf) -> FitParameters:
    return toy.parameters(*(toy.parameter(f"e{i}", f"e{i}", low=lower) for i in range(p)))


def dense_log_evidence(linear: Linear, prior: SizePrior, size: float) -> float:
    a, n, d = linear.effects, linear.nuisance.whole, size * linear.discrepancy
    covariance = np.eye(len(a)) + (a * prior.variance) @ a.T + n @ n.T + d @ d.T
    return float(multivariate_normal(a @ prior.mean, covariance).logpdf(linear.observed)) - linear.log_noise


@pytest.mark.parametrize("size", [0.0, 0.5, 3.0])
@pytest.mark.parametrize("variance", [[0.0, 0.0, 0.0], [1.0, 0.01, 0.01], [1.0, 0.0, 4.0]])
@pytest.mark.parametrize("mean", [[0.0, 0.0, 0.0], [0.0, 0.3, -1.2]])
def test_log_evidence_equals_the_gaussian_marginal_likelihood(size: float, variance: list[float], mean: list[float]) -> None:
    linear, prior = small_problem(), SizePrior(np.array(mean), np.array(variance), WIDE)
    assert linear.reduced(size, 0.0).update(prior)[0] == pytest.approx(dense_log_evidence(linear, prior, size), abs=1e-9)


def test_what_a_law_gets_wrong_widens_the_marginal_likelihood_as_columns_of_noise_do() -> None:
    plain, columns = small_problem(), RNG.normal(size=(12, 2))
    wrong = replace(plain, form_error=columns)
    noisy = replace(plain, nuisance=Columns.of(np.hstack([plain.nuisance.whole, 0.3 * columns])))
    v = SizePrior(np.zeros(3), np.ones(3), WIDE)
    assert wrong.reduced(0.5, 0.3).update(v)[0] == pytest.approx(float(noisy.reduced(0.5, 0.0).update(v)[0]))


NAMED, TOLERATED = [(LEAST_NAMED_SIZE, 10.0)], [(-LARGEST_TOLERATED_SIZE, LARGEST_TOLERATED_SIZE)]


@pytest.mark.parametrize(
    ("hypothesis", "sd", "lower", "sides"),
    [
        (("e0",), 1.0, 0.0, NAMED),
        (("e0",), 1.0, -np.inf, [*NAMED, (-10.0, -LEAST_NAMED_SIZE)]),
        ((), 0.3, -np.inf, TOLERATED),
    ],
    ids=["named, one way", "named", "tolerated"],
)
def test_an_effect_is_weighed_with_the_prior_within_its_bounds_and_on_its_side_of_the_least_size_that_is_named(
    hypothesis: tuple[str, ...], sd: float, lower: float, sides: list[tuple[float, float]]
) -> None:
    a, y = RNG.normal(size=(8, 1)), RNG.normal(size=8)
    linear = Linear(y, a, Columns.nothing(8, 0), np.zeros((8, 0)), 0.0, np.zeros((8, 0)))

    def joint(theta: float) -> float:
        return float(norm.pdf(y - a[:, 0] * theta).prod() * norm.pdf(theta, scale=sd))

    prior = sum(norm.cdf(high / sd) - norm.cdf(low / sd) for low, high in sides)
    exact = np.log(sum(quad(joint, low, high)[0] for low, high in sides) / prior)
    grid = replace(ONE, spikes=np.array([0.1 if hypothesis else sd]))
    assert weigh(linear, grid, parameters(1, lower=lower), [hypothesis])[0].log_evidence == pytest.approx(exact, abs=1e-6)


def test_the_grid_is_averaged_and_its_shares_sum_to_one() -> None:
    linear = small_problem()
    grid = Grid(np.array([0.0, 0.02]), np.ones(2), np.array([0.3, 0.7]), np.array([0.0, 1.0]), np.array([0.5, 0.5]), NO_FORM)
    found = weigh(linear, grid, parameters(3), [()])[0]
    log_terms = [
        w * v * np.exp(dense_log_evidence(linear, SizePrior(np.zeros(3), np.full(3, k**2), WIDE), g))
        for k, w in zip(grid.spikes, grid.spike_weights, strict=True)
        for g, v in zip(grid.sizes, grid.size_weights, strict=True)
    ]
    assert found.log_evidence == pytest.approx(np.log(sum(log_terms)), abs=1e-9)
    assert found.log_evidence == pytest.approx(
        np.logaddexp(
            *(weigh(linear, grid.part(with_tolerances), parameters(3), [()])[0].log_evidence for with_tolerances in (False, True))
        )
    )


def test_what_is_averaged_over_the_grid_is_a_mixture_of_its_points() -> None:
    linear, p = small_problem(), parameters(3)
    grid = Grid(np.array([0.0, 0.2]), np.ones(2), np.array([0.3, 0.7]), np.array([0.0, 1.0]), np.array([0.5, 0.5]), NO_FORM)
    found = weigh(linear, grid, p, [("e1",)])[0]
    weight = np.exp(found.log_terms - found.log_evidence)
    rng, drawn = np.random.default_rng(5), []
    for i, spike in enumerate(grid.spikes):
        for j, size in enumerate(grid.sizes):
            _, mean, root = linear.reduced(float(size), 0.0).update(p.prior(p.mask(("e1",)), float(spike), 1.0))
            drawn.append(rng.multivariate_normal(mean, root.T @ root, int(round(4e5 * weight[i, j, 0])), method="eigh"))
    every = np.vstack(drawn)
    assert found.averaged_mean == pytest.approx(every.mean(axis=0), abs=5e-3)
    assert found.averaged_sd == pytest.approx(every.std(axis=0), abs=5e-3)


def test_posterior_mean_and_covariance_are_those_of_the_full_problem() -> None:
    linear, prior = small_problem(), SizePrior(np.array([0.0, 0.2, -0.1]), np.array([1.0, 0.04, 0.04]), WIDE)
    _, mean, root = linear.reduced(0.5, 0.0).update(prior)
    n, d = linear.nuisance.whole, 0.5 * linear.discrepancy
    noise = np.eye(12) + n @ n.T + d @ d.T
    exact = np.linalg.inv(linear.effects.T @ np.linalg.solve(noise, linear.effects) + np.diag(1 / prior.variance))
    assert root.T @ root == pytest.approx(exact, abs=1e-10)
    pulled = linear.effects.T @ np.linalg.solve(noise, linear.observed) + prior.mean / prior.variance
    assert mean == pytest.approx(exact @ pulled, abs=1e-10)


def test_what_acts_one_way_only_is_tolerated_like_a_size_evenly_spread_up_to_a_limit() -> None:
    free, up = parameters(3), parameters(3, lower=0.0)
    named = np.array([True, False, False])
    both, one = free.prior(named, 0.2, 1.0), up.prior(named, 0.2, 1.0)
    assert both.mean == pytest.approx(np.zeros(3)) and both.variance == pytest.approx([1.0, 0.04, 0.04])
    even = uniform(scale=np.sqrt(3) * 0.2)
    assert one.mean == pytest.approx([0.0, even.mean(), even.mean()])
    assert one.variance == pytest.approx([1.0, even.var(), even.var()])
    changes = replace(up, changes=True).prior(named, 0.2, 1.0)
    assert changes.mean == pytest.approx(np.zeros(3)) and changes.variance == pytest.approx(both.variance)


def test_how_a_tolerated_effect_looks_is_as_little_known_as_how_a_named_one_does() -> None:
    p = toy.parameters(*parameters(2).infos, toy.parameter("e2", "e2", role="shape"))
    with_tolerances, strict = (p.prior(np.zeros(3, bool), spike, 1.0) for spike in (0.2, 0.0))
    assert with_tolerances.variance == pytest.approx([0.04, 0.04, 1.0])
    # around a point where the effect is larger than it may be, a look can do no more than at the limit
    limit = np.sqrt(3) * 0.2
    around = p.prior(np.zeros(3, bool), 0.2, 1.0, effect_size=np.array([0.0, 0.0, 2 * limit]))
    assert around.variance == pytest.approx([0.04, 0.04, 0.25])
    assert strict.variance == pytest.approx(np.zeros(3))


DRAW = np.random.default_rng(3)
N, TRIALS = 60, 6
TRIAL = np.repeat(np.arange(TRIALS), N // TRIALS)


def matrix() -> np.ndarray:
    """Columns that all rows have, two of each trial, one of two trials together, and one of nothing, in no order."""
    one_hot = (TRIAL[:, None] == np.arange(TRIALS)).astype(float)
    two = (TRIAL[:, None] == 2).astype(float) + (TRIAL[:, None] == 3)
    whole = np.hstack([np.ones((N, 3)), one_hot, one_hot, two * (np.arange(N) % 2)[:, None], np.zeros((N, 1))])
    return (DRAW.normal(size=whole.shape) * whole)[:, DRAW.permutation(whole.shape[1])]


def noise() -> Noise:
    """Values of two channels in one state, whose errors last within half a trial; of the last trial nothing does."""
    state, half = np.arange(N) // 2, np.arange(N) // (N // TRIALS // 2)
    block = np.where(TRIAL == TRIALS - 1, -1, DRAW.permutation(half.max() + 1)[half])
    some = DRAW.uniform(0.5, 2.0, (3, N))
    lasting = Lasting(block, 3.0 * state, np.arange(N) % 2, some[0], np.full(N, 0.4), np.full(N, 7.0))
    return Noise(state, some[1], some[2][:, None], lasting)


def test_products_are_those_of_the_whole() -> None:
    a, x = matrix(), DRAW.normal(size=(N, 4))
    one = Columns.of(a)
    assert one.at.size and one.rest.size
    assert one.shape == a.shape and one.whole == pytest.approx(a)
    assert one.against(x) == pytest.approx(a.T @ x) and one.against(x[:, 0]) == pytest.approx(a.T @ x[:, 0])
    assert one.along(a.sum(axis=0)) == pytest.approx(a @ a.sum(axis=0))


def test_parts_are_those_of_the_whole() -> None:
    a, new = matrix(), matrix()[:, :5]
    chosen, seen, at = DRAW.random(a.shape[1]) < 0.5, TRIAL != 2, np.array([11, 0, 3, 7, 15])
    assert Columns.of(a).take(chosen).whole == pytest.approx(a[:, chosen])
    assert Columns.of(a).rows(seen).whole == pytest.approx(a[seen])
    neighbours = Columns.of(x := DRAW.normal(size=(N, 5))).take(np.arange(5) % 4 > 0)
    assert neighbours.whole == pytest.approx(x[:, 1:4]) and neighbours.whole.base is not None  # a view, not a copy
    replaced = a.copy()
    replaced[:, at] = new
    assert Columns.of(a).replaced(at, Columns.of(new)).whole == pytest.approx(replaced)
    nothing = Columns.nothing(N, 20).replaced(at, Columns.of(new))
    assert nothing.whole[:, at] == pytest.approx(new) and np.count_nonzero(nothing.whole) == np.count_nonzero(new)


def test_whitened_by_parts_is_the_whole_whitened_and_what_is_zero_in_a_block_stays_so() -> None:
    a, errors = matrix(), noise()
    scale = DRAW.uniform(0.5, 2.0, a.shape[1])
    white = Columns.of(a).whitened(errors, scale)
    assert white.whole == pytest.approx(errors.whiten(a * scale)) and white.coloured(errors, scale).whole == pytest.approx(a)
    assert np.count_nonzero(white.sparse.data) <= 2 * np.count_nonzero(a[:, white.rest])
    assert Columns.of(np.ones((N, 2))).whitened(errors, np.ones(2)).whole == pytest.approx(errors.whiten(np.ones((N, 2))))


def test_normal_equations_by_parts_are_solved_as_the_whole_ones_are() -> None:
    a, more = matrix(), DRAW.normal(size=(N, 2))
    x, columns = np.hstack([a, more]), Columns.of(a)
    c, some = x.shape[1], DRAW.normal(size=(a.shape[1] + 2, 3))
    scale = np.where(np.arange(c) == columns.at[0], 0.0, DRAW.uniform(0.5, 2.0, c))
    whole, arrow = np.diag(scale) @ x.T @ x @ np.diag(scale), columns.normal(more).scaled(scale)
    assert arrow.times(some[:, 0]) == pytest.approx(whole @ some[:, 0])
    diagonal = DRAW.uniform(0.5, 2.0, c)
    whole, factors = whole + np.diag(diagonal), arrow.plus(diagonal).factorised()
    kept = scale != 0
    inverse = np.where(np.outer(kept, kept), np.linalg.inv(whole), 0.0)
    assert factors.solve(some) == pytest.approx(inverse @ some)
    assert factors.quadratic(some) == pytest.approx(some.T @ inverse @ some)
    assert factors.half_log_det == pytest.approx(0.5 * np.linalg.slogdet(whole[np.ix_(kept, kept)])[1])
    sparse = np.isin(np.arange(c), columns.rest)
    low, high = np.full(c, -0.05), np.full(c, 0.02)
    low[~kept], slope = 0.0, np.where(kept, some[:, 0], 0.0)
    (best,) = box_minima(whole[None], slope[None], low[None], high[None])
    assert np.isin(best[kept], [-0.05, 0.02]).any() and ((best > low) & (best < high))[sparse].any()
    assert arrow.plus(diagonal).within(slope, low, high) == pytest.approx(best)


def test_derivatives_by_copies_are_kept_by_the_rows_that_take_them() -> None:
    slope = DRAW.normal(size=(2, N))
    copy = np.array([np.zeros(N, int), 1 + np.arange(N) // 3])
    copy[1, :6] = -1
    columns = Columns.of_copies(slope, copy, 1 + N // 3)
    whole = np.zeros((N, 2 + N // 3))
    whole[np.arange(N), copy] = slope
    assert columns.whole == pytest.approx(whole[:, :-1]) and columns.at.tolist() == [0]
    assert columns.sparse.nnz == N - 6
    assert columns.take(np.arange(columns.shape[1]) == 4).whole[:, 0] == pytest.approx(whole[:, 4])


def test_huge_columns_that_are_nearly_the_same_are_reduced_all_the_same() -> None:
    problem = toy_problem(3, {})
    theta = np.zeros_like(problem.parameters.sd)
    linear = replace(fit(problem, problem.parameters.prior_of(()), 0.0, theta, 0), slope=None).linear(problem)
    column = np.random.default_rng(1).normal(size=(len(linear.observed), 1))
    near = 1e-3 * np.random.default_rng(2).normal(size=(len(column), 20))
    plain = replace(linear, nuisance=Columns.of(1e3 * (column + near)))
    huge = replace(linear, nuisance=Columns.of(1e9 * (column + 1e-9 * near)))
    for one in (plain, huge):
        found = one.reduced(0.0, 0.0)
        assert np.isfinite(found.base) and np.linalg.eigvalsh(found.information).min() > -1e-6 * found.information.max()
    # One direction is lost, whatever the size of what takes it.
    alone = replace(linear, nuisance=Columns.of(1e5 * column)).reduced(0.0, 0.0)
    assert huge.reduced(0.0, 0.0).score == pytest.approx(alone.score, rel=0.05, abs=0.05 * np.abs(alone.score).max())
