"""`lab investigate` and `lab power` on fakes, and whether the rig can do what a diagnosis proposes."""

import functools
import json
import shutil
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from commands import SOUND, Cli
from diagnosed_case import ROBOT, campaign, folder
from virtual_lab import VirtualLab, settings

from diagnosis.answer.experiments import candidate_experiments, columns, to_apply
from diagnosis.answer.result import Diagnosis, Proposal, Ranked
from diagnosis.data.case import states
from diagnosis.investigate import Investigation, Round
from lab.files.all_protocols import found_protocols
from lab.files.inputs import Case, read_case
from lab.files.robot_file import paper_robot
from lab.investigation.command import write_page
from lab.verbs.diagnose import write_protocols
from lab.verbs.run import Outcome, protocol_plan, source_of
from model.robot import load_robot
from protocols.errors import NotReached
from protocols.parameters import RobotFacts
from recordings.campaign.labels import RECORD
from recordings.file.reader import Recording
from recordings.trials import Table
from tests.diagnosis.small_campaigns import SOME, examined_once

LONGER = ["--set", "settle.average=16", "--without", "rate"]
"""At twenty times real speed few samples fall into a window, and none into that of a fast ramp."""
WEIGHED = ("chamber_ballooning", "base_tilt")


@pytest.fixture(autouse=True)
def few_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lab.files.own_effects.CATALOGUE", {effect: SOME[effect] for effect in WEIGHED})
    monkeypatch.setattr("diagnosis.investigate.examine", examined_once)


def little(place: Path) -> Path:
    """A case that names nothing: one noisy pressure on the way up, of a robot whose chambers balloon."""
    rows = campaign({"chamber_ballooning.growth": 0.12}, repeats=2, lengths=(0.0, 0.2), pressures=(0.0, 120e3, 240e3))
    return folder(place, [r for r in rows if r.branch == "load"])


def test_an_experiment_is_predicted_done_and_added(virtual_lab: VirtualLab, tmp_path: Path, cli: Cli) -> None:
    file, place, rig = little(tmp_path / "case"), tmp_path / "why", virtual_lab.rig.with_name("console.yaml")
    rig.write_text(yaml.safe_dump({**yaml.safe_load(virtual_lab.rig.read_text()), "operator": "console"}))
    words = ("--experiments", 1, "--yes", "--operator", "Ada", *LONGER, "--json")
    found = cli("investigate", file, "--rig", rig, "--out", place, *words, code=SOUND).json
    assert found == {**json.loads((place / "investigation.json").read_text()), **found}
    done = [r for r in found["rounds"] if "experiment" in r]
    assert len(done) == len(found["inputs"]) - 1 == 1 and "hands" not in done[0]["experiment"]
    (below,) = [p for p in place.iterdir() if p.is_dir()]
    recording = Recording.open(Path(found["inputs"][1]))
    assert recording.path.parent == below and recording.metadata[RECORD] == {"investigation": "why", "operator": "Ada"}
    predicted = json.loads((below / "predicted.json").read_text())
    begun = time.mktime(time.strptime(recording.path.stem[-15:], "%Y%m%d-%H%M%S"))
    assert int((below / "predicted.json").stat().st_mtime) <= begun
    rows = read_case([recording.path]).table
    assert all(len(r["tip_mm"]) == len(rows) for r in predicted["rivals"]) and predicted["rivals"]
    answer = Diagnosis.from_json((place / "diagnosis.json").read_text())
    assert answer.data.rows == len(read_case([file]).table) + len(rows)
    assert {"investigation.html", "diagnosis.html"} <= {p.name for p in place.iterdir()}
    named = Ranked(("base_tilt",), 0.39, 0.0, None, {})
    doubted = replace(answer.attribute, effects=("base_tilt",), verdict="effect", probability=0.39,
                      ranking=(Ranked(("unknown",), 0.47, 0.0, None, {}), named))  # fmt: skip
    story = Investigation((Round(replace(answer, attribute=doubted), 3.0),), "done")
    page = write_page(story, tmp_path / "page.html", "why", "diagnosis.html").read_text()
    assert "tilt of the base with probability 0.39; outside the catalogue with 0.47." in page
    assert "already holds an investigation" in cli("investigate", file, "--rig", virtual_lab.rig, "--out", place, code=2).err


