"""The verdict, as deep as the data carry, its sentences and its headline: no two of one answer contradict each other."""

import itertools
import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from diagnosis.answer.calibration import origins
from diagnosis.answer.decision import Verdict, behaves_like, capped, decide, doubted, without_nothing
from diagnosis.answer.headline import MOST_WORDS, headline
from diagnosis.answer.locate import concentrated
from diagnosis.answer.result import (
    Alike,
    Attribute,
    Calibration,
    Carries,
    Conclusion,
    Diagnosis,
    FittedRobot,
    Locate,
    Ranked,
    SetUp,
    Shrink,
    Simulator,
    Step,
    Value,
    Waterfall,
)
from diagnosis.answer.sentences import as_stiff, changed_by, numbers_beyond, stands_for, statement
from diagnosis.answer.size import Size, by_actuator
from diagnosis.answer.verdict import conclude, doubts, own_evidence, rivals
from diagnosis.criticism.stage_errors import StageError
from diagnosis.findings import finding
from diagnosis.inference.posterior import EffectPosterior
from diagnosis.judgement import BENCHMARK
from lab.files.config import load
from lab.files.robot_file import paper_robot
from model.actuators import Chambers, Tendons, Words
from model.effects.catalogue import CATALOGUE
from model.robot import Robot
from tests.diagnosis.test_case import case, states, sweep
from tests.diagnosis.test_findings import ANSWER
from tests.diagnosis.toy import parameter, parameters

WHERE = Locate(3.0, 0.5, True, {}, {})
BUDGET = (Carries("base_tilt", "named", 2.5, 2.0, 3.0), Carries("contact", "present", 0.4, 0.1, 0.8))
NAMES = {"base_tilt": "tilt of the base"}
MATERIAL = (StageError("material", "time", 20.0),)
BOTH = (StageError("material", "time", 5.0), StageError("load", "pressure", 5.0))
HEADS = (
    "Cause: ", "The most probable cause is ", "not in the catalogue (p", "not in the catalogue; it", "No cause: ", "No gap: ",
    "Too little",
)  # fmt: skip


def weighed(**p: float) -> EffectPosterior:
    """Hypotheses by name, "none" for none."""
    ranking = sorted(p.items(), key=lambda x: -x[1])
    return EffectPosterior(tuple((() if name == "none" else (name,), value) for name, value in ranking), {})


def answer(a: Attribute) -> Diagnosis:
    detail = {"names": NAMES, "best_hypothesis": ["base_tilt"], "misfit": {"outlier_trial": None}}
    budget = tuple(c for c in BUDGET if c.role != "named" or c.effect in a.effects)
    return replace(ANSWER, locate=WHERE, attribute=a, detail=detail, budget=budget)


def facts(p: EffectPosterior, enough: bool = True, gap: bool = True, asking: tuple[StageError, ...] = MATERIAL) -> Diagnosis:
    d = decide(p, enough)
    return answer(Attribute(**vars(d), stage_errors=asking, conclusion=conclude(d, gap, asking), rivals=rivals(d, p)))


def attributed(d: Diagnosis, **changed: object) -> Diagnosis:
    return replace(d, attribute=replace(d.attribute, **changed))  # type: ignore[arg-type]


SURE = weighed(base_tilt=0.97, none=0.025, unknown=0.005)
OPEN = weighed(base_tilt=0.72, weight=0.13, none=0.1, unknown=0.05)
ALONE, STRANGE = weighed(base_tilt=0.72, none=0.2, unknown=0.08), weighed(base_tilt=0.72, none=0.08, unknown=0.2)
OUTSIDE, NONE = weighed(unknown=0.6, base_tilt=0.3, none=0.1), weighed(none=0.8, base_tilt=0.15, unknown=0.05)


@pytest.mark.parametrize(
    ("found", "conclusion", "told"),
    [
        (facts(SURE), "cause", f"Cause: tilt of the base [base_tilt] (p = 0.97; {BENCHMARK})."),
        (facts(SURE), "cause", "tilt of the base moves the tip by 2.50 mm"),
        (facts(SURE), "cause", "Also present: contact [contact] 0.40 mm"),
        (
            attributed(facts(SURE), second={"weight": 0.55, "contact": 0.44}),
            "cause",
            "of comparable size acts with it: weight [weight] (p = 0.55) or contact [contact] (p = 0.44).",
        ),
        (facts(OPEN), "one of several", f"tilt of the base [base_tilt] (p = 0.72; 0.76 if it is in the catalogue; {BENCHMARK})"),
        (facts(OPEN), "one of several", "cannot rule out weight [weight]."),
        (facts(ALONE), "one of several", "cannot rule out that no effect"),
        (facts(STRANGE), "one of several", "cannot rule out a cause that this software does not know."),
        (facts(OUTSIDE), "stage", "An error in the material that varies with time fits best (log evidence 20.0"),
        (facts(OUTSIDE, asking=BOTH), "outside", f"The cause is not in the catalogue (p = 0.60; {BENCHMARK})."),
        (facts(OUTSIDE, asking=()), "outside", f"The cause is not in the catalogue (p = 0.60; {BENCHMARK})."),
        (facts(NONE), "none", "No cause: no effect explains enough"),
        (facts(NONE), "none", "(p = 0.80; 0.84 if no cause is outside the catalogue; "),
        (facts(NONE, gap=False), "noise", "No gap: nothing is above the noise floor"),
        (attributed(facts(SURE, enough=False), missing=("only one pressure",)), "too little data", ": only one pressure."),
    ],
)
def test_each_conclusion_has_its_sentences(found: Diagnosis, conclusion: str, told: str) -> None:
    assert found.attribute.conclusion == conclusion and told in statement(found)


