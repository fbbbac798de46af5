"""The search finds what is there and nothing where nothing is; its fits go along curved valleys."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from diagnosis import judgement
from diagnosis.data.noise import Lasting, Noise
from diagnosis.inference.discrepancy import SmoothErrors
from diagnosis.inference.evidence import NONE
from diagnosis.inference.executor import Executor
from diagnosis.inference.fit import fit
from diagnosis.inference.posterior import posterior
from diagnosis.inference.problem import Problem
from diagnosis.inference.search import MOST_UNKEPT, Search, recalibrated
from model.arrays import Array
from tests.diagnosis.toy import IDS, Grid, ToyForward, parameter, parameters, toy_problem


@pytest.mark.parametrize("effect", ["stiffer", "ballooning", "play", "turned", "bent"])
def test_a_single_effect_is_ranked_first_with_its_size(effect: str) -> None:
    found = Search(toy_problem(3, {effect: 0.8})).run()
    assert found[0].named == (effect,)
    assert found[0].fit.theta[IDS.index(effect)] == pytest.approx(0.8, abs=0.25)


@pytest.mark.parametrize(("acting", "rival"), [("play", "offset"), ("ballooning", "offset"), ("bent", "turned")])
def test_an_effect_far_behind_is_fitted_alone_to_its_end(acting: str, rival: str) -> None:
    search = Search(toy_problem(3, {acting: 0.8}, clutter=0.1))
    weighed = next(c for c in search.run() if c.named == (rival,))
    alone = search.alone(weighed)
    again = search.fit((rival,), False, alone.weighed.peak.size, alone.fit, 30)
    assert again.theta == pytest.approx(alone.fit.theta, abs=1e-3) and not again.theta[IDS.index(acting)]
    assert abs(alone.fit.theta[IDS.index(rival)]) > 2 * abs(weighed.fit.theta[IDS.index(rival)])


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("clutter", [0.0, 0.1])
def test_no_effect_is_ranked_first_where_there_is_none(seed: int, clutter: float) -> None:
    assert posterior(Search(toy_problem(seed, {}, clutter=clutter)).run(), len(IDS)).ranking[0][0] == NONE


def test_a_fit_stays_within_bounds() -> None:
    problem = toy_problem(1, {"turned": 1.5})
    problem.parameters.upper[IDS.index("turned")] = 0.7
    prior = problem.parameters.prior_of(("turned",))
    fitted = fit(problem, prior, 0.5, np.zeros_like(problem.parameters.sd))
    assert fitted.theta[IDS.index("turned")] == pytest.approx(0.7)


def test_progress_only_rises_to_the_end() -> None:
    told = list[tuple[str, float]]()
    search = Search(toy_problem(5, {"play": 1.0, "turned": -0.9}), Executor(lambda step, share: told.append((step, share))))
    assert set(search.run()[0].named) == {"play", "turned"}
    steps, shares = zip(*told, strict=True)
    assert list(steps) == sorted(steps) and steps[0] == "step 2 of 5: hypotheses"
    assert shares[0] > 0 and shares[-1] == 1.0 and list(shares) == sorted(shares)


@pytest.mark.parametrize("of_a_pair", [False, True])
def test_a_search_that_ended_elsewhere_is_begun_again_where_a_hypothesis_next_to_it_was_found(of_a_pair: bool) -> None:
    search = Search(toy_problem(3, {"play": 0.8}))
    search.run()
    single, pair = (("play",), False), ("play", "turned")
    known = search._tried[single]
    (around,) = search.around(known.fit, [pair], False)
    # A search that ended elsewhere.
    worse = replace(known, weighed=replace(known.weighed, log_evidence=known.weighed.log_evidence - 50.0))
    if of_a_pair:
        reached = (search._none[False], worse, search._turn(around))
        search._queue, search._tried = [], {(c.named, False): c for c in reached}
    else:
        found = search._searched_on(around)[0]
        search._tried[single], search._promised[single] = worse, worse.weighed.log_evidence
        search._add(search._next_to(found))
    search._search()
    assert search._tried[single].log_evidence == pytest.approx(known.log_evidence, abs=1.0)


def test_an_effect_is_weighed_at_its_own_starts_in_both_ways_where_none_is_as_probable_in_both() -> None:
    problem, play = toy_problem(3, {}), IDS.index("play")
    problem.parameters.lower[play] = 0.0  # one-sided
    search = Search(problem)
    assert abs(search._calibrated(True).log_evidence - search._calibrated(False).log_evidence) < judgement.SEARCH_MARGIN
    begun = [c.with_tolerances for c in search._first() if c.named == ("play",) and c.fit.theta[play]]
    assert set(begun) == {False, True}


def test_effects_are_added_one_by_one_without_tolerances_whatever_the_margin(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("diagnosis.judgement.SEARCH_MARGIN", -1e9)
    search = Search(toy_problem(5, {"play": 1.0, "turned": -0.9}))
    search.run()
    searched = {c.named for c in search.tried if c.turns and not c.with_tolerances}
    assert ("play", "turned") in searched and {len(named) for named in searched} == {0, 1, 2, 3}


def test_no_search_is_followed_where_no_linear_problem_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    search = Search(toy_problem(3, {"play": 0.8}))
    monkeypatch.setattr("diagnosis.inference.search.UNKEPT", -np.inf)
    search.run()
    assert sum(c.turns > 0 for c in search.tried) <= MOST_UNKEPT + judgement.SEARCHED_AT_ONCE + 2  # none, twice


class _Snapping(ToyForward):
    """States are lost where an effect goes beyond half its scale, and have no derivative a little before."""

    def linearise(self, theta: np.ndarray, columns: Sequence[int] | None = None) -> tuple[np.ndarray, np.ndarray]:
        predicted, slope = super().linearise(theta, columns)
        far = theta[IDS.index("bent")]
        return np.where(far > 0.5, np.nan, predicted), np.where(far > 0.45, np.nan, slope)


class _Wavering(_Snapping):
    """Whose trials do not see that states are lost."""

    def predict(self, theta: np.ndarray, trial: bool = False, whole: bool = False) -> np.ndarray:
        return ToyForward.linearise(self, theta)[0] if trial else super().predict(theta)


def test_a_step_that_turns_out_to_have_no_equilibrium_is_taken_back() -> None:
    problem = replace(toy_problem(4, {"bent": 1.0}), forward=_Wavering(Grid()))
    fitted = fit(problem, problem.parameters.prior_of(("bent",)), 0.0, np.zeros_like(problem.parameters.sd), 6)
    assert np.isfinite(fitted.predicted).all() and np.isfinite(fitted.cost)
    assert fitted.theta[IDS.index("bent")] <= 0.5


def test_a_step_that_no_trial_finds_is_given_up_at_the_first_state_without_equilibrium() -> None:
    asked = set()

    class Lost(ToyForward):
        def predict(self, theta: np.ndarray, trial: bool = False, whole: bool = False) -> np.ndarray:
            asked.add((trial, whole))
            return np.full_like(self.base, np.nan)

    problem = replace(toy_problem(4, {"bent": 1.0}), forward=Lost(Grid()))
    fit(problem, problem.parameters.prior_of(("bent",)), 0.0, np.zeros_like(problem.parameters.sd), 6)
    assert asked == {(True, False), (False, True)}


@pytest.mark.parametrize("halvings", [6, 1])
def test_a_start_without_equilibrium_is_left_for_one_nearer_to_the_baseline_or_for_that(
    halvings: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("diagnosis.inference.fit.HALVINGS", halvings)
    problem = replace(toy_problem(4, {"bent": 0.4}), forward=_Snapping(Grid()))
    prior = problem.parameters.prior_of(("bent",))
    fitted = fit(problem, prior, 0.0, np.where(np.array(problem.parameters.names) == "bent", 3.0, 0.0), 6)
    assert np.isfinite(fitted.predicted).all() and np.isfinite(fitted.derivatives(problem).every.whole).all()
    assert fitted.theta[IDS.index("bent")] == pytest.approx(0.4, abs=0.1)


def test_the_robot_is_calibrated_anew_at_a_start_far_from_the_data(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, effect = toy_problem(3, {"play": 0.8}), ("play",)
    problem.parameters.lower[IDS.index("play")] = 0.0  # a one-sided effect has a start of its own
    search = Search(problem)
    (around,) = search.around(search._none[False].fit, [effect], False)
    (start,) = search._at_starts(around)
    anew = list[np.ndarray]()
    where = "diagnosis.inference.search.recalibrated"
    monkeypatch.setattr(where, lambda problem, theta: (anew.append(theta), recalibrated(problem, theta))[1])
    for far in (False, True):
        monkeypatch.setattr("diagnosis.inference.search.far", lambda problem, predicted, none, far=far: far)
        assert search._searched_on(start)[0].fit.theta[IDS.index("play")] == pytest.approx(0.8, abs=0.25)
        assert bool(anew) == far


N = 60
SD = 0.01


class Valley(ToyForward):
    """A bend and a tilt that do nearly the same, the bend growing along the robot: y = tilt + bend (1 + growth s)."""

    def __init__(self) -> None:
        self._s = np.linspace(-1, 1, N)
        self.parameters = parameters(
            parameter("bend.size", "bend", low=-9.0, high=9.0),
            parameter("bend.growth", "bend", low=-3.0, high=3.0, role="shape"),
            parameter("tilt", low=-9.0, high=9.0),
        )

    def linearise(self, theta: Array, columns: Sequence[int] | None = None) -> tuple[Array, Array]:
        size, growth, tilt = theta
        along = 1 + 0.3 * growth * self._s + 0.05 * self._s**2
        slope = np.column_stack([along, 0.3 * size * self._s, np.ones(N)])
        return tilt + size * along, slope if columns is None else slope[:, list(columns)]


def test_a_few_rounds_go_along_a_curved_valley_to_its_end() -> None:
    forward = Valley()
    y = forward.predict(np.array([1.2, -0.7, -0.5])) + SD * np.random.default_rng(4).normal(size=N)
    noise = Noise(np.arange(N), np.full(N, SD), np.zeros((N, 1)), Lasting.none(N))
    errors = SmoothErrors(np.full((N, 1), np.sqrt(0.5)), np.zeros(N, int), 1, np.zeros(N))
    problem = Problem(forward, forward.parameters, y, noise, errors)
    p = problem.parameters

    def residual(theta: Array) -> Array:
        return np.concatenate([problem.noise.whiten(problem.observed - problem.forward.predict(theta)), theta])

    start = np.array([0.2, -2.9, 0.5])
    known = float(least_squares(residual, start).cost)
    found = fit(problem, p.prior_of(("bend",)), 0.0, start, 6)
    assert found.cost < known + 1.0
    assert found.predicted_decrease < 1.0
