"""`lab info` shows the streams that were used, `lab runs` what was read of the plan and which run continued which."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from lab.cli import main
from recordings.campaign.info import info
from recordings.campaign.resumed import metadata
from recordings.file.writer import Recorder
from recordings.states.rules import State, Window
from recordings.trials import TrialRow

TOPICS = ("/pressure", "/tip", "/spine", "/vacuum", "/force", "/arm", "/valve", "/state", "/trial")
PRESSURES = (30e3, 0.0, 0.0)
PLAN = {"protocol": "puffs", "states": 2}
RIG = b"""poll: 20 Hz
clock: {speed: 10}
instruments: {mocap: {rate: 60}}
"""


def recorded(path: Path, day: int, states: int, plan: object, campaign: str = "", rig: bytes = RIG) -> Path:
    """A run of three chambers with a pressure stream of 2 Hz in rig time, and `states` states that are asked for."""
    recorder = Recorder(
        path,
        start_wall_ns=1_750_000_000 * 10**9 + day * 86_400 * 10**9,
        attachments={"rig.yaml": rig, "plan.json": json.dumps(plan).encode()},
        metadata=metadata(campaign, "run.journal", 1) if campaign else {},
        chambers=3,
    )
    for k in range(40):
        recorder.push("/pressure", k * 0.5, (PRESSURES, PRESSURES))
    for number in range(1, states + 1):
        state = State(
            trial=1, step=number, protocol="bending", repeat=1, branch="load", rule=Window(0.5), t_start=0.0, ramp_end=0.0,
            rate=0.0, targets=PRESSURES, spine_length=0.1, tip_mass=0.0, topics=("/pressure",),
        )  # fmt: skip
        recorder.state(number * 0.5, state)
    recorder.close("completed")
    return path


def test_info_shows_used_streams_with_nominal_rates_in_rig_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = recorded(tmp_path / "a.mcap", 0, 3, {"protocol": "bending", "states": 7})
    assert main(["info", str(file)]) == 0
    told = capsys.readouterr().out
    rows = {words[0]: words for line in told.splitlines() if (words := line.split()) and words[0] in TOPICS}
    assert set(rows) == {"/pressure", "/state"}  # the recorder has a topic for each instrument of a rig
    assert rows["/pressure"][1:4] == ["40", "2.0", "2.0"] and rows["/state"] == ["/state", "3", "0", "0"]
    assert "its clock ran at 10 times real speed" in told and "0 of 7 planned states read" in told
    assert "p50/p99/max" in told and "…" not in told


@pytest.mark.parametrize("rig", [b"\xff", b"[1, 2]", b"poll: fast\nclock: 3\n", b"clock: {speed: -2}\npoll: 0\n"])
@pytest.mark.parametrize("plan", [[], {"protocol": "bending", "states": "many"}, {"protocol": "x", "states": -4}])
def test_a_rig_or_plan_that_says_nothing_is_left_out(
    rig: bytes, plan: object, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = recorded(tmp_path / "a.mcap", 0, 2, plan, rig=rig)
    assert main(["info", str(file)]) == 0
    told = capsys.readouterr().out
    assert "times real speed" not in told and "0 of 2 states read" in told and info(file).planned == 0


def test_runs_count_against_the_plan_and_name_the_run_that_continues(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan = {"protocol": "bending", "states": 9}
    recorded(tmp_path / "early.mcap", 0, 2, plan, "one")
    recorded(tmp_path / "other.mcap", 1, 4, {"protocol": "bending"}, "two")
    recorded(tmp_path / "later.mcap", 2, 7, plan, "one")
    assert main(["runs", str(tmp_path)]) == 0
    told = capsys.readouterr().out
    assert told.count("0 of 9 planned") == 2 and "0 of 4" in told
    assert [line for line in told.splitlines() if "continued" in line] == ["early.mcap: continued in later.mcap"]
    assert main(["runs", str(tmp_path), "--json"]) == 0
    assert [run["planned"] for run in json.loads(capsys.readouterr().out)] == [9, 0, 9]


def test_states_beyond_the_plan_are_told_but_not_those_that_were_read_again(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.mcap", start_wall_ns=10**18, attachments={"plan.json": json.dumps(PLAN).encode()})
    for number, step in enumerate((1, 2, 2, 2, 3), 1):
        row = TrialRow(1, step, "puffs", 1, "load", float(number), 0.1, PRESSURES)
        recorder.trial(float(number), number, row, repeats=number - 1 if step == 2 and number > 2 else 0)
        recorder.sync()
        told = info(recorder.path).notes
        assert ("states were read, and the plan lists 2" in "".join(told)) is (step == 3), told
    recorder.close("completed")
    assert info(recorder.path).rows == 3
