"""Which robots count as the same, and what is told of clipped states."""

from __future__ import annotations

from pathlib import Path

import pytest

from lab.cli import main
from lab.files.example import paper_robot
from lab.files.inputs import marked_notes, read_case, same_body
from recordings.file.writer import Recorder
from recordings.states.rules import State, Window
from recordings.trials import Table, TrialRow


def row(step: int, clipped: bool) -> TrialRow:
    return TrialRow(
        trial=1, step=step, protocol="bending", repeat=1, branch="load", t=0.0, spine_length=0.0, pressures=(0.0,),
        clipped=clipped,
    )  # fmt: skip


def test_a_robot_stays_the_same_when_the_pressure_it_bears_is_written_down() -> None:
    now = paper_robot().read_bytes()
    before = b"\n".join(line for line in now.splitlines() if not line.startswith(b"max_pressure"))
    assert same_body(before, now) and len(before) < len(now) - 20
    assert not same_body(before, now.replace(b"length: 0.40", b"length: 0.41"))
    assert not same_body(before, b"no robot") and not same_body(b"\xff", now) and same_body(b"no robot", b"no robot")


def test_clipped_states_are_counted_and_named() -> None:
    assert marked_notes(Table((row(1, False),))) == []
    (note,) = marked_notes(Table(tuple(row(step, step != 2) for step in range(1, 10))))
    assert "8 of 9 states" in note and "trial 1 step 1, trial 1 step 3" in note and "and 3 more; " in note
    assert "the pressures read are right" in note and "max_rate" in note


def test_the_robot_that_travels_with_a_recording_is_the_one_that_is_used(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = paper_robot().read_bytes().replace(b"length: 0.40", b"length: 0.41")
    (tmp_path / "robot.yaml").write_bytes(paper_robot().read_bytes())  # what the rig has by now
    none = (0.0,) * 9
    read = TrialRow(1, 1, "bending", 1, "load", 1.0, 0.0, none, tip_mass=0.053, tip=(0.0, 0.0, 0.42))
    with Recorder(tmp_path / "run.mcap", start_wall_ns=10**18, attachments={"robot.yaml": own}) as recorder:
        state = State(1, 1, "bending", 1, "load", Window(0.0), 1.0, 1.0, 0.0, none, 0.0, 0.053)
        recorder.trial(1.0, recorder.state(1.0, state), read)
    case = read_case([recorder.path])
    assert case.robot.length == 0.41 and list(case.table) == [read]
    assert main(["export", "--case", "--out", str(tmp_path / "case"), str(recorder.path)]) == 0
    assert (tmp_path / "case" / "robot.yaml").read_bytes() == own
    assert read_case([recorder.path], tmp_path / "robot.yaml").robot.length == 0.40  # only where a person says so
    capsys.readouterr()
