"""What a diagnosis proposes can be done: `lab run` takes every protocol file, and the rig reads the states foreseen."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from diagnosed_case import ROBOT, campaign
from virtual_lab import VirtualLab

from diagnosis.answer.experiments import Experiment, candidate_experiments, columns
from diagnosis.answer.result import Proposal
from diagnosis.data.case import states
from lab.cli import main
from lab.files.all_protocols import found_protocols
from lab.files.inputs import Case, read_case
from lab.verbs.diagnose import write_protocols
from lab.verbs.run import protocol_plan
from protocols.parameters import RobotFacts
from recordings.trials import Table

MENU = {
    "unload", "orientation", "markers", "elongation", "other_chambers", "roll", "tip_mass", "hold", "vacuum", "rate",
    "lengths", "pressures",
}  # fmt: skip


def offered() -> dict[str, Experiment]:
    """The whole menu: what is offered after a campaign that read tips on the way up and nothing else."""
    robot = ROBOT.model_copy(update={"markers": (0.1, 0.2, 0.3)})
    rows = [replace(r, orientation=None) for r in campaign({}) if r.branch == "load"]
    return {e.id: e for e in candidate_experiments(robot, states(Case(robot, Table(tuple(rows))))[0])}


def file(folder: Path, e: Experiment, **changes: object) -> Path:
    """The protocol file of an experiment, some of its parameters changed."""
    (path,) = write_protocols([Proposal(e.id, e.do, (), 0.1, e.minutes, {**e.parameters, **changes})], folder, ROBOT)
    return path


def planned(path: Path, virtual_lab: VirtualLab, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    """What `lab plan` says of a protocol file."""
    capsys.readouterr()
    assert main(["plan", str(path), "--rig", str(virtual_lab.rig), "--json"]) == 0, capsys.readouterr().err
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def test_the_whole_menu_is_tried() -> None:
    assert set(offered()) == MENU


def test_a_proposal_is_written_with_units_and_reads_as_it_was_meant(tmp_path: Path) -> None:
    for experiment in offered().values():
        path = file(tmp_path, experiment)
        written = yaml.safe_load(path.read_text())
        assert all(str(p).endswith(" kPa") for p in written.get("pressures", []))
        name = experiment.parameters["protocol"]
        values = {key: value for key, value in experiment.parameters.items() if key != "protocol"}
        meant = found_protocols().usable[name].parameters.model_validate(values)
        assert protocol_plan(str(path), [], RobotFacts(9, (), meant.tip_mass, True))[1] == meant


@pytest.mark.parametrize("id", sorted(MENU))
def test_every_proposal_is_a_protocol_of_the_rig_and_takes_as_long_as_was_said(
    id: str, virtual_lab: VirtualLab, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    experiment = offered()[id]
    plan = planned(file(tmp_path, experiment), virtual_lab, capsys)
    assert plan["protocol"] == experiment.parameters["protocol"]
    assert plan["limits"]["pressure_pa"] <= 250e3 and plan["limits"]["spine_length_m"] <= 0.3
    said = experiment.minutes - experiment.hands
    assert 0.5 * said < plan["seconds"] / 60 < 2 * said


SHORT: Mapping[str, object] = {"spine_lengths": [0.0], "pressures": [50e3, 100e3], "repeats": 1}


@pytest.mark.parametrize(("id", "more"), [("elongation", {}), ("hold", {"hold_times": [5.0, 20.0]})], ids=["elongation", "hold"])
def test_the_rig_reads_the_states_that_were_foreseen(
    virtual_lab: VirtualLab, tmp_path: Path, id: str, more: Mapping[str, object]
) -> None:
    experiment = offered()[id]
    short = replace(experiment, parameters={**experiment.parameters, **SHORT, **more})
    path = file(tmp_path / "next", short)
    assert main(["run", str(path), "--rig", str(virtual_lab.rig), "--out", str(tmp_path)]) in (0, 3)
    (recording,) = tmp_path.glob("*.mcap")
    rows = read_case([recording]).table.rows
    foreseen = columns(short.parameters, 9, ("x", "y", "z"))
    assert [r.branch for r in rows] == foreseen["branch"].tolist()
    assert [r.protocol for r in rows] == foreseen["protocol"].tolist()
    assert [r.spine_length for r in rows] == pytest.approx(foreseen["spine_length"].tolist(), abs=2e-3)
    for c in range(9):
        assert [r.pressures[c] for r in rows] == pytest.approx(foreseen[f"p{c + 1}"].tolist(), abs=4e3)
    if id == "hold":
        assert [r.hold for r in rows] == pytest.approx(foreseen["hold"].tolist(), abs=0.5)
    assert all(r.tip is not None for r in rows)