def test_what_calibration_changed_is_part_of_the_statement() -> None:
    gap = Waterfall("leave one trial out", 40, 25.2, (Step("calibration", None, 24.6, 24.0, 25.0, 0.6),))
    found = replace(facts(NONE, gap=False), waterfall=gap, calibration=Calibration(0.88, 1.0))
    text = statement(found)
    assert text.startswith("Calibration closes 100 % of the reducible gap; beyond it, nothing is above the noise floor")
    assert "one area factor (0.88 instead of 1.00; a body 14 % stiffer would look the same) and the set-up fitted, by" in text
    assert "no better" not in text
    part = statement(replace(found, waterfall=replace(gap, lost=12)))
    assert "misses the tip by 25.20 mm rms in 40 of 52 states (in the other 12 a fit without them finds no equilibrium)" in part
    worse = statement(replace(found, waterfall=replace(gap, given_mm=0.59)))
    assert "no better" not in worse
    worse = statement(attributed(replace(found, waterfall=replace(gap, given_mm=0.59)), conclusion="none"))
    assert "by 0.60 mm on unseen states, which is no better; the noise floor" in worse
    kept = statement(replace(found, calibration=Calibration(1.003, 1.0)))
    assert kept.startswith("Calibration closes 100 % ") and "instead of" not in kept
    both, ratio, same = (Calibration(area, 1.0, 1.06, determined=area == 0.998) for area in (0.998, 0.96, 1.06))
    assert "(1.00 as stated, with 1.06 times the modulus)" in statement(replace(found, calibration=both))
    one = "(a body 10 % stiffer: these data determine only the ratio of its stiffness to the area factor)"
    assert one in statement(replace(found, calibration=ratio))  # no other number of what is not known by itself
    assert as_stiff(same) == "as stiff as stated" and "only the ratio" not in statement(replace(found, calibration=same))
    small = statement(replace(found, calibration=Calibration(2.34, 1.5), waterfall=replace(gap, given_mm=0.63)))
    assert small.startswith("No gap: ") and "a body 36 % softer" in small
    near = replace(found, calibration=Calibration(1, 1, 1.09, body_mm=1, set_up=(SetUp("tilt.x", 0.003, 0.0035, "rad", 2),)))
    assert "the set-up fitted, by" in statement(near)
    found = replace(found, calibration=Calibration(1, 1, 1.09, body_mm=1, set_up=(SetUp("tilt.x", 0.009, 0.0035, "rad", 2),)))
    assert "(tilt.x 0.52 deg, stated to 0.2 deg, moves the tip by 2.00 mm: measure again)" in statement(found)
    assert changed_by(found) == "tilt.x 0.52 deg, a body 9 % stiffer"
    many = tuple(SetUp(f"azimuths.p{k}", 0.09, 0.0175, "rad", 9 - k) for k in range(1, 9))
    many = statement(replace(found, calibration=replace(found.calibration, set_up=many)))
    assert many.count(", stated to 1 deg, moves") == 6 and "moves the tip by 3.00 mm; 2 more numbers: measure again)" in many
    beside = statement(replace(found, fitted=FittedRobot(("base_tilt",), {}, 0.4, 3.0)))
    assert "the set-up fitted, by" in beside  # a note states what the fit with the cause moves
    only = statement(replace(found, calibration=replace(found.calibration, modulus=1.0)))
    assert only.startswith("Calibration closes 100 %") and "may stand for" not in only
    far = statement(replace(found, calibration=Calibration(13.5, 1.5, 0.8, at_bound=True)))
    assert "(13.50 instead of 1.50, with 0.80 times the modulus, at the limit of the fit)" in far and "only the ratio" not in far


def test_where_calibration_alone_closes_the_gap_the_headline_does_not_say_that_nothing_does() -> None:
    a = attribute("effect", "one of several", {}, "body_modulus", p=0.9)
    said = line(a, by_calibration=0.99, closed=-0.01, calibrated="a body 86 % softer")
    assert said == "Calibration closes 99 % of the gap (a body 86 % softer); no effect closes the rest."
    said = line(a, by_calibration=0.99, closed=0.7, calibrated="a body 86 % softer", alone=True)
    assert said == "Calibration closes 99 % of the gap (a body 86 % softer); the rest has no clear cause."
    tense = replace(answer(attribute("none", "none", {}, p=0.5)), findings=(finding("beyond_tolerance", fit="", numbers=[]),))
    said = headline(tense, CATALOGUE, by_calibration=1.0, calibrated="a body 40 % softer")
    assert said == "Calibration closes 100 % of the gap, but beyond tolerances: a body 40 % softer (p = 0.50)."
    settled = (finding("thrust_settled", walls_mm=0.67, cap_mm=3.95),)
    walls = replace(answer(attribute("effect", "cause", {}, "chamber_thrust", p=0.92)), findings=settled)
    said = headline(walls, CATALOGUE, by_calibration=0.99, calibrated="a body 86 % softer")
    assert said == "Calibration closes 99 % of the gap; no other cause is needed (p = 0.92). Write `thrust: walls`."
    waterfall = replace(walls, waterfall=CALIBRATED, calibration=None)
    assert "Uncalibrated but with `thrust: walls`, the model misses" in statement(waterfall)
    assert walls.texts("note") == [str(settled[0])] and replace(walls, statement=f"{settled[0]}. So").texts("note") == []
    sure = replace(answer(attribute("effect", "cause", {}, "base_tilt", p=0.98)), calibration=Calibration(1.0, 1.0, 0.86))
    assert headline(sure, CATALOGUE, 0.97, "a body 14 % softer").endswith("(p = 0.98), beside a body 14 % softer.")


