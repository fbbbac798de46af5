"""`lab investigate` and `lab power` on fakes: what is done on the rig, kept in the folder, and said."""

from __future__ import annotations

import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from diagnosed_case import ROBOT, campaign, folder
from virtual_lab import VirtualLab

from diagnosis.answer.result import Diagnosis, Ranked
from diagnosis.investigate import Investigation, Round
from diagnosis.judgement import CERTAIN
from lab.cli import main
from lab.files.inputs import read_case
from lab.pages import investigation_page
from lab.verbs.run import Outcome
from model.robot import load_robot
from protocols.errors import NotReached
from recordings.campaign.labels import labels_of
from recordings.file.reader import Recording
from recordings.trials import Table
from tests.diagnosis.small_campaigns import SOME

LONGER = ["--set", "settle.average=16", "--without", "rate"]
"""At twenty times real speed few samples fall into a window, and none into that of a fast ramp."""
WEIGHED = ("chamber_ballooning", "pressure_offset", "base_tilt")


@pytest.fixture(autouse=True)
def few_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "lab.files.own_effects.CATALOGUE", {e: SOME[e] for e in ("chamber_ballooning", "pressure_offset", "base_tilt")}
    )


def told(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, dict[str, Any], str]:
    capsys.readouterr()
    code = main([*map(str, words)])
    out, err = capsys.readouterr()
    return code, json.loads(out) if out.strip().startswith("{") else {}, err


def little(place: Path) -> Path:
    """A case that names nothing: one noisy pressure on the way up, of a robot whose chambers balloon."""
    rows = campaign({"chamber_ballooning.growth": 0.3}, repeats=2, lengths=(0.0, 0.2), pressures=(0.0, 120e3, 240e3))
    return folder(place, [r for r in rows if r.branch == "load"])


