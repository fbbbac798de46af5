"""The diagnosis of any model: a swinging pendulum, and an arm of two links."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

import lab
from diagnosis.any_model.answer import Answer
from diagnosis.errors import BadCase
from model.arrays import Array

Values = Mapping[str, float]

ROWS, STEP, SUB_STEPS = 30, 0.1, 4


def pendulum(theta: Values, inputs: pd.DataFrame) -> Array:
    """Angle of each trial over time, rad."""
    start = inputs.groupby("trial", sort=False)["start"].first().to_numpy(float)
    angle, speed, rows, h = start.copy(), np.zeros(len(start)), [], STEP / SUB_STEPS
    for _ in range(ROWS):
        rows.append(angle.copy())
        for _ in range(SUB_STEPS):
            rub = theta["rub"] * np.tanh(speed / 0.05)
            speed -= h * (9.81 / theta["length"] * np.sin(angle) + theta["drag"] * speed + rub + theta["loose"] * angle**3)
            speed -= h * theta.get("wind", 0.0) * np.cos(angle)
            angle += h * speed
    return np.array(rows).T.ravel()


SWINGS = {
    "drag": lab.Cause("drag", {"drag": (0.0, 0.1, "1/s", 0.0, 2.0)}, says="the air drags"),
    "rub": lab.Cause("friction", {"rub": (0.0, 0.3, "rad/s2", 0.0, 5.0)}, says="the bearing rubs"),
    "loose": lab.Cause("pivot", {"loose": (0.0, 1.0, "1/s2")}, stage="boundary", says="the pivot is loose"),
}
STILL = {"length": 1.0, "drag": 0.0, "rub": 0.0, "loose": 0.0}


def wandering(rng: np.random.Generator, count: int) -> Array:
    """Errors of size 1 in each of `count` swings that are forgotten over ten rows."""
    errors = rng.normal(0, 1, (ROWS, count))
    for i in range(1, ROWS):
        errors[i] = 0.9 * errors[i - 1] + np.sqrt(1 - 0.9**2) * errors[i]
    return errors.T.ravel()


def swung(seed: int, repeats: int = 1, lasting: bool = False, **truth: float) -> Answer:
    starts = np.tile([0.3, 0.7, 1.2], repeats)
    inputs = pd.DataFrame({"trial": np.repeat(np.arange(len(starts)), ROWS), "start": np.repeat(starts, ROWS)})
    rng = np.random.default_rng(seed)
    errors = wandering(rng, len(starts)) if lasting else rng.normal(0, 1, len(inputs))
    angle = pendulum({**STILL, "length": 1.015, **truth}, inputs) + 0.004 * errors
    return lab.diagnose_model(
        pendulum, inputs.assign(angle=angle), {"angle": "rad"}, list(SWINGS.values()), {"length": (1.0, 0.03, "m")}, group="trial"
    )


@pytest.mark.parametrize("cause", SWINGS)
def test_the_cause_of_a_pendulum_is_named_with_its_size(cause: str) -> None:
    size = {"drag": 0.11, "rub": 0.22, "loose": 0.7}[cause]
    answer = swung(0, **{cause: size})
    assert answer.effects == (SWINGS[cause].name,) and answer.certain and answer.probability > 0.9
    assert abs(answer.sizes[0].value - size) < 4 * answer.sizes[0].sd
    assert SWINGS[cause].says in answer.headline and "too few repeats" in " ".join(answer.notes)


def test_the_name_of_a_unit_weighs_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    before = swung(0, rub=0.22)
    monkeypatch.setitem(SWINGS, "rub", lab.Cause("friction", {"rub": (0.0, 0.3, "N m", 0.0, 5.0)}, says="the bearing rubs"))
    assert swung(0, rub=0.22).probability == before.probability


def test_a_pendulum_of_another_length_needs_no_cause() -> None:
    answer = swung(7)
    assert (answer.verdict, answer.effects) == ("none", ())
    assert answer.calibration["length"][0] == pytest.approx(1.015, abs=0.003)


def test_equal_trials_show_the_noise() -> None:
    answer = swung(3, repeats=3, drag=0.1)
    assert answer.noise_from == "from repeats" and answer.notes == () and answer.effects == ("drag",)
    assert answer.steps[-1].seen.by_output["angle"] == pytest.approx(0.004, rel=0.2)


def test_errors_that_last_over_rows_are_no_cause() -> None:
    alone, repeated = swung(0, lasting=True), swung(0, repeats=3, lasting=True)
    assert alone.verdict == repeated.verdict == "none" and alone.probability <= 0.8 < repeated.probability
    assert "last over several rows" in alone.doubts[0] and repeated.doubts == ()
    assert repeated.steps[-1].seen.by_output["angle"] == pytest.approx(0.004, rel=0.4)


def test_repeats_of_a_swing_are_held_out_together() -> None:
    answer = swung(4, repeats=3, wind=0.4)
    assert answer.verdict == "unknown" and answer.steps[1].unseen.floors > answer.steps[1].seen.floors  # type: ignore[union-attr]


def test_a_swing_whose_beginning_is_calibrated_is_held_out_in_parts() -> None:
    def begun(theta: Values, inputs: pd.DataFrame) -> Array:
        return pendulum({**STILL, **theta}, inputs.assign(start=inputs["trial"].map(lambda trial: theta[f"start_{trial}"])))

    trials = pd.DataFrame({"trial": np.repeat([0, 1], ROWS)})
    true = {"start_0": 0.5, "start_1": 1.2, "length": 1.01, "drag": 0.1}
    angle = begun(true, trials) + np.random.default_rng(5).normal(0, 0.004, len(trials))
    starts = {f"start_{trial}": (0.8, 0.5, "rad") for trial in (0, 1)}
    answer = lab.diagnose_model(begun, trials.assign(angle=angle), {"angle": "rad"}, [SWINGS["drag"], SWINGS["loose"]],
                                {"length": (1.0, 0.03, "m"), **starts}, group="trial")  # fmt: skip
    assert answer.effects == ("drag",) and answer.certain and answer.how == "a fifth of the series left out in turn"


# ------------------------------------------------------------------ an arm
def arm(theta: Values, inputs: pd.DataFrame) -> Array:
    """Tip (x, y) of two links, m."""
    q1, q2 = inputs["q1"].to_numpy(float), inputs["q2"].to_numpy(float) + theta["zero"]
    q1 = q1 + theta["gear"] * np.sin(q1)
    reach = 0.4 + theta["longer"]
    x, y = reach * np.cos(q1) + 0.3 * np.cos(q1 + q2), reach * np.sin(q1) + 0.3 * np.sin(q1 + q2)
    bent = theta.get("hidden", 0.0)
    c, s = np.cos(theta["tilt"]), np.sin(theta["tilt"])
    return np.column_stack([
        c * x - s * y + theta["x0"] + bent * np.sin(2 * q2),
        s * x + c * y + theta["y0"] + bent * np.cos(q1) * q2,
    ])  # fmt: skip


def with_relatives(theta: Values, inputs: pd.DataFrame) -> Array:
    """The same arm with more that may be wrong."""
    q1 = inputs["q1"].to_numpy(float)
    return arm(theta, inputs.assign(q1=q1 + theta.get("shoulder", 0.0) + theta.get("late", 0.0) * np.sin(2 * q1)))


JOINTS = [
    lab.Cause("elbow", {"zero": (0.0, 0.01, "rad")}, stage="measurement", says="the elbow's zero is off"),
    lab.Cause("link", {"longer": (0.0, 0.003, "m")}, says="the upper link has another length"),
    lab.Cause("gear", {"gear": (0.0, 0.01, "rad")}, stage="actuation", says="the gear errs once a turn"),
    lab.Cause("base", {"tilt": (0.0, 0.01, "rad")}, stage="boundary", says="the base is turned", exact=True),
]
ELBOW = JOINTS[0]
PLACE = {"x0": (0.0, 0.01, "m"), "y0": (0.0, 0.01, "m")}
AS_DRAWN = {"zero": 0.0, "longer": 0.0, "gear": 0.0, "tilt": 0.0, "x0": 0.0, "y0": 0.0}


def posed(seed: int, repeats: int = 2, **truth: float) -> pd.DataFrame:
    rng = np.random.default_rng(seed)
    poses = pd.DataFrame(np.tile(rng.uniform(-1.8, 1.8, (25, 2)), (repeats, 1)), columns=["q1", "q2"])
    tip = with_relatives({**AS_DRAWN, "x0": 0.005, **truth}, poses) + rng.normal(0, 2e-4, (len(poses), 2))
    return poses.assign(x=tip[:, 0], y=tip[:, 1])


def of_arm(data: pd.DataFrame, **keys: Any) -> Answer:
    given: dict[str, Any] = {"predict": arm, "outputs": {"x": "m", "y": "m"}, "causes": JOINTS, "calibration": PLACE}
    return lab.diagnose_model(**{**given, "data": data, **keys})


@pytest.mark.parametrize(
    ("key", "cause", "true"),
    [("zero", "elbow", -0.013), ("longer", "link", 2.2e-3), ("gear", "gear", 0.008), ("tilt", "base", -0.007)],
)
def test_the_cause_of_an_arm_is_named_with_its_size(key: str, cause: str, true: float) -> None:
    answer = of_arm(posed(0, **{key: true}))
    assert answer.effects == (cause,) and answer.certain and answer.probability > 0.9
    assert abs(answer.sizes[0].value - true) < 4 * answer.sizes[0].sd < 0.35 * abs(true)


def test_two_causes_of_an_arm_are_named_together() -> None:
    answer = of_arm(posed(11, zero=0.011, longer=-0.004))
    assert answer.effects == ("elbow", "link") and answer.probability > 0.9


def test_an_arm_as_drawn_has_no_cause() -> None:
    for repeats in (1, 3):
        assert of_arm(posed(12 + repeats, repeats)).verdict == "none"


def test_a_cause_that_nobody_listed_is_outside() -> None:
    for repeats in (1, 3):
        answer = of_arm(posed(20 + repeats, repeats, hidden=0.006))
        assert answer.verdict == "unknown" and answer.effects == () and answer.probability > 0.5
        assert answer.headline.startswith("A cause outside of the list") and "the inputs" in answer.goes_with


def test_a_relative_that_does_as_well_is_doubt_and_one_that_does_better_takes_the_place_of_its_cause() -> None:
    turned = lab.Cause("shoulder", {"shoulder": (0.0, 0.01, "rad")}, says="the shoulder's zero is off")
    late = lab.Cause("late", {"late": (0.0, 0.01, "rad")}, says="the gear errs twice a turn")
    causes = [*JOINTS[:2], replace(JOINTS[2], relatives=[late]), replace(JOINTS[3], relatives=[turned])]

    def of(seed: int, **truth: float) -> Answer:
        return of_arm(posed(seed, **truth), causes=causes, predict=with_relatives)

    answer = of(1, tilt=0.012)  # turning the shoulder turns the whole arm
    assert answer.effects == ("base",) and answer.probability < 0.8 and not answer.certain
    assert answer.relatives == ("the shoulder's zero is off",) and "as good an explanation" in answer.statement
    answer = of(2, late=0.012)
    assert answer.verdict == "unknown" and answer.relatives == ("the gear errs twice a turn",)
    answer = of(3, gear=0.012)
    assert answer.effects == ("gear",) and answer.certain and answer.relatives == ()


def tanks(theta: Values, inputs: pd.DataFrame) -> Array:
    """Level of the lower of two tanks, fed by the upper one, which overflows at its rim."""
    upper, lower, rows = theta["upper"], theta["lower"], []
    rim = 10 - theta["low"] if theta["low"] > 0 else np.inf
    for u in inputs["u"].to_numpy():
        rows.append(lower)
        for _ in range(2):
            out = theta["k1"] * np.sqrt(max(upper, 0.0))
            upper += theta["k3"] * (1 - theta["bend"] * u) * u - out
            lower += out - theta["k2"] * np.sqrt(max(lower, 0.0)) + 0.3 * max(upper - rim, 0.0) - theta["leak"] * lower
            upper = min(upper, rim)
    return np.array(rows)


def test_a_cause_without_which_the_calibration_goes_astray_is_named() -> None:
    angle, phase = np.outer(np.arange(200) * 2 * np.pi / 200, np.arange(1, 8)), np.random.default_rng(4).uniform(0, 6.28, 7)
    inputs = pd.DataFrame({"u": 2.6 + 0.8 * np.sin(angle + phase).sum(axis=1) / np.sqrt(3.5)})
    truth = {"k1": 0.07, "k2": 0.08, "k3": 0.076, "upper": 5.0, "lower": 4.0, "low": 2.0, "leak": 0.0, "bend": 0.0}
    level = tanks(truth, inputs) + np.random.default_rng(4).normal(0, 0.02, 200)
    causes = [lab.Cause("overflow", {"low": (0.0, 1.0, "V")}), lab.Cause("leak", {"leak": (0.0, 0.004, "1/s")}),
              lab.Cause("pump", {"bend": (0.0, 0.005, "1/V")})]  # fmt: skip
    calibration = dict.fromkeys(("k1", "k2", "k3"), (0.1, 0.06, "1/s")) | dict.fromkeys(("upper", "lower"), (4.0, 3.0, "V"))
    answer = lab.diagnose_model(tanks, inputs.assign(level=level), {"level": "V"}, causes, calibration)
    assert answer.effects == ("overflow",) and answer.certain and answer.sizes[0].value == pytest.approx(2.0, abs=0.3)


def test_a_cause_that_acts_beyond_its_plausible_size_and_in_one_series_alone_is_named() -> None:
    """Without that series nothing shows how large it is."""
    flow = np.repeat([1.6, 1.9, 3.1, 2.2], 60) * (1 + 0.1 * np.sin(np.arange(240) / 4))
    inputs = pd.DataFrame({"trial": np.repeat(np.arange(4), 60), "u": flow})

    def filled(theta: Values, inputs: pd.DataFrame) -> Array:
        still = {"k3": 0.1, "upper": 3.0, "lower": 3.0, "bend": 0.0}
        return np.concatenate([tanks(still | theta, own) for _, own in inputs.groupby("trial", sort=False)])

    level = filled({"k1": 0.102, "k2": 0.1, "low": 3.0, "leak": 0.0}, inputs) + np.random.default_rng(1).normal(0, 0.02, 240)
    causes = [lab.Cause("overflow", {"low": (0.0, 1.0, "V", 0.0, 8.0)}), lab.Cause("leak", {"leak": (0.0, 0.004, "1/s")})]
    calibration = dict.fromkeys(("k1", "k2"), (0.1, 0.01, "1/s"))
    answer = lab.diagnose_model(filled, inputs.assign(level=level), {"level": "V"}, causes, calibration, group="trial")
    assert answer.effects == ("overflow",) and answer.certain and "pieces of each series" in answer.how


def test_single_values_far_from_every_model_hide_no_cause() -> None:
    strayed = posed(2, zero=0.012)
    strayed.loc[[3, 11], "x"] += [0.4, -0.3]
    answer = of_arm(strayed)
    assert answer.effects == ("elbow",) and answer.certain
    assert any("2 values lie 15 times farther" in note and "rows 3, 11" in note for note in answer.notes)


def test_what_is_doubted_is_no_more_probable_than_four_fifths() -> None:
    answer = of_arm(posed(2, zero=0.06))
    assert answer.effects == ("elbow",) and answer.probability <= 0.8 and not answer.certain
    assert answer.doubts == ("zero is 6 times its plausible size",)


def test_the_gap_is_stated_step_by_step_in_the_units_of_the_outputs() -> None:
    answer = of_arm(posed(5, zero=0.012))
    assert [s.step for s in answer.steps] == ["as given", "calibrated", "with the cause", "noise floor"]
    given, calibrated, caused, floor = (s.seen for s in answer.steps)
    assert given.floors > calibrated.floors > 3 > caused.floors and floor.floors == 1
    assert floor.by_output["x"] == pytest.approx(2e-4, rel=0.5) and answer.share_closed > 0.9  # type: ignore[operator]
    assert answer.steps[2].unseen.by_output["y"] < 3e-4  # type: ignore[union-attr]
    plain = json.loads(json.dumps(answer.as_dict(), allow_nan=False))
    assert plain["schema"] == "diagnosis/1" and plain["attribute"]["effects"] == ["elbow"]
    assert repr(answer) == f"<Answer: {answer.headline}>"


def test_the_pose_that_shows_most_is_proposed() -> None:
    """Two causes that do the same with a straight elbow differ most where it is bent."""
    rng = np.random.default_rng(0)
    poses = pd.DataFrame({"q1": rng.uniform(-1.5, 1.5, 40), "q2": 0.0})
    tip = arm({**AS_DRAWN, "tilt": 0.012}, poses) + rng.normal(0, 2e-4, (40, 2))
    candidates = pd.DataFrame({"q1": 0.3, "q2": [0.0, 1.6, 0.1]})
    causes = [JOINTS[3], lab.Cause("shoulder", {"zero": (0.0, 0.02, "rad")})]
    answer = of_arm(poses.assign(x=tip[:, 0], y=tip[:, 1]), causes=causes, candidates=candidates,
                    predict=lambda theta, inputs: arm({**AS_DRAWN, **theta}, inputs), calibration={})  # fmt: skip
    assert answer.next_experiment[0].at == 1
    assert answer.next_experiment[0].squared_difference > answer.next_experiment[1].squared_difference


def test_a_model_is_asked_no_more_than_it_must() -> None:
    asked: list[Values] = []

    def slow(theta: Values, inputs: pd.DataFrame) -> Array:
        asked.append(theta)
        return arm(theta, inputs)

    assert of_arm(posed(6, gear=0.01), predict=slow).effects == ("gear",)
    assert len(asked) < 105 and len({tuple(theta.values()) for theta in asked}) >= len(asked) - 2  # twice with rows reversed


def test_of_causes_that_cannot_be_told_apart_the_best_is_named_in_doubt() -> None:
    """Turning the base or the shoulder is the same, so that either may be zero."""
    causes = [JOINTS[3], lab.Cause("shoulder", {"shoulder": (0.0, 0.01, "rad")})]
    answer = of_arm(posed(1, tilt=0.012), causes=causes, predict=lambda t, x: with_relatives({**AS_DRAWN, **t}, x))
    assert answer.verdict == "effect" and len(answer.effects) == 1 and answer.probability < 0.8 and not answer.certain
    assert answer.cannot_tell_apart == (("base", "shoulder"),)


@dataclass
class Offers:
    """The arm with derivatives of its own."""

    offered: dict[str, Array]
    asked: int = 0

    def __call__(self, theta: Values, inputs: pd.DataFrame) -> Array:
        return arm({**AS_DRAWN, **theta}, inputs)

    def derivatives(self, theta: Values, inputs: pd.DataFrame) -> dict[str, Array]:
        self.asked += 1
        return self.offered


def test_derivatives_that_a_model_offers_are_used() -> None:
    offers = Offers({"x0": np.tile([1.0, 0.0], (50, 1)), "y0": np.tile([0.0, 1.0], (50, 1))})
    assert of_arm(posed(6, gear=0.01), predict=offers).effects == ("gear",) and offers.asked


def test_rows_that_lack_values_are_left_out_with_a_note() -> None:
    data = posed(8, zero=0.01).assign(remark=None, spare=np.nan)
    data.loc[3, "q1"], data.loc[5, "y"], data.loc[7, "remark"] = np.nan, np.nan, "slow"
    candidates = pd.DataFrame({"q1": [0.3, np.nan, 0.5], "q2": 1.0, "remark": None, "spare": np.nan})
    answer = of_arm(data, candidates=candidates, predict=lambda t, x: {"y": arm(t, x)[:, 1], "x": arm(t, x)[:, 0]})
    assert answer.effects == ("elbow",) and answer.rows == len(data) - 1
    assert "1 of 50 rows lack q1 and are ignored: row 3" in answer.notes
    assert sorted(p.at for p in answer.next_experiment) == [0, 2]
    assert any("lack an output" in note and "row 5" in note for note in answer.notes)


def test_rows_that_the_model_does_not_answer_are_left_out_with_a_note() -> None:
    def half(theta: Values, inputs: pd.DataFrame) -> Array:
        far = (inputs["q1"].abs() > 1.6).to_numpy() | (abs(theta["zero"]) > 0.015)
        return np.where(far[:, None], np.nan, arm(theta, inputs))

    data = posed(8, zero=0.01)
    answer = of_arm(data, predict=half)
    assert answer.effects == ("elbow",)
    assert f"no answer at nominal parameters in {(data['q1'].abs() > 1.6).sum()} rows" in answer.notes[0]


def test_inputs_that_never_change_are_diagnosed() -> None:
    answer = of_arm(posed(8, zero=0.03).assign(q1=0.3, q2=0.4), calibration={}, predict=lambda t, x: arm({**AS_DRAWN, **t}, x))
    assert answer.rows == 50 and not answer.certain


def test_copies_of_rows_are_no_repeats_that_show_the_noise() -> None:
    data = posed(8, repeats=1, zero=0.012)
    answer = of_arm(pd.concat([data, data]).rename(columns={"x": 0, "y": 1}), outputs={0: "m", 1: "m"})
    assert answer.effects == ("elbow",) and answer.steps[-1].seen.by_output["0"] == pytest.approx(2e-4, rel=0.5)


def test_a_cause_that_changes_nothing_is_said_to_be_unseen() -> None:
    idle = lab.Cause("idle", {"idle": (0.0, 1.0, "1")})
    answer = of_arm(posed(9, zero=0.01), causes=[*JOINTS, idle])
    assert answer.effects == ("elbow",) and any(note.startswith("idle cannot be seen") for note in answer.notes)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"outputs": {"z": "m"}}, "outputs: no column 'z' in data; it has q1, q2, x, y"),
        ({"group": "trial"}, "group: no column 'trial'"),
        ({"predict": lambda theta, inputs: np.zeros(len(inputs))}, r"predict returned shape \(50,\), must be \(50, 2\)"),
        ({"predict": lambda theta, inputs: np.full((len(inputs), 2), np.nan)}, "predict returned NaN at nominal"),
        ({"predict": lambda theta, inputs: np.zeros((len(inputs), 2))}, "none of them changes a measured output"),
        ({"predict": lambda theta, inputs: inputs["q3"]}, "predict raised KeyError: 'q3' at zero=0, .*x0=0"),
        ({"causes": []}, "causes: none given"),
        ({"causes": [ELBOW, ELBOW]}, "cause 'elbow' is given 2 times"),
        ({"causes": [ELBOW, lab.Cause("other", ELBOW.parameters)]}, "parameter 'zero' is given 2 times"),
        ({"causes": [lab.Cause("a", {"zero": (0.0, 0.0, "rad")})]}, "a.zero: nominal 0, plausible size 0"),
        ({"causes": [lab.Cause("a", {"zero": (0.0, 0.1)})]}, "a.zero: .*write"),
        ({"causes": [lab.Cause("a", {"zero": (0.0, 0.1, "rad", 1.0, 2.0)})]}, "a.zero: nominal 0 must lie within its bounds"),
        ({"causes": ELBOW}, "causes: must be a list of lab.Cause"),
        ({"causes": [lab.Cause("a", ["zero"])]}, "cause 'a': .*'zero'.*write {parameter"),  # type: ignore[arg-type]
        ({"causes": [lab.Cause("a", {"zero": (0.0, 0.01, None)})]}, "a.zero: unit None; write it as text"),
        ({"calibration": ["x0"]}, "calibration: .*'x0'.*write {parameter"),
        ({"outputs": {"x": None, "y": "m"}}, "outputs: x has no unit; write it as text"),
        ({"data": posed(1)[["q1", "q1", "q2", "x", "y"]]}, "data: column 'q1' appears more than once"),
        ({"data": posed(1).iloc[:3]}, "data: 6 measured values are too few for 6 parameters; measure 9 or more"),
        ({"predict": lambda theta, inputs: {"x": 0.0}}, r"predict returned dict, must be an array of numbers \(50, 2\)"),
        ({"predict": Offers({"zero": np.zeros(3)})}, "predict.derivatives failed with ValueError: .*it must return parameter"),
        ({"candidates": [1]}, "candidates: list, must be a pandas.DataFrame"),
        ({"candidates": pd.DataFrame({"q1": [0.0]})}, "candidates: no column 'q2'"),
    ],
)
def test_bad_input_is_one_clear_error(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(BadCase, match=message):
        of_arm(**{"data": posed(1), **keys})