def test_where_numbers_far_off_were_calibrated_first_the_gap_as_given_is_not_said_to_be_none() -> None:
    gap = Waterfall("leave one trial out", 40, 42.0, (Step("calibration", None, 24.6, 24.0, 25.0, 0.6),))
    found = replace(facts(NONE, gap=False), waterfall=gap, calibration=Calibration(1.0, 1.0))
    found = replace(found, detail={**found.detail, "first_calibration": {"adjusted": [{"code": "refitted"}]}})
    assert statement(found).startswith("Calibration closes 100 % of the reducible gap; beyond it, nothing is above")
    said = line(attribute("none", "noise", p=0.9), by_calibration=1.0, calibrated="azimuth of the first chamber")
    assert said == "Calibration closes 100 % of the gap (azimuth of the first chamber); no other cause is needed (p = 0.90)."
    assert len(said.split()) <= 20


def test_where_calibration_reaches_its_limit_the_headline_asks_for_robot_yaml_instead_of_naming_an_effect() -> None:
    a = attribute("effect", "one of several", {}, "tip_payload", p=0.9)
    said = line(a, calibrated="a body 91 % softer", beyond=True)
    assert said == "Unclear: robot.yaml is too far from the data (a body 91 % softer): check it first."
    assert "too far" not in line(a, calibrated="a body 91 % softer")


def test_a_body_that_is_softer_by_its_cavities_has_them() -> None:
    robot = load(paper_robot(), Robot).replace(area_factor=1.0)
    (cavities,), *without = ([o for o in origins(robot, s, 0.1) if o.name == "cavities"] for s in (0.85, 1.1, 0.6))
    # nor are they most of what makes a body much softer
    assert 0.85 < cavities.factor < 0.95 and cavities.probability > 0.6 and without == [[], []]
    assert origins(robot, 0.6, 0.5)[0].name == "youngs_modulus" and origins(robot, 0.6, 0.5)[0].probability > 0.8


def test_a_calibrated_area_factor_stands_for_the_number_that_is_least_certain() -> None:
    robot = load(paper_robot(), Robot)
    found = origins(robot, 1 / 0.88, 0.1)
    (by_modulus,) = (o for o in found if o.name == "youngs_modulus")
    assert by_modulus in found[:2] and by_modulus.factor == pytest.approx(1 / 0.88) and by_modulus.probability > 0.3
    unsure = origins(robot, 1 / 0.88, 0.3)
    assert unsure[0].name == "youngs_modulus" and unsure[0].probability > 0.6
    sure = {o.name: o for o in origins(robot, 1 / 0.88, 1e-3)}
    radius = sure["chambers.radius"]
    assert radius.factor == pytest.approx(0.88**0.5) and radius.probability > sure["youngs_modulus"].probability
    assert "youngs_modulus" not in {o.name for o in origins(robot, 1 / 0.88, 0.0)}
    told = stands_for(Calibration(0.88, 1.0, origins=found), robot.actuators.words)
    assert told.startswith("One wrong number could account for") and "need not sum to 1" in told
    assert "youngs_modulus 13.6 % larger (p = 0." in told
    assert stands_for(Calibration(1.0, 1.0, origins=found), robot.actuators.words) == ""


def test_what_tolerances_close_is_not_said_of_the_cause() -> None:
    shrink = Shrink("leave one trial out", 7.5, 1.2, 0.5, 0.979, None, ())
    texts = {}
    for name, mm in (("alone", 1.4), ("beside", 6.9)):
        steps = (
            Step("calibration", None, 20.0, 18.0, 22.0, 7.5),
            Step("cause", "base_tilt", 7.5 - mm, 0.0, 9.0, mm),
            Step("tolerances", None, mm - 1.2, 0.0, 9.0, 1.2),
        )
        gap = Waterfall("leave one trial out", 40, 27.5, steps)
        texts[name] = statement(replace(facts(SURE), waterfall=gap, shrink=shrink))
    whole = "98 % of the reducible gap is closed"
    assert f"{whole}." in texts["alone"]
    assert f"{whole}, 15 % by the cause itself and the rest by tolerances of other effects." in texts["beside"]


@pytest.mark.parametrize(
    ("posterior", "enough", "gap", "asking"),
    list(itertools.product((SURE, OPEN, ALONE, STRANGE, OUTSIDE, NONE), (True, False), (True, False), (MATERIAL, BOTH, ()))),
)
def test_no_two_sentences_contradict(posterior: EffectPosterior, enough: bool, gap: bool, asking: tuple[StageError, ...]) -> None:
    for share in (None, -0.4, 0.0, 0.3, 0.6, 0.98):
        after = 3.0 if share is None else 3.0 * (1 - share)
        shrunk = Shrink("leave one spine length out", 3.0, after, 0.5, share, None, ())
        found = replace(facts(posterior, enough, gap, asking), shrink=shrunk)
        misfit = {"outlier_trial": 3, "outlier_state": "trial 3 step 4, where marker 1 is 12 mm"}
        named = found.attribute.verdict == "effect"
        present = () if named else (Carries("base_tilt", "present", 9.0, 8.0, 10.0),)  # may only stand in for the cause
        found = replace(found, detail={**found.detail, "misfit": misfit}, budget=(*found.budget, *present))
        text = statement(found)
        assert sum(text.count(head) for head in HEADS) == 1
        assert ("moves the tip" in text) == named
        assert not (named and "not in the catalogue" in text)
        told = "check it first, above all trial 3 step 4, where marker 1 is 12 mm from the fit."
        alone = statement(replace(found, detail={**found.detail, "misfit": {**misfit, "outlier_trial": None}}))
        assert ("Check first trial 3 step 4, where marker 1 is 12 mm from the fit." in alone) == (told in text)
        assert (told in text) == (found.attribute.verdict == "unknown")
        assert "9.00 mm" not in text
        if share is not None and share < 0:
            assert "is closed" not in text and "closes" not in text
            assert ("worse" in text) == named
        if share is not None and share >= 0.5:
            assert "does not explain" not in text and "worse" not in text


