"""The blind bench: what is drawn and measured, how it is sealed, and how answers are scored."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from benchmarks.blind import run as bench
from benchmarks.blind import truth as drawing
from benchmarks.blind.__main__ import main
from benchmarks.blind.answers import Answer, answer_from
from benchmarks.blind.folder import SetFolder, open_seal
from benchmarks.blind.make import make, walk_of
from benchmarks.blind.metrics import JudgedAnswer, bootstrap, calibration_error, flagged_at, judged, metrics, mm_metrics, share
from benchmarks.blind.score import score, write
from benchmarks.blind.sheet import sheet
from benchmarks.blind.sweeps import BASE, CHANNELS, MENU, design
from benchmarks.blind.truth import Recipe, causes, draw, draw_robot
from benchmarks.blind.worlds.forms import EFFECTS, ON_REQUEST
from benchmarks.blind.worlds.outside_held_out import HELD_OUT
from benchmarks.blind.worlds.table import world
from lab.files.baseline import from_table
from lab.files.config import ConfigError
from lab.files.inputs import read_case
from recordings.table_file import read_csv
from tests.lab.diagnosed_case import EULER
from tests.simulated.bench import raises


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two clean cases and one without a cause, tip alone, with their menus."""
    root = tmp_path_factory.mktemp("bench") / "set"
    make(root, Recipe("bench", 3, 3, ("clean", "none")), "tip")
    return root


@pytest.fixture
def small_set(made: Path, tmp_path: Path) -> Path:
    """A copy of that set, to be answered and scored."""
    return Path(shutil.copytree(made, tmp_path / "small"))


def always_none(folder: Path) -> dict[str, Any]:
    """A diagnosis that never sees anything."""
    return {"attribute": {"verdict": "none", "effects": [], "probability": 0.7, "ranking": [], "credible_set": [[]]}}


def asks(folder: Path) -> dict[str, Any]:
    """A diagnosis that wants to know more, and tells what it was given."""
    table = read_csv(folder / "trials.csv")
    return {
        **always_none(folder),
        "given": [len(table), "qw" in table.columns, "m1x" in table.columns],
        "next_experiment": [{"id": "unload"}, {"id": "tip_mass"}, {"id": "paint_it_blue"}, {"do": "sweep the vacuum"}],
    }


def held_against(folder: Path) -> dict[str, Any]:
    """A diagnosis that tells what lies in its case, and how far the baseline is from what was measured."""
    case = read_case([folder])
    there = from_table(folder / "predicted.csv", case)
    measured = np.array([r.tip for r in case.table])
    return {**always_none(folder), "missed_mm": float(np.linalg.norm(there.predicted.tip - measured, axis=1).max()) * 1e3}


def breaks(folder: Path) -> dict[str, Any]:
    raise ValueError("no idea")


def told(folder: SetFolder, name: str) -> list[dict[str, Any]]:
    """The rounds of an answer."""
    found: list[dict[str, Any]] = json.loads((folder.answers(name) / "rounds.json").read_text())
    return found


# ------------------------------------------------------------------ truth
def test_every_stratum_can_be_asked_for_and_a_mixture_holds_them_all() -> None:
    strata = get_args(drawing.Stratum)
    assert set(drawing.KINDS) == set(drawing.MIXED) == set(strata)
    drawn = [s for s, _ in draw(Recipe("bench", 60, 1))]
    assert set(drawn) == set(strata) and drawn != sorted(drawn, key=strata.index)  # its number says nothing about a case
    assert {s for s, _ in draw(Recipe("bench", 5, 1, ("walls", "none")))} == {"walls", "none"}


def test_sizes_lie_in_the_asked_range_and_clutter_is_every_other_effect() -> None:
    recipe = Recipe("bench", 1, 2, sizes=(0.8, 1.2))
    for place, effect in enumerate(e for e in EFFECTS if e != "chamber_thrust"):
        robot, effects = draw_robot(recipe, place, "cluttered", (effect,))
        low, high = (0.6, 1.0) if EFFECTS[effect].sign == "blend" else (0.8, 1.2)
        assert set(effects) == {effect} and low <= abs(effects[effect]) <= high
        assert set(robot.present) == set(EFFECTS) - {"chamber_thrust"}


