"""`lab diagnose`: exit codes, what is written, and that bad input never earns a confident verdict."""

import html
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from commands import Cli
from diagnosed_case import Answered, campaign, folder, without
from pages import read_as_text

from diagnosis.answer.result import Diagnosis
from lab.files.inputs import read_case, unconfirmed_guesses
from lab.files.own_effects import effects_from_file
from lab.files.robot_file import paper_robot
from lab.verbs.diagnose import show
from model.effects import CATALOGUE, with_effects

AREA = {"area_moment.blend": 0.7}
CONFIDENT = 0.9
OWN_LENGTHS, OWN_PRESSURES = (0.0, 0.15, 0.3), (0.0, 120e3, 240e3)
"""m and Pa: enough to tell what a spine does by its length."""

BOWED = """
import numpy as np

from model.effects import EffectSpec, Law, Parameter


def _bowed(q, v):
    bend = v["bow"] * (q.spine_length / q.robot.length) ** 2
    q.rest_curvature = q.rest_curvature + np.stack(np.broadcast_arrays(bend, 0 * bend, 0 * bend), axis=-1)


EFFECTS = (
    EffectSpec("bowed_spine", "structure", "u* = b (L_s / L)^2 about x", (Parameter("bow", "1/m", 0.1, -1.0, 1.0),),
               Law(before=_bowed), "a look at the spine", "long spines"),
)
"""