@pytest.mark.parametrize(
    ("repeated", "after", "told"),
    [
        (True, 0.02, "by 0.046 mm rms (in-sample; noise floor 0.327 mm); with the cause, by 0.020 mm."),
        (True, 0.0461, "(in-sample; noise floor 0.327 mm); with the cause, by as much."),
        (False, 0.02, "(in-sample; none repeated; assumed noise floor 0.327 mm); with the cause, by 0.020 mm."),
    ],
)
def test_stiffness_trials_say_where_their_floor_is_from(repeated: bool, after: float, told: str) -> None:
    pushes = {"waterfall_mm": {"calibrated": 0.046, "explained": after}, "floor_mm": 0.327, "floor_from_repeats": repeated}
    sure, none = (replace(d, detail={**d.detail, "stiffness": pushes}) for d in (facts(SURE), facts(NONE)))
    assert statement(sure).endswith(told) and statement(none).endswith("0.327 mm).")


def test_a_simulators_difference_says_what_remains_without_it() -> None:
    steps = (Step("calibration", None, 1.0, 0.9, 1.1, 0.44), Step("simulator", None, 0.29, 0.2, 0.3, 0.15))
    gap = Waterfall("leave one trial out", 40, 1.43, steps)
    own = Simulator("cc", 0.9, 2.2, 2.1, 0.2, 0.4)
    text = statement(replace(facts(NONE, gap=False), waterfall=gap, simulator=own))
    assert "cc differs from the rod of robot.yaml by 2.20 mm rms, and by 2.10 mm after an area factor is fitted" in text
    assert "0.40 mm of that is not in the measurements (in-sample). Without that part, 0.15 mm" in text
    alike = statement(replace(facts(NONE, gap=False), simulator=replace(own, beyond_calibration_mm=0.1)))
    assert "by 0.10 mm after an area factor is fitted: less than the noise floor." in alike
    assert "not in the measurements" not in alike


def test_a_cause_that_leads_but_is_probably_too_small_is_not_named() -> None:
    leading = weighed(base_tilt=0.45, none=0.35, contact=0.16, unknown=0.04)
    small, large = (decide(leading, True, share) for share in (0.7, 0.3))
    assert (small.verdict, small.effects, small.too_small) == ("none", (), ("base_tilt",))
    assert small.probability == pytest.approx(0.96 * 0.7)
    assert large.verdict == "effect" and large.effects == ("base_tilt",)
    assert decide(weighed(base_tilt=0.76, none=0.2, unknown=0.04), True, 0.9).verdict == "effect"
    ranked = tuple(Ranked(h, p, 0.0, None, {}) for h, p in leading.ranking)
    for conclusion, first in (("none", "No cause:"), ("noise", "No gap:")):
        found = replace(answer(Attribute(**vars(small), conclusion=conclusion, ranking=ranked)), budget=())
        assert statement(found).startswith(f"{first} probably no effect moves the tip by 2 noise floors (p = 0.67")
        assert "The most probable one is tilt of the base [base_tilt] (p = 0.45)." in statement(found)
    assert headline(found, {}, by_calibration=1.0) == "Calibration closes 100 % of the gap; perhaps tilt of the base (p = 0.45)."


def test_a_number_of_robot_yaml_far_beyond_its_tolerance_is_stated_and_no_cause_is_certain() -> None:
    area = replace(parameter("area", sd=0.1), group="calibration")
    p = parameters(parameter("contact", "contact"), parameter("youngs_modulus", sd=0.02), parameter("density", sd=0.1), area)
    moved = p.tense(np.array([9.0, -0.12, 0.7, -0.57]))
    assert moved == {1: -0.12, 2: 0.7, 3: -0.57}
    assert [*p.tense(np.array([9.0, -0.12, 0.3, 0.1]))] == [1, 2]  # beside one far beyond, all that are beyond
    assert p.tense(np.array([9.0, -0.06, 0.3, 0.1])) == {}
    assert p.tense(np.array([9.0, -0.12, 0.7, 0.1]), np.array([0.0, -0.5, 0.0, 0.1])) == {1: -0.12}
    robot = load(paper_robot(), Robot)
    stiff = robot.model_copy(update={"bending_stiffness": 0.1})
    assert str(next(numbers_beyond(p, moved, stiff))).startswith("bending_stiffness 12 % below")
    said = [
        "youngs_modulus 12 % below robot.yaml (2 %)",
        "density 70 % above robot.yaml (10 %)",
        "area_factor 57 % below robot.yaml (10 %)",
    ]
    assert [str(number) for number in numbers_beyond(p, moved, robot)] == said
    sure = decide(SURE, True)
    assert conclude(sure, True, (), tense=True) == "one of several" and conclude(sure, True, ()) == "cause"