def test_a_run_that_fails_leaves_what_is_known_and_the_line_to_go_on_with(
    virtual_lab: VirtualLab, tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(rig: object, job: object, place: Path, *more: object, **named: object) -> Outcome:
        return Outcome(place / "none.mcap", "failed", Table(), {}, True, NotReached("1 usable samples"))

    monkeypatch.setattr("lab.investigation.command.execute", fails)
    file, why = little(tmp_path / "case"), tmp_path / "why"
    words = ["investigate", file, "--rig", virtual_lab.rig, "--out", why, "--no-hands", "--watch", *LONGER]
    _, out, err = cli(*words, code=1)
    (line,) = [line for line in out.splitlines() if line.startswith("go on with: lab investigate ")]
    (experiment,) = [p.name[3:] for p in why.iterdir() if p.is_dir()]
    assert "--no-hands" in line and f"--without rate --without {experiment} --set" in line and "watch it at http://" in out
    assert "1 usable samples" in err and json.loads((why / "investigation.json").read_text())["ended"].startswith("stopped early")
    assert {"investigation.html", "diagnosis.html"} <= {p.name for p in why.iterdir()}


def test_where_nothing_is_left_to_ask_nothing_moves(virtual_lab: VirtualLab, tmp_path: Path, cli: Cli) -> None:
    case, why = little(tmp_path / "case"), tmp_path / "why"
    found = cli("investigate", case, "--rig", virtual_lab.rig, "--out", why, "--budget", "0 min", "--json").json
    assert len(found["rounds"]) == 1 and not list(why.glob("*/*.mcap"))
    not_done = found["rounds"][0]["not_done"]
    assert not_done and all("min" in reason for reason in not_done.values())


def test_another_robot_s_campaign_is_refused(virtual_lab: VirtualLab, small_case: Path, tmp_path: Path, cli: Cli) -> None:
    case = Path(shutil.copytree(small_case, tmp_path / "case"))
    robot = case / "robot.yaml"
    robot.write_text(robot.read_text().replace("length: 0.4", "length: 0.41"))
    assert load_robot(robot).length != ROBOT.length
    assert "another body" in cli("investigate", case, "--rig", virtual_lab.rig, "--out", tmp_path / "why", code=2).err
    assert not (tmp_path / "why").exists()
    assert "bananas" in cli("investigate", case, "--rig", virtual_lab.rig, "--budget", "5 bananas", code=2).err


def test_the_power_of_a_plan_is_told_for_a_robot_alone(cli: Cli) -> None:
    plan = settings("spine_lengths=[0.0, 0.2]", "pressures=[100 kPa, 200 kPa]")
    words = ("--robot", paper_robot(), *plan, "--worlds", 6, "--no-additions", "--json")
    found = cli("power", "--protocol", "bending", *words).json
    assert found["schema"] == "power/1"
    effects = [e["effect"] for e in found["clean"]["effects"]]
    assert set(effects) | set(found["clean"]["unseen"]) == set(WEIGHED)
    assert found["clean"]["worlds"] == 6 * (1 + len(effects)) and found["additions"] == []
    assert "--protocol, --campaign and --case" in cli("power", "--robot", paper_robot(), code=2).err


# ------------------------------------------------------------------ what is proposed can be done
MENU = {
    "unload", "orientation", "markers", "elongation", "other_chambers", "roll", "tip_mass", "hold", "vacuum", "rate",
    "lengths", "pressures",
}  # fmt: skip


@functools.cache
def offered(max_pressure: float | None = ROBOT.max_pressure) -> dict[str, Proposal]:
    """The whole menu: what is offered after a campaign that read tips on the way up and nothing else."""
    robot = ROBOT.model_copy(update={"markers": (0.1, 0.2, 0.3), "max_pressure": max_pressure})
    rows = [replace(r, orientation=None) for r in campaign({}) if r.branch == "load"]
    return {e.id: e for e in candidate_experiments(robot, states(Case(robot, Table.of(rows)))[0])}


def written(folder: Path, e: Proposal, **changes: object) -> Path:
    """The protocol file of an experiment, some of its parameters changed."""
    _, path = write_protocols([replace(e, protocol={**e.protocol, **changes})], folder, ROBOT)
    return path


def test_a_proposal_is_written_with_units_and_reads_as_it_was_meant(tmp_path: Path) -> None:
    assert set(offered()) == MENU
    for experiment in offered().values():
        path = written(tmp_path, experiment)
        assert all(str(p).endswith(" kPa") for p in yaml.safe_load(path.read_text()).get("pressures", []))
        name = experiment.protocol["protocol"]
        values = {key: value for key, value in experiment.protocol.items() if key != "protocol"}
        meant = found_protocols().usable[name].parameters.model_validate(values)
        assert protocol_plan(source_of(str(path)), RobotFacts(9, (), meant.tip_mass, True))[1] == meant


@pytest.mark.parametrize(("most", "limit"), [(150e3, 150e3), (239_970.0, 239_970.0), (None, 240e3)])
def test_no_proposal_is_above_the_robots_limit_also_as_it_is_printed(most: float | None, limit: float) -> None:
    asked = [to_apply(e.protocol, ROBOT.actuators.words).partition(": ")[2].partition(" kPa")[0] for e in offered(most).values()]
    assert max(float(p) for levels in asked for p in levels.split(", ")) == limit / 1e3


@pytest.mark.parametrize("id", sorted(MENU))
def test_every_proposal_is_a_protocol_of_the_rig_and_takes_as_long_as_was_said(
    id: str, virtual_lab: VirtualLab, tmp_path: Path, cli: Cli
) -> None:
    experiment = offered()[id]
    plan = cli("plan", written(tmp_path, experiment), "--rig", virtual_lab.rig, "--json").json
    assert plan["protocol"] == experiment.protocol["protocol"]
    assert plan["limits"]["pressure_pa"] <= 250e3 and plan["limits"]["spine_length_m"] <= 0.3
    said = experiment.cost_min - experiment.hands_min
    assert 0.5 * said < plan["seconds"] / 60 < 2 * said


SHORT: Mapping[str, object] = {"spine_lengths": [0.0], "pressures": [50e3, 100e3], "repeats": 1}


@pytest.mark.parametrize(("id", "more"), [("elongation", {}), ("hold", {"hold_times": [5.0, 20.0]})], ids=["elongation", "hold"])
def test_the_rig_reads_the_states_that_were_foreseen(
    virtual_lab: VirtualLab, tmp_path: Path, id: str, more: Mapping[str, object], cli: Cli
) -> None:
    experiment = offered()[id]
    short = replace(experiment, protocol={**experiment.protocol, **SHORT, **more})
    cli("run", written(tmp_path / "next", short), "--rig", virtual_lab.rig, "--out", tmp_path, code=(0, 3))
    (recording,) = tmp_path.glob("*.mcap")
    rows = read_case([recording]).table.rows
    foreseen = columns(short.protocol, 9, ("x", "y", "z"))
    assert [r.branch for r in rows] == foreseen["branch"].tolist()
    assert [r.protocol for r in rows] == foreseen["protocol"].tolist()
    assert [r.spine_length for r in rows] == pytest.approx(foreseen["spine_length"].tolist(), abs=2e-3)
    for c in range(9):
        assert [r.pressures[c] for r in rows] == pytest.approx(foreseen[f"p{c + 1}"].tolist(), abs=4e3)
    if id == "hold":
        assert [r.hold for r in rows] == pytest.approx(foreseen["hold"].tolist(), abs=0.5)
    assert all(r.tip is not None for r in rows)
