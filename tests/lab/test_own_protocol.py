"""A protocol in a file of one's own, on the rig: recorded, concluded, replayed, resumed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from virtual_lab import VirtualLab

from lab.cli import main
from lab.files.example import paper_robot
from recordings.campaign.replay import table_of
from recordings.file.reader import Recording

CREEP = Path(__file__).parents[2] / "examples/protocol/creep.py"


def test_creep_is_run_and_replayed_though_its_plan_forgets_a_state(
    virtual_lab: VirtualLab, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    creep = tmp_path / "creep.py"
    creep.write_text(CREEP.read_text().replace("in zip(p.times, waits, strict=True)", "in zip(p.times[:1], waits)"))
    settings = ("pressure=60 kPa", "times=[10 s, 30 s]", "average=8 s", "spine_length=5 cm")
    how = [word for setting in settings for word in ("--set", setting)]
    code = main(["run", str(creep), "--rig", str(virtual_lab.rig), *how, "--out", str(tmp_path)])
    told = "".join(capsys.readouterr())
    assert code in (0, 3) and "note: 2 states were read, and the plan lists 1:" in told, told
    (file,) = tmp_path.glob("creep-*.mcap")
    recording = Recording.open(file)
    assert recording.attachments["protocol.py"] == creep.read_bytes()
    rows = table_of(recording).rows
    assert [row.protocol for row in rows] == ["creep", "creep"]
    assert [row.hold for row in rows] == pytest.approx([10.0, 30.0], abs=0.5)
    assert all(row.pressures[0] == pytest.approx(60e3, rel=0.05) for row in rows)
    assert main(["replay", str(file)]) == 0 and "bit-identical to the live run's" in capsys.readouterr().out
    assert main(["info", str(file)]) in (0, 3) and "2 states were read, and the plan lists 1" in capsys.readouterr().err


def test_a_staircase_of_a_few_lines_is_planned_run_and_replayed(
    virtual_lab: VirtualLab, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    staircase = CREEP.with_name("staircase.py")
    assert len(staircase.read_text().splitlines()) <= 30
    how = ["--rig", str(virtual_lab.rig)]
    for setting in ("step=30 kPa", "steps=2", "chambers=[9, 1, 2]", "hold=10 s", "repeats=2"):
        how += ["--set", setting]
    assert main(["plan", str(staircase), *how, "--json"]) == 0
    planned = json.loads(capsys.readouterr().out)
    code = main(["run", str(staircase), *how, "--out", str(tmp_path)])
    assert code in (0, 3), "".join(capsys.readouterr())
    (file,) = tmp_path.glob("staircase-*.mcap")
    rows = table_of(Recording.open(file)).rows
    assert len(planned["steps"]) == len(rows) + 2  # and a preparation in each repeat
    assert [(row.repeat, row.branch) for row in rows] == [
        (k, branch) for k in (1, 2) for branch in ("load", "load", "load", "unload", "unload")
    ]
    assert [row.pressures[1] / 30e3 for row in rows] == pytest.approx([0, 1, 2, 1, 0] * 2, abs=0.1)
    assert main(["replay", str(file)]) == 0 and "bit-identical to the live run's" in capsys.readouterr().out


def test_a_mistake_in_run_ends_safe_and_is_told_with_its_line(
    virtual_lab: VirtualLab, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = tmp_path / "own.py"
    text = CREEP.with_name("staircase.py").read_text()
    own.write_text(text.replace("    go_through(bench", "    bench.say(p.stepp)\n    go_through(bench"))
    line = len(own.read_text().splitlines()) - 1
    how = ["--set", "chambers=[9, 1, 2]", "--rig", str(virtual_lab.rig), "--out", str(tmp_path)]
    assert main(["run", str(own), *how]) == 2
    told = capsys.readouterr()
    assert f"{own}:{line}: run: AttributeError: 'Staircase' object has no attribute 'stepp'" in told.err
    (file,) = tmp_path.glob("own-*.mcap")
    assert Recording.open(file).outcome == "failed" and "safe state confirmed" in Recording.open(file).log[-1].text


def test_a_mistake_in_the_defaults_for_a_robot_is_told_with_its_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "robot.yaml").write_text(paper_robot().read_text())
    (tmp_path / "rig.yaml").write_text("name: bench\nrobot: robot.yaml\ninstruments: {}\n")
    own = tmp_path / "own.py"
    text = CREEP.with_name("staircase.py").read_text()
    defaults = '    @classmethod\n    def defaults_for(cls, robot):\n        return {"chambers": robot.azimuths}\n'
    own.write_text(text.replace("class Staircase(Parameters):\n", f"class Staircase(Parameters):\n{defaults}\n"))
    assert main(["plan", str(own), "--rig", str(tmp_path / "rig.yaml")]) == 2
    told = capsys.readouterr().err
    assert f"{own}:" in told and "'RobotFacts' object has no attribute 'azimuths'" in told and "Traceback" not in told
