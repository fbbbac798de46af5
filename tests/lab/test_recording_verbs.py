"""`lab info`, `runs`, `replay` and `export` of one recording, of several, and of a torn one next to what was recovered of it."""

import json
import shutil
from pathlib import Path

import pytest
from commands import Cli

from lab.files.inputs import marked_notes, read_case, same_body
from lab.files.robot_file import paper_robot
from lab.verbs.run import recording_of
from recordings.campaign.info import info
from recordings.campaign.replay import metadata
from recordings.file.reader import Recording
from recordings.file.writer import Recorder
from recordings.states.rules import Window
from recordings.trials import Table, TrialRow
from tests.recordings.synthetic_run import OLD, state

TOPICS = ("/pressure", "/tip", "/spine", "/vacuum", "/force", "/arm", "/valve", "/state", "/trial")
PRESSURES = (30e3, 0.0, 0.0)
PLAN = {"protocol": "puffs", "states": 2}
RIG = b"poll: 20 Hz\nclock: {speed: 10}\ninstruments: {mocap: {rate: 60}}\n"


# ------------------------------------------------------------------ several
def test_each_of_several_recordings_is_told_by_its_name(tmp_path: Path, cli: Cli) -> None:
    two = [Path(shutil.copy(OLD, tmp_path / name)) for name in ("first.mcap", "second.mcap")]
    whole = cli("replay", two[0], "--json", code=(0, 1, 3))
    assert cli("replay", *two, "--json", code=whole.returncode).json == [{"file": str(file), **whole.json} for file in two]
    said = cli("info", *two, code=cli("info", two[0], code=(0, 1, 3)).returncode).out
    assert all(file.name in said.replace("\n", "") for file in two)


def test_names_sort_as_the_runs_began(tmp_path: Path) -> None:
    begun = [1_790_000_000_000_000_000 + ms * 1_000_000 for ms in (250, 714, 999, 1000)]
    files = []
    for started_ns in begun:
        files.append(recording_of(tmp_path, "bending", started_ns))
        files[-1].touch()
    assert sorted(tmp_path.glob("*.mcap")) == files and len(set(files)) == len(begun)


# ------------------------------------------------------------------ torn and recovered
@pytest.fixture
def torn(tmp_path: Path, cli: Cli) -> tuple[Path, Path]:
    """A recording without its end, and what `lab recover` saved of it."""
    file = tmp_path / "sweep.mcap"
    file.write_bytes(OLD.read_bytes()[:-9000])
    cli("recover", file, code=3)
    return file, tmp_path / "sweep-recovered.mcap"