def test_where_a_relative_does_the_same_no_cause_is_certain_and_the_answer_says_what_tells() -> None:
    sure = replace(decide(SURE, True), relatives=("camera_scale", "lens", "body_length"))
    assert conclude(sure, True, ()) == "one of several"
    told = statement(answer(Attribute(**vars(sure), conclusion="one of several")))
    assert "most probable cause is tilt of the base [base_tilt]" in told and told.count("would look the same") == 2
    assert "cannot rule out a cause that this software does not know." in told
    assert "The scale of the cameras would look the same. To find out, let the cameras read a rod of known length." in told
    outside = replace(decide(OUTSIDE, True), relatives=("mount_creeps",))
    found = attributed(facts(OUTSIDE), relatives=outside.relatives)
    assert "It may be a mount that turns during the campaign. To find out, repeat the first trial" in statement(found)
    assert headline(found, CATALOGUE).endswith("; it may be a mount that turns during the campaign.")


def test_where_a_relative_is_at_one_place_or_two_the_answer_names_them_with_the_size_and_else_names_none() -> None:
    def told(relative: str, unit: str, **places: float) -> Diagnosis:
        sizes = {name.replace("_", " "): Value(value, 0.03 if unit == "1" else 200.0, unit) for name, value in places.items()}
        outside = replace(decide(OUTSIDE, True), relatives=(relative,))
        found = attributed(facts(OUTSIDE), relatives=outside.relatives, at_places={relative: sizes})
        return replace(found, headline=headline(found, CATALOGUE))

    one = told("shared_pressure", "1", chambers_3_and_4=0.3, chambers_1_and_2=0.05)
    assert one.headline.endswith("; it may be leaks between chambers 3 and 4 (30 ± 3 %).")
    assert "leaks between chambers 3 and 4 (30 ± 3 %). To find out, hold one of chambers 3 and 4 at pressure" in statement(one)
    two = told("shared_pressure", "1", chambers_3_and_4=0.12, chambers_1_and_2=0.3, chambers_2_and_3=0.0)
    assert "chambers 1 and 2 (30 ± 3 %) and chambers 3 and 4 (12 ± 3 %). To find out, hold one of chambers 1" in statement(two)
    for spread in ({"chambers_1_and_2": 0.3, "chambers_2_and_3": 0.07}, {f"chambers_{k}_and_{k + 1}": 0.3 for k in (1, 2, 3)}):
        assert "may be leaks between neighbouring chambers. To find out" in statement(told("shared_pressure", "1", **spread))
    offset = told("regulator_offset", "Pa", chamber_1=100.0, chamber_2=-3100.0)
    assert offset.headline.endswith("; it may be a regulator's offset at chamber 2 (-3.1 ± 0.2 kPa).")
    assert all(len(d.headline.split()) <= MOST_WORDS for d in (one, two, offset))


def test_a_cause_is_certain_only_if_its_size_is_determined_and_possible_and_its_robot_leaves_little() -> None:
    sure = Size("base_tilt.x", "rad", 0.02, 0.02, 0.002, -0.2, 0.2, 0.017, 0.023, True)
    shape = replace(sure, name="base_tilt.growth", mean=9.0, role="shape")
    little, robot = Shrink("", 3.0, 0.6, 0.3, 0.99, None, ()), FittedRobot(("base_tilt",), {}, 0.4, 3.0)
    cause = {"base_tilt": "tilt"}

    def why(
        sizes: list[Size], left: Shrink, low: float = 2.0, alone: bool = False, mm: float = 0.4, law: bool = True
    ) -> list[str]:
        carried, other = [Carries("base_tilt", "named", 2.5, low, 3.0)], ["contact"]
        fitted = replace(robot, left_mm=mm)
        return [f.code for f in doubts(cause, sizes, carried, left, fitted, 0.3, alone * other, law)]

    assert why([sure, shape], little) == []
    assert why([sure], little, low=0.2) == ["cause_undetermined"]
    assert why([replace(sure, mean=-0.3)], little) == ["cause_impossible"]
    assert why([replace(sure, least=0.03)], little) == ["law_of_another_form"]
    assert why([replace(sure, least=0.03)], little, law=False) == why([sure], little, law=False) == ["law_of_another_form"]
    assert why([sure], replace(little, after_mm=1.8)) == ["gap_remains"]
    assert why([sure], replace(little, after_mm=1.8, before_mm=20.0)) == []
    assert why([sure], little, mm=2.9) == ["fit_not_reached"]
    assert why([sure], little, alone=True) == ["cause_or_calibration"]


def test_a_doubt_leaves_room_for_other_causes() -> None:
    sure, why = decide(SURE, True), [finding("gap_remains", mm=1.0)]
    assert doubted(sure, [], 0).probability == sure.probability
    capped, shared = doubted(sure, why, 0), doubted(sure, why, 1)
    assert capped.probability == 0.8 and shared.probability == pytest.approx(0.97 / 2)
    assert 1 - capped.outside == pytest.approx(0.995 * 0.8 / 0.97) and conclude(capped, True, ()) == "one of several"


