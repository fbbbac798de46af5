"""What is named for what it carries."""

import numpy as np
import pytest

from diagnosis.answer.result import Diagnosis
from diagnosis.data.case import states
from diagnosis.diagnose import diagnose
from diagnosis.inference import budget as module
from diagnosis.inference.budget import Budget
from diagnosis.inference.fit import Fit
from diagnosis.inference.posterior import EffectPosterior
from diagnosis.inference.prepare import parts, prepare
from diagnosis.judgement import LEAST_NAMED_SIZE
from model.arrays import Mask
from model.effects import CATALOGUE
from tests.diagnosis.small_campaigns import FEW, Catalogue, few_and_all, measured, quick
from tests.diagnosis.test_case import ROBOT

EFFECTS = ("a", "b", "c")
THRUST = {"chamber_thrust": CATALOGUE["chamber_thrust"]}

NONE, TOLERANT = 0.0, 0.3
"""Sizes of the second effect, in plausible scales: of what carries nothing by a tolerance, and as large as tolerances are."""


def names(of_draws: tuple[str, ...]) -> Mask:
    return np.array([[e in each for e in EFFECTS] for each in of_draws])


@pytest.mark.parametrize(
    ("floors", "second", "hypothesis", "expected"),
    [
        ((0.9, 0.3, 0.1), NONE, ("a",), ()),  # nothing carries a noise floor
        ((1.9, 0.3, 0.1), NONE, ("b",), ()),  # what carries most is a tolerance, and less than two floors
        ((1.9, 0.3, 0.1), NONE, ("a",), ("a",)),
        ((2.1, 0.3, 0.1), NONE, ("a",), ("a",)),
        ((5.0, 1.6, 0.1), NONE, ("a", "b"), ("a",)),  # less than 0.4 of the largest carrier
        ((5.0, 3.0, 0.1), NONE, ("a", "b"), ("a", "b")),
        ((5.0, 3.0, 0.1), NONE, ("a",), ("a",)),  # a tolerance beside the largest carrier is none
        ((1.5, 4.0, 0.1), NONE, (), ("b",)),  # the largest carrier is named though no hypothesis names it
        ((2.4, 4.0, 0.1), NONE, ("a",), ("a", "b")),
        ((5.0, 4.0, 2.4), 0.4, ("a",), ("a", "b")),  # what is taken for a tolerance carries as much
        ((5.0, 4.0, 2.4), TOLERANT, ("a",), ("a",)),  # it is no larger than tolerances are
        ((5.0, 4.0, 2.4), TOLERANT, ("a", "b"), ("a", "b")),
        ((3.0, 1.9, 0.0), 0.4, ("a",), ("a",)),
        ((1.4, 1.9, 0.0), 0.4, ("a",), ()),  # the largest is no cause
    ],
)
def test_what_carries_a_good_part_of_the_largest_and_a_floor_is_named(
    floors: tuple[float, ...], second: float, hypothesis: tuple[str, ...], expected: tuple[str, ...]
) -> None:
    size = np.array([1.0, second, 0.1]) * (second > 0)
    (which,) = module._names(np.array([floors]), size[None] >= LEAST_NAMED_SIZE, np.isin(EFFECTS, hypothesis), module.USUAL)
    assert tuple(np.array(EFFECTS)[which]) == expected


@pytest.mark.parametrize(
    ("named", "weight", "expected"),
    [
        (("ab", "ac", "a"), (0.5, 0.4, 0.1), {"b": 0.5, "c": 0.4}),  # one of them acts, these data do not tell which
        (("ab", "ac", "a"), (0.3, 0.3, 0.4), {}),  # perhaps none does
        (("ab", "ac", "b"), (0.4, 0.05, 0.55), {"b": 0.4 / 0.45, "c": 0.05 / 0.45}),  # of the draws that name the answer
    ],
)
def test_where_one_of_several_acts_with_the_answer_all_are_told(
    named: tuple[str, ...], weight: tuple[float, ...], expected: dict[str, float]
) -> None:
    b = Budget(EFFECTS, *(np.zeros((3, 3)),) * 2, np.array(weight), np.zeros(3), np.zeros(3, bool), {}, names(named))
    assert b.second(("a",)) == pytest.approx(expected)


def test_quantiles_are_weighted() -> None:
    metres, named = np.array([[1.0], [100.0], [1e4]]), np.zeros((3, 1), bool)
    b = Budget(("a",), metres, metres, np.array([0.1, 0.1, 0.8]), np.zeros(3), np.zeros(3, bool), {"a": 1.0}, named)
    assert b.interval("a", 0.05, 0.15, 0.6) == pytest.approx((1.0, 100.0, 1e4))


@pytest.mark.parametrize(
    ("form_error", "of_law", "tolerant", "share"),
    [(0.03, 1.0, False, 1.0), (0.3, 1.0, False, 1.0), (0.3, 0.1, False, 0.1), (0.3, 0.1, True, 1.0)],
    ids=["little", "usual", "exact", "exact, where tolerances may hide the error of another law"],
)
def test_an_interval_counts_on_a_law_that_is_wrong_by_as_much_as_such_laws_are(
    form_error: float, of_law: float, tolerant: bool, share: float
) -> None:
    known, named = np.ones((1, 1)), np.zeros((1, 1), bool)
    b = Budget(("a",), known, known, np.ones(1), np.array([form_error]), np.array([tolerant]), {"a": of_law}, named)
    low, middle, high = b.interval("a", 0.025, 0.5, 0.975)
    assert middle == pytest.approx(1.0)
    assert np.log(high) == pytest.approx(-np.log(low)) and 1.7 < np.log(high) / (form_error * share) < 2.0