@pytest.fixture(params=["some effects", pytest.param("all effects", marks=pytest.mark.long)])
def weighed(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is asked does not depend on how many effects compete; `answered` is an answer of all of them."""
    if request.param == "some effects":
        few = ("area_moment", "chamber_azimuth")
        monkeypatch.setattr("lab.files.own_effects.CATALOGUE", {effect: CATALOGUE[effect] for effect in few})


@pytest.fixture(scope="module")
def answer(answered: Answered) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(answered.json.read_text())
    return found


def test_the_effect_is_named_and_the_run_succeeds(answered: Answered, answer: dict[str, Any]) -> None:
    assert answered.code == 0
    assert answer["attribute"]["verdict"] == "effect" and answer["attribute"]["effects"] == ["area_moment"]
    assert "area_moment" in answered.said and "5 min added to each for setting up" in " ".join(answered.said.split())
    assert "settle first" not in answered.said
    text = answered.json.read_text().rstrip("\n")
    assert Diagnosis.from_json(text).to_json() == text and "unconfirmed_guesses" not in text


def test_a_campaign_held_out_confirms_the_effect(answered: Answered, answer: dict[str, Any]) -> None:
    held = answer["holdout"]
    assert held["hypothesis"] == ["area_moment"] and held["verdict"] == "confirmed"
    assert held["trials"] == 4 and held["states"] == 28
    assert held["after_mm"] < 0.5 * held["before_mm"]
    low, high = held["ci95"]
    assert 0.5 < low <= held["share_closed"] <= high
    assert "area_moment] confirmed." in answer["statement"] and "held-out campaign" in " ".join(answered.said.split())


def test_shapes_end_at_the_tips_of_their_models(answer: dict[str, Any]) -> None:
    shapes = answer["detail"]["shapes"]
    assert 1 <= len(shapes) <= 4
    assert len({round(s["spine_length"], 2) for s in shapes}) == len(shapes)
    for s in shapes:
        for model in ("calibrated", "explained"):
            backbone = s[model]["backbone"]
            assert backbone[0] == pytest.approx([0.0, 0.0, 0.0], abs=16.3e-3)
            assert backbone[-1] == pytest.approx(s[model]["tip"], abs=2e-3)


def test_separations_list_effects_of_weight_first(answer: dict[str, Any]) -> None:
    apart = answer["detail"]["distinguishability"]
    assert apart["effects"][0] == "area_moment" and apart["tied_below"] == 9.0
    assert apart["weight"] == sorted(apart["weight"], reverse=True)
    n = len(apart["effects"])
    assert len(apart["separation"]) == n and all(len(row) == n for row in apart["separation"])


def test_the_size_stays_within_what_is_possible(answer: dict[str, Any]) -> None:
    sizes = {size["name"]: size for size in answer["detail"]["sizes"]}
    assert set(sizes) == {"area_moment.blend", "area_moment.sliding"}
    for size in sizes.values():
        assert (size["low"], size["high"]) == (0.0, 1.0) and not size["impossible"]
        assert size["low"] <= size["low90"] < size["high90"] <= size["high"]
        assert size["low90"] <= size["median"] <= size["high90"]
        assert answer["attribute"]["ranking"][0]["parameters"][size["name"]]["value"] == size["median"]
    blend = sizes["area_moment.blend"]
    assert blend["mean"] == pytest.approx(0.9, abs=4 * blend["sd"])


def test_a_protocol_file_is_written_for_each_proposal(answered: Answered, answer: dict[str, Any]) -> None:
    files = {p.stem: yaml.safe_load(p.read_text()) for p in answered.protocols.glob("*.yaml")}
    assert set(files) == {p["id"] for p in answer["next_experiment"]} and files
    assert all(f["protocol"] in ("bending", "elongation") for f in files.values())


def test_the_command_for_the_first_proposal_names_the_file_that_was_written_and_an_answer_without_proposals_says_why(
    answered: Answered, answer: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    file = answered.protocols / f"{answer['next_experiment'][0]['id']}.yaml"
    assert f"Run the first: lab run {file} --rig RIG.yaml; without a rig, measure the states in" in answered.said
    assert file.exists() and file.with_suffix(".csv").exists()
    show(found := Diagnosis.from_json(answered.json.read_text()), None)
    assert f"--protocols next, which writes its file; then lab run next/{file.name} --rig RIG.yaml" in capsys.readouterr().out

    show(replace(found, next_experiment=(), attribute=replace(found.attribute, verdict="none")), None)
    floor = f"within the noise floor of {found.locate.noise_floor_mm:.3g} mm"
    assert f"Nothing on this rig: robot and model agree {floor}." in " ".join(capsys.readouterr().out.split())


@pytest.mark.usefixtures("weighed")
def test_a_small_table_is_answered_with_its_limits_and_without_confidence(tmp_path: Path, cli: Cli) -> None:
    rows, path = campaign(AREA, repeats=1, lengths=(0.0, 0.2), pressures=(0.0, 160e3)), tmp_path / "diagnosis.json"
    cli("diagnose", folder(tmp_path / "case", rows), "--json", path)
    found = json.loads(path.read_text())
    assert any("most states were read in one trial only" in said for said in found["concerns"])
    assert found["attribute"]["verdict"] != "effect" or found["attribute"]["probability"] < CONFIDENT


@pytest.mark.usefixtures("weighed", "drawn")
def test_guesses_that_nobody_has_confirmed_stand_first_and_a_page_of_a_small_table_is_drawn_too(tmp_path: Path, cli: Cli) -> None:
    case = folder(tmp_path / "case", campaign({}, repeats=1, lengths=(0.2,), pressures=(160e3,)))
    (case / "map.yaml").write_text(
        "robot: robot.yaml\nunconfirmed:\n- which chamber does 'Valve B' feed?\n- 'frame: taken as z, or -z'\n"
    )
    page, answer = tmp_path / "d.html", tmp_path / "d.json"
    printed = cli("diagnose", case, "--json", answer, "--report", page).out
    said = (
        "2 guesses of the map are unconfirmed (which chamber does 'Valve B' feed?; frame: taken as z, or -z): check and correct "
        f"each in {case / 'map.yaml'}, move it to `confirmed`, and import with that map"
    )
    assert "".join(printed.split()).startswith("".join(f"settle first: {said}".split()))
    first = json.loads(answer.read_text())["findings"][0]
    assert (first["code"], first["severity"], first["text"]) == ("unconfirmed_guesses", "critical", said)
    shown = html.unescape(page.read_text())
    assert shown.count(said) == 1 and shown.index(said) < shown.index('<p class="lead">')
    text = read_as_text(page.read_text())
    assert "Too little data to name a cause" in text and "A single trial" in text
    assert "Only one spine length" in text and "Only one pressure" in text


def test_one_guess_is_in_the_singular_a_long_one_keeps_its_remedy_and_a_map_in_short_form_is_known(tmp_path: Path) -> None:
    case = folder(tmp_path / "case", campaign({}, repeats=1, lengths=(0.2,), pressures=(160e3,)))
    (case / "map.yaml").write_text(f"columns: {{p1: P}}\nunconfirmed:\n- '{'is it so? ' * 30}write kPa'\n")
    (said,) = map(str, unconfirmed_guesses([case]))
    assert said.startswith("1 guess of the map is unconfirmed (is it so?") and "write kPa): check" in said and len(said) < 400
    mapped = read_case([case]).table.mapped
    assert mapped is not None and mapped.headings == (("p1", "P"),)


def test_campaigns_of_two_robots_are_not_mixed(answered: Answered, tmp_path: Path, cli: Cli) -> None:
    other = heavier(folder(tmp_path / "other", campaign({}, repeats=1, lengths=(0.2,))))
    text = cli("diagnose", answered.case, other, code=2).err
    assert "a different robot.yaml" in text and "--robot" in text


def heavier(case: Path) -> Path:
    robot = yaml.safe_load(paper_robot().read_text())
    (case / "robot.yaml").write_text(yaml.safe_dump({**robot, "tip_mass": 0.2}))
    return case


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda path, case: case, "fit saw them"),
        (lambda path, case: heavier(folder(path, campaign(AREA, seed=3, repeats=1))), "differs"),
        (lambda path, case: without("p9", path, campaign(AREA, seed=3, repeats=1)), "9 chambers"),
        (lambda path, case: without("x", path, campaign(AREA, seed=3, repeats=1)), "y, z without x"),
        (lambda path, case: path / "nowhere", "nowhere"),
    ],
    ids=["the same", "another robot", "other chambers", "no x", "not there"],
)
def test_a_campaign_that_cannot_be_held_out_is_refused_before_anything_is_fitted(
    answered: Answered, tmp_path: Path, cli: Cli, make: Callable[[Path, Path], Path], words: str
) -> None:
    text = cli("diagnose", answered.case, "--holdout", make(tmp_path / "other", answered.case), code=2).err
    assert "--holdout" in text and words in text, text
    assert len(text.strip().splitlines()) == 1


@pytest.mark.usefixtures("weighed")
def test_an_effect_of_one_s_own_is_found_where_it_is_at_work(tmp_path: Path, cli: Cli) -> None:
    file = tmp_path / "own.py"
    file.write_text(BOWED)
    effects = with_effects(effects_from_file(file))
    rows = campaign({"bowed_spine.bow": 0.3}, repeats=2, lengths=OWN_LENGTHS, catalogue=effects, pressures=OWN_PRESSURES)
    path = tmp_path / "diagnosis.json"
    cli("diagnose", folder(tmp_path / "case", rows), "--effects", file, "--json", path)
    found = json.loads(path.read_text())
    assert found["attribute"]["verdict"] == "effect" and found["attribute"]["effects"] == ["bowed_spine"]
    size = found["attribute"]["ranking"][0]["parameters"]["bowed_spine.bow"]
    assert size["value"] == pytest.approx(0.3, abs=4 * size["sd"]) and size["unit"] == "1/m"
    assert found["locate"]["stage"]["structure"] > 0.8
    fitted = cli("fit", tmp_path / "case", "--with", "bowed_spine", "--effects", file, "--out", tmp_path / "fit", "--json").json
    words = ("compare", tmp_path / "case", "--robot", tmp_path / "fit" / "robot.yaml")
    assert "or give its file to a command that has --effects" in cli(*words, code=2).flat_err
    assert 1e3 * cli(*words, "--effects", file, "--json").json["rmse"] == pytest.approx(fitted["fitted_mm"], rel=1e-3)


def test_a_wrong_effect_of_one_s_own_is_refused_before_it_is_weighed(answered: Answered, tmp_path: Path, cli: Cli) -> None:
    file = tmp_path / "own.py"
    file.write_text(BOWED.replace('v["bow"]', 'v["bough"]'))
    said = cli("diagnose", answered.case, "--effects", file, code=2).err
    assert "bowed_spine: its law fails: KeyError: 'bough'" in said and len(said.strip().splitlines()) == 1


def test_wrong_words_are_told_at_once(answered: Answered, tmp_path: Path, cli: Cli) -> None:
    assert "cannot be written" in cli("diagnose", answered.case, "--json", tmp_path / "none" / "diagnosis.json", code=2).err
    said = cli("diagnose", answered.case, "--workers", 0, code=2).err
    assert "--workers 0" in said and "at least 1" in said
