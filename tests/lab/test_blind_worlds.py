"""Blind cases of other worlds: what is drawn, what is sealed, and how answers are scored by mm."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lab.blind.answers import Answer, answer_from
from lab.blind.folder import SetFolder, open_seal
from lab.blind.options import STRATA
from lab.blind.score import score
from lab.blind.sheet import sheet
from lab.blind.sweeps import BASE, MENU
from lab.blind.workers import Crew
from lab.blind.worlds import make as making
from lab.blind.worlds import truth as drawing
from lab.blind.worlds.by_mm import Weighed, mm_metrics, weighed
from lab.blind.worlds.make import make, walk_of
from lab.blind.worlds.truth import WorldRecipe, causes, draw, draw_robot
from lab.cli import main
from lab.files.config import ConfigError
from recordings.table_file import read_csv
from sim_fakes.worlds.forms import EFFECTS, ON_REQUEST
from sim_fakes.worlds.outside_held_out import HELD_OUT
from sim_fakes.worlds.table import WORLDS

QUIET = Crew(quiet=True)


@pytest.fixture(scope="module")
def small_set(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One clean case."""
    root = tmp_path_factory.mktemp("world") / "set"
    make(root, WorldRecipe("bench", 1, 3, ("clean",)), "full", menu=False, crew=QUIET)
    return root


# ------------------------------------------------------------------ truth
def test_where_no_size_of_a_cause_leaves_an_equilibrium_another_cause_is_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recipe = WorldRecipe("bench", 1, 3, ("clean",))
    ((_, (first,)),) = draw(recipe)
    measured = making._measured

    def snaps(order: making.Order, attempt: int) -> object:
        if order.causes == (first,):
            raise making.NoEquilibrium("snapped")
        return measured(order, attempt)

    monkeypatch.setattr(making, "_measured", snaps)
    make(tmp_path / "set", recipe, "full", menu=False, crew=QUIET)
    (truth,) = open_seal(SetFolder(tmp_path / "set")).values()
    assert first not in truth["effects"] and len(truth["effects"]) == 1


def test_the_help_names_every_world(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["blind", "make", "--help"])
    told = capsys.readouterr().out
    assert all(name in told for name in WORLDS)


def test_every_stratum_can_be_asked_for_and_a_mixture_holds_them_all() -> None:
    assert set(drawing.KINDS) == set(drawing.MIXED) == set(STRATA)
    assert {s for s, _ in draw(WorldRecipe("bench", 60, 1))} == set(STRATA)
    assert {s for s, _ in draw(WorldRecipe("bench", 5, 1, ("walls", "none")))} == {"walls", "none"}


def test_every_effect_gets_its_turn() -> None:
    drawn = [ids[0] for _, ids in draw(WorldRecipe("bench", 44, 1, ("cluttered",)))]
    assert sorted(drawn) == sorted([e for e in EFFECTS if e != "chamber_thrust"] * 2)


def test_clutter_of_one_way_effects_is_never_negative_and_tolerances_grow_with_the_world() -> None:
    sizes = [draw_robot(WorldRecipe("field", 1, 7), place, "cluttered", ("contact",))[0].sizes for place in range(60)]
    one_way = [e for e, info in EFFECTS.items() if info.sign != "both"]
    assert all(s.get(e, 0.0) >= 0 for s in sizes for e in one_way)
    tilt = {
        w: np.std([draw_robot(WorldRecipe(w, 1, 7), k, "none", ())[0].sizes["base_tilt"] for k in range(80)])
        for w in ("quiet", "field")
    }
    assert tilt["field"] > 2 * tilt["quiet"]


def test_held_out_causes_are_drawn_where_they_are_asked_for_only() -> None:
    assert not set(causes(False)) & set(HELD_OUT) and causes(True) == HELD_OUT
    recipe = WorldRecipe("bench", 20, 1, ("outside",), held_out=True)
    assert {ids[0] for _, ids in draw(recipe)} == set(HELD_OUT)


def test_some_effects_are_drawn_on_request_only() -> None:
    usual = draw(WorldRecipe("bench", 60, 1, ("clean",)))
    assert not {ids[0] for _, ids in usual} & set(ON_REQUEST)
    recipe = WorldRecipe("bench", 8, 1, ("clean", "cluttered"), causes=tuple(ON_REQUEST))
    assert {ids[0] for _, ids in draw(recipe)} == set(ON_REQUEST)
    robot, effects = draw_robot(recipe, 0, "clean", ("tip_payload",))
    assert set(effects) == {"tip_payload"} and robot.present["tip_payload"] == effects["tip_payload"] >= 0.5


def test_gas_loads_the_walls_of_every_robot_of_a_world_that_says_so_and_of_that_stratum() -> None:
    robot, effects = draw_robot(WorldRecipe("shared", 1, 1), 0, "clean", ("base_tilt",))
    assert robot.sizes["chamber_thrust"] == effects["chamber_thrust"] == 0.5
    robot, effects = draw_robot(WorldRecipe("bench", 1, 1), 0, "walls", ("chamber_thrust",))
    assert set(effects) == {"chamber_thrust"} and effects["chamber_thrust"] >= 0.6