@pytest.mark.parametrize(
    ("named", "weight", "expected"),
    [
        (("a", "a", "b"), (0.3, 0.3, 0.4), ("a",)),
        (("a", "ab", "bc"), (0.4, 0.3, 0.3), ("a",)),
        (("a", "bc", "b"), (0.35, 0.4, 0.25), ("b",)),  # in .65 of all, though no set is as probable as "bc"
        (("ab", "abc", "c"), (0.5, 0.4, 0.1), ("a", "b")),
        (("ab", "a", "c"), (0.6, 0.3, 0.1), ("a",)),  # together in .6 only
        (("", "a", "b"), (0.4, 0.35, 0.25), ()),
        (("", "ab", "b"), (0.4, 0.35, 0.25), ("b",)),
    ],
)
def test_the_answer_is_named_in_most_draws(named: tuple[str, ...], weight: tuple[float, ...], expected: tuple[str, ...]) -> None:
    draws, n = np.zeros((len(named), 3)), len(named)
    sizes = dict.fromkeys(EFFECTS, 1.0)
    b = Budget(EFFECTS, draws, draws, np.array(weight), np.zeros(n), np.zeros(n, bool), sizes, names(named))
    found = module.by_what_is_carried(b, EffectPosterior((((), 1.0),), {(): None}))  # type: ignore[dict-item]
    counted = [set(expected) <= set(n) if expected else not n for n in named]
    assert found.ranking[0] == (expected, pytest.approx(float(np.array(weight) @ counted)))
    assert sum(p for _, p in found.ranking) == pytest.approx(1.0)


def test_what_a_tolerated_stop_carries_is_not_its_slope_times_its_size() -> None:
    """A stop of 300 N/m already holds the tip; twice as stiff it does little more."""
    catalogue = {e: CATALOGUE[e] for e in ("contact", "base_tilt")}
    prepared = prepare(ROBOT, states(measured(2, 4, FEW))[0], catalogue=catalogue)
    problem, p = prepared.problem, prepared.problem.parameters
    theta = np.zeros_like(p.sd)
    theta[[p.names.index("contact.stiffness"), p.names.index("contact.distance")]] = 300.0, -0.04
    predicted, jacobian = problem.jacobian(theta)
    fitted, slope = Fit(theta, predicted, jacobian, 0.0, 0.0), jacobian.every.coloured(problem.noise, p.sd).whole
    where = parts(prepared)
    every, _ = module._carried(p, where, module._squares(problem, where, fitted), np.zeros((1, len(p.scale))))
    carried = every[0, p.ids.index("contact")]

    def beyond(done: np.ndarray) -> float:
        return float(np.sqrt((p.beyond_calibration(done[:, None], slope) ** 2).sum() / len(prepared.states)))

    own = [i for i, e in enumerate(p.effects) if e == "contact"]
    assert carried == pytest.approx(beyond(predicted - problem.forward.predict(np.zeros_like(p.sd))), rel=1e-6)
    assert beyond(slope[:, own] @ theta[own]) < 0.5 * carried


def answer(catalogue: Catalogue, **effects: float) -> Diagnosis:
    return diagnose(measured(3, 5, FEW, **effects), quick(catalogue))


@few_and_all
def test_a_tolerance_that_carries_more_than_all_else_is_the_cause(catalogue: Catalogue) -> None:
    """0.05 1/m is within what every robot may have, and moves this one's tip by millimetres."""
    d = answer(catalogue, precurvature__y=0.05)
    assert d.attribute.effects == ("precurvature",)
    share = next(c for c in d.budget if c.effect == "precurvature")
    assert share.role == "named" and share.low95_mm <= share.mm <= share.high95_mm and share.mm > d.locate.noise_floor_mm


@few_and_all
def test_what_carries_less_than_the_floor_is_no_cause_however_sure_it_is(catalogue: Catalogue) -> None:
    d = answer(catalogue, marker_offset__x=0.4e-3)
    assert d.attribute.verdict != "effect"
    assert all(c.role != "named" for c in d.budget)


@few_and_all
def test_thrust_that_the_side_walls_balance_is_named(catalogue: Catalogue) -> None:
    d = answer({**catalogue, **THRUST}, chamber_thrust__share=1.0)
    assert d.attribute.effects == ("chamber_thrust",)
    assert d.attribute.ranking[0].parameters["chamber_thrust.share"].value == pytest.approx(1.0, abs=0.05)


@few_and_all
def test_thrust_in_walls_that_it_hardly_stretches_is_named_alone(catalogue: Catalogue) -> None:
    thrust = {"chamber_thrust__share": 0.6, "chamber_thrust__borne": 0.9, "chamber_thrust__growth": -0.4}
    assert answer({**catalogue, **THRUST}, **thrust).attribute.effects == ("chamber_thrust",)