def test_a_probability_at_its_limit_says_so_and_why() -> None:
    doubt = finding("gap_remains", mm=1.0)
    sure = facts(SURE)
    found = attributed(sure, **vars(doubted(decide(SURE, True), [doubt], 0)), conclusion="one of several", doubts=(doubt.text,))
    found = replace(found, findings=(doubt,), headline=headline(found, CATALOGUE))
    assert found.headline.endswith("(p ≤ 0.80).") and "(p is at most 0.80, as 1 mm remain on unseen states)" in statement(found)
    for certain in (sure, replace(sure, attribute=replace(sure.attribute, probability=0.8))):  # by chance it is what the limit is
        assert f"(p = {certain.attribute.probability:.2f}" in headline(certain, CATALOGUE) + statement(certain)
    assert str(found).splitlines()[:3] == [found.headline, found.statement, f"  note: {doubt}"]


def test_effects_that_close_most_of_the_gap_are_named_though_their_law_is_of_another_form() -> None:
    unknown, most = decide(OUTSIDE, True), Shrink("", 16.3, 1.6, 0.4, 0.99, None, ())
    named = behaves_like(unknown, ("base_tilt",), OUTSIDE, most.share_closed)
    assert (named.verdict, named.effects, named.limited) == ("effect", ("base_tilt",), True)
    assert doubted(named, [finding("gap_remains", mm=1.0)], 0).limited  # below the limit, as 20 % of it were left for others
    assert named.probability == pytest.approx(0.8 * 0.3 / 0.4) and conclude(named, True, ()) == "one of several"
    for left in (replace(most, share_closed=0.5), None):
        assert behaves_like(unknown, ("base_tilt",), OUTSIDE, left and left.share_closed) == unknown
    explained = replace(unknown, relatives=("shared_pressure",))
    assert behaves_like(explained, ("base_tilt",), OUTSIDE, most.share_closed) == explained
    assert behaves_like(unknown, (), OUTSIDE, most.share_closed) == unknown
    assert behaves_like(decide(SURE, True), (), SURE, most.share_closed).effects


def test_effects_are_no_more_probable_than_the_share_of_the_gap_that_they_close() -> None:
    sure, known = decide(SURE, True), [capped(decide(SURE, True), closed) for closed in (None, 1.0, 0.7, 0.04)]
    assert known[:2] == [sure, sure] and known[2] == replace(sure, probability=0.7, outside=1 - 0.7)
    assert (known[3].verdict, known[3].effects, known[3].p) == ("unknown", (), "p ≤ 0.80")


CALIBRATED = Waterfall("", 9, 14.8, (Step("calibration", None, 14.5, 14.0, 15.0, 0.3),))
NOTHING = replace(facts(NONE, gap=False), waterfall=CALIBRATED, locate=replace(WHERE, noise_floor_mm=0.3))


def test_what_else_would_do_what_an_area_factor_does_stands_beside_it_with_the_experiment() -> None:
    found = Calibration(
        1.2, 1.5, alike=(Alike("tip_payload.mass", 0.117, "kg", 0.32), Alike("body_modulus.excess", 0.25, "1", 0.4))
    )
    told = statement(replace(NOTHING, calibration=found))
    assert told.startswith("Calibration closes 100 % of the reducible gap") and "(1.20 instead of 1.50" in told
    for each in ("[tip_payload] +117 g (0.32 mm remain)", "[body_modulus] +25 % (0.40 mm remain)", "pressures", "radius"):
        assert each in told
    assert "weigh what the tip carries, hang a known mass on it without pressure, check the pressures with a gauge" in told
    changed = changed_by(replace(NOTHING, calibration=found))
    assert changed == "a body 25 % stiffer or tip payload +117 g"
    assert changed_by(replace(NOTHING, calibration=replace(found, alike=found.alike[1:]))) == "a body 25 % stiffer"
    creeping = replace(NOTHING, calibration=replace(found, alike=()), attribute=attribute("effect", "cause", {}, "viscoelastic"))
    assert changed_by(creeping) == "a body 25 % stiffer before it creeps"
    for which in (attribute("none", "noise"), attribute("effect", "one of several", {}, "base_tilt")):
        said = line(which, by_calibration=1.0, calibrated=changed, alone=True)
        assert (f"({changed})" in said or f"gap: {changed} (p" in said) and len(said.split()) <= MOST_WORDS


@pytest.mark.parametrize(
    ("of_rod", "of_data", "told"),
    [(0.9, 1.5, "the gap is in sofa.csv"), (1.5, 2.5, "check area_factor and youngs_modulus of robot.yaml"), (0.9, 2.0, "")],
)
def test_a_simulator_is_told_as_which_pressure_it_acts_and_where_to_look(of_rod: float, of_data: float, told: str) -> None:
    own = Simulator("sofa.csv", of_rod, 10.0, 0.1, 0.0, 0.0, 1.5)
    text = statement(replace(NOTHING, simulator=own, calibration=Calibration(of_data, of_rod)))
    assert f"sofa.csv acts as with {of_rod / of_data:.2f} times the pressure; that closes 14.5 of 14.8 mm." in text
    assert told in text and ("the gap is in" in text) == ("the gap is in" in told)


def test_a_simulator_that_does_what_nobody_measures_has_the_gap() -> None:
    own = Simulator("elastica.csv", 1.5, 10.0, 9.0, 1.0, 9.0, 1.5)
    steps = (Step("calibration", None, 0.1, 0.0, 0.2, 9.0), Step("simulator", None, 8.7, 8.0, 9.0, 0.3))
    text = statement(replace(NOTHING, simulator=own, waterfall=replace(CALIBRATED, given_mm=9.1, steps=steps)))
    assert "The gap is in elastica.csv." in text