# ------------------------------------------------------------------ cases
def test_a_case_is_the_bench_s_base_sweep_and_its_seal_tells_mm(small_set: Path) -> None:
    table = read_csv(small_set / "cases" / "0001" / "trials.csv")
    states = list(BASE.states())
    assert len(table) == len(states) == 231
    assert [(r.trial, r.step, r.branch, r.hold) for r in table] == [(s.trial, s.step, s.branch, s.hold) for s in states]
    assert all(abs(max(r.pressures) - s.pressure) < 3e3 for r, s in zip(table, states, strict=True))
    (truth,) = open_seal(SetFolder(small_set)).values()
    (cause,) = truth["effects"]
    assert truth["kind"] == "single" and truth["world"] == "bench"
    assert 0 < truth["calibrated_mm"][cause] <= truth["moves_mm"][cause] and truth["floor_mm"] > 0.2
    public = (small_set / "commitment.json").read_text()
    assert not any(f'"{e}"' in public for e in EFFECTS) and "seed" not in json.loads(public)


@pytest.mark.parametrize("sweep", [BASE, *MENU], ids=lambda s: s.name)
def test_legs_of_a_sweep_read_as_often_as_its_states(sweep: Any) -> None:
    walked = walk_of(sweep)
    assert sum(leg.read for leg in walked.legs) * len(walked.trials) == len(list(sweep.states()))
    assert all(leg.hold >= 0 for leg in walked.legs)


def test_what_belongs_to_one_world_is_refused_in_the_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words, said in (
        (["--world", "moon"], "must be one of bench"),
        (["--world", "bench", "--wire", "1"], "with --world leave them out"),
        (["--kind", "clean"], "give --world"),
    ):
        assert main(["blind", "make", "--n", "1", "--seed", "1", *words, str(tmp_path / "set")]) != 0
        assert said in " ".join(capsys.readouterr().err.split())
    with pytest.raises(ConfigError, match="not empty"):
        (tmp_path / "file").write_text("x")
        make(tmp_path, WorldRecipe("bench", 1, 1), crew=QUIET)


# ------------------------------------------------------------------ figures
def answered(*named: str, p: float = 0.95, **more: Any) -> Answer:
    verdict = "effect" if named else "none"
    return Answer("1", verdict, frozenset(named), p, credible=(frozenset(named),), **more)


def case(answer: Answer, *causes: str, stratum: str = "cluttered", **carries: float) -> Weighed:
    return Weighed(stratum, frozenset(causes), carries, 0.9, {"effect": "base_tilt", "leaves_mm": 2.0}, answer)


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
    assert found["cluttered_none.right"].value == 1.0 and "cluttered_none.exact" not in found
    assert found["cluttered_outside.named"].value == 1.0 and found["cluttered_outside.flagged_apart"].n == 1


def test_the_stage_of_an_outside_cause_is_scored_where_it_is_called_unknown() -> None:
    recipe = WorldRecipe("bench", 1, 1)
    robot, effects = draw_robot(recipe, 0, "outside", ("warm_room",))
    truth = drawing.WorldTruth("1", "outside", robot, effects, calibrated_mm={"warm_room": 3.0}).as_dict()
    assert truth["stage"] == "material"
    assert drawing.WorldTruth("1", "clean", *draw_robot(recipe, 0, "clean", ("contact",))).as_dict()["stage"] is None

    def told(verdict: str, *stages: str) -> Weighed:
        errors = [{"stage": s, "dependence": "time", "gain": 9.0} for s in stages]
        found = weighed(truth, answer_from("1", {"attribute": {"verdict": verdict, "stage_errors": errors}}))
        assert found is not None
        return found

    cases = [told("unknown", "material", "load"), told("unknown", "load"), told("unknown"), told("none", "material")]
    (stage,) = (m.found for m in mm_metrics(cases) if m.key == "outside.stage")
    assert stage.n == 3 and stage.value == pytest.approx(1 / 3)


def test_the_budget_is_read_from_an_answer_and_old_truths_have_no_mm() -> None:
    budget = [{"effect": "contact", "role": "named", "mm": 2.0, "low95_mm": 1.0, "high95_mm": 3.0}]
    a = answer_from("1", {"attribute": {"verdict": "effect", "effects": ["contact"]}, "budget": budget})
    assert a.budget == {"contact": (1.0, 3.0)}
    assert weighed({"kind": "single", "effects": {"contact": 1.0}}, a) is None


def test_a_set_of_a_world_is_scored_by_mm_as_well(small_set: Path) -> None:
    (truth,) = open_seal(SetFolder(small_set)).values()
    diagnosis = {"attribute": {"verdict": "effect", "effects": list(truth["effects"]), "probability": 0.9}}
    place = SetFolder(small_set).answers("0001")
    place.mkdir(parents=True)
    (place / "rounds.json").write_text(json.dumps([{"asked": [], "seconds": 1.0, "diagnosis": diagnosis}]))
    result = score(small_set)
    found = {m.key: m.found.value for m in result.figures}
    carried = truth["calibrated_mm"]
    alone = carried[next(iter(truth["effects"]))] >= max(truth["floor_mm"], max(carried.values()) / 2)
    assert found["named"] == found["clean.exact"] == 1.0 and found["clean.right"] == float(alone)
    assert sheet(result).row_count > 10