def test_clutter_of_one_way_effects_is_never_negative_and_tolerances_grow_with_the_world() -> None:
    exact, loose = "bench", "drawn:6"
    assert world(loose).tolerance > 2.5 * world(exact).tolerance
    sizes = [draw_robot(Recipe(loose, 1, 7), place, "cluttered", ("contact",))[0].sizes for place in range(60)]
    assert all(s.get(e, 0.0) >= 0 for s in sizes for e, info in EFFECTS.items() if info.sign != "both")
    tilt = {
        w: np.std([draw_robot(Recipe(w, 1, 7), k, "none", ())[0].sizes["base_tilt"] for k in range(80)]) for w in (exact, loose)
    }
    assert tilt[loose] > 2 * tilt[exact]


def test_held_out_causes_are_drawn_where_they_are_asked_for_only() -> None:
    assert not set(causes(False)) & set(HELD_OUT) and causes(True) == HELD_OUT
    assert {ids[0] for _, ids in draw(Recipe("bench", 20, 1, ("outside",), held_out=True))} == set(HELD_OUT)


def test_gas_loads_the_walls_of_every_robot_of_a_world_that_says_so_and_of_that_stratum() -> None:
    robot, effects = draw_robot(Recipe("drawn:2", 1, 1), 0, "clean", ("base_tilt",))
    assert robot.sizes["chamber_thrust"] == effects["chamber_thrust"] == world("drawn:2").thrust > 0.5
    robot, effects = draw_robot(Recipe("bench", 1, 1), 0, "walls", ("chamber_thrust",))
    assert set(effects) == {"chamber_thrust"} and effects["chamber_thrust"] >= 0.6


# ------------------------------------------------------------------ cases
def test_a_case_is_the_base_sweep_and_its_seal_tells_mm(made: Path) -> None:
    states = list(BASE.states())
    assert len(states) == 7 * 3 * 11 and {s.branch for s in states} == {"load", "unload"}
    assert {s.hold for s in states if s.pressure == 0} == {5.0} and {s.hold for s in states if s.pressure > 0} == {0.0}
    assert design("full").orientation and not design("full").markers
    for name, truth in open_seal(SetFolder(made)).items():
        table = read_csv(made / "cases" / name / "menu" / "base.csv")
        keys = [(r.trial, r.step, r.branch, r.hold) for r in table]
        assert keys == [(s.trial, s.step, s.branch, s.hold) for s in states]
        assert all(abs(max(r.pressures) - s.pressure) < 3e3 for r, s in zip(table, states, strict=True))
        assert truth["world"] == "bench" and truth["floor_mm"] > 0.2
        assert truth["kind"] == ("single" if truth["effects"] else "none")
        for cause in truth["effects"]:
            assert 0 < truth["calibrated_mm"][cause] <= truth["moves_mm"][cause]


@pytest.mark.parametrize("sweep", [BASE, *MENU], ids=lambda s: s.name)
def test_legs_of_a_sweep_read_as_often_as_its_states(sweep: Any) -> None:
    walked = walk_of(sweep)
    assert sum(leg.read for leg in walked.legs) * len(walked.trials) == len(list(sweep.states()))
    assert all(leg.hold >= 0 for leg in walked.legs)


def test_what_cannot_be_drawn_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words, said in (
        (["--world", "moon"], "must be bench, drawn:SEED"),
        (["--cause", "force_bias"], "--cause force_bias: must be one of"),
        (["--sizes", "2", "1"], "--sizes 2 1: must increase"),
        (["--clutter", "2"], "--clutter 2: must be within 0..1"),
        (["--n", "0"], "--n 0: must be 1 or more"),
    ):
        assert main(["make", "--n", "1", "--seed", "1", *words, str(tmp_path / "set")]) == 2
        assert said in capsys.readouterr().err