def attribute(
    verdict: Verdict, conclusion: Conclusion, sizes: dict[str, Value] | None = None, *effects: str, p: float = 0.96
) -> Attribute:
    return Attribute(verdict, effects, p, ranking=(Ranked(effects, p, 10.0, None, sizes or {}),), conclusion=conclusion)


def line(a: Attribute, closed: float | None = None, words: Words = Chambers.words, **known: Any) -> str:
    """The headline where what is named closes this share of the gap on unseen states."""
    names = {e: spec.name(words) for e, spec in CATALOGUE.items()}
    shrunk = None if closed is None else Shrink("", 3.0, 3.0, 0.5, closed, None, ())
    return headline(replace(answer(a), shrink=shrunk, detail={"actuators": words.kind, "names": names}), CATALOGUE, **known)


@pytest.mark.parametrize(
    ("effect", "sizes", "words"),
    [
        ("chamber_azimuth", {"angle": (0.1396, "rad")}, "The chambers are turned by 8.0 ± 0.6 deg about the axis"),
        ("spine_length_offset", {"offset": (-0.0123, "m")}, "The spine is 12 ± 10 mm shorter than read"),
        ("body_modulus", {"excess": (0.15, "1")}, "The body is 15 ± 1 % stiffer than stated"),
        ("base_tilt", {"x": (0.03, "rad"), "y": (-0.04, "rad")}, "The base is tilted by 2.9 ± 0.6 deg"),
        ("pressure_deadband", {"band": (9e3, "Pa")}, "The chambers act only above 9.0 kPa"),
        ("chamber_order", {}, "The chambers hang on other regulators than robot.yaml states"),
        ("my_own_effect", {"d": (3.0, "1")}, "My own effect is at work"),
        ("spine_length_offset", {"offset": (-0.0123, "m", False)}, "The spine is some amount longer or shorter than read"),
    ],
)
def test_a_cause_is_said_with_its_size_if_determined(effect: str, sizes: dict[str, tuple[Any, ...]], words: str) -> None:
    found = {f"{effect}.{name}": Value(value, 0.01, *of) for name, (value, *of) in sizes.items()}
    assert line(attribute("effect", "cause", found, effect)) == f"{words} (p = 0.96)."


@pytest.mark.parametrize("effect", CATALOGUE)
@pytest.mark.parametrize("sign", [1, -1])
def test_every_effect_of_the_catalogue_fits_and_needs_no_identifier(effect: str, sign: int) -> None:
    sizes = {f"{effect}.{p.name}": Value(sign * 0.123456 * p.scale, 0.0, p.unit) for p in CATALOGUE[effect].parameters}
    for conclusion in ("cause", "one of several"):
        said = line(attribute("effect", conclusion, sizes, effect))  # type: ignore[arg-type]
        assert len(said.split()) <= 20 and "_" not in said and not set(said) & set("[]{}|")
        assert said.startswith("Most likely ") == (conclusion == "one of several")


def test_two_causes_and_the_other_conclusions_fit_too() -> None:
    two = line(attribute("effect", "one of several", {}, "tendon_friction", "chamber_gain"))
    assert two == "Most likely friction of the tendons, difference between the areas of the chambers (p = 0.96)."
    vain = line(attribute("effect", "one of several", {}, "tether", p=0.77), closed=0.02)
    assert vain.startswith("Unclear: no effect closes the gap; the closest is") and vain.endswith("(p = 0.77).")
    assert StageError("load", "experiment", 20.0).varies.startswith("varies with the kind of trial (which {actuators} act")
    asking = (StageError("material", "spine_length", 20.0),)
    unknown = line(replace(attribute("unknown", "stage", p=0.6), stage_errors=asking))
    assert unknown == ("No listed effect fits (p = 0.60); it may be in the material and varies with spine length.")
    none = line(attribute("none", "noise", p=0.9), by_calibration=0.93)
    assert none == "Calibration closes 93 % of the gap; no other cause is needed (p = 0.90)."
    unsure = line(attribute("none", "noise", p=0.42), by_calibration=0.93)
    assert unsure == "Calibration closes 93 % of the gap; no other cause stands out (p = 0.42)."
    lacks = ("no repeated pushes to two deflections at two lengths",)
    little = line(replace(attribute("unknown", "too little data"), missing=lacks))
    made = (unknown, none, little, line(attribute("none", "none")), line(attribute("none", "noise")))
    assert all(len(said.split()) <= 20 for said in made) and lacks[0] in little


def test_where_most_of_the_gap_lies_is_said_where_no_known_cause_fits() -> None:
    s, rng = states(case(sweep()))[0], np.random.default_rng(1)
    gap = 1e-3 * rng.normal(size=(len(s), 3))
    assert concentrated(s, gap) is None

    def said(where: Any) -> str:
        found = concentrated(s, np.where(where[:, None], 8 * gap, gap))
        assert found is not None and found.rmse_mm == pytest.approx(8 * found.others_mm, rel=0.3)
        a = attribute("unknown", "stage", p=0.98)
        return headline(replace(answer(a), locate=replace(WHERE, concentrated=found)), CATALOGUE).partition("; ")[2]

    chamber = int(np.argmax(s.pressure.max(axis=0))) + 1
    assert said(s.highest > 150e3) == f"the gap is where the pressure of chamber {chamber} is above 100 kPa."
    assert said(s.trial > 4) == "the gap is after trial 4." and said(s.trial <= 4) == "the gap is up to trial 4."
    assert said(s.branch < 0) == "the gap is on the way down."
    turned = states(case([replace(r, pressures=tuple(np.roll(r.pressures, r.trial))) for r in sweep()]))[0]
    assert concentrated(turned, np.where(turned.highest[:, None] > 150e3, 8 * gap, gap)).factor == "highest"  # type: ignore[union-attr]


