"""The page of a robot with three chambers and no spine: every chamber group is drawn, and nothing is said of spines."""

from __future__ import annotations

import itertools
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from page_text import read_as_text

from diagnosis.answer.experiments import candidate_experiments
from diagnosis.answer.result import Diagnosis, Ranked
from diagnosis.answer.sentences import disorder
from diagnosis.data.case import states
from lab.cli import main
from lab.console import out
from lab.files.config import load
from lab.files.inputs import read_case
from lab.pages.diagnosis_figures import groups
from lab.verbs.diagnose import ranked
from model.actuators import Chambers
from model.effects import CATALOGUE, ForwardModel, design_from_columns
from model.robot import Robot
from recordings.table_file import write_csv
from recordings.trials import Table, TrialRow

pytestmark = pytest.mark.usefixtures("drawn")

ROBOT = Path(__file__).parents[2] / "examples/three_chambers/robot.yaml"
GROUPS = ((1,), (2,), (3,), (2, 3))
PRESSURES = (0.0, 35e3, 70e3)
ANGLE = 0.16
"""rad, by which the chambers are turned."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """Case, diagnosis.json and page."""
    folder, robot = tmp_path_factory.mktemp("chambers"), load(ROBOT, Robot)
    cells = [
        {"trial": trial, "step": step, "protocol": "bending", "repeat": repeat, "branch": "load", "t": 90.0 * trial + 9 * step,
         "rate": 5e3, "hold": 3.0, "spine_length": 0.0, "tip_mass": robot.tip_mass, "roll_deg": 0.0,
         **{f"p{c}": p if c in used else 0.0 for c in (1, 2, 3)}, "x": 0.0, "y": 0.0, "z": 0.0}
        for trial, (repeat, used) in enumerate(itertools.product((1, 2), GROUPS), 1)
        for step, p in enumerate(PRESSURES, 1)
    ]  # fmt: skip
    design = design_from_columns(robot, {name: np.array([c[name] for c in cells]) for name in cells[0]})
    forward = ForwardModel(robot, design, area_factor=1.5)
    theta = np.array([ANGLE if p.name == "chamber_azimuth.angle" else 0.0 for p in forward.parameters])
    read = forward.predict(theta)
    tip = np.stack([read[forward.observations.channel == axis] for axis in "xyz"], axis=1)
    tip += 0.1e-3 * np.random.default_rng(5).normal(size=tip.shape)
    rows = [TrialRow.from_cells({**c, **dict(zip("xyz", map(float, at), strict=True))}) for c, at in zip(cells, tip, strict=True)]
    case = folder / "case"
    case.mkdir()
    shutil.copy(ROBOT, case / "robot.yaml")
    write_csv(Table(tuple(rows)), case / "trials.csv")
    answer, page = folder / "diagnosis.json", folder / "page.html"
    assert main(["diagnose", str(case), "--json", str(answer), "--report", str(page)]) == 0
    return case, answer, page


def test_page_json_and_statement_say_nothing_of_spines(made: tuple[Path, Path, Path]) -> None:
    _, answer, page = made
    found = json.loads(answer.read_text())
    text = re.sub(r'src="[^"]*"', "", page.read_text())
    assert "spine" not in text.lower()
    assert "spine" not in " ".join((found["headline"], found["statement"], *found["concerns"])).lower()
    assert not [c["effect"] for c in found["budget"] if CATALOGUE[c["effect"]].id.startswith("spine")]


def test_every_state_is_in_the_panel_of_its_chambers_and_the_worst_group_comes_first(
    made: tuple[Path, Path, Path],
) -> None:
    found = Diagnosis.from_json(made[1].read_text())
    drawn = groups(found)
    assert {g.name for g in drawn} == {"chamber 1", "chamber 2", "chamber 3", "chambers 2, 3"}
    assert np.array_equal(sum(g.own.astype(int) for g in drawn), np.ones(len(GROUPS) * len(PRESSURES) * 2))
    missed = np.linalg.norm(np.subtract(found.detail["states"]["tip"], found.detail["states"]["calibrated"]), axis=1)
    assert drawn[0].own[np.argmax(missed)]
    for g in drawn:
        bent = np.array(found.detail["states"]["tip"])[g.own & (np.array(found.detail["states"]["pressure"]) > 60e3)]
        assert (bent @ g.side > 0.95 * np.linalg.norm(bent[:, :2], axis=1)).all()
    shown = {tuple(s["chambers"]) for s in found.detail["shapes"]}
    assert len(shown) == 4 and "chambers 2, 3, 70 kPa" in made[2].read_text()


def test_the_headline_says_the_angle_in_degrees(made: tuple[Path, Path, Path]) -> None:
    found = Diagnosis.from_json(made[1].read_text())
    stated = float(re.findall(r"turned by ([\d.]+) (?:± [\d.]+ )?deg", found.headline)[0])
    assert stated == pytest.approx(np.degrees(ANGLE), rel=0.1)
    assert f'<p class="lead">{found.headline}</p>' in made[2].read_text()


def test_nothing_is_proposed_that_was_measured_and_each_step_has_its_command(made: tuple[Path, Path, Path]) -> None:
    case, answer, page = made
    found = json.loads(answer.read_text())
    proposed = [p for p in found["next_experiment"] if p["id"] == "other_chambers"]
    assert proposed == []  # each chamber was inflated alone, and a pair turned about the axis is a pair
    assert all(f"lab run next/{p['id']}.yaml --rig rig.yaml" in page.read_text() for p in found["next_experiment"][:6])
    read = read_case([case])
    some = replace(read, table=replace(read.table, rows=tuple(r for r in read.table if r.pressures[2] < 1e3)))
    menu = {e.id: e for e in candidate_experiments(read.robot, states(some)[0])}
    assert menu["other_chambers"].parameters["chambers"] == [3]


def test_the_page_ends_with_where_it_comes_from(made: tuple[Path, Path, Path]) -> None:
    foot = re.findall(r"<footer[^>]*>(.*?)</footer>", made[2].read_text())[0]
    assert "three-chamber robot" in foot and "softlab" in foot and len(re.findall(r"sha256 [0-9a-f]{16}", foot)) == 2


def test_empty_tables_are_left_out_and_every_caption_says_in_sample_or_unseen(made: tuple[Path, Path, Path]) -> None:
    text = made[2].read_text()
    assert "<tbody></tbody>" not in text
    captions = re.findall(r"<figcaption>(.*?)</figcaption>", read_as_text(text))
    free = ("Probability of each hypothesis", "Share of each effect")
    assert all("in-sample" in c or "unseen" in c or "did not see" in c or c.startswith(free) for c in captions)
    assert not re.search(r"baseline model|best hypothesis|leading hypothesis", text)


def test_probability_and_evidence_that_disagree_are_explained(made: tuple[Path, Path, Path]) -> None:
    first, second, *_ = Diagnosis.from_json(made[1].read_text()).attribute.ranking
    second = replace(second, probability=min(0.2, first.probability))
    assert disorder((first, replace(second, log_evidence=first.log_evidence - 1))) == ""
    outside = replace(second, effects=("unknown",), log_evidence=first.log_evidence + 9)
    assert disorder((first, outside)) == "" and "-123.0" not in shown(first, replace(outside, log_evidence=-123.0))
    carried = replace(second, effects=("contact",), log_evidence=first.log_evidence + 9)
    assert "over the fits of all hypotheses" in disorder((first, carried))
    assert "over the fits of all hypotheses" in shown(first, carried)
    assert "smaller prior" in disorder((first, replace(carried, effects=("contact", "payload"))))


def shown(*ranking: Ranked) -> str:
    """What the command prints of a ranking."""
    with out.capture() as printed:
        out.print(ranked(ranking, Chambers.words))
        out.print(disorder(ranking))
    return " ".join(printed.get().split())