def test_a_tip_case_is_the_paper_s_own_data(made: Path) -> None:
    table = read_csv(made / "cases" / "0001" / "trials.csv")
    assert len(table) == 35 * 3 and set(table["branch"]) == {"load"} and "qw" not in table.columns
    assert np.unique(table["trial"]).size == 21


def test_no_file_of_a_case_tells_what_was_on(made: Path) -> None:
    for file in [*made.glob("cases/**/*"), made / "commitment.json"]:
        if file.is_file():
            text = file.read_text()
            assert not any(f'"{n}"' in text or f"\n{n}" in text for n in (*EFFECTS, *ON_REQUEST)), file
    assert "seed" not in json.loads((made / "commitment.json").read_text())


# ------------------------------------------------------------------ seal
def test_a_changed_truth_is_noticed(small_set: Path) -> None:
    folder = SetFolder(small_set)
    assert len(open_seal(folder)) == 3
    folder.seal.chmod(0o600)
    folder.seal.write_text(folder.seal.read_text() + " ")
    raises(ConfigError, "changed after it was committed", open_seal, folder)


def test_a_set_is_not_made_over_another(made: Path) -> None:
    raises(ConfigError, "not empty", make, made, Recipe("bench", 1, 1), "tip")


# ------------------------------------------------------------------ run
def test_a_diagnosis_is_given_what_it_asks_for_and_nothing_else(small_set: Path) -> None:
    folder = SetFolder(small_set)
    for name, chosen in (("0001", 2), ("0002", 0)):
        bench.answer(folder, asks, chosen, name)
    rounds = told(folder, "0001")
    assert [r["asked"] for r in rounds] == [[], ["unload"], ["unload", "tip_mass"]]
    given = [r["diagnosis"]["given"] for r in rounds]
    assert given == [[105, False, False], [231, False, False], [231 + 24, False, False]]
    assert len(told(folder, "0002")) == 1


@pytest.mark.parametrize("wish", [s.name for s in MENU] + list(CHANNELS))
def test_everything_on_the_menu_can_be_had(made: Path, wish: str) -> None:
    case = made / "cases" / "0001"
    table = read_csv(case / "trials.csv")
    wider = bench.granted(table, case / "menu", wish)
    assert len(wider) > len(table) or set(wider.columns) > set(table.columns)
    assert [(r.trial, r.step) for r in wider] == sorted((r.trial, r.step) for r in wider)
    assert wish in bench.MENU_OF.values()


def test_a_simulator_s_predictions_are_the_baseline_of_a_set(tmp_path: Path) -> None:
    (tmp_path / "euler.py").write_text(EULER)
    root = tmp_path / "set"
    make(root, Recipe("bench", 1, 5, ("none",)), "tip", menu=False, simulator=str(tmp_path / "euler.py"))
    folder = SetFolder(root)
    assert json.loads((root / "commitment.json").read_text())["simulator"].endswith("euler.py")
    (name,) = folder.names()
    rod, predicted = (folder.case(name) / n for n in ("trials.csv", "predicted.csv"))
    assert len(predicted.read_text().splitlines()) == len(rod.read_text().splitlines())
    assert bench.run(root, held_against) == 1
    (first,) = told(folder, name)
    # an area factor of 1.6 where the truth lies between 1.4 and 1.8, and the Euler integration's own error
    assert 1.0 < first["diagnosis"]["missed_mm"] < 60.0


def test_a_failing_diagnosis_is_an_answer_and_a_wrong_one(small_set: Path) -> None:
    folder = SetFolder(small_set)
    bench.answer(folder, breaks, 0, "0002")
    found = answer_from("0002", told(folder, "0002")[0]["diagnosis"])
    assert found.verdict == "failed" and "no idea" in found.error