@pytest.mark.parametrize("words", [["replay"], ["export", "--out", "streams"], ["export", "--case", "--out", "case"]])
def test_a_torn_recording_is_left_out_where_its_recovered_file_is_given(
    torn: tuple[Path, Path], words: list[str], tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    told = cli(words[0], *(file.name for file in torn), *words[1:]).err
    assert told.count("note: sweep.mcap: not read") == 1 and "sweep-recovered.mcap" in told
    again = ["--replace"] if words[0] == "export" else []
    assert "lab recover" in cli(words[0], "sweep.mcap", *words[1:], *again, code=1).err  # alone it is refused as before


def test_a_whole_recording_counts_and_not_what_was_recovered_of_it_earlier(torn: tuple[Path, Path], cli: Cli) -> None:
    file, saved = torn
    shutil.copy(OLD, file)
    done = cli("replay", saved, file, "--json")
    assert done.json["replayed"] == len(Recording.open(OLD).trials)
    assert "sweep-recovered.mcap: not read" in done.err.replace("\n", "")


def test_a_refused_export_leaves_no_folder(torn: tuple[Path, Path], tmp_path: Path, cli: Cli) -> None:
    cli("export", torn[0], "--out", tmp_path / "new" / "streams", code=1)
    assert not (tmp_path / "new").exists()
    (tmp_path / "old").mkdir()
    cli("export", torn[0], "--out", tmp_path / "old", code=1)
    assert (tmp_path / "old").exists()


# ------------------------------------------------------------------ info and runs
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
        recorder.state(number * 0.5, state(step=number, targets=PRESSURES, topics=("/pressure",)))
    recorder.close("completed")
    return path


def test_info_shows_used_streams_with_nominal_rates_in_rig_time(tmp_path: Path, cli: Cli) -> None:
    told = cli("info", recorded(tmp_path / "a.mcap", 0, 3, {"protocol": "bending", "states": 7})).out
    rows = {words[0]: words for line in told.splitlines() if (words := line.split()) and words[0] in TOPICS}
    assert set(rows) == {"/pressure", "/state"}  # the recorder has a topic for each instrument of a rig
    assert rows["/pressure"][1:4] == ["40", "2.0", "2.0"] and rows["/state"] == ["/state", "3", "0", "0"]
    assert "its clock ran at 10 times real speed" in told and "0 of 7 planned states read" in told
    assert "p50/p99/max" in told and "…" not in told


@pytest.mark.parametrize("rig", [b"\xff", b"[1, 2]", b"poll: fast\nclock: 3\n", b"clock: {speed: -2}\npoll: 0\n"])
@pytest.mark.parametrize("plan", [[], {"protocol": "bending", "states": "many"}, {"protocol": "x", "states": -4}])
def test_a_rig_or_plan_that_says_nothing_is_left_out(rig: bytes, plan: object, tmp_path: Path, cli: Cli) -> None:
    file = recorded(tmp_path / "a.mcap", 0, 2, plan, rig=rig)
    told = cli("info", file).out
    assert "times real speed" not in told and "0 of 2 states read" in told and info(file).planned == 0


def test_runs_count_against_the_plan_and_name_the_run_that_continues(tmp_path: Path, cli: Cli) -> None:
    plan = {"protocol": "bending", "states": 9}
    recorded(tmp_path / "early.mcap", 0, 2, plan, "one")
    recorded(tmp_path / "other.mcap", 1, 4, {"protocol": "bending"}, "two")
    recorded(tmp_path / "later.mcap", 2, 7, plan, "one")
    told = cli("runs", tmp_path).out
    assert told.count("0 of 9 planned") == 2 and "0 of 4" in told
    assert [line for line in told.splitlines() if "continued" in line] == ["early.mcap: continued in later.mcap"]
    assert [run["planned"] for run in cli("runs", tmp_path, "--json").json] == [9, 0, 9]


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


# ------------------------------------------------------------------ losses
def test_a_recording_that_ended_abruptly_says_that_its_losses_are_unknown(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap", start_wall_ns=10**18)
    recorder.push("/valve", 0.1, on=True)
    recorder.sync()
    valve = info(tmp_path / "a.mcap").streams["/valve"]
    assert (valve.timing.count, valve.dropped, valve.lost) == (1, None, None)
    recorder.close("completed")


# ------------------------------------------------------------------ the robot of a recording
def test_a_robot_stays_the_same_when_the_pressure_it_bears_is_written_down() -> None:
    now = paper_robot().read_bytes()
    before = b"\n".join(line for line in now.splitlines() if not line.startswith(b"max_pressure"))
    assert same_body(before, now) and len(before) < len(now) - 20
    assert not same_body(before, now.replace(b"length: 0.40", b"length: 0.41"))
    assert not same_body(before, b"no robot") and not same_body(b"\xff", now) and same_body(b"no robot", b"no robot")


def test_clipped_states_are_counted_and_named() -> None:
    rows = [TrialRow(1, step, "bending", 1, "load", 0.0, 0.0, (0.0,), clipped=step != 2) for step in range(1, 10)]
    assert marked_notes(Table.of([rows[1]])) == []
    (note,) = marked_notes(Table.of(rows))
    assert "8 of 9 states" in note and "trial 1 step 1, 3, 4" in note and "and 3 more; " in note
    assert "the pressures read are right" in note and "max_rate" in note


def test_the_robot_that_travels_with_a_recording_is_the_one_that_is_used(tmp_path: Path, cli: Cli) -> None:
    own = paper_robot().read_bytes().replace(b"length: 0.40", b"length: 0.41")
    (tmp_path / "robot.yaml").write_bytes(paper_robot().read_bytes())  # what the rig has by now
    none = (0.0,) * 9
    read = TrialRow(1, 1, "bending", 1, "load", 1.0, 0.0, none, tip_mass=0.053, tip=(0.0, 0.0, 0.42))
    with Recorder(tmp_path / "run.mcap", start_wall_ns=10**18, attachments={"robot.yaml": own}) as recorder:
        asked = state(rule=Window(0.0), t_start=1.0, ramp_end=1.0, targets=none, spine_length=0.0, tip_mass=0.053)
        recorder.trial(1.0, recorder.state(1.0, asked), read)
    case = read_case([recorder.path])
    assert case.robot.length == 0.41 and list(case.table) == [read]
    cli("export", "--case", "--out", tmp_path / "case", recorder.path)
    assert (tmp_path / "case" / "robot.yaml").read_bytes() == own
    assert read_case([recorder.path], tmp_path / "robot.yaml").robot.length == 0.40  # only where a person says so