def test_an_experiment_is_foretold_done_and_added(
    virtual_lab: VirtualLab, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, place = little(tmp_path / "case"), tmp_path / "why"
    code, found, said = told(
        capsys, "investigate", file, "--rig", virtual_lab.rig, "--out", place, "--experiments", 1, "--no-hands", "--operator",
        "Ada", *LONGER, "--json",
    )  # fmt: skip
    assert code in (0, 3), said
    assert found == {**json.loads((place / "investigation.json").read_text()), **found}
    assert all(name in found["rounds"][0]["not_done"] for name in ("roll", "tip_mass") if name in found["rounds"][0]["not_done"])
    done = [r for r in found["rounds"] if "experiment" in r]
    assert len(done) == len(found["inputs"]) - 1 == 1 and "hands" not in done[0]["experiment"]
    (below,) = [p for p in place.iterdir() if p.is_dir()]
    recording = Recording.open(Path(found["inputs"][1]))
    assert recording.path.parent == below and labels_of(recording) == {"investigation": "why", "operator": "Ada"}
    foretold = json.loads((below / "foretold.json").read_text())
    begun = time.mktime(time.strptime(recording.path.stem[-15:], "%Y%m%d-%H%M%S"))
    assert int((below / "foretold.json").stat().st_mtime) <= begun
    rows = read_case([recording.path]).table
    assert all(len(r["tip_mm"]) == len(rows) for r in foretold["rivals"]) and foretold["rivals"]
    answer = Diagnosis.from_json((place / "diagnosis.json").read_text())
    assert answer.data.rows == len(read_case([file]).table) + len(rows)
    assert {"investigation.html", "diagnosis.html"} <= {p.name for p in place.iterdir()}
    named = Ranked(("base_tilt",), 0.39, 0.0, None, {})
    doubted = replace(answer.attribute, effects=("base_tilt",), verdict="effect", probability=0.39,
                      ranking=(Ranked(("unknown",), 0.47, 0.0, None, {}), named))  # fmt: skip
    story = Investigation((Round(replace(answer, attribute=doubted), 3.0),), "done")
    page = investigation_page.write(story, tmp_path / "page.html", "why", "diagnosis.html").read_text()
    assert "tilt of the base with probability 0.39; outside the catalogue with 0.47." in page
    again, _, err = told(capsys, "investigate", file, "--rig", virtual_lab.rig, "--out", place)
    assert again == 2 and "holds an investigation already" in err


def test_a_run_that_fails_leaves_what_is_known_and_the_line_to_go_on_with(
    virtual_lab: VirtualLab, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(rig: object, job: object, place: Path, *more: object, **named: object) -> Outcome:
        return Outcome(place / "none.mcap", "failed", Table(()), {}, True, NotReached("1 usable samples"))

    monkeypatch.setattr("lab.investigation.laboratory.execute", fails)
    file, why = little(tmp_path / "case"), tmp_path / "why"
    words = ["investigate", file, "--rig", virtual_lab.rig, "--out", why, "--no-hands", "--watch", *LONGER]
    assert main([*map(str, words)]) == 1
    out, err = capsys.readouterr()
    (line,) = [line for line in out.splitlines() if line.startswith("go on with: lab investigate ")]
    (experiment,) = [p.name[3:] for p in why.iterdir() if p.is_dir()]
    assert "--no-hands" in line and f"--without rate --without {experiment} --set" in line and "watch it at http://" in out
    assert "1 usable samples" in err and json.loads((why / "investigation.json").read_text())["ended"].startswith("broken")
    assert {"investigation.html", "diagnosis.html"} <= {p.name for p in why.iterdir()}


def test_where_nothing_is_left_to_ask_nothing_moves(
    virtual_lab: VirtualLab, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = folder(tmp_path / "case", campaign({"chamber_ballooning.growth": -0.4}, lengths=(0.0, 0.2)))
    code, found, _ = told(
        capsys, "investigate", case, "--rig", virtual_lab.rig, "--out", tmp_path / "why", "--budget", "0 min", "--json"
    )
    assert code == 0 and len(found["rounds"]) == 1 and not list((tmp_path / "why").glob("*/*.mcap"))
    last = found["rounds"][-1]
    assert last["probability"] >= CERTAIN or all("min" in why for why in last["not_done"].values())


def test_another_robot_s_campaign_is_refused(virtual_lab: VirtualLab, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    case = folder(tmp_path / "case", campaign({}))
    robot = case / "robot.yaml"
    robot.write_text(robot.read_text().replace("length: 0.4", "length: 0.41"))
    assert load_robot(robot).length != ROBOT.length
    code, _, err = told(capsys, "investigate", case, "--rig", virtual_lab.rig, "--out", tmp_path / "why")
    assert code == 2 and "another body" in err and not (tmp_path / "why").exists()
    with pytest.raises(SystemExit, match="2"):
        main(["investigate", str(case), "--rig", str(virtual_lab.rig), "--budget", "5 bananas"])
    assert "bananas" in capsys.readouterr().err


def test_the_power_of_a_plan_is_told_for_a_robot_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    case = folder(tmp_path / "case", campaign({}))
    words = (
        "--set",
        "spine_lengths=[0.0, 0.2]",
        "--set",
        "pressures=[100 kPa, 200 kPa]",
        "--worlds",
        6,
        "--no-additions",
        "--json",
    )
    code, found, _ = told(capsys, "power", "--protocol", "bending", "--robot", case / "robot.yaml", *words, "--json")
    assert code == 0 and found["schema"] == "power/1"
    effects = [e["effect"] for e in found["clean"]["effects"]]
    assert set(effects) | set(found["clean"]["unseen"]) == set(WEIGHED)
    assert found["clean"]["worlds"] == 6 * (1 + len(effects)) and found["additions"] == []
    code, _, err = told(capsys, "power", "--robot", case / "robot.yaml")
    assert code == 2 and "--protocol, --campaign and --case" in err