def test_a_set_is_scored_once_all_cases_are_answered_and_then_closed(small_set: Path) -> None:
    raises(ConfigError, "have no answer", score, small_set)
    assert bench.run(small_set, always_none) == 3
    result = score(small_set)
    write(result, small_set)
    found = {m.key: m.found for m in result.figures}
    assert found["top1"].value == 0 and found["false_alarm"].value == 0 and found["failed"].value == 0
    assert any(m.key == "top1" for m, _ in result.shortfalls)
    assert sheet(result).row_count > 10
    json.dumps(result.as_dict(), allow_nan=False)
    raises(ConfigError, "not blind", bench.run, small_set, always_none)


def test_answers_of_another_method_are_scored_on_the_same_cases(
    small_set: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    truth = open_seal(SetFolder(small_set))
    for name, sealed in truth.items():
        effects = sorted(sealed["effects"]) if sealed["kind"] != "outside" else []
        verdict = {"single": "effect", "pair": "effect", "none": "none", "outside": "unknown"}[sealed["kind"]]
        (theirs / f"{name}.json").write_text(
            json.dumps({"attribute": {"verdict": verdict, "effects": effects, "probability": 0.9, "ranking": []}})
        )
    assert all(c.exact for c in score(small_set, theirs).cases)
    words = ["score", str(small_set), "--answers", str(theirs)]
    assert main([*words, "--json"]) in (0, 1) and json.loads(capsys.readouterr().out)["schema"] == "blind-score/1"
    assert (theirs / "score.json").exists()
    raises(ConfigError, "not blind", bench.run, small_set, always_none)
    (theirs / f"{min(truth)}.json").write_text("[1]")
    assert main(words) == 2 and "holds no answer; write {" in capsys.readouterr().err
    (theirs / f"{min(truth)}.json").unlink()
    raises(ConfigError, r"have no answer .* write .*CASE\.json", score, small_set, theirs)


# ------------------------------------------------------------------ figures
STRATA = {"single": "clean", "pair": "pairs"}


def made_up(kind: str, truth: set[str], named: set[str], p: float, verdict: str = "effect", **more: Any) -> JudgedAnswer:
    ranking = ((frozenset(named), p),) if named else ()
    a = Answer("1", verdict, frozenset(named), p, ranking, (frozenset(named),), **more)
    return JudgedAnswer(STRATA.get(kind, kind), frozenset(truth), a)


def test_figures_of_answers_made_by_hand() -> None:
    right = made_up("single", {"contact"}, {"contact"}, 0.95)
    wrong = made_up("single", {"contact"}, {"base_tilt"}, 0.55)
    pair = made_up("pair", {"contact", "base_tilt"}, {"contact", "base_tilt", "spine_slip"}, 0.6)
    alarm = made_up("none", set(), {"contact"}, 0.5)
    found = {m.key: m.found.value for m in metrics([right, right, right, wrong, pair, alarm])}
    assert found["top1"] == 0.75 and found["sure_right"] == 1.0 and found["sure_share"] == 0.75
    assert found["pair_both"] == 1.0 and found["pair_exact"] == 0.0 and found["pair_spurious"] == 1.0
    assert found["false_alarm"] == 1.0 and found["coverage"] == pytest.approx(3 / 5)


def test_unknowns_are_flagged_by_their_probability_at_ten_percent_false_flags() -> None:
    known = [made_up("single", {"contact"}, {"contact"}, 0.9, unknown_probability=i / 100) for i in range(50)]
    outside = [made_up("outside", set(), set(), p, "unknown", unknown_probability=p) for p in (0.1, 0.9, 0.95, 0.99)]
    assert flagged_at(known, outside).value == 0.75
    silent = [replace(c, answer=replace(c.answer, unknown_probability=0.0)) for c in known + outside]
    assert flagged_at(silent[:50], silent[50:]).value == 0.0


def test_calibration_error_is_none_for_honest_and_half_for_bold_answers() -> None:
    honest = np.array([[0.75, 1], [0.75, 1], [0.75, 1], [0.75, 0]], float)
    bold = np.array([[1.0, 1], [1.0, 0]], float)
    assert calibration_error(honest) == pytest.approx(0.0) and calibration_error(bold) == pytest.approx(0.5)


def test_exact_intervals_agree_with_the_rule_of_three() -> None:
    none_of_300 = share(np.zeros(300))
    assert none_of_300.low == 0 and none_of_300.high == pytest.approx(1 - 0.025 ** (1 / 300))
    mean = bootstrap(np.random.default_rng(1).normal(5, 1, 400), lambda v: float(v.mean()))
    assert mean.low < 5 < mean.high and mean.high - mean.low == pytest.approx(2 * 1.96 / 20, rel=0.2)


def answered(*named: str, p: float = 0.95, **more: Any) -> Answer:
    return Answer("1", "effect" if named else "none", frozenset(named), p, credible=(frozenset(named),), **more)


def case(answer: Answer, *causes: str, stratum: str = "cluttered", **carries: float) -> JudgedAnswer:
    return JudgedAnswer(stratum, frozenset(causes), answer, carries, 0.9, {"effect": "base_tilt", "leaves_mm": 2.0})


def test_right_by_mm_is_what_carries_half_of_the_largest_and_a_floor() -> None:
    assert case(answered("contact"), "contact", contact=4.0, base_tilt=3.0).right
    assert case(answered("base_tilt"), "contact", contact=4.0, base_tilt=3.0).right
    assert not case(answered("base_tilt"), "contact", contact=4.0, base_tilt=1.5).right
    assert not case(answered("contact", "base_tilt"), "contact", contact=4.0, base_tilt=1.5).right
    assert not case(answered("contact"), "contact", contact=0.8).right
    assert case(answered("contact", "base_tilt"), "contact", contact=5.0, base_tilt=3.0).right
    assert not case(answered("base_tilt"), "contact", contact=1.5, base_tilt=0.8).right  # less than a floor
    assert case(answered(), "contact", contact=1.7).right and not case(answered(), "contact", contact=1.9).right


def test_figures_by_mm_of_answers_made_by_hand() -> None:
    sure = answered("contact", budget={"contact": (3.0, 5.0)})
    wide = answered("base_tilt", p=0.5, budget={"contact": (0.0, 1.0)})
    cases = [
        case(sure, "contact", contact=4.0, base_tilt=1.0),
        case(wide, "contact", contact=4.0, base_tilt=1.0),
        case(answered(), stratum="cluttered_none", base_tilt=0.5),
        case(answered("base_tilt"), "camera_scale", stratum="cluttered_outside", camera_scale=3.0),
    ]
    found = {m.key: m.found for m in mm_metrics(cases)}
    assert found["cluttered.right"].value == found["cluttered.spurious"].value == found["cluttered.inside"].value == 0.5
    assert found["cluttered.sure_right"].value == 1.0 and found["cluttered.sure_share"].value == 0.5
    assert found["cluttered_none.right"].value == 1.0 and found["cluttered_none.exact"].n == 0
    assert found["cluttered_outside.named"].value == 1.0 and found["cluttered_outside.flagged_apart"].n == 1


def test_the_stage_of_an_outside_cause_is_scored_where_it_is_called_unknown() -> None:
    recipe = Recipe("bench", 1, 1)
    robot, effects = draw_robot(recipe, 0, "outside", ("warm_room",))
    truth = drawing.Truth("1", "outside", robot, effects, calibrated_mm={"warm_room": 3.0}).as_dict()
    assert truth["stage"] == "material"
    assert drawing.Truth("1", "clean", *draw_robot(recipe, 0, "clean", ("contact",))).as_dict()["stage"] is None

    def told(verdict: str, *stages: str) -> JudgedAnswer:
        errors = [{"stage": s, "dependence": "time", "gain": 9.0} for s in stages]
        return judged(truth, answer_from("1", {"attribute": {"verdict": verdict, "stage_errors": errors}}))

    cases = [told("unknown", "material", "load"), told("unknown", "load"), told("unknown"), told("none", "material")]
    (stage,) = (m.found for m in mm_metrics(cases) if m.key == "outside.stage")
    assert stage.n == 3 and stage.value == pytest.approx(1 / 3)
