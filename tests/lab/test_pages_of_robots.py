"""Pages of other robots and data: chambers without a spine, stiffness trials alone, and a lab's own sensors."""

import itertools
import json
import re
from dataclasses import replace
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from commands import Cli
from diagnosed_case import ROBOT as PAPER
from diagnosed_case import folder
from pages import read_as_text

from diagnosis.answer.experiments import candidate_experiments
from diagnosis.answer.result import Diagnosis, Ranked
from diagnosis.data.case import states
from lab.cli import main
from lab.console import out
from lab.files.config import load
from lab.files.inputs import read_case
from lab.pages.diagnosis_figures import groups
from lab.pages.figures import apart, in_a_row, numbers, quantities, sensors
from lab.verbs.diagnose import ranked
from model.actuators import Chambers
from model.effects import CATALOGUE, ForwardModel, design_from_columns
from model.robot import Robot
from recordings.trials import Table, TrialRow
from tests.diagnosis.small_campaigns import SOME
from tests.diagnosis.test_stiffness import RIVALS
from tests.model.effects.campaigns import Moved, pushes

pytestmark = pytest.mark.usefixtures("drawn")


# ------------------------------------------------------------------ three chambers and no spine
ROBOT = Path(__file__).parents[2] / "examples/three_chambers/robot.yaml"
GROUPS = ((1,), (2,), (3,), (2, 3))
PRESSURES = (0.0, 35e3, 70e3)
ANGLE = 0.16
"""rad, by which the chambers are turned."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """Case, diagnosis.json and page."""
    place, robot = tmp_path_factory.mktemp("chambers"), load(ROBOT, Robot)
    cells = [
        {"trial": trial, "step": step, "protocol": "bending", "repeat": repeat, "branch": "load", "t": 90.0 * trial + 9 * step,
         "rate": 5e3, "hold": 3.0, "spine_length": 0.0, "tip_mass": robot.tip_mass, "roll_deg": 0.0,
         **{f"p{c}": p if c in used else 0.0 for c in (1, 2, 3)}, "x": 0.0, "y": 0.0, "z": 0.0}
        for trial, (repeat, used) in enumerate(itertools.product((1, 2), GROUPS), 1)
        for step, p in enumerate(PRESSURES, 1)
    ]  # fmt: skip
    design = design_from_columns(robot, {name: np.array([c[name] for c in cells]) for name in cells[0]})
    forward = ForwardModel(robot, design, area_factor=1.5)
    read = forward.predict(np.array([ANGLE if p.name == "chamber_azimuth.angle" else 0.0 for p in forward.parameters]))
    tip = np.stack([read[forward.observations.channel == axis] for axis in "xyz"], axis=1)
    tip += 0.1e-3 * np.random.default_rng(5).normal(size=tip.shape)
    rows = [TrialRow.from_cells({**c, **dict(zip("xyz", map(float, at), strict=True))}) for c, at in zip(cells, tip, strict=True)]
    case = folder(place / "case", rows, ROBOT)
    answer, page = place / "diagnosis.json", place / "page.html"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("lab.files.own_effects.CATALOGUE", {effect: SOME[effect] for effect in ("chamber_azimuth", "base_tilt")})
        assert main(["diagnose", str(case), "--json", str(answer), "--report", str(page)]) == 0
    return case, answer, page


def test_page_json_and_statement_say_nothing_of_spines(made: tuple[Path, Path, Path]) -> None:
    _, answer, page = made
    found = json.loads(answer.read_text())
    assert "spine" not in re.sub(r'src="[^"]*"', "", page.read_text()).lower()
    assert "spine" not in " ".join((found["headline"], found["statement"], *found["concerns"])).lower()
    assert not [c["effect"] for c in found["budget"] if CATALOGUE[c["effect"]].id.startswith("spine")]


def test_every_state_is_in_the_panel_of_its_chambers_and_the_worst_group_comes_first(made: tuple[Path, Path, Path]) -> None:
    found = Diagnosis.from_json(made[1].read_text())
    drawn = groups(found)
    assert {g.name for g in drawn} == {"chamber 1", "chamber 2", "chamber 3", "chambers 2, 3"}
    assert np.array_equal(sum(g.selected.astype(int) for g in drawn), np.ones(len(GROUPS) * len(PRESSURES) * 2))
    missed = np.linalg.norm(np.subtract(found.detail["states"]["tip"], found.detail["states"]["calibrated"]), axis=1)
    assert drawn[0].selected[np.argmax(missed)]
    for g in drawn:
        bent = np.array(found.detail["states"]["tip"])[g.selected & (np.array(found.detail["states"]["pressure"]) > 60e3)]
        assert (bent @ g.side > 0.95 * np.linalg.norm(bent[:, :2], axis=1)).all()
    shown = {tuple(s["chambers"]) for s in found.detail["shapes"]}
    assert len(shown) == 4 and "chambers 2, 3, 70 kPa" in made[2].read_text()


def test_nothing_is_proposed_that_was_measured_and_each_step_has_its_command(made: tuple[Path, Path, Path]) -> None:
    case, answer, page = made
    found = json.loads(answer.read_text())
    proposed = [p for p in found["next_experiment"] if p["id"] == "other_chambers"]
    assert proposed == []  # each chamber was inflated alone, and a pair turned about the axis is a pair
    assert all(f"lab run next/{p['id']}.yaml --rig RIG.yaml" in page.read_text() for p in found["next_experiment"][:6])
    read = read_case([case])
    some = replace(read, table=read.table.take(read.table["p3"] < 1e3))
    menu = {e.id: e for e in candidate_experiments(read.robot, states(some)[0])}
    assert menu["other_chambers"].protocol["chambers"] == [3]
    assert {*menu["elongation"].protocol["pressures"]} <= {*PRESSURES}
    assert menu["tip_mass"].do == "hang about 10 g more on the tip"  # of 15 cm; 100 g for the paper's robot


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


def test_the_heads_of_a_ranking_say_why_probability_and_evidence_may_disagree(made: tuple[Path, Path, Path]) -> None:
    first, second, *_ = Diagnosis.from_json(made[1].read_text()).attribute.ranking
    outside = replace(second, probability=0.2, effects=("unknown",), log_evidence=float("nan"))
    assert "nan" not in shown(first, outside)
    in_command = " ".join(shown(first).split())
    assert all(effect in in_command for effect in first.effects)
    for text in (in_command, made[2].read_text()):
        assert {"by all fits", "of one fit"} == {*re.findall("by all fits|of one fit", text)}


def shown(*ranking: Ranked) -> str:
    """What the command prints of a ranking."""
    with out.capture() as printed:
        out.print(ranked(ranking, Chambers.words))
    return " ".join(printed.get().split())


# ------------------------------------------------------------------ stiffness trials alone, which have no tip to show
SPINES, STEPS, REPEATS = (0.05, 0.15, 0.3), 4, 3
BIAS, NOISE = 0.15, 0.01
"""N."""
OF_PUSHES = [
    "The answer in full",
    "The gap, step by step", "What to do next", "Evidence: which cause", "What speaks against the answer",
    "How large the cause is", "The gap by spine length, pressure, branch and time", "Stiffness trials",
    "Stages and misfit diagnostics", "Terms",
]  # fmt: skip


def pushed() -> list[TrialRow]:
    """Deflections up to 2 % of the length of three bare spines, of which the sensor reads too much."""
    table = pushes("spine", SPINES * REPEATS, 0.02 * np.arange(1, STEPS + 1) / STEPS)
    table["deflection"] *= table["spine_length"]
    forward = Moved(PAPER, table, None).forward
    read = forward.predict(np.zeros(len(forward.parameters))) + BIAS
    table["force"] = read + NOISE * np.random.default_rng(1).normal(size=len(read))
    told = zip(*(table[name].tolist() for name in ("trial", "spine_length", "deflection", "force")), strict=True)
    return [
        TrialRow(
            trial, 1 + i % STEPS, "stiffness", 1 + (trial - 1) // len(SPINES), "load", 100.0 * trial + i % STEPS, length,
            (0.0,) * 9, rate=0.0, hold=1.0, vacuum=80e3, specimen="spine", force=force, deflection=deflection,
        )
        for i, (trial, length, deflection, force) in enumerate(told)
    ]  # fmt: skip


def test_stiffness_trials_alone_make_a_page_of_what_they_show(tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lab.files.own_effects.CATALOGUE", RIVALS)
    case, page, answer = folder(tmp_path / "case", pushed()), tmp_path / "page.html", tmp_path / "answer.json"
    cli("diagnose", case, "--report", page, "--json", answer)
    text, told = page.read_text(), json.loads(answer.read_text())
    assert told["locate"]["of"] == "deflection" and told["attribute"]["effects"] == ["force_bias"]
    assert re.findall(r"<h2>([^<]+)</h2>", text) == OF_PUSHES
    assert text.count("<figure>") == 3
    assert "Error of the deflection, mm rms" in text and "Tip error" not in text


# ------------------------------------------------------------------ what a lab's own sensors measured, with name and unit
def table() -> Table:
    """Six states of a thermometer that feels the pressure; one was read without it."""
    rows = [
        TrialRow(
            trial=1 + i // 3, step=1 + i % 3, protocol="bending", repeat=1, branch="load", t=30.0 * i,
            spine_length=0.1 * (i // 3), pressures=(20e3 * i,) * 3,
            sensors={} if i == 4 else {"sensor_skin_temperature": 296.0 + 0.1 * i, "sensor_skin_humidity": 0.38},
            sd={} if i == 4 else {"sensor_skin_temperature": 0.03, "sensor_skin_humidity": 0.01},
        )
        for i in range(6)
    ]  # fmt: skip
    return Table.of(rows, sensor_units={"sensor_skin_temperature": "K", "sensor_skin_humidity": "1"})


def test_names_and_units_are_those_that_were_recorded_and_without_units_there_are_names_alone() -> None:
    assert quantities(table()) == ("sensor_skin_humidity", "sensor_skin_temperature")
    _, (humidity, temperature) = numbers(table())
    assert humidity[0] == "skin_humidity" and temperature[0] == "skin_temperature, K"
    assert temperature[1:] == ("5", "296", "296.22", "296.5", "0.03")
    _, rows = numbers(Table.of(table()))
    assert [row[0] for row in rows] == ["skin_humidity", "skin_temperature"]


def test_every_quantity_is_drawn_in_one_row_and_with_each_axis_in_a_panel_of_its_own(tmp_path: Path) -> None:
    picture = matplotlib.image.imread(in_a_row(sensors(table(), Chambers.words), tmp_path / "sensors.png"))
    assert all(np.mean(part) > 0.001 for part in np.array_split(picture[..., :3].min(axis=2) < 0.5, 4))
    panels = [matplotlib.image.imread(path) for path in apart(sensors(table(), Chambers.words), tmp_path / "sensors.png")]
    assert len(panels) == 4
    assert all(panel.shape[1] < 700 for panel in panels)  # at 150 dots an inch: no wider than a phone
    assert all((panel[..., :3].min(axis=2) < 0.5).mean() > 0.001 for panel in panels)