def tied(effect: str, sizes: dict[str, Value], p: float, other: str, q: float, found: dict[str, Value]) -> str:
    a = attribute("effect", "one of several", sizes, effect, p=p)
    return line(replace(a, ranking=(*a.ranking, Ranked((other,) if other else (), q, 9.0, None, found))))


def test_no_more_is_said_of_several_causes_than_their_names() -> None:
    for effects in itertools.combinations(CATALOGUE, 3):
        said = line(attribute("effect", "one of several", {}, *effects))
        assert len(said.split()) <= 20 and "more" not in said


def test_actuators_are_named_by_number() -> None:
    robot = load(paper_robot(), Robot)
    three = robot.replace(chambers={**robot.model_dump()["chambers"], "azimuths_deg": (0, 120, 240)})
    weak = {"chamber_gain.x": -0.05, "chamber_gain.y": 0.0866, "chamber_gain.single": 1.5}
    sizes = {name: Value(value, 0.01, "1") for name, value in weak.items()}

    def said(robot: Robot, sizes: dict[str, Value]) -> str:
        found, a = by_actuator(robot, CATALOGUE["chamber_gain"], sizes), attribute("effect", "cause", sizes, "chamber_gain")
        assert found is not None
        words = {"chamber_gain": (found.says(robot.actuators.words), found.says(robot.actuators.words, False))}
        return line(replace(a, ranking=(replace(a.ranking[0], in_words=words),)), words=robot.actuators.words)

    assert said(three, sizes) == "Chamber 2 pushes 21 ± 2 % more than the others (p = 0.96)."
    assert said(three, {n: replace(v, value=-v.value) for n, v in sizes.items()}).startswith("Chamber 2 pushes")
    driven = robot.model_copy(update={"chambers": None, "tendons": Tendons(path_radius=0.04, azimuths_deg=(0, 90, 180, 270))})
    side = said(driven, {**sizes, "chamber_gain.single": Value(0.0, 0.5, "1")})
    assert side.startswith("Tendon 4 pulls 16") and "less than tendon 2" in side


def test_no_size_is_said_of_what_is_not_likely() -> None:
    tilt = {"base_tilt.x": Value(0.0628, 0.01, "rad"), "base_tilt.y": Value(0.0, 0.01, "rad")}
    assert line(attribute("effect", "one of several", tilt, "base_tilt", p=0.46)) == ("Possibly tilt of the base (p = 0.46).")


def test_two_that_are_nearly_as_probable_are_both_named() -> None:
    tilt, turn = (
        {f"{effect}.x": Value(angle, 0.01, "rad"), f"{effect}.y": Value(0.0, 0.01, "rad")}
        for effect, angle in (("base_tilt", 0.0628), ("frame_misalignment", 0.0611))
    )
    both = tied("base_tilt", tilt, 0.51, "frame_misalignment", 0.47, turn)
    assert both == "The base is tilted by 3.6 deg or the cameras' frame is turned by 3.5 deg (p = 0.51, 0.47)."
    assert "frame" not in tied("base_tilt", tilt, 0.55, "frame_misalignment", 0.41, turn)
    assert tied("base_tilt", tilt, 0.49, "", 0.45, {}) == "Tilt of the base or no effect (p = 0.49, 0.45)."


def test_both_fit_whichever_they_are() -> None:
    for effect, other in itertools.permutations(CATALOGUE, 2):
        sizes, found = (
            {f"{e}.{p.name}": Value(0.123456 * p.scale, 0.0, p.unit) for p in CATALOGUE[e].parameters} for e in (effect, other)
        )
        said = tied(effect, sizes, 0.59, other, 0.57, found)
        assert len(said.split()) <= 20 and said.endswith("(p = 0.59, 0.57)."), said


def test_a_size_that_is_zero_within_its_error_is_not_named() -> None:
    unsure = Size("base_tilt.x", "rad", 0.001, 0.001, 0.002, -0.2, 0.2, -0.002, 0.004, True)
    found, large = decide(SURE, True), {"base_tilt": 1.4}
    sure, zero = ([(s.effect, s.certain)] for s in (replace(unsure, mean=0.02), unsure))
    assert without_nothing(found, [*zero, *sure], {"base_tilt": 0.3}, 0.025) == found
    assert without_nothing(found, zero, large, 0.025) == found == without_nothing(found, [], {"base_tilt": 0.3}, 0.025)
    none = without_nothing(found, zero, {"base_tilt": 0.3}, 0.025)
    assert (none.verdict, none.effects, none.too_small) == ("none", (), ("base_tilt",)) and none.probability == 0.995


def test_no_fit_of_others_stands_for_a_hypothesis_and_none_that_has_not_ended() -> None:
    def fitted(named: str, log_evidence: float, left: float = 0.0) -> Any:
        return SimpleNamespace(named=(named,), log_evidence=log_evidence, fit=SimpleNamespace(predicted_decrease=left))

    assert own_evidence(("contact",), (fitted("contact", 7.0), fitted("contact", 9.0, left=9.0), fitted("base_tilt", 8.0))) == 7.0
    assert own_evidence(("contact",), (fitted("base_tilt", 8.0), None)) is None
    assert math.isnan(own_evidence(("contact",), (fitted("contact", 9.0, left=9.0),)) or 0.0)
