"""A second campaign: held out, what is refused, how the verdict falls, and that nothing of it leaks into the fit; compared, what
changed is found beside what both have in common."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.answer.attribute import Attribution, attribute, calibrated, related_ahead
from diagnosis.answer.decision import Decision
from diagnosis.answer.sentences import held_out
from diagnosis.answer.unseen import evaluate_holdout, interval_closed, other_campaign
from diagnosis.compare_campaigns import compare_campaigns, sentence
from diagnosis.data.case import states
from diagnosis.errors import BadCase, BadHoldout
from diagnosis.inference.budget import weighed
from diagnosis.inference.evidence import NONE
from diagnosis.inference.executor import SINGLE_THREAD
from diagnosis.inference.posterior import UNKNOWN, EffectPosterior
from diagnosis.inference.prepare import parts, prepare
from model.actuators import Chambers
from model.effects import CATALOGUE
from recordings.trials import TrialRow
from tests.diagnosis.small_campaigns import FEW, SOME, Catalogue, few_and_all, measured
from tests.diagnosis.test_case import ROBOT, Measured, case, sweep
from tests.diagnosis.test_findings import ANSWER
from tests.simulated.bench import raises

BEFORE = {"chamber_ballooning__growth": 0.2}
AZIMUTH, NAMELESS = np.radians(8), replace(ANSWER, detail={"names": {}})


@pytest.fixture(scope="module")
def diagnosed() -> Measured:
    return measured(3, 1, FEW, chamber_azimuth__angle=AZIMUTH)


@pytest.fixture(scope="module")
def found(diagnosed: Measured) -> Attribution:
    three = {effect: SOME[effect] for effect in ("chamber_azimuth", "base_tilt", "marker_offset")}
    prepared = prepare(ROBOT, states(diagnosed)[0], catalogue=three)
    leading = weighed(prepared.problem, parts(prepared), SINGLE_THREAD)
    return attribute(prepared, leading, calibrated(prepared), related_ahead(prepared, leading, SINGLE_THREAD))


def test_an_effect_that_is_at_work_in_both_is_confirmed(found: Attribution, diagnosed: Measured) -> None:
    held = evaluate_holdout(found, other_campaign(diagnosed, measured(2, 9, FEW, chamber_azimuth__angle=AZIMUTH))[0])
    assert held.hypothesis == ("chamber_azimuth",) and held.named and held.verdict == "confirmed"
    assert held.share_closed is not None and held.share_closed > 0.8
    assert held.states == 20 and held.trials == 4 and held.unsolved == 0
    assert sum(x.n for x in held.by_spine_length) == held.states


def test_an_effect_that_was_gone_by_then_is_contradicted(found: Attribution, diagnosed: Measured) -> None:
    held = evaluate_holdout(found, other_campaign(diagnosed, measured(2, 9, FEW, chamber_azimuth__angle=-AZIMUTH))[0])
    assert held.verdict == "contradicted" and held.ci95 is not None and held.ci95[1] < 0
    assert held.after_mm > held.before_mm and "contradicted" in held_out(replace(NAMELESS, holdout=held))


def test_nothing_is_confirmed_where_the_baseline_is_right_or_nothing_was_named(found: Attribution, diagnosed: Measured) -> None:
    right = replace(found, calibrated=found.best.fit, prepared=replace(found.prepared, noise_floor=1e-3))
    doubtful = replace(found, decision=Decision("unknown", (), 0.3, 0.3))
    again, _ = other_campaign(diagnosed, measured(2, 9, FEW, chamber_azimuth__angle=AZIMUTH))
    closed, unnamed = (evaluate_holdout(f, again) for f in (right, doubtful))
    assert closed.share_closed is None and closed.verdict == unnamed.verdict == "open"
    said = [held_out(replace(NAMELESS, holdout=held)) for held in (closed, unnamed)]
    assert "no gap to close" in said[0] and "not named, so nothing is confirmed" in said[1]


def test_of_one_trial_parts_are_drawn_anew(found: Attribution, diagnosed: Measured) -> None:
    rows = [replace(r, trial=1) for r in measured(2, 9, FEW, chamber_azimuth__angle=AZIMUTH).table]
    held = evaluate_holdout(found, other_campaign(diagnosed, case(rows))[0])
    assert held.trials == 1 and held.ci95 is not None and held.verdict == "confirmed"
    assert " %, from parts of its one trial); " in held_out(replace(NAMELESS, holdout=held))


def test_a_robot_yaml_that_lacks_what_a_diagnosis_proposes_is_of_the_same_robot(diagnosed: Measured) -> None:
    other = measured(2, 9, FEW)
    told = Measured(diagnosed.robot.model_copy(update={"thrust": "walls", "area_factor": 0.8}), diagnosed.table)
    campaign, (note,) = other_campaign(told, other)
    assert note.values == {"keys": "area_factor, thrust"} and len(campaign) == len(other.table)


def push(r: TrialRow) -> TrialRow:
    """A row of a stiffness trial in the place of one of a sweep."""
    return replace(r, protocol="stiffness", tip=None, specimen="spine", force=0.1, deflection=1e-3)


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (lambda c: c, "the fit saw them"),
        (lambda c: Measured(ROBOT.model_copy(update={"tip_mass": 0.5}), c.table), "same robot"),
        (lambda c: case([replace(r, tip=(40.0, 0.0, 0.4)) for r in sweep()]), "looks like cm"),
        (lambda c: case([replace(r, protocol="stiffness", tip=None) for r in sweep()]), "rows has a tip"),
        (lambda c: case([push(r) for r in sweep() if r.spine_length > 0.05]), "held-out campaign has none"),
    ],
)
def test_what_cannot_be_held_out_is_refused(diagnosed: Measured, other: object, said: str) -> None:
    assert callable(other)
    raises(BadHoldout, said, other_campaign, diagnosed, other(diagnosed))


def test_what_was_diagnosed_without_tips_cannot_be_tried_on_them() -> None:
    pushed = case([push(r) for r in sweep() if r.spine_length > 0.05])
    raises(BadHoldout, "the diagnosed campaign has none", other_campaign, pushed, measured(2, 9))


def test_pushes_beside_tips_are_not_tried(diagnosed: Measured) -> None:
    other = list(measured(2, 9).table)
    own, _ = other_campaign(diagnosed, case(other + [push(r) for r in other if r.spine_length > 0.05]))
    assert len(own) == len(other) and not own.pushed.any()


def test_trials_are_drawn_within_their_kind() -> None:
    trial = np.repeat(np.arange(4), 5)
    before = np.repeat([1e-3, 1e-3, 9e-3, 9e-3], 5)
    after = np.repeat([0.9e-3, 0.9e-3, 1e-3, 1e-3], 5)
    wide = interval_closed(before, after, 0.5e-3, trial)
    tight = interval_closed(before, after, 0.5e-3, trial, trial // 2)
    assert tight[1] - tight[0] < 1e-9 < wide[1] - wide[0]


# ------------------------------------------------------------------ compared with an earlier one
@few_and_all
def test_the_effect_that_came_is_named_and_the_one_that_was_there_is_not(catalogue: Catalogue) -> None:
    turned = measured(3, 2, FEW, **BEFORE, chamber_azimuth__angle=np.radians(6))
    change = compare_campaigns(turned, measured(3, 1, FEW, **BEFORE), catalogue)
    assert change.effects == change.ranking[0][0] == ("chamber_azimuth",)
    assert change.sizes["chamber_azimuth.angle (change)"] == pytest.approx(np.radians(6), abs=np.radians(1))


@few_and_all
def test_silicone_as_soft_as_a_warmer_day_makes_it_is_no_change(catalogue: Catalogue) -> None:
    warmer = measured(3, 2, FEW, **BEFORE, youngs_modulus__excess=-0.03)
    change = compare_campaigns(warmer, measured(3, 1, FEW, **BEFORE), catalogue)
    assert change.effects == () and change.statement.startswith("No change since the reference")


def test_what_is_told_follows_from_the_probability_that_nothing_changed() -> None:
    def told(nothing: float) -> str:
        ranking = ((("contact",), 0.95 - nothing), (NONE, nothing), (UNKNOWN, 0.05))
        found = EffectPosterior(tuple(sorted(ranking, key=lambda r: -r[1])), {})
        sizes = {"contact.stiffness (change)": 30.0, "contact.distance (change)": -0.002}
        return sentence(found, sizes, CATALOGUE, Chambers.words)

    assert told(0.8).startswith("No change since the reference stands out from the noise (p = 0.80")
    assert told(0.2).startswith("No change since the reference is certain: that nothing changed has p = 0.20")
    assert "most probable otherwise: contact with an obstacle [contact] (p" in told(0.2)
    by = "contact with an obstacle, stiffness by 30 N/m; contact with an obstacle, distance by -2 mm; p = 0.94"
    assert told(0.01).startswith(f"Since the reference contact with an obstacle [contact] changed ({by}")


def test_campaigns_of_different_robots_are_not_compared() -> None:
    reference = measured(3, 1, FEW)
    other = Measured(ROBOT.model_copy(update={"density": 1200.0}), reference.table)
    raises(BadCase, "same robot.yaml", compare_campaigns, other, reference)
